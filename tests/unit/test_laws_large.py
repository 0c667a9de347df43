"""Laws of any size are the same laws, through the command: cases of the open world on which something was mended."""

from pathlib import Path

import pytest

from studies.open_world import judging, score

SEED = "66ff7ef17a204d806ec138e48a9793a8c0c0dbe3"


@pytest.mark.parametrize(
    "name",
    [
        # a tilt of five degrees: the misalignment that the base fit had put in its place acts on the load it moves, and
        # was told as a scale that follows the temperature and two more laws
        "sweep/006/10000000",
        # 14 poses in 1/f noise: 40 nats were asked beside a random walk, and a law of any size gained 15
        "sweep/004/10000000",
        "sweep/004/100000",
        # a law of time taken for one of temperature left another nothing, and both were lost
        "sweep/122/10000",
    ],
)
def test_what_is_told_of_a_law_is_told_of_a_larger_one(name: str, tmp_path: Path) -> None:
    row = score.run_case(score.every_case(SEED, ("sweep",))[name](), tmp_path)
    assert judging.judged(row)["in_class"]


@pytest.mark.parametrize("name", ["null/006", "null/052", "null/066"])
def test_a_walk_of_poses_is_no_law(name: str, tmp_path: Path) -> None:
    row = score.run_case(score.every_case(SEED, ("null",))[name](), tmp_path)
    assert row["answer"]["verdict"] == "wander"
    assert [c for c in row["answer"]["claims"] if c["effect"] != "wander"] == []
