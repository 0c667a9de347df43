"""The watch over rests alone while the noise of a sensor changes and its calibration does not.

Rows at ten a second of 40 rests of a minute in 10 h, no gyros, a hole that builds from 5 to 70 deg, a random toolface
each. From the 20th on the noise of one axis, or of all, is 1.5 to 12 times what it was (log-uniform), white or 1/f (10
ug of the mean of a rest, as a good tool has it). `--step` adds a step of 0.5 to 2 mg of an offset at the same time,
which must be found all the same.

    python -m studies.watch_noise --series 100 --first-seed 61000
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

import highside
from highside.arrays import Array
from highside.calibration.applied import corrected_accel
from highside.watch import Watch, WatchResult, prior_of_record
from highside.watch.live import LiveRows, LiveWatch
from studies.survey_analysis import calibration

RATE_HZ, LASTS_S, APART_S = 10.0, 60.0, 900.0
RESTS, FROM = 40, 20
WHITE_G = 3e-4
"""of a row"""
FLICKER_G = 1e-5
"""of the mean of a rest"""
FACTORS = 1.5, 12.0
STEPS_G = 5e-4, 2e-3
WAYS = ("white", "1/f")
COLUMNS = ("ax_g", "ay_g", "az_g")


@dataclass(frozen=True)
class Series:
    """What happens to the axes at rest `FROM`: factors (3,) of their noise, steps (3,) of their offsets, g."""

    colour: str
    factors: Array
    step_g: Array


def rows_of(seed: int, what: Series) -> dict[str, Array]:
    """Columns of a recording: rests, and between them a quick change of attitude."""
    rng = np.random.default_rng(seed)
    b, S = 5e-5 * rng.standard_normal(3), 5e-5 * rng.standard_normal((3, 3))
    times, parts = [], []
    for k in range(RESTS):
        inclination, toolface = np.radians(np.interp(k, [0, RESTS - 1], [5.0, 70.0])), rng.uniform(0.0, 2.0 * np.pi)
        s, c = np.sin(inclination), np.cos(inclination)
        f = (np.eye(3) + S) @ np.array([s * np.cos(toolface), s * np.sin(toolface), c]) + b
        noise = WHITE_G * rng.standard_normal((3, int(LASTS_S * RATE_HZ)))
        if what.colour == "1/f":
            noise = noise + flicker(rng, noise.shape[1])
        changed = k >= FROM
        rest = (f + what.step_g * changed)[:, None] + (what.factors[:, None] if changed else 1.0) * noise
        moved = f[:, None] + 0.2 * rng.standard_normal((3, int(20.0 * RATE_HZ)))
        for start, part in ((0.0, rest), (LASTS_S + 5.0, moved)):
            times.append(APART_S * k + start + np.arange(part.shape[1]) / RATE_HZ)
            parts.append(part)
    readings = np.hstack(parts)
    columns = dict(zip(COLUMNS, readings, strict=True))
    return {"t_s": np.concatenate(times), "temp_c": np.full(readings.shape[1], 25.0), **columns}


def flicker(rng: np.random.Generator, count: int) -> Array:
    """(3, count) g of 1/f noise whose mean over `count` rows scatters by `FLICKER_G`."""
    whole = 8 * count
    frequencies = np.arange(1, whole // 2 + 1)
    lines = np.exp(2j * np.pi * rng.random((3, frequencies.size))) / np.sqrt(frequencies)
    made = np.fft.irfft(np.hstack([np.zeros((3, 1)), lines]), whole)[:, :count] * whole / np.sqrt(2.0)
    # variance of the mean: of the lines slower than the rest, all; of the others next to nothing
    return np.asarray(FLICKER_G / np.sqrt(np.sum(np.sinc(frequencies / 8.0) ** 2 / frequencies)) * made)


def drawn(rng: np.random.Generator, colour: str, *, step: bool) -> Series:
    """Which axes, how much, and by how much an offset steps."""
    factor = np.exp(rng.uniform(*np.log(FACTORS)))
    axis, whole = int(rng.integers(3)), rng.random() < 0.25
    factors = np.where(whole | (np.arange(3) == axis), factor, 1.0)
    size = np.exp(rng.uniform(*np.log(STEPS_G))) * rng.choice([-1.0, 1.0])
    return Series(colour, factors, np.where(np.arange(3) == rng.integers(3), size * step, 0.0))


@dataclass(frozen=True)
class Said:
    """Of one series."""

    departs: bool
    axes_right: bool
    error: float
    """of the factor, relative, the largest of the axes that are named"""
    rests: int


def streamed(rows: dict[str, Array]) -> WatchResult:
    """What a service says of the same rows, which judges each stretch by itself."""
    record = calibration().record
    live, watch = LiveRows(), LiveWatch(Watch(prior_of_record(record)))
    corrected = corrected_accel(record, np.stack([rows[name] for name in COLUMNS]), rows["temp_c"], where="rows")
    for t_s, c in zip(rows["t_s"], corrected.T, strict=True):
        if (done := live.add(float(t_s), (c[0], c[1], c[2]), None, 25.0)) is not None:
            watch.take(done)
    if (done := live.cut()) is not None:
        watch.take(done)
    return watch.result()


def said(seed: int, what: Series, *, stream: bool = False) -> Said:
    """What the watch says at its end."""
    rows = rows_of(seed, what)
    found = streamed(rows) if stream else highside.watch_recording(rows, calibration()).found
    # an older watch says nothing of axes
    named = {one.axis: one.factor for one in getattr(found, "noise_changes", ())}
    true = {axis: factor for axis, factor in zip("xyz", what.factors, strict=True) if factor > 1.0}
    errors = [abs(named[axis] / true[axis] - 1.0) for axis in named if axis in true]
    return Said(found.verdict == "departs", named.keys() == true.keys(), max(errors, default=0.0), found.counts.stills)


def main() -> None:
    """Print the scores."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--series", type=int, default=100, help="of each colour")
    parser.add_argument("--first-seed", type=int, default=61_000)
    parser.add_argument("--step", action="store_true", help="an offset steps at the same time")
    parser.add_argument("--stream", action="store_true", help="as a service sees it, not as a recording")
    args = parser.parse_args()
    for colour in WAYS:
        all_of = [
            said(seed, drawn(np.random.default_rng([seed, 1]), colour, step=args.step), stream=args.stream)
            for seed in range(args.first_seed, args.first_seed + args.series)
        ]
        errors = [one.error for one in all_of if one.axes_right]
        print(
            f"{colour}: departs {sum(one.departs for one in all_of)} of {len(all_of)}; exactly the noisy axes named"
            f" {sum(one.axes_right for one in all_of)}; factor wrong by {100 * np.median(errors or [0.0]):.0f} % in the"
            f" median, {100 * np.quantile(errors or [0.0], 0.95):.0f} % at 95 %; rests used"
            f" {np.median([one.rests for one in all_of]):.0f} of {RESTS} in the median",
            flush=True,
        )


if __name__ == "__main__":
    main()
