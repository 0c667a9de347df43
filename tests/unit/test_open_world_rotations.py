"""Rotations of the open world on which something was mended, through the command."""

from pathlib import Path

import pytest

from studies.open_world import judging, score

FURTHER = pytest.mark.further

WHERE_ROWS_ARE = "06f31f0a752188b81e127ebd1beb876e580300d2"
PAIRS = "66ff7ef17a204d806ec138e48a9793a8c0c0dbe3"
SEVERAL = "e266825cd4db4ada570d642751ea3f26b1d87403"
SLOW = "be5acceddb62ccb7f38721f12cdcfaa664e58bff"


@pytest.mark.parametrize(
    ("seed", "name"),
    [
        # a curve that bends within a cell: of its mean temperature it left a second law, and both were wrong elsewhere
        pytest.param(WHERE_ROWS_ARE, "law/301", marks=FURTHER),
        # a factor that follows the rate and the supply together, no listed pair
        pytest.param(PAIRS, "law/037", marks=FURTHER),
        # a stray delay was learned of a temperature at single rows in place of means, and took the laws away
        (PAIRS, "law/089"),
    ],
)
def test_a_law_is_found_and_predicts_another_session(seed: str, name: str, tmp_path: Path) -> None:
    row = score.run_case(score.every_case(seed, ("law",))[name](), tmp_path)
    assert judging.judged(row)["in_class"]
    assert row["closed"] >= 0.9


@pytest.mark.parametrize(
    ("name", "effect"),
    [
        # steps of a converter across the axis are no error of means; a step within a cell has its time
        pytest.param("known/173", "temperature_bias", marks=FURTHER),
        pytest.param("known/181", "bias_step", marks=FURTHER),
        # a hysteresis wider than the range, in a random walk, is a temperature coefficient
        ("known/087", "temperature_bias"),
    ],
)
def test_an_effect_of_the_library_has_its_name_and_no_other(name: str, effect: str, tmp_path: Path) -> None:
    row = score.run_case(score.every_case(WHERE_ROWS_ARE, ("known",))[name](), tmp_path)
    claims = row["answer"]["claims"]
    assert [claim["effect"] for claim in claims if claim["effect"] != "wander"] == [effect]
    if effect == "bias_step":
        assert claims[0]["parameters"]["t0"]["value"] == pytest.approx(299.9, abs=0.2)


@FURTHER
def test_of_three_effects_no_surface_stands_for_two(tmp_path: Path) -> None:
    # a surface of toolface and rate held an eccentric encoder and a late clock, 8 nats behind the three names
    row = score.run_case(score.every_case(SEVERAL, ("table",))["table/three in rotation/1"](), tmp_path)
    assert row["answer"]["verdict"] == "named"
    assert {"encoder_first_harmonic", "time_offset"} <= {claim["effect"] for claim in row["answer"]["claims"]}


@pytest.mark.parametrize(
    "name",
    [
        # a rate that a test of rows with a short memory points at, and beside the noise that was learned nothing does
        "null/195",
        pytest.param("null/117", marks=FURTHER),
        # a name worth 0.4 nats beside the noise that was learned with it
        pytest.param("null/069", marks=FURTHER),
    ],
)
def test_noise_with_a_long_memory_is_told_as_noise(name: str, tmp_path: Path) -> None:
    answer = score.run_case(score.every_case(SLOW, ("null",))[name](), tmp_path)["answer"]
    assert (answer["verdict"], answer["claims"]) == ("wander", [])
