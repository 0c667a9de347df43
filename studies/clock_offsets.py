"""A real hand-held recording beside optics whose clock is moved: is `time_offset` right to a millisecond, or refused?

    python -m studies.clock_offsets --seeds 3 --first-seed 50

Of the 184 s of a trial of BROAD (Laidig, Caruso, Cereatti, Seel 2021; in `HIGHSIDE_DATA`) each seed takes 60 s anywhere
and moves the prediction's clock, earlier or later, by the offset and by up to half a row more. The files have an offset
of their own, which is taken off.
"""

from __future__ import annotations

import argparse
import collections
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_simulation
from highside.diagnosis.simulation.session import simulation_session
from studies.open_world.real import clock
from studies.sealed.real_recordings import DATA

OFFSETS_MS = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
STRETCH_S = 60.0
OWN_S = 2.65e-3
"""s; by which the recording lags the optics as published: what `highside diagnose` says of the whole trial"""
WITHIN_S = 1e-3
"""s; an offset that is found nearer to the truth is right"""
Columns = Mapping[str, NDArray[np.float64]]


def reported(recording: Columns, prediction: Columns, start_s: float, moved_s: float, *, laws: bool) -> DiagnosisResult:
    """The answer to a stretch of the recording, the prediction stamped later by `moved_s`."""
    t = recording["t_s"]
    rows = (t >= start_s) & (t < start_s + STRETCH_S)
    recorded = {name: values[rows] for name, values in recording.items()}
    predicted = {name: values[rows] for name, values in prediction.items()}
    session = simulation_session(recorded, predicted | {"t_s": predicted["t_s"] + moved_s})
    return diagnose_simulation(session, (), method=WHOLE if laws else ProcedureParts.without("laws"))[0]


def clock_files() -> tuple[Columns, Columns]:
    """The recording with its rates, and what optics say that the accelerometers read."""
    case = clock("clock", "study", 0.0)
    assert case.prediction is not None
    with np.load(DATA / "broad" / "07_undisturbed_fast_rotation_B.npz") as z:
        turned = np.degrees(z["imu_gyr"].T.astype(float))
    return case.recording | dict(zip(("gx_dps", "gy_dps", "gz_dps"), turned, strict=True)), case.prediction


def offset_of(found: DiagnosisResult) -> float | None:
    """Seconds that `time_offset` was given; None where it is not claimed."""
    return next((c.parameters["t0"].value for c in found.claims if c.effect == "time_offset"), None)


def judged(found: DiagnosisResult, expected_s: float) -> str:
    """What of an answer is right."""
    value = offset_of(found)
    if value is not None:
        return "right" if abs(value - expected_s) <= WITHIN_S else "wrong size"
    if any("time_offset" in c.equivalence_class for c in found.claims):
        return "in the class"
    return "nothing" if found.verdict == "nothing_left_out" else "other name" if found.claims else "refused"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=50)
    parser.add_argument("--offsets-ms", type=float, nargs="*", default=list(OFFSETS_MS))
    parser.add_argument("--laws", action="store_true", help="with the search for laws, which takes far longer")
    given = parser.parse_args()
    recording, prediction = clock_files()
    table: dict[float, collections.Counter[str]] = {ms: collections.Counter() for ms in given.offsets_ms}
    off: dict[float, list[float]] = {ms: [] for ms in given.offsets_ms}
    for seed in range(given.first_seed, given.first_seed + given.seeds):
        rng = np.random.default_rng(seed)
        start_s = float(rng.uniform(0.0, recording["t_s"][-1] - STRETCH_S))
        for ms in given.offsets_ms:
            moved_s = float(rng.choice([-1.0, 1.0])) * 1e-3 * ms + float(rng.uniform(-1.7e-3, 1.7e-3))
            found = reported(recording, prediction, start_s, moved_s, laws=given.laws)
            word, value = judged(found, OWN_S - moved_s), offset_of(found)
            table[ms][word] += 1
            if value is not None:
                off[ms].append(1e3 * abs(value - OWN_S + moved_s))
            names = ", ".join(c.effect for c in found.claims)
            print(f"{seed} {1e3 * moved_s:9.2f} ms {word:12s} {value!s:24s} {found.verdict}: {names}", flush=True)
    print("| offset, ms | answers | farthest off, ms |")
    for ms, count in table.items():
        words = ", ".join(f"{v} {k}" for k, v in count.most_common())
        print(f"| {ms:g} | {words} | {max(off[ms], default=np.nan):.2f} |")


if __name__ == "__main__":
    main()
