"""The watch over means at rest (surveys), whose rows nobody kept: noise that jumps against an offset that steps.

Rests in all attitudes, one mean each with noise of 14 ug of its length, a tool whose offsets, matrix and gravity are
off by what its record and class allow, with the random walk of its class. In the middle of the series either the noise
grows (`WAYS`) and nothing departs, or one offset steps and the noise stays. The bound is of the same rests: the first
at which size x sqrt(information) reaches the square root of the threshold and `WatchPolicy.power`, by a filter that
follows no noise. Beside it stands what could be found by whoever knows the departure, its onset and the noise as it
was, and yet takes no noise that has jumped for a step: the same filter's column of that departure must pass the
threshold, and be a hundred times likelier than noise of the best size, of as many numbers as the watch wants. A test
that knows less finds it later.

`--scatter rows`: each rest is a minute at ten readings a second, white and 1/f, and what its axes scatter is kept with
its mean, as the service keeps it with a survey. `--scatter blind`: the same, but what grows is constant within a rest,
so that its scatter shows nothing of it: the worst that noise can do to who trusts the scatter.

    python -m studies.watch_means --series 40 --first-seed 71000
    python -m studies.watch_means --series 40 --first-seed 72000 --apart-min 30
    python -m studies.watch_means --series 40 --first-seed 171000 --apart-min 30 --scatter rows
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.watch import POLICY, STATED, Still, Watch
from highside.watch.axis_noise import scatters
from highside.watch.bank import HYPOTHESES
from highside.watch.hold import noise_evidence
from highside.watch.parameters import GRAVITY, prior
from studies.watch_noise import flicker

RESTS, FROM = 200, 100
READ_G = 1e-5
"""of a mean by its own rows, beside the floor of the class"""
ROWS, ROW_S = 600, 0.1
"""of a rest whose axes' scatter is kept"""
WAYS: dict[str, Sequence[float]] = {
    **{f"{times} times": [times] * (RESTS - FROM) for times in (2, 3, 4, 6, 10, 30)},
    "6 times, 12 rests": [6] * 12,
    "6 times, 3 rests": [6] * 3,
    "30 times, one rest": [30],
}
"""by how much the noise grows, rest by rest from `FROM` on; as it was afterwards"""
STEPS_G = 1e-4, 1.5e-4, 2e-4, 3e-4, 5e-4, 1e-3, 3e-3
BAR_H, BAR_TIMES = 2.0, 1.5
"""a departure is to be found within that many hours, or that many times what the bound needs"""
UNFOLLOWED = replace(POLICY, jump=np.inf, scale_from=10**9)
"""noise is as stated, whatever is seen"""


@dataclass(frozen=True)
class Said:
    """Of one series: whether something departs, whether that was said before anything happened, and that noise has
    grown; of a step: rests from the first that has it until the alarm (0: that one) and until the bound; whether the
    truth is in the class at the alarm."""

    departs: bool
    early: bool
    grown: bool
    after: int | None = None
    bound: int | None = None
    named: bool = False
    knowing: int | None = None
    """rests until who knows all but the size, and whether noise has jumped, could say it"""


def run(seed: int, apart_s: float, noise: Sequence[float] = (), step_g: float = 0.0, scatter: str = "none") -> Said:
    """One series."""
    rng = np.random.default_rng(seed)
    stated = prior(np.eye(12) * 1e-10, 1e-6, 20.0, STATED, POLICY)
    watch, bound = Watch(stated), Watch(stated, policy=UNFOLLOWED)
    truth = np.sqrt(np.diag(stated.covariance)) * rng.standard_normal(len(stated.covariance))
    walk = np.sqrt(np.diag(stated.process_noise) * apart_s / 3600.0)
    axis = int(rng.integers(3))
    size, name = step_g * float(rng.choice([-1.0, 1.0])), f"b_{'xyz'[axis]}"
    need = np.sqrt(POLICY.threshold) + POLICY.power
    early, after, reached, named, knowing = False, None, None, False, None
    for k in range(RESTS):
        truth = truth + walk * rng.standard_normal(truth.size)
        truth[axis] += size * (k == FROM)
        times = noise[k - FROM] if 0 <= k - FROM < len(noise) else 1.0
        one = _rest(apart_s * k, truth, times, rng, scatter)
        if after is None:
            watch.still(one)
            if watch.alarm_s is not None:
                early, after = k < FROM, k - FROM
                named = name in watch.result().claims[0].equivalence_class
        if step_g and (reached is None or knowing is None):
            bound.still(replace(one, std_g=READ_G, scatter_g=None))
            information = bound.information_of(name, FROM * apart_s) if k >= FROM else 0.0
            if reached is None and abs(size) * np.sqrt(information) >= need:
                reached = k - FROM
            if knowing is None and k >= FROM and _could_say(bound, name, FROM * apart_s):
                knowing = k - FROM
        if early or (after is not None and (not step_g or None not in (reached, knowing))):
            break
    return Said(after is not None, early, watch.result().noise_grown, after, reached, named, knowing)


