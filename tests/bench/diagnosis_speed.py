"""How long a diagnosis takes: the curve over poses and over rows of a rotation, and what the search for laws adds.

    python -m tests.bench.diagnosis_speed [--rows 12000 45000 90000 180000 360000] [--strong 360000]
                                          [--laws NAME...] [--pairs 5]

First what laws cost, as ratios: of each case the diagnosis with laws and without by turns, and the median of the
ratios of processor time over `--pairs` pairs. Then the curves: each is run in a process that has imported everything
and diagnosed once; wall time and processor time are told, since another job on the machine makes the first longer.
Noise is coloured, a lever arm of 20 um is left out of the model; of `--strong` ones a lever arm of 8 mm and a delay of
2 ms, a hundred and more times louder than the noise.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.floor import NoiseFloor
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.engine import diagnose_poses, diagnose_rotation
from highside.diagnosis.poses.session import PoseSession
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from highside.physics.plan import PosePlan, Session, station_poses
from studies import diagnosis_deck as deck
from studies import rotation_cases as cases


def poses(inclinations: int) -> PoseSession:
    """Twelve toolfaces at each inclination, there and back."""
    plan = PosePlan(
        station_poses(np.linspace(3, 150, inclinations).tolist(), range(0, 360, 30), returns=True), hold_s=1, row_s=1
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


TWO = {"quadratic": {"k2_x": 2e-4}, "encoder_first_harmonic": {"c1": 3e-4, "s1": 2e-4}}
BITS = 12
"""of a converter of -1 to 1 g"""


def held(inclinations: int, effects: dict[str, dict[str, float]], law_g: float = 0.0) -> PoseSession:
    """Poses at a temperature that varies, their floor known; the law is a bump of y's offset over toolface."""
    plan = PosePlan(
        station_poses(np.linspace(3, 150, inclinations).tolist(), range(0, 360, 30), returns=True), hold_s=1, row_s=1
    )
    state = Session(plan).rows().state
    share = state.t_s / state.t_s[-1]
    state = replace(state, temp_c=25 + 30 * np.interp(share, [0, 0.25, 0.4, 0.5, 0.6, 1], [0, 0.6, 1, 0.8, 1, 0]))
    rng = np.random.default_rng(1)
    sensor, _ = deck.sensor_and_base(state, rng)
    apart = np.mod(np.degrees(state.tf_rad) - 130 + 180, 360) - 180
    mean = sensor.with_effects(effects).predict(state) + deck.white_noise(state, rng)
    mean[1] += law_g * np.exp(-0.5 * (apart / 40) ** 2)
    return PoseSession(mean, np.ones(state.n), state, floor=NoiseFloor(np.full(mean.shape, deck.SIGMA_G), 1000.0))


def turned(rows: int, law_g: float = 0.0, bits: int = 0) -> RotationSession:
    """A rotation without effects; the law is a bump of x's offset over temperature."""
    plain = rotation(rows, {})
    temp = plain.state.temp_c
    readings = plain.readings.copy()
    readings[0] += law_g * np.exp(-0.5 * (((temp - temp.min()) / np.ptp(temp) - 0.6) / 0.12) ** 2)
    step = 2.0 / 2**bits
    return RotationSession(np.round(readings / step) * step if bits else readings, plain.state)


BESIDE: dict[str, Callable[[], PoseSession | RotationSession]] = {
    "144 poses, nothing": lambda: held(6, {}),
    "144 poses, two names": lambda: held(6, TWO),
    "264 poses, nothing": lambda: held(11, {}),
    "264 poses, a law": lambda: held(11, {}, 2e-4),
    "264 poses, a name, no floor": lambda: poses(11),
    "12,000 rows, a name": lambda: rotation(12_000, WEAK),
    "12,300 rows, nothing": lambda: turned(12_300),
    "12,300 rows, a law": lambda: turned(12_300, 2e-4),
    "12,300 rows of 12 bits": lambda: turned(12_300, bits=BITS),
    "360,000 rows, nothing": lambda: turned(360_000),
    "360,000 rows, a law": lambda: turned(360_000, 2e-4),
}


def beside(session: PoseSession | RotationSession, pairs: int) -> tuple[float, float, str]:
    """Processor seconds with laws, the median ratio to those without, and the verdict."""
    seconds, ratios, verdict = [], [], ""
    for _ in range(pairs):
        took = []
        for method in (ProcedureParts.without("laws"), WHOLE):
            began = time.process_time()
            if isinstance(session, PoseSession):
                found = diagnose_poses(session, ForwardModel.of({}), deck.FREE, method=method)[0]
            else:
                found = diagnose_rotation(session, ForwardModel.of({}), cases.FREE, method=method)[0]
            took.append(time.process_time() - began)
        seconds.append(took[1])
        ratios.append(took[1] / took[0])
        verdict = found.verdict
    return float(np.median(seconds)), float(np.median(ratios)), verdict


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
    parser.add_argument("--rows", type=int, nargs="*", default=[12_000, 45_000, 90_000, 180_000, 360_000])
    parser.add_argument("--strong", type=int, nargs="*", default=[360_000])
    parser.add_argument("--laws", nargs="*", default=list(BESIDE), choices=list(BESIDE))
    parser.add_argument("--pairs", type=int, default=5)
    given = parser.parse_args()
    deck.diagnosed(poses(3))
    print(f"{'case':28s}{'cpu s with laws':>17s}{'ratio':>8s}")
    for name in given.laws:
        seconds, ratio, verdict = beside(BESIDE[name](), given.pairs)
        print(f"{name:28s}{seconds:17.2f}{ratio:8.1f}  {verdict}", flush=True)
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
