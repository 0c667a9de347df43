"""Cases of the open world through the real command: files in, an answer and a written model out, a second session."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from studies.open_world import deck, designs, judging, score, section_one, world
from studies.open_world.answers import Case
from studies.open_world.laws import Law
from studies.open_world.shapes import Shape


def pair(shape: Shape, seed: str) -> Case:
    """A law of the load on x in the other deck's stepped session, with a second session."""
    rng = deck.rng_of(seed, "pair")
    s = section_one.stepped(rng)
    law = Law("offset", ("load_x",), shape, ((-1.0, 1.0),), 1e-3, (1.0, 0.0, 0.0))
    noise, sensor = section_one.white(s), world.drawn_sensor(rng)
    law = deck.sized(s, sensor, law, noise, 3000.0)
    return deck.built("law/test", "law", rng, s, noise, (law,), sensor, designs.second(rng, s), plain=True)


@pytest.fixture(scope="module")
def square(tmp_path_factory: pytest.TempPathFactory) -> score.Row:
    """A square of the load, which the library holds."""
    case = pair(Shape("power", {"at": 0.0, "exponent": 2.0, "odd": False}), "square")
    return score.run_case(case, tmp_path_factory.mktemp("square"))


def test_what_the_library_holds_is_named_and_closes_on_the_other_session(square: score.Row) -> None:
    assert square["trouble"] is None
    assert [claim["effect"] for claim in square["answer"]["claims"]] == ["quadratic"]
    assert square["closed"] > 0.95
    assert square["outside"] < judging.OUTSIDE, "the name holds all of it"
    assert square["captured"] > 0.95
    assert judging.judged(square)["bucket"] == "near name"


def test_an_answer_that_ends_in_an_error_is_counted_with_its_reason(tmp_path: Path) -> None:
    case = deck.null_case("null/000", "test", 0)
    case.model = "[sensor]\nfree = ["
    row = score.run_case(case, tmp_path)
    assert row["answer"] is None and "model.toml" in row["trouble"]
    assert judging.judged(row)["bucket"] == "error"


def test_the_share_does_not_depend_on_rows_that_the_first_session_has_not_visited(tmp_path: Path) -> None:
    case = pair(Shape("power", {"at": 0.0, "exponent": 2.0, "odd": False}), "square")
    assert case.kept_from is not None and case.other is not None
    case.kept_from[:, :50] = np.nan
    assert score.run_case(case, tmp_path)["closed"] > 0.95
