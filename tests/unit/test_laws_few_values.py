"""Strong laws in few poses are found beside less noise than is learnt without them, and told for what they are."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies.open_world.score import every_case, run_case

FURTHER = pytest.mark.further
DECK = "6e7a83282220bb7c572626125f35237d45e292c7"
"""whose cases set the numbers (`highside.diagnosis.laws.few_values_policy`)"""


@FURTHER
@pytest.mark.parametrize(
    ("name", "poses", "depends_on", "closed"),
    [pytest.param("law/022", 21, ["tf"], 0.9, marks=FURTHER), ("law/092", 20, ["temp"], 0.5)],
)
def test_a_strong_law_of_several_in_few_poses_is_told_though_noise_would_take_it(
    name: str, poses: int, depends_on: list[str], closed: float, tmp_path: Path
) -> None:
    case = every_case(DECK, ("law",))[name]()
    assert len(set(case.recording["pose"])) == poses
    row = run_case(case, tmp_path)
    assert row["answer"]["verdict"] == "law"
    assert depends_on in [claim["depends_on"] for claim in row["answer"]["claims"]]
    assert row["closed"] > closed


@FURTHER
def test_each_of_two_strong_laws_in_few_poses_is_chosen_by_its_evidence_with_the_noise_learnt_again(
    tmp_path: Path,
) -> None:
    # beside any one noise offsets of all axes that follow time gain more than either, and nothing is left for the other
    case = every_case("a8d2cc90c1702daeeaaa123b11a1caf618258a7c", ("law",))["law/318"]()
    assert len(set(case.recording["pose"])) == 13
    row = run_case(case, tmp_path)
    told = {(claim["place"], *claim["depends_on"]) for claim in row["answer"]["claims"]}
    assert told == {("toolface", "temp"), ("matrix", "vibration")}
    assert row["closed"] > 0.95


def test_where_noise_far_above_the_floor_stays_a_law_of_a_few_nats_is_no_claim(tmp_path: Path) -> None:
    # an offset of the toolface would gain 15.6 nats, and leave 29 times the floor
    row = run_case(every_case(DECK, ("law",))["law/308"](), tmp_path)
    assert row["answer"]["verdict"] == "unknown"
    assert row["answer"]["claims"] == []


def test_of_formulas_that_tie_the_best_predicts_where_the_curve_does_worse(tmp_path: Path) -> None:
    # an exponential, of 18 poses: a saturation does as well, and the curve of three cosines closed 0.11
    row = run_case(every_case(DECK, ("law",))["law/306"](), tmp_path)
    (claim,) = row["answer"]["claims"]
    assert "exp(" in claim["formula"] and " or " in claim["formula"]
    assert row["closed"] > 0.95
