"""What the in-run re-balance leaves of toolface after three turns, for single frames and for means: all limits beside.

    python -m studies.rolling_bias_limits [--sessions N]

300 ug of turn-on bias on x and on y, I = 1.2 deg, 20 rpm, 100 frames/s of 50 ug/sqrt(Hz): 353.6 ug a frame. Three turns
are 900 frames, so that no estimator can know the centre of the circle better than `sqrt(2 / 900)` of a frame's noise,
16.7 ug. The error of a toolface from the mean of n frames is

    sqrt(s^2 / n + offset^2) / sin I,       limit: s / (sqrt(n) sin I).
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from highside.arrays import Array
from highside.calibration.linear_correction import LinearCorrection
from highside.calibration.linear_errors import linear_parameters
from highside.calibration.rolling_bias import RollingBias
from highside.calibration.zone import Zone
from highside.physics.gravity import gravity_direction

RATE_HZ = 100.0
RPM = 20.0
INC_RAD = math.radians(1.2)
NOISE_G = 50e-6 * math.sqrt(RATE_HZ / 2.0)
BIAS_G = np.array([300e-6, 300e-6, 0.0])
FRAMES = 907
"""Three turns and a few frames, for the third to be seen complete."""
AVERAGED = (1, 10, 100, 1000)
LATER = 64
"""Readings of each kind after the three turns of a session."""


def frames(rng: np.random.Generator, count: int) -> Array:
    """(3, N) corrected frames of the turning tool, its bias in them."""
    turned = 2.0 * math.pi * RPM / 60.0 * np.arange(count) / RATE_HZ + rng.uniform(0.0, 2.0 * math.pi)
    noise = NOISE_G * rng.standard_normal((3, count))
    return np.asarray(gravity_direction(np.full(count, INC_RAD), turned) + BIAS_G[:, None] + noise)


def measure(sessions: int) -> dict[int, tuple[float, float, float, float]]:
    """For each number of frames averaged: rms of T in deg before, after, with the centre as well known as it can be,
    and with the centre known exactly (the noise limit)."""
    identity = LinearCorrection(
        Zone("global", None, 0.0, math.pi, linear_parameters(np.eye(3), np.zeros(3), np.zeros((12, 12))), 1.0)
    )
    squares: dict[int, list[tuple[float, float]]] = {n: [] for n in AVERAGED}
    for seed in range(sessions):
        rng = np.random.default_rng([seed, 12])
        rolling_bias = RollingBias()
        for k, row in enumerate(frames(rng, FRAMES).T.tolist()):
            rolling_bias.add(k / RATE_HZ, *row)
        if rolling_bias.offset is None:
            raise RuntimeError(f"session {seed}: {rolling_bias.state}, {rolling_bias.reason}")
        correction = rolling_bias.wrap(identity)
        for n in AVERAGED:
            tf = rng.uniform(0.0, 2.0 * math.pi, LATER)
            m = gravity_direction(np.full(LATER, INC_RAD), tf) + BIAS_G[:, None]
            m = m + NOISE_G / math.sqrt(n) * rng.standard_normal(m.shape)
            for k, row in enumerate(m.T.tolist()):
                out = correction.correct((row[0], row[1], row[2]))
                before = math.remainder(math.atan2(row[1], row[0]) - tf[k], 2.0 * math.pi)
                after = math.remainder(math.atan2(out.gy, out.gx) - tf[k], 2.0 * math.pi)
                squares[n].append((before**2, after**2))
    out_deg = {}
    for n, pairs in squares.items():
        before, after = np.degrees(np.sqrt(np.mean(pairs, axis=0)))
        limit = NOISE_G / math.sqrt(n)
        known = math.hypot(limit, NOISE_G * math.sqrt(2.0 / 900.0))
        exact, best = (math.degrees(value / math.sin(INC_RAD)) for value in (limit, known))
        out_deg[n] = (float(before), float(after), best, exact)
    return out_deg


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sessions", type=int, default=200)
    found = measure(parser.parse_args().sessions)
    print("| frames averaged | T before | T after | best possible after 3 turns | noise limit | after / limit |")
    print("|---|---|---|---|---|---|")
    for n, (before, after, best, limit) in found.items():
        print(f"| {n} | {before:.3f} | {after:.3f} | {best:.3f} | {limit:.3f} | {after / limit:.2f} |")


if __name__ == "__main__":
    main()
