"""Beside a prediction that goes on where the recording ends: do the ends of the low-pass pass for something?

    python -m studies.simulation_ends --seeds hands-1 a1 a2
    python -m studies.simulation_ends --seeds a1 --late-ms 10 --diagnose

Of each session what is left after the exact shift of the clock, over what its middle leaves, the channel farthest from
1, with all rows and with those that are compared; with `--diagnose` also what is claimed, laws among it.
"""

from __future__ import annotations

import argparse

import numpy as np

from highside.diagnosis.engine import diagnose_simulation
from highside.diagnosis.simulation.session import OFFSET, simulation_session
from studies.open_world import beside_simulation
from studies.open_world.deck import rng_of

MIDDLE = 20
"""rows at either end that are not the middle"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", nargs="+", required=True)
    parser.add_argument("--late-ms", type=float, default=-10.0, help="by how much the prediction is late")
    parser.add_argument("--diagnose", action="store_true")
    given = parser.parse_args()
    name = "table/early/10" if given.late_ms < 0 else f"beside/late{given.late_ms:g}"
    for seed in given.seeds:
        case = beside_simulation.early(name, rng_of(seed, name), -1e-3 * given.late_ms)
        assert case.prediction is not None
        session = simulation_session(case.recording, case.prediction)
        moved = session.about({OFFSET: (-1e-3 * given.late_ms,)})
        left = moved.readings - moved.predicted
        kept = np.ones(moved.n, dtype=bool) if moved.omitted is None else ~moved.omitted
        middle = left[:, MIDDLE:-MIDDLE].std(axis=1)
        whole, compared = left.std(axis=1) / middle, left[:, kept].std(axis=1) / middle
        farthest = compared[int(np.argmax(np.abs(compared - 1)))]
        print(
            f"{seed}: all rows {whole.max():.3g}, compared {farthest:.3g} ({kept.mean():.1%} of the rows)", flush=True
        )
        if given.diagnose:
            found = diagnose_simulation(session, ())[0]
            claims = {c.effect: {n: f"{p.value:.6g}" for n, p in c.parameters.items()} for c in found.claims}
            print(f"  {found.verdict}: {claims}", flush=True)


if __name__ == "__main__":
    main()
