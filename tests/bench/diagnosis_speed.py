"""How long a diagnosis takes: the curve over poses and over rows of a rotation.

    python -m tests.bench.diagnosis_speed [--rows 12000 45000 90000 180000 360000] [--strong 360000]

Each is run in a process that has imported everything and diagnosed once; wall time and processor time are told, since
another job on the machine makes the first longer. Noise is coloured, a lever arm of 20 um is left out of the model; of
`--strong` ones a lever arm of 8 mm and a delay of 2 ms, a hundred and more times louder than the noise.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.poses.session import PoseSession
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from highside.physics.plan import PosePlan, Session, rings
from studies import diagnosis_deck as deck
from studies import rotation_cases as cases


def poses(inclinations: int) -> PoseSession:
    """Rings of twelve toolfaces, there and back."""
    plan = PosePlan(
        rings(np.linspace(3, 150, inclinations).tolist(), range(0, 360, 30), returns=True), hold_s=1, row_s=1
    )
    state = Session(plan).rows().state
    rng = np.random.default_rng(1)
    sensor, _ = deck.sensor_and_base(state, rng)
    mean = sensor.with_effects({"quadratic": {"k2_x": 1e-4}}).predict(state) + deck.white_noise(state, rng)
    return PoseSession(mean, np.ones(state.n), state)


WEAK = {"lever_arm": {"r_x": 1e-5, "r_y": 2e-5}}
STRONG = {"lever_arm": {"r_x": 8e-3, "r_y": -3e-3}, "time_offset": {"t0": 2e-3}}


def rotation(rows: int, effects: dict[str, dict[str, float]]) -> RotationSession:
    """A rotation of so many rows at 50 Hz."""
    state = cases.design(3, seconds=rows / 50)
    rng = np.random.default_rng(1)
    sensor, _ = deck.sensor_and_base(state, rng)
    moved = sensor.with_effects(effects)
    return RotationSession(moved.predict(state) + cases.noise_of("coloured", state, rng).draw(rng), state)


def timed(what: Callable[[], object]) -> tuple[float, float]:
    """Wall and processor seconds, the better of two."""
    found = []
    for _ in range(2):
        wall, processor = time.perf_counter(), time.process_time()
        what()
        found.append((time.perf_counter() - wall, time.process_time() - processor))
    return min(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rows", type=int, nargs="+", default=[12_000, 45_000, 90_000, 180_000, 360_000])
    parser.add_argument("--strong", type=int, nargs="*", default=[360_000])
    given = parser.parse_args()
    deck.diagnosed(poses(3))
    print(f"{'poses':>8s}{'wall s':>9s}{'cpu s':>9s}")
    for inclinations in (3, 5, 11):
        session = poses(inclinations)
        wall, processor = timed(lambda session=session: deck.diagnosed(session))
        print(f"{session.n:8d}{wall:9.2f}{processor:9.2f}")
    diagnose_rotation(rotation(3000, WEAK), ForwardModel.of({}), cases.FREE)
    print(f"{'rows':>8s}{'wall s':>9s}{'cpu s':>9s}{'cpu us/row':>12s}")
    for effects, sizes, words in ((WEAK, given.rows, ""), (STRONG, given.strong, "  strong")):
        for rows in sizes:
            turning = rotation(rows, effects)
            wall, processor = timed(lambda turning=turning: diagnose_rotation(turning, ForwardModel.of({}), cases.FREE))
            print(f"{rows:8d}{wall:9.2f}{processor:9.2f}{1e6 * processor / rows:12.1f}{words}", flush=True)


if __name__ == "__main__":
    main()
