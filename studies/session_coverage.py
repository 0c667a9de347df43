"""How often a session's record is within twice its stated uncertainty of the simulated truth, for each plan.

    python -m studies.session_coverage [SEEDS [WORD]] [--workers 0 --parts DIR]     (10 where not given; `make evidence`
                                                    takes 100; WORD: only the plans whose names hold it)

Sensors at random (scale within 0.5 %, misalignment 0.2 deg, offset 2 mg), benches at random (tilt 0.02 deg, settings
0.0052 deg, half of the variance common to inclination or station), everything through the session: stillness,
recognition, capture, checks, solution. Errors and stated uncertainties are root mean squares over all attitudes of use;
where the plan goes over temperature both are taken at each of its temperatures, and the worst of them counts.
"""

from __future__ import annotations

import argparse

import numpy as np

from highside.bench.session import outcome, plans
from highside.bench.session.plans import Criterion, Limits, SessionKind, SessionPlan
from highside.bench.session.snapshot import SessionState
from studies import over_seeds
from tests.session.rehearsal import Rehearsal, random_sensor

EIGHTHS = tuple(45.0 * k for k in range(8))
LIMITS = Limits(std_error_g=4e-5, min_hold_s=1.0, max_hold_s=3.0, soak_s=15.0)
HAND = Limits(std_error_g=4e-5, min_hold_s=1.5, max_hold_s=6.0, prior_offset_g=0.05, prior_matrix=0.05)
PLANS: dict[str, SessionPlan] = {
    "balance at 30 deg": plans.balance_plan([30.0], LIMITS),
    "balance at 1.2, 10, 45 deg": plans.balance_plan([1.2, 10.0, 45.0], LIMITS),
    "conventional 3": plans.conventional_plan(3, LIMITS),
    "conventional 6": plans.conventional_plan(6, LIMITS),
    "conventional 12": plans.conventional_plan(12, LIMITS),
    "conventional 8": plans.conventional_plan(8, LIMITS),
    "conventional 24": plans.conventional_plan(24, LIMITS),
    "joint 8": plans.joint_plan(8, LIMITS),
    "joint 16": plans.joint_plan(16, LIMITS),
    "custom, 14 poses on two inclinations": plans.custom_plan(
        [(inc, tf) for inc in (5.0, 45.0) for tf in EIGHTHS[:-1]], "joint", LIMITS
    ),
    "custom, 12 poses on three inclinations": plans.custom_plan(
        [(inc, tf) for inc in (5.0, 45.0, 90.0) for tf in EIGHTHS[1::2]], "joint", LIMITS
    ),
    "turntable, 16 stations at 20, 50, 90 deg": plans.turntable_plan((20.0, 50.0, 90.0), 16, LIMITS),
    "unguided, 20 attitudes": plans.unguided_plan(HAND),
    "oven 25 65 25 C": plans.soak_plan([25.0, 65.0, 25.0], (5.0, 45.0, 90.0), (45.0, 135.0, 225.0, 315.0), LIMITS),
    "heated roll 30 45 60 C at 45 deg": plans.heated_roll_plan([30.0, 45.0, 60.0], 45.0, EIGHTHS, LIMITS),
    "heated roll 30 45 60 45 30 C at 90 deg": plans.heated_roll_plan(
        [30.0, 45.0, 60.0, 45.0, 30.0], 90.0, (0.0, 90.0, 180.0, 270.0), LIMITS
    ),
}


