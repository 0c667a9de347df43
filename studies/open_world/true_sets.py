"""Whether what was hidden is likelier than what was told: the true places and covariates as the search would have them.

    python -m studies.open_world.true_sets --seed HASH --answers FILE [--design rotation] [--only NAMES] [--minutes M]

Of each case of laws, or of a sweep of one, of strength 400 and more in FILE (of `studies.open_world.score` on the same
deck) that is not in the class told, the session is diagnosed again. Where its last search ends, the groups of the true
places and covariates, on whatever channels, are put in the place of what was found: one for each true law, more while
one gains 12 nats; sized and with the noise learned in turn, from the noise of the search and from the floor. Told is
the worth of both (log evidence, 6 nats less for each law): a true set of less worth cannot be told by a search that
judges by evidence; one of more was missed by its steps; one of the same was found and not told, for its laws predict no
values that were held out. A true law that has no group (a product that was not tried) is told; onsets are not among
these.
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
LEAST = 400.0
"""strength from which the bars count a case"""
ROUNDS = 4
"""of sizes and noise in turn; a third changed nothing in six cases looked at"""


@dataclass(frozen=True)
class Compared:
    """What a search found and what was hidden, both by worth in nats beside the session without laws."""

    found: float
    true: float
    lacking: int
    """true laws for which there is no group"""


def _plain(name: str) -> str:
    return "temp_filtered" if name.startswith("temp_filtered") else name


def is_of(group: LawGroup, law: Law) -> bool:
    """Whether a group is in the place of a law and follows what it follows. No product is: it was made for what a
    search found, and its worth is without what its second function costs."""
    same = sorted(map(_plain, group.depends_on)) == sorted(map(_plain, law.covariates))
    return not (group.effect or isinstance(group, ProductGroup)) and group.place == law.place and same


def true_set(search: Search, laws: Sequence[Law], found: State) -> State | None:
    """The likeliest state of groups of the true laws; None where there is none of any."""
    best = None
    own = [[g for g in search.groups if is_of(g, law)] for law in laws]
    for start in (found.noise, LawNoise.floor_alone(search.problem)):
        noise, terms = start, dict[int, LawTerm]()
        for _ in range(ROUNDS):
            white = search._whitened(State([], noise, 0.0, found.residual))
            for k, groups in enumerate(own):
                others = [t for i, t in terms.items() if i != k]
                if groups and (one := _best(white.of_groups(groups).scores(others), groups)) is not None:
                    terms[k] = one[0]
            every = [g for groups in own for g in groups]
            more = list(terms.values())
            while every and (one := _best(white.of_groups(every).scores(more), every)) is not None:
                if one[1] < LAW_SEARCH.gain or len(more) >= LAW_SEARCH.most:
                    break
                more.append(one[0])
            if not more:
                return None
            state = search._learn(more, search.problem.residual)
            noise = state.noise
            if best is None or state.worth > best.worth:
                best = state
    return best


def _best(scored: tuple[np.ndarray, list[Any]], groups: Sequence[LawGroup]) -> tuple[LawTerm, float] | None:
    gains, priors = scored
    at = int(np.argmax(gains))
    return (LawTerm(groups[at], priors[at]), float(gains[at])) if np.isfinite(gains[at]) else None


def compared(seed: str, name: str) -> tuple[Row, Compared | None]:
    """What is told of a case now, and what its last search found beside what was hidden."""
    case = score.every_case(seed, (name.split("/")[0],))[name]()
    last: list[Compared] = []
    found_of = Search._found

    def and_compare(search: Search, state: State) -> Any:
        found = found_of(search, state)
        nothing = search._learn([], search.problem.residual).worth
        true = true_set(search, case.laws, state)
        lacking = sum(not any(is_of(g, law) for g in search.groups) for law in case.laws)
        last[:] = [Compared(state.worth - nothing, true.worth - nothing if true else -np.inf, lacking)]
        return found

    with mock.patch.object(Search, "_found", and_compare), tempfile.TemporaryDirectory() as folder:
        row = score.run_case(case, Path(folder))
    return row, last[0] if last else None


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
    began, less, more, none = time.perf_counter(), 0, 0, 0
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
        lacks = f", {one.lacking} of {len(truth['laws'])} laws without a group" if one.lacking else ""
        print(f"{said}: told is worth {one.found:.1f} nats, what was hidden {one.true:.1f}{lacks}", flush=True)
    print(
        f"of {less + more + none} not in the class told: hidden worth no more {less}, more {more}, "
        f"not comparable {none}"
    )


if __name__ == "__main__":
    main()
