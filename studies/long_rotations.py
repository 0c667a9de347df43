"""Laws that are found in rotations in which there are none: noise alone, and noise beside a weak lever arm.

    python -m studies.long_rotations [--rows 12000 45000 90000] [--seeds 10 17] [--kinds coloured "random walk"]
                                     [--names]

By default the search for laws by itself, on cells of rows, beside the sensor as it is; with `--names` the whole
diagnosis, with a lever arm of 20 um left out of the model. A line for each session, and the counts.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.method import WHOLE
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.law_sessions import ChainSession
from highside.diagnosis.laws.search import Search
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from studies import diagnosis_deck as deck
from studies import rotation_cases as cases

LEVER_ARM = {"lever_arm": {"r_x": 1e-5, "r_y": 2e-5}}
HERTZ = 50
FLICKER = "1/f"


def drawn(kind: str, state: ChainState, rng: np.random.Generator) -> Array:
    """(3, n) noise of a kind; 1/f noise down to one cycle of the whole recording, 0.5 to 2 times the white noise on
    which it lies."""
    if kind != FLICKER:
        return np.asarray(cases.noise_of(kind, state, rng).draw(rng))
    lines = np.arange(1, state.n // 2 + 1)
    random = rng.standard_normal((3, lines.size)) + 1j * rng.standard_normal((3, lines.size))
    slow = np.fft.irfft(np.concatenate([np.zeros((3, 1)), random / np.sqrt(lines)], axis=1), state.n)
    slow *= rng.uniform(0.5, 2.0) / slow.std(axis=1, keepdims=True)
    return cases.SIGMA_G * (slow + rng.standard_normal((3, state.n)))


def found_in(seed: int, rows: int, kind: str, *, names: bool) -> list[str]:
    """What is found: places and covariates of laws, or all that is claimed but the lever arm."""
    state = cases.design(seed, seconds=rows / HERTZ)
    rng = np.random.default_rng([seed, rows])
    sensor, _ = deck.sensor_and_base(state, rng)
    noise = drawn(kind, state, rng)
    if names:
        session = RotationSession(sensor.with_effects(LEVER_ARM).predict(state) + noise, state)
        told = diagnose_rotation(session, ForwardModel.of({}), cases.FREE, method=WHOLE)[0]
        return [claim.effect for claim in told.claims if claim.effect != "lever_arm"]
    laws = ChainSession.of_rotation(RotationSession(sensor.predict(state) + noise, state), cases.FREE, noise)
    terms = Search(laws.problem(sensor, laws.residual(sensor))).run().terms
    return [f"{one.group.place}({', '.join(axis.covariate for axis in one.group.axes)})" for one in terms]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rows", type=int, nargs="*", default=[12_000, 45_000, 90_000])
    parser.add_argument("--seeds", type=int, nargs=2, default=[10, 17])
    parser.add_argument("--kinds", nargs="*", default=["coloured", "random walk"], choices=[*cases.NULL_KINDS, FLICKER])
    parser.add_argument("--names", action="store_true")
    given = parser.parse_args()
    counts: dict[tuple[str, int], list[bool]] = defaultdict(list)
    for seed in range(*given.seeds):
        for kind in given.kinds:
            for rows in given.rows:
                began = time.process_time()
                found = found_in(seed, rows, kind, names=given.names)
                counts[kind, rows].append(bool(found))
                print(f"{seed} {kind} {rows}: {found} ({time.process_time() - began:.1f} s)", flush=True)
    for (kind, rows), false in counts.items():
        print(f"{kind}, {rows} rows: {sum(false)} of {len(false)}")


if __name__ == "__main__":
    main()
