"""Whether what was hidden is likelier than what was told: the true places and covariates as the search would have them.

    python -m studies.open_world.true_sets --seed HASH --answers FILE [--design rotation] [--only NAMES] [--minutes M]

Of each case of laws, or of a sweep of one, of strength 400 and more in FILE (of `studies.open_world.score` on the same
deck) that is not in the class told, the session is diagnosed again. Where the search that has most of them and finds
most ends, another begins with nothing but the groups of the true places and covariates, on whatever channels: with the
same starts, products, variants and onsets of these, and without laws of anything else. Told is the worth of what both
end with (log evidence, 6 nats less for each law, and the logarithm of how many like it are tried): a true set of less
worth cannot be told by a search that judges by evidence; one of more was missed by its steps; one of the same was found
and not told, for its laws predict no values that were held out. A true law that has no group is told.

Then all true laws stand side by side in the places and on the channels that they have, which no search is told: of how
many the removal costs the 12 nats that a law must be worth, the noise learnt again. Where that is not all of them, a
search by this evidence, of smooth functions with these priors, cannot tell them all; who knows the forms may.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from highside.diagnosis.laws.evidence import LawTerm
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.noise import LawNoise
from highside.diagnosis.laws.policy import LAW_SEARCH
from highside.diagnosis.laws.products import ProductGroup
from highside.diagnosis.laws.search import Search
from highside.diagnosis.laws.state import State

from . import deck, judging, score
from .laws import Law

Row = dict[str, Any]
TURNS = 4
"""rounds of priors and noise beside all true laws"""
LEAST = 400.0
"""strength from which the bars count a case"""


@dataclass(frozen=True)
class Compared:
    """What a search found and what was hidden, both by worth in nats beside the session without laws."""

    found: float
    true: float
    lacking: int
    """true laws for which there is no group"""
    shown: int | None
    """true laws that are worth what a law must be, all of them side by side; None where one has no group"""


def is_of(group: LawGroup, law: Law, design: str = "poses") -> bool:
    """Whether a group acts where a law does and follows what it follows, in whatever words the judging accepts. No
    product that a search made is: it was made for what that found."""
    if group.effect or isinstance(group, ProductGroup):
        return False
    follows = frozenset("temp_filtered" if n.startswith("temp_filtered") else n for n in group.depends_on)
    return (group.place, follows) in judging.accepted(law.plain(), design)


class Among(Search):
    """A search among some groups, and what they become, alone."""

    def _from_edges(self, best: State) -> State:
        return best

    def _from_onsets(self, first: State) -> State:
        return first

    def _without_time(self, state: State) -> State:
        return state

    def _ended(self, state: State) -> State:
        return state


def true_set(search: Search, laws: Sequence[Law], design: str) -> float | None:
    """What the likeliest groups of the true laws are worth, in nats; None where there is none of any."""
    groups = [g for g in search.groups if any(is_of(g, law, design) for law in laws)]
    worths: list[float] = []

    def noted(_: Search, state: State) -> None:
        worths.append(state.less_tries)

    with mock.patch.object(Among, "_found", noted):
        if groups:
            Among(search.problem, groups).run()
    return worths[-1] if worths else None


def of_channels(group: LawGroup, law: Law) -> bool:
    """Whether a group acts on the channels that a law acts on, or on the one element of the matrix."""
    own = [unit.channel[-2:] if law.place == "matrix" else unit.channel[-1] for unit in group.units]
    if law.place == "matrix":
        return own == ["".join("xyz"[k] for k in law.element)]
    if law.place not in ("offset", "scale", "level") or group.place == "inclination":
        return True
    axes = [axis for axis, weight in zip("xyz", law.weights, strict=False) if weight]
    return sorted(own) == axes or (law.place == "scale" and len(axes) == len("xyz") and len(own) == 1)


def side_by_side(search: Search, laws: Sequence[Law], design: str) -> State | None:
    """The true laws all at once where they are, each as its likeliest group beside the others; the likeliest of some
    rounds of priors, variants and noise. None where one has no group."""
    offered = [[g for g in search.groups if is_of(g, law, design) and of_channels(g, law)] for law in laws]
    if not all(offered):
        return None
    best, state = None, State([], LawNoise.floor_alone(search.problem), -np.inf, search.problem.residual)
    for turn in range(TURNS):
        white = search._whitened(state)
        for k, groups in enumerate(offered):
            others = [t for i, t in enumerate(state.terms) if i != k]
            gains, priors = white.of_groups(groups).scores(others, within=np.inf)
            chosen = LawTerm(groups[int(np.argmax(gains))], priors[int(np.argmax(gains))])
            state.terms[k : k + 1] = [chosen] if np.isfinite(gains).any() else state.terms[k : k + 1] or [chosen]
        terms = search._varied(state, state.terms) if turn else state.terms
        state = search._learn(list(terms), search.problem.residual)
        best = state if best is None else max((best, state), key=lambda one: one.less_tries)
    return best


def compared(seed: str, name: str) -> tuple[Row, Compared | None]:
    """What is told of a case now, and what its best search of all places found beside what was hidden."""
    case = score.every_case(seed, (name.split("/")[0],))[name]()
    searched: list[tuple[Search, State, float]] = []
    found_of = Search._found

    def and_keep(search: Search, state: State) -> Any:
        worth = state.less_tries - search._learn([], search.problem.residual).worth
        searched.append((search, state, worth))
        return found_of(search, state)

    with mock.patch.object(Search, "_found", and_keep), tempfile.TemporaryDirectory() as folder:
        row = score.run_case(case, Path(folder))
    if not searched:
        return row, None
    # names are compared by searches of their own, and the rows within poses by some of few places
    most = max(len(search.groups) for search, _, _ in searched)
    search, _, found = max((one for one in searched if 2 * len(one[0].groups) > most), key=lambda one: one[2])
    nothing = search._learn([], search.problem.residual).worth
    true = true_set(search, case.laws, case.design)
    lacking = sum(not any(is_of(g, law, case.design) for g in search.groups) for law in case.laws)
    every = side_by_side(search, case.laws, case.design)
    shown = None if every is None else sum(cost >= LAW_SEARCH.gain for cost in search._costs(every))
    return row, Compared(found, -np.inf if true is None else true - nothing, lacking, shown)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", required=True)
    parser.add_argument("--answers", type=Path, required=True)
    parser.add_argument("--design", choices=deck.KINDS, default="poses")
    parser.add_argument("--only", default="", help="cases whose name begins so, or so: separated by commas")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after so long")
    given = parser.parse_args()
    rows = [json.loads(line) for line in given.answers.read_text().splitlines()]
    missed = [
        row["name"]
        for row in rows
        if row["group"] in ("law", "sweep")
        and row["name"].startswith(tuple(given.only.split(",")))
        and deck.kind_of(row["name"]) == given.design
        and row["truth"]["strength"] >= LEAST
        and not judging.judged(row)["in_class"]
    ]
    began, less, more, none, hidden = time.perf_counter(), 0, 0, 0, 0
    for name in missed:
        if time.perf_counter() - began > 60.0 * given.minutes:
            break
        row, one = compared(given.seed, name)
        truth = row["truth"]
        said = f"{name} [{truth['noise']} {truth['strength']:.3g}]"
        if one is None or not np.isfinite(one.true):
            none += 1
            print(f"{said}: no search, or no group of what was hidden", flush=True)
            continue
        less, more = less + (one.true <= one.found), more + (one.true > one.found)
        count = len(truth["laws"])
        hidden += one.shown is not None and one.shown < count
        lacks = f", {one.lacking} of {count} laws without a group" if one.lacking else ""
        worths = f"told is worth {one.found:.1f} nats, what was hidden {one.true:.1f}"
        show = "" if one.shown is None else f"; side by side {one.shown} of {count} laws show"
        print(f"{said}: {worths}{show}{lacks}", flush=True)
    print(
        f"of {less + more + none} not in the class told: hidden worth no more {less}, more {more}, "
        f"not comparable {none}; of the compared, not all laws show in {hidden}"
    )


if __name__ == "__main__":
    main()
