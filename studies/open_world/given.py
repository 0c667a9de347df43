"""What closes where the true places and covariates are given: the bound of everything that the choice among laws does.

    python -m studies.open_world.given --seed SEED [--several] [--first K] [--cases N] [--minutes M] [--out FOLDER]

Stepped sessions with one law, or with --several two to four that act all the time, of strength 400 or more. Each is
answered as `studies.open_world.score` does it, and once more by a search that has nothing but the groups of its true
places, channels and covariates: these still have to be worth their claims, beside noise that is learnt. What that does
not tell or close is beyond any choice. The answers are kept line by line, with the strength of each law by itself.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from . import deck, judging, score, world
from .answers import Case

Row = dict[str, Any]


def is_true(law: Row, group: Any) -> bool:
    """Whether a group of functions is of a law's place, channel and covariates."""
    keys = judging.accepted(law, "poses")
    if group.effect or (group.place, frozenset(group.depends_on)) not in keys:
        return False
    channels = "".join(unit.channel for unit in group.units)
    acting = [axis for axis, weight in zip("xyz", law["weights"], strict=True) if weight]
    if law["place"] == "matrix":
        return channels.startswith("xyz"[law["element"][0]])
    return law["place"] not in ("offset", "scale") or len(acting) > 1 or channels == acting[0]


@contextmanager
def nothing_but(laws: list[Row]) -> Iterator[None]:
    """The search for laws has the groups of these laws alone, and no name stands beside them."""
    from highside.diagnosis import beside_laws, names_instead
    from highside.diagnosis.laws.found import Found
    from highside.diagnosis.laws.search import Search

    run, alone = Search.run, beside_laws._alone

    def given(self: Search) -> Found:
        groups = [group for group in self.groups if any(is_true(law, group) for law in laws)]
        return run(Search(self.problem, groups) if groups else self)

    def without_names(session: Any, model: Any, claims: Any, near: Any, refused: Any) -> Any:
        return alone(session, model, [], frozenset())

    with (
        mock.patch.object(Search, "run", given),
        mock.patch.object(beside_laws, "_chosen", without_names),
        mock.patch.object(beside_laws, "alike_of", return_value=[]),
        mock.patch.object(names_instead, "alike_of", return_value=[]),
    ):
        yield


def strengths(case: Case) -> list[float]:
    """Of each law by itself, against white noise, on the readings of an instrument without faults of its own."""
    assert case.first is not None
    plain = world.drawn_sensor(np.random.default_rng(0))
    parts = [world.off_base(case.first, world.contribution(case.first, plain, [law])) for law in case.laws]
    return [float(np.sum((part / np.array(case.sigma)[:, None]) ** 2)) for part in parts]


def asked(seed: str, first: int, *, several: bool) -> Iterator[str]:
    """Names of the cases of poses with one law, or with several."""
    size = deck.Size()
    for k in range(first, size.laws):
        name = f"law/{k:03d}"
        if deck.kind_of(name) != "poses":
            continue
        count, onset = deck.drawn_count(deck.rng_of(seed, name))
        if not onset and (count > 1) == several:
            yield name


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", required=True)
    parser.add_argument("--several", action="store_true", help="two to four laws, not one")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--out", type=Path, default=Path("open-world"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / f"given-{'several' if given.several else 'one'}-of-{given.seed[:12]}.jsonl"
    done = {row["name"] for row in score.written(path)}
    began, makers = time.perf_counter(), score.every_case(given.seed, ("law",))
    with tempfile.TemporaryDirectory(prefix="given-") as place, path.open("a") as file:
        for name in list(asked(given.seed, given.first, several=given.several))[: given.cases]:
            if time.perf_counter() - began > 60.0 * given.minutes:
                break
            if name in done or (case := makers[name]()).strength < judging.STRONG:
                continue
            answers: dict[str, Row] = {}
            for way in ("searched", "given"):
                folder = Path(place) / name.replace("/", "_") / way
                folder.mkdir(parents=True, exist_ok=True)
                if way == "searched":
                    answers[way] = score.run_case(case, folder)
                else:
                    with nothing_but(case.answer()["laws"]):
                        answers[way] = score.run_case(case, folder)
                print(f"{name} {way}: {score._said(answers[way])}", flush=True)
            row = {"name": name, "strengths": strengths(case), **answers}
            file.write(json.dumps(row, default=float) + "\n")
            file.flush()


if __name__ == "__main__":
    main()
