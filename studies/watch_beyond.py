"""The watch before what it does not look for: which numbers does it state that are false, and does it say so?

`two`: two steps at one time, of different parameters, 0.5 to 3 mg or mg/g each; a class without `a second departure`
has not said so. `after`: one such step; do the 95 % intervals of the twelve parameters, and of the size of the
likeliest, hold the truth once it is said? `bent`: an antisymmetric misalignment of 3 mrad from the start, which reads
like a bent collar: is it said to hold, and if it departs, what stands of the claim at the end? `turned`: the triad
turned in the tool by 5 mrad about its axis, a toolface offset: how often is it said to hold, and which error of
toolface would have been seen? `depth`: one measurement of some 500 has a depth that is 6 km too large. `sliding`: a
tool that rested each quarter of an hour slides for three hours, its toolface wandering, shaken by 20 mg, without rest.
Wells of 100 h that build (`depth`: of all profiles), as in `studies.watch_wells`;
`sliding` from rows, as a stream and as a recording.

    python -m studies.watch_beyond --cases two after --wells 60 --first-seed 81000000
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

import highside
from highside.arrays import Array
from highside.watch import Still, Turning, Watch, WatchResult
from highside.watch.claims import SECOND
from highside.watch.parameters import CALIBRATION, INDEX, NAMES
from studies.survey_analysis import calibration
from studies.watch_noise import COLUMNS, RATE_HZ, Series, rows_of, streamed
from studies.watch_wells import BUILDS, WELLS, Conditions, Departure, Well, share, stated_prior

LAGS_H = (0.0, 3.0, 10.0, 24.0)
SIZES_G = 5e-4, 3e-3
HOURS = 100.0
BENT_RAD, TURNED_RAD = 3e-3, 5e-3
GLITCH_KM, GLITCH_AT = 6.0, 150
SLIDES_H, SHAKEN_G = 3.0, 0.02
WANDERS = ((2.0, 60.0), (5.0, 60.0), (10.0, 60.0), (5.0, 300.0))
"""deg rms of toolface, and the correlation time in s"""


class Stepped(Well):
    """A well in which several steps happen."""

    def __init__(self, kind: str, seed: int, steps: Sequence[Departure] = ()) -> None:
        super().__init__(kind, seed, Conditions(hours=HOURS))
        self._waiting = list(steps)

    def _advance(self, t_s: float) -> None:
        super()._advance(t_s)
        for step in [one for one in self._waiting if t_s >= one.at_s]:
            self.truth[step.places] += step.size
            self._waiting.remove(step)


class Glitch(Watch):
    """Told once of a depth that is none."""

    taken = 0

    def _depth(self, km: float | None) -> float | None:
        self.taken += 1
        return None if km is None else km + GLITCH_KM * (self.taken == GLITCH_AT)

    def still(self, still: Still) -> None:
        super().still(replace(still, depth_km=self._depth(still.depth_km)))

    def turning(self, turn: Turning) -> None:
        super().turning(replace(turn, depth_km=self._depth(turn.depth_km)))


@dataclass(frozen=True)
class Look:
    """At what is said, some time after the alarm."""

    second: bool
    alone: bool
    truth_in_class: bool
    size_right: bool
    """the likeliest is what happened, and the interval of its size holds that"""
    truth_held: bool
    """the interval of the size of what happened, wherever in the class it stands"""
    held: int
    """of the intervals of the twelve parameters"""
    worst: float
    """deviation of one of these from the truth, in its standard deviations"""


def look(said: WatchResult, well: Well, steps: Sequence[Departure]) -> Look:
    """Against the truth."""
    (claim,) = said.claims
    sizes = {one.name: one.size for one in steps}
    size = claim.parameters[claim.parameter]
    z = [
        abs(one.value - well.truth[INDEX[name]]) / one.std for name, one in list(said.parameters.items())[:CALIBRATION]
    ]
    return Look(
        SECOND in claim.equivalence_class,
        len(claim.equivalence_class) == 1,
        any(name in claim.equivalence_class for name in sizes),
        size.low <= sizes.get(claim.parameter, np.inf) <= size.high,
        any(one.low <= sizes.get(name, np.inf) <= one.high for name, one in claim.parameters.items()),
        int(np.sum(np.array(z) < 1.96)),
        float(np.max(z)),
    )


def stepped(kind: str, seed: int, count: int) -> list[Look] | None:
    """Looks at one well with so many steps at one time; None where it alarmed before."""
    rng = np.random.default_rng([seed, 7])
    names = [str(name) for name in rng.choice(NAMES[:CALIBRATION], count, replace=False)]
    at_s = float(rng.uniform(0.2, 0.5) * HOURS * 3600.0)
    sizes = np.exp(rng.uniform(*np.log(SIZES_G), count)) * rng.choice([-1.0, 1.0], count)
    steps = [Departure(name, float(size), at_s) for name, size in zip(names, sizes, strict=True)]
    well, watch = Stepped(kind, seed, steps), Watch(stated_prior())
    out: list[Look] = []
    while well.t_s < HOURS * 3600.0 and len(out) < len(LAGS_H):
        well.stand(watch)
        if watch.alarm_s is None:
            continue
        if watch.alarm_s < at_s:
            return None
        while len(out) < len(LAGS_H) and well.t_s >= watch.alarm_s + 3600.0 * LAGS_H[len(out)]:
            out.append(look(watch.result(), well, steps))
    return out


def print_stepped(count: int, wells: int, first_seed: int) -> None:
    """The looks of all wells, by the time after the alarm."""
    found = [stepped(BUILDS[k % len(BUILDS)], first_seed + k, count) for k in range(wells)]
    print(f"steps at one time: {count}; {wells} wells, {sum(one is None for one in found)} alarms before them")
    for k, lag in enumerate(LAGS_H):
        at = [one[k] for one in found if one is not None and len(one) > k]
        plain = [one for one in at if not one.second]
        alone = [one for one in plain if one.alone]
        held, of = sum(one.held for one in plain), CALIBRATION * len(plain)
        right = share(sum(one.size_right for one in plain), len(plain))
        inside = share(sum(one.truth_held for one in plain), len(plain))
        print(
            f"  {lag:g} h after the alarm: a second departure said {share(len(at) - len(plain), len(at))}; of the"
            f" others truth in the class {share(sum(one.truth_in_class for one in plain), len(plain))}, likeliest true"
            f" and its size in the interval {right}, what happened in the interval of its size {inside}, one name alone"
            f" {len(alone)}, that wrong {sum(not one.size_right for one in alone)}; intervals of the parameters hold"
            f" {100 * held / max(of, 1):.1f} % of {of}, the worst {max([one.worst for one in plain], default=0):.0f}"
            " standard deviations off",
            flush=True,
        )


def print_skewed(
    word: str,
    moved: dict[str, float],
    wells: int,
    first_seed: int,
    make: Callable[[], Watch],
    kinds: Sequence[str] = BUILDS,
) -> None:
    """What is said of wells whose truth is `moved` from the start, or that are told what is not so."""
    departs, holds, small, below, unseen, worst = 0, 0.0, 0, 0, [], []
    for k in range(wells):
        well, watch, looks = Stepped(kinds[k % len(kinds)], first_seed + k), make(), []
        for name, size in moved.items():
            well.truth[INDEX[name]] += size
        while well.t_s < HOURS * 3600.0:
            well.stand(watch)
            looks.append(watch.result().verdict == "holds")
        said = watch.result()
        holds += float(np.mean(looks)) / wells
        assert said.still_unseen is not None
        unseen.append(said.still_unseen.tf_sin_inc_deg)
        z = [abs(one.value - well.truth[INDEX[name]]) / one.std for name, one in said.parameters.items()]
        worst.append(max(z[:CALIBRATION]))
        for claim in said.claims:
            departs += 1
            size = claim.parameters[claim.parameter]
            evidence = claim.evidence or 0.0
            below += evidence < said.threshold
            small += evidence < said.threshold and size.low * size.high > 0.0
    print(
        f"{word}: {wells} wells; departs {share(departs, wells)}, of these with less evidence at the end than the"
        f" threshold {below}, with an interval of its size that excludes zero all the same {small}; holds in"
        f" {100 * holds:.0f} % of all looks; of toolface times sin I {np.median(unseen):.3f} deg would have been seen"
        f" (median); a parameter is {np.median(worst):.0f} standard deviations off (median)",
        flush=True,
    )


def sliding(seed: int, wander_deg: float, over_s: float) -> dict[str, Array]:
    """Rows: 16 rests, then a tool that slides."""
    rng = np.random.default_rng([seed, 5])
    rows = rows_of(seed, Series("white", np.ones(3), np.zeros(3)))
    kept = rows["t_s"] < 16 * 900.0
    count = int(SLIDES_H * 3600.0 * RATE_HZ)
    left = np.exp(-1.0 / (over_s * RATE_HZ))
    noise = lfilter([1.0 - left], [1.0, -left], lfilter([1.0], [1.0, -left], rng.standard_normal(count)))
    toolface = 0.7 + np.radians(wander_deg) * noise / noise.std()
    s, c = np.sin(np.radians(50.0)), np.cos(np.radians(50.0))
    f = np.stack([s * np.cos(toolface), s * np.sin(toolface), np.full(count, c)])
    f += SHAKEN_G * rng.standard_normal(f.shape)
    beside = dict(zip(COLUMNS, f, strict=True)) | {"temp_c": np.full(count, 25.0)}
    beside["t_s"] = 16 * 900.0 + np.arange(count) / RATE_HZ
    return {name: np.concatenate([rows[name][kept], beside[name]]) for name in rows}


def print_sliding(series: int, first_seed: int) -> None:
    """Whether something is said to depart, as a stream and as a recording."""
    for wander, over in WANDERS:
        departs = {"stream": 0, "recording": 0}
        rests = 0
        for seed in range(first_seed, first_seed + series):
            rows = sliding(seed, wander, over)
            live, whole = streamed(rows), highside.watch_recording(rows, calibration()).found
            departs["stream"] += live.verdict == "departs"
            departs["recording"] += whole.verdict == "departs"
            rests += live.counts.stills - 16
        print(
            f"sliding, toolface {wander:g} deg rms over {over:g} s: departs, false: stream"
            f" {departs['stream']}, recording {departs['recording']} of {series}; 'rests' of the stream while it slid"
            f" {rests / series:.0f} in the mean",
            flush=True,
        )


CASES = ("two", "after", "bent", "turned", "depth", "sliding")


def main() -> None:
    """Print what is found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--wells", type=int, default=20, help="of each case; of sliding, series")
    parser.add_argument("--first-seed", type=int, default=81_000_000)
    args = parser.parse_args()

    def plain() -> Watch:
        return Watch(stated_prior())

    for case in args.cases:
        if case in ("two", "after"):
            print_stepped(2 if case == "two" else 1, args.wells, args.first_seed)
        elif case == "bent":
            print_skewed("bent", {"S_xz": BENT_RAD, "S_zx": -BENT_RAD}, args.wells, args.first_seed, plain)
        elif case == "turned":
            print_skewed("turned", {"S_xy": TURNED_RAD, "S_yx": -TURNED_RAD}, args.wells, args.first_seed, plain)
        elif case == "depth":
            print_skewed("depth", {}, args.wells, args.first_seed, lambda: Glitch(stated_prior()), WELLS)
        else:
            print_sliding(args.wells, args.first_seed)


if __name__ == "__main__":
    main()
