"""Laws of any size are the same laws, through the command: cases of the open world on which something was mended."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_laws_search import PLAIN, problem, session

from highside.diagnosis.laws.claims import size_beside_free
from highside.diagnosis.laws.evidence import Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.noise import LawNoise, Whitener
from studies.open_world import judging, score

FURTHER = pytest.mark.further

SEED = "66ff7ef17a204d806ec138e48a9793a8c0c0dbe3"


@pytest.mark.parametrize(
    "name",
    [
        # a tilt of five degrees: the misalignment that the base fit had put in its place acts on the load it moves, and
        # was told as a scale that follows the temperature and two more laws
        pytest.param("sweep/006/10000000", marks=FURTHER),
        # 14 poses in 1/f noise: 40 nats were asked beside a random walk, and a law of any size gained 15
        "sweep/004/10000000",
        pytest.param("sweep/004/100000", marks=FURTHER),
        # a law of time taken for one of temperature left another nothing, and both were lost
        pytest.param("sweep/122/10000", marks=FURTHER),
    ],
)
def test_what_is_told_of_a_law_is_told_of_a_larger_one(name: str, tmp_path: Path) -> None:
    row = score.run_case(score.every_case(SEED, ("sweep",))[name](), tmp_path)
    assert judging.judged(row)["in_class"]


def test_a_law_is_no_larger_than_the_misfit_that_it_is() -> None:
    """Under a random walk offsets were let go, and a tilt of 38 mg of misfit had a size of 71 mg."""
    state = session(3, 40)
    effect = PLAIN.pose_sensitivity(state)[:, 0] * 3e-3 * np.tanh((state.temp_c - 35) / 4)
    posed = problem(state, PLAIN.predict(state) + effect)[1]
    wandering = replace(LawNoise.floor_alone(posed), share=np.full(3, 1e4), length=np.full(3, 1e6))
    left = []
    for noise in (LawNoise.floor_alone(posed), wandering):
        white = Whitened(Families(posed, []), Whitener(posed, noise), posed.residual)
        left.append(size_beside_free(white, effect, (0, 1, 2))[0])
    misfit = float(np.sqrt(np.mean(posed.residual**2)))
    assert left == pytest.approx([misfit, misfit], rel=0.02)


@pytest.mark.parametrize(
    "name", [pytest.param("null/006", marks=FURTHER), pytest.param("null/052", marks=FURTHER), "null/066"]
)
def test_a_walk_of_poses_is_no_law(name: str, tmp_path: Path) -> None:
    row = score.run_case(score.every_case(SEED, ("null",))[name](), tmp_path)
    assert row["answer"]["verdict"] == "wander"
    assert [c for c in row["answer"]["claims"] if c["effect"] != "wander"] == []
