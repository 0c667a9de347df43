"""What the bench session says of the time to go, against what it then took, on simulated benches.

    python -m studies.time_to_go [--seeds 10] [--first-seed 500]

Of every moment from the third pose on (each 0.1 s of the session's clock): whether what was said is within a quarter of
the truth, or within the time of one pose where that is more. Prints the share, the worst session, and said / true half
way; hands that err at two poses are in the last line.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / "tests" / "session")]

from rehearsal import Rehearsal  # noqa: E402
from test_time_to_go import said_against_true  # noqa: E402

from highside.bench.session.plans import balance_plan, conventional_plan, joint_plan  # noqa: E402
from highside.bench.simulated_operator import OperatorMistake  # noqa: E402

PLANS = {
    "joint, 16 poses": (joint_plan(16), ()),
    "conventional, 24": (conventional_plan(24), ()),
    "balance, 3 inclinations": (balance_plan([5.0, 45.0, 120.0]), ()),
    "joint, 16, two mistakes": (joint_plan(16), ((6, OperatorMistake.WRONG_TF), (10, OperatorMistake.SHOCK))),
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=500)
    given = parser.parse_args()
    for name, (plan, mistakes) in PLANS.items():
        shares, ratios = [], []
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            said, true = said_against_true(Rehearsal(plan, seed=seed, mistakes=mistakes))
            pose_s = true[0] / (len(plan.poses) - 3)
            shares.append(np.mean(np.abs(said - true) <= np.maximum(0.25 * true, pose_s)))
            half = np.argmin(np.abs(true - true[0] / 2))
            ratios.append(said[half] / true[half])
        print(
            f"{name:26} within bounds {np.mean(shares):.3f} of the time, worst session {min(shares):.3f};"
            f" said / true half way {min(ratios):.2f} to {max(ratios):.2f}"
        )


if __name__ == "__main__":
    main()