def _could_say(bound: Watch, name: str, since_s: float) -> bool:
    """Whether one departure of known kind and onset is above the threshold, and no noise explains as much."""
    known = bound.memory().arrays
    at = (known["bank_of"] == [one.name for one in HYPOTHESES].index(name)) & (known["bank_since"] == since_s)
    (column,) = np.flatnonzero(at)
    ratio = known["bank_score"][column] ** 2 / known["bank_information"][column]
    squares, numbers = known["bank_all"][:, column]
    left = max(squares - ratio, numbers - 1.0)
    against_noise = squares - left - noise_evidence(float(squares), int(numbers))
    return bool(
        numbers >= POLICY.jump_fewest and ratio > POLICY.threshold and against_noise > -2.0 * np.log(POLICY.jump_chance)
    )


def _rest(t_s: float, truth: Array, times: float, rng: np.random.Generator, scatter: str) -> Still:
    """A mean in any attitude."""
    f = rng.standard_normal(3)
    f /= np.linalg.norm(f)
    read = (np.eye(3) + truth[3:12].reshape(3, 3)) @ f * (1.0 + truth[GRAVITY]) + truth[:3]
    of_mean = np.hypot(READ_G, STATED.still_floor_g)
    if scatter == "none":
        return Still(t_s, read + times * of_mean * rng.standard_normal() * f, READ_G, 20.0)
    rows = READ_G * np.sqrt(ROWS) * rng.standard_normal((3, ROWS)) + flicker(rng, ROWS)
    if scatter == "rows":
        rows *= times
    else:
        rows += np.sqrt(times**2 - 1.0) * of_mean * rng.standard_normal((3, 1))
    within = scatters(ROW_S * np.arange(ROWS), rows)
    return Still(
        t_s, read + rows.mean(axis=1), float(np.linalg.norm(f * within[0])) / np.sqrt(ROWS), 20.0, None, within
    )


def _print_noise(word: str, found: list[Said]) -> None:
    false = sum(one.departs for one in found)
    grown = sum(one.grown for one in found)
    print(f"| {word} | {false} of {len(found)} | {grown} of {len(found)} |", flush=True)


def _print_step(size: float, apart_s: float, found: list[Said]) -> None:
    judged = [one for one in found if not one.early]
    got = [one.after for one in judged if one.after is not None]
    within = [one for one in judged if one.bound is not None]
    late = [one for one in within if _is_late(one, apart_s)]
    knowing = sum(not _is_late(replace(one, after=one.knowing), apart_s) for one in within)
    say = ", ".join(f"{np.quantile(got, q):.0f}" for q in (0.5, 0.95, 1.0)) if got else "none"
    bound = np.median([one.bound for one in within if one.bound is not None]) if within else np.nan
    print(
        f"| {1e3 * size:g} mg | {len(found) - len(judged)} | {len(got)} of {len(judged)} | {say} | {bound:.0f} |"
        f" {len(within) - len(late)} of {len(within)} | {knowing} of {len(within)} |"
        f" {sum(one.named for one in judged)} of {len(got)} |",
        flush=True,
    )


def _is_late(one: Said, apart_s: float) -> bool:
    """Whether it was not found in the time of the bar."""
    assert one.bound is not None
    return one.after is None or one.after * apart_s > max(BAR_TIMES * one.bound * apart_s, BAR_H * 3600.0)


def main() -> None:
    """Print both tables as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--series", type=int, default=40, help="of each row")
    parser.add_argument("--first-seed", type=int, default=71_000)
    parser.add_argument("--apart-min", type=float, default=10.0, help="from one rest to the next")
    parser.add_argument("--scatter", choices=["none", "rows", "blind"], default="none", help="what is kept of the rows")
    parser.add_argument("--only", choices=["noise", "step"], help="one of the tables")
    parser.add_argument("--sizes-mg", type=float, nargs="+", help="of the steps these alone")
    args = parser.parse_args()
    apart_s, seeds = 60.0 * args.apart_min, range(args.first_seed, args.first_seed + args.series)
    if args.only != "step":
        print("| noise | departs: false | noise grown, said |\n|---|---|---|")
        all_of = []
        for k, (word, noise) in enumerate(WAYS.items()):
            found = [run(1000 * seed + k, apart_s, noise, 0.0, args.scatter) for seed in seeds]
            _print_noise(word, found)
            all_of += found
        _print_noise("all", all_of)
    if args.only != "noise":
        print(
            "| step | alarms before it | found | rests until the alarm: 50, 95, 100 % | bound | in time |"
            " could be | in class |"
        )
        print("|---|---|---|---|---|---|---|---|")
        for k, size in enumerate(STEPS_G):
            if args.sizes_mg and not np.isclose(args.sizes_mg, 1e3 * size).any():
                continue
            steps = [run(1000 * seed + 100 + k, apart_s, (), size, args.scatter) for seed in seeds]
            _print_step(size, apart_s, steps)


if __name__ == "__main__":
    main()
