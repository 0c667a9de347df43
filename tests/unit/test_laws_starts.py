"""Laws that the first way of a search misses: what stands for parts of two, what heating and cooling tell apart, what
only less noise shows. Sessions of the open world, each with another session that the law has to predict."""

from __future__ import annotations

from pathlib import Path

import pytest

from studies.open_world import judging
from studies.open_world.score import every_case, run_case

FURTHER = pytest.mark.further
DECK = "cb5901c6a147b8743ddc8cee4822d3b03e1defd5"
LARGE = "c8696ab3196eb2f95da88a44ce077e014fa59311"
OTHER = "8dc7ed3d6d795879a3857e0d2962d8c77becaa6a"


@pytest.mark.parametrize(
    ("deck", "name", "least"),
    [
        pytest.param(DECK, "law/090", 0.95, marks=FURTHER, id="a level, and not only what follows a load"),
        pytest.param(DECK, "law/216", 0.8, id="a temperature and its lag, not the time"),
        pytest.param(
            DECK, "law/136", 0.95, marks=FURTHER, id="two laws in few poses, one under the noise of the other"
        ),
        pytest.param(OTHER, "law/134", 0.95, id="two that set in together, and not a lean"),
        pytest.param(OTHER, "law/182", 0.8, marks=FURTHER, id="three axes, each its own way"),
        pytest.param(
            LARGE, "law/262", 0.99, marks=FURTHER, id="two large ones, found about a name of no plausible size"
        ),
    ],
)
def test_a_law_that_another_start_finds_is_told_and_predicts(
    deck: str, name: str, least: float, tmp_path: Path
) -> None:
    row = run_case(every_case(deck, ("law",))[name](), tmp_path)
    judged = judging.judged(row)
    assert judged["in_class"], judged["told"]
    assert row["closed"] > least
