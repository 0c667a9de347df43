"""200 spoilt files: what comes out is what was recorded, or nothing. Never a wrong unit or axis, asked for or not."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from foreign_files import FILES
from foreign_session import Session, session
from foreign_texts import ForeignFile
from mutations import MUTATIONS
from test_foreign_files import wrong

import highside
from highside.errors import InputError

FILES_SPOILT = 200
READ = {name: file for name, file in FILES.items() if not file.refused}


def spoilt(seed: int, count: int) -> list[tuple[str, str, bytes, Session]]:
    """(name of the file, what was done, bytes, what is true): each mutation as often, each file in its turn."""
    rng = np.random.default_rng(seed)
    made: list[tuple[str, str, bytes, Session]] = []
    names = list(READ)
    tries = 0
    while len(made) < count:
        mutation, name = MUTATIONS[len(made) % len(MUTATIONS)], names[tries % len(names)]
        tries += 1
        found = mutation(READ[name], session(seed=int(rng.integers(100))), rng)
        if found is not None:
            made.append((name, mutation.__name__, *found))
    return made


def answers(file: ForeignFile) -> list[dict[str, object]]:
    """Nothing, and yes to what is shown; a rate where rows have no time. Who gives a unit himself is not asked."""
    rate = {key: value for key, value in file.answer.items() if key == "rate_hz"}
    return [rate, {"accept": True} | rate]


def judged(path: Path, name: str, how: str, data: bytes, s: Session, answer: dict[str, object]) -> str:
    """`refused`, `right`, or what is wrong."""
    path.write_bytes(data)
    try:
        found = highside.import_recording(path, **answer)  # type: ignore[arg-type]
    except InputError as error:
        return "refused" if "\n" not in str(error) else "wrong: a refusal of several lines"
    # a torn file may end within a number, which is said; what is before that row is whole
    fault = wrong(found, s, READ[name], beginning=how == "torn_end")
    return f"wrong: {', '.join(fault)}" if fault else "right"


@pytest.mark.parametrize("seed", [20261123])
def test_no_spoilt_file_gives_a_wrong_unit_or_a_wrong_axis(tmp_path: Path, seed: int) -> None:
    counts: Counter[tuple[str, str]] = Counter()
    faults = []
    for number, (name, how, data, s) in enumerate(spoilt(seed, FILES_SPOILT)):
        for answer in answers(READ[name]):
            said = judged(tmp_path / name, name, how, data, s, answer)
            counts[how, said.split(":")[0]] += 1
            if said.startswith("wrong"):
                faults.append((number, name, how, answer, said))
    print(*sorted(counts.items()), sep="\n")
    assert not faults
    # they are not all refused
    assert counts["shuffled_columns", "right"] >= 5
    assert counts["cut_rows", "right"] >= 5
    assert counts["other_separator", "right"] >= 3
    # and what is wrong in them is seen
    assert counts["scaled_accelerations", "refused"] >= 5
    assert counts["two_axes", "refused"] >= 10