def one(name: str, seed: int) -> tuple[bool, bool, float, float]:
    """Of a plan: accepted, within, and the two errors in units of what is stated."""
    plan = PLANS[name]
    tilt = tuple(np.random.default_rng([seed, 3]).normal(0.0, 0.02, 2).tolist())
    options = {"tilt_deg": tilt, "settle_s": 0.5, "turn_rate_dps": 120.0, "oven_tau_s": 10.0}
    options |= {"offset_per_c": tuple(np.random.default_rng([seed, 4]).normal(0.0, 1e-5, 3).tolist())}
    if plan.kind is SessionKind.TURNTABLE:
        options["encoder_deg"] = tuple(map(tuple, np.random.default_rng([seed, 6]).normal(0.0, 0.02, (3, 2)).tolist()))
    rehearsal = Rehearsal(
        plan, seed=seed, rate_hz=20.0, sensor=random_sensor(seed), gyros=False, bench_options=options
    ).run(limit_s=20_000.0, look_s=0.4)
    if rehearsal.state is not SessionState.ACCEPTED:
        return False, False, np.nan, np.nan
    record, solved = rehearsal.session.record, rehearsal.session.solved
    assert record is not None and solved is not None and solved.solution is not None
    matrix = np.array(rehearsal.bench.settings.matrix)
    found = []
    for temp in sorted({stage.temp_c for stage in plan.stages if stage.temp_c is not None}) or [25.0]:
        errors = outcome.errors_against(record, matrix, rehearsal.bench.true_offset(temp), temp)
        found.append(np.divide(errors, outcome.stated_uncertainty(solved.solution, temp)))
    worst = np.max(found, axis=0)
    return True, bool(np.all(worst <= 2.0)), float(worst[0]), float(worst[1])


def verdict(seed: int, moved_g: float) -> str | None:
    """Of a verification at a limit of 0.3 deg (T: 6), after the x offset has moved since the calibration."""
    bench = {"settle_s": 0.5, "turn_rate_dps": 120.0}
    matrix, offset = random_sensor(seed)
    made = Rehearsal(
        PLANS["joint 8"], seed=seed, rate_hz=20.0, sensor=(matrix, offset), gyros=False, bench_options=bench
    ).run(look_s=0.4)
    record = made.session.record
    if record is None:
        return None
    plan = plans.verification_plan(
        [(inc, tf) for inc in (5.0, 45.0, 90.0) for tf in (20.0, 140.0, 260.0)],
        LIMITS,
        Criterion(record.id, 0.3, 6.0),
    )
    sensor = (matrix, (offset[0] + moved_g, *offset[1:]))
    done = Rehearsal(
        plan, seed=seed + 500, rate_hz=20.0, sensor=sensor, gyros=False, bench_options=bench, judged=record
    ).run(look_s=0.4)
    return None if done.session.solved is None else outcome.verdict_of(done.session.solved)


def main(seeds: int, word: str, over: over_seeds.Over) -> None:
    """Print the table."""
    print(
        f"| plan | poses | accepted of {seeds} | within 2 sigma: both, I, T | median I error / stated |"
        " median T error / stated |"
    )
    print("|---|---|---|---|---|---|", flush=True)
    for name, plan in PLANS.items():
        if word not in name:
            continue
        found = over(one, [(name, seed) for seed in range(seeds)])
        accepted, within = sum(f[0] for f in found), sum(f[1] for f in found)
        each = [sum(f[k] <= 2.0 for f in found) for k in (2, 3)]
        inc, tf = np.nanmedian([f[2] for f in found]), np.nanmedian([f[3] for f in found])
        print(
            f"| {name} | {len(plan.poses) or 20} | {accepted} | {within}, {each[0]}, {each[1]} | {inc:.2f} |"
            f" {tf:.2f} |",
            flush=True,
        )
    if word in ("", "verdict"):
        for moved_g, what in ((0.0, "unchanged"), (10e-3, "offset moved by 10 mg (0.57 deg)")):
            said = over(verdict, [(seed, moved_g) for seed in range(seeds)])
            reported = ", ".join(f"{said.count(name)} {name}" for name in ("pass", "undecided", "fail"))
            print(f"verification at 0.3 deg, sensor {what}: {reported}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("seeds", type=int, nargs="?", default=10)
    parser.add_argument("word", nargs="?", default="")
    over_seeds.add_options(parser)
    options = parser.parse_args()
    main(options.seeds, options.word, over_seeds.chosen(options, seconds=2.0))
