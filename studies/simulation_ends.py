"""Beside another program's prediction: what does the low-pass of both sides leave, and what is claimed for it?

    python -m studies.simulation_ends --seeds hands-1 a1 a2
    python -m studies.simulation_ends --seeds a1 --late-ms 10 --diagnose
    python -m studies.simulation_ends --seeds b1 --share 0.05 -0.03 --diagnose --names-alone

The prediction goes on where the recording ends, and is late; or, with `--share`, a frequency of its motion is off by a
share. Of each session what is left after the exact shift or rate of the clock (and a factor of each channel, with
`--share`), over what its middle leaves, the channel farthest from 1, with all rows and with those that are compared;
with `--diagnose` also what is claimed.
"""

from __future__ import annotations

import argparse
import itertools

import numpy as np

from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.engine import diagnose_simulation
from highside.diagnosis.simulation.session import OFFSET, SKEW, SimulationSession, simulation_session
from studies.open_world import beside_simulation
from studies.open_world.deck import rng_of

MIDDLE = 60
"""rows at either end that are not the middle"""


def left_of(moved: SimulationSession, factors: bool) -> str:
    """What is left of a session whose clock was moved, in words."""
    kept = np.ones(moved.n, dtype=bool) if moved.omitted is None else ~moved.omitted
    left = moved.readings - moved.predicted
    if factors:
        shown = moved.predicted[:, kept]
        slope = np.sum(left[:, kept] * shown, axis=1) / np.sum(shown**2, axis=1)
        left = left - slope[:, None] * moved.predicted
    middle = left[:, MIDDLE:-MIDDLE].std(axis=1)
    whole, compared = left.std(axis=1) / middle, left[:, kept].std(axis=1) / middle
    farthest = compared[int(np.argmax(np.abs(compared - 1)))]
    return f"all rows {whole.max():.3g}, compared {farthest:.3g} ({kept.mean():.1%} of the rows)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs="+", required=True)
    parser.add_argument("--late-ms", type=float, default=-10.0, help="by how much the prediction is late")
    parser.add_argument(
        "--share", type=float, nargs="+", default=[0.0], help="by which a frequency of the prediction is off instead"
    )
    parser.add_argument("--diagnose", action="store_true")
    parser.add_argument("--names-alone", action="store_true", help="no search for laws")
    given = parser.parse_args()
    for share, seed in itertools.product(given.share, given.seeds):
        shift_s = -1e-3 * given.late_ms
        if share:
            name = f"beside/freq{100 * share:g}"
            case = beside_simulation.frequency_off(name, rng_of(seed, name), share)
        else:
            name = "table/early/10" if given.late_ms < 0 else f"beside/late{given.late_ms:g}"
            case = beside_simulation.early(name, rng_of(seed, name), shift_s)
        assert case.prediction is not None
        session = simulation_session(case.recording, case.prediction)
        moved = session.about({SKEW: (share / (1 + share),)} if share else {OFFSET: (shift_s,)})
        print(f"{seed}, {share:g}: {left_of(moved, bool(share))}", flush=True)
        if given.diagnose:
            method = ProcedureParts.without("laws") if given.names_alone else WHOLE
            found = diagnose_simulation(session, (), method=method)[0]
            claims = {c.effect: {n: f"{p.value:.6g}" for n, p in c.parameters.items()} for c in found.claims}
            print(f"  {found.verdict}: {claims} {found.remainder.hints[:1]}", flush=True)


if __name__ == "__main__":
    main()
