"""What tools of a lot have in common: pooled estimates against the truth, false discoveries, classes, outliers."""

from __future__ import annotations

import numpy as np
import pytest

from highside.arrays import Array
from highside.fleet.common import LotScores, LotTested, ToolScores, judge
from highside.fleet.policy import COMMON
from highside.fleet.pooling import moments_scatter, outlying, pool, reml_scatter

NAMES = ("a_x", "a_y", "a_z", "b", "c", "d_x", "d_y")
ENTRIES = ("a", "b", "c", "d")
AMPLITUDES = ((0, 1, 2), (3,), (4,), (5, 6))


def information(rng: np.random.Generator) -> Array:
    """(7, 7) of a design of 60 readings, in which c is b but for a thousandth."""
    columns = rng.standard_normal((7, 60))
    columns[4] = columns[3] + 0.03 * columns[4]
    return columns @ columns.T


def lot_of(rng: np.random.Generator, tools: int, truth: Array, *, scatter: float = 0.0, name: str = "lot") -> LotScores:
    """A lot in which every tool has the amplitudes `truth` (7,), scattered about it."""
    made = []
    for i in range(tools):
        info = information(rng)
        own = truth + scatter * rng.standard_normal(7)
        score = info @ own + np.linalg.cholesky(info) @ rng.standard_normal(7)
        made.append(ToolScores(f"tool {i}", score, info))
    return LotScores(name, ENTRIES, AMPLITUDES, tuple(made), ordered=True)


def test_scatter_between_tools_is_estimated_without_bias_and_moments_agree() -> None:
    rng = np.random.default_rng(1)
    found, by_moments = [], []
    for _ in range(400):
        variance = rng.uniform(0.5, 2.0, 20)
        estimate = 3.0 + np.sqrt(variance + 1.0) * rng.standard_normal(20)
        found.append(reml_scatter(estimate, variance) ** 2)
        by_moments.append(moments_scatter(estimate, variance) ** 2)
    # truth 1.0; standard error of a mean of 400 about 0.035; truncation at zero adds a little
    assert np.mean(found) == pytest.approx(1.0, abs=0.12)
    assert np.mean(by_moments) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize(("scatter", "most"), [(0.0, 1.0), (0.3, 0.985)])
def test_intervals_of_the_mean_hold_the_truth(scatter: float, most: float) -> None:
    """95 % intervals over 300 lots: binomial, 0.90 to 0.985 is passed with probability 0.999. Of tools that are all
    alike they hold more, for a scatter that is found by chance is believed."""
    rng = np.random.default_rng(2)
    truth = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    held = 0
    for _ in range(300):
        lot = lot_of(rng, 12, truth, scatter=scatter)
        one = pool(*lot.of(0)[:2])
        held += abs(one.t[0] - truth[0] / one.std[0]) < 2.201  # Student, 11 degrees of freedom
    assert 0.90 <= held / 300 <= most


def test_a_pooled_mean_is_as_sharp_as_all_readings_together() -> None:
    """Without scatter the variance is the Cramer-Rao limit of all tools' readings together."""
    rng = np.random.default_rng(3)
    errors, limits = [], []
    for _ in range(200):
        lot = lot_of(rng, 10, np.zeros(7))
        score, info, _ = lot.of(3)
        one = pool(score, info)
        errors.append(one.mean)
        limits.append(np.diag(np.linalg.inv(info.sum(axis=0))))
    ratio = np.var(errors, axis=0) / np.mean(limits, axis=0)
    assert np.all(ratio < 1.35)  # 200 draws: 0.8 to 1.2 at two sigma, and what a scatter found by chance costs


def test_an_effect_too_small_for_one_tool_is_found_in_its_lot_with_its_class() -> None:
    found = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        one_sigma = float(1 / np.sqrt(np.mean([information(rng)[3, 3] for _ in range(20)])))
        with_it = lot_of(rng, 40, one_sigma * np.eye(7)[3], name="with")
        without = lot_of(rng, 40, np.zeros(7), name="without")
        tested = {one.lot: one for one in judge([with_it, without], NAMES)}
        (claim, *others) = tested["with"].common or (None,)
        assert claim is not None
        found += {"b", "c"} <= set(claim.same) and not others and claim.proof.holds and not tested["without"].common
        assert claim.change is None
    assert found >= 9  # power 0.99 each


def test_lots_without_anything_in_common_are_left_alone() -> None:
    """120 lots in 40 fleets: 5 % of fleets may name one; 7 or more of 40 has probability 0.003."""
    named = 0
    for seed in range(40):
        rng = np.random.default_rng(1000 + seed)
        lots = [lot_of(rng, 10, np.zeros(7), scatter=0.1 * (k > 0), name=str(k)) for k in range(3)]
        named += any(one.common for one in judge(lots, NAMES))
    assert named <= 6


def test_a_lot_of_few_tools_is_refused_in_words() -> None:
    few = lot_of(np.random.default_rng(5), COMMON.fewest_tools - 1, np.ones(7))
    (tested,) = judge([few], NAMES)
    assert not tested.common and not tested.outliers
    assert tested.refused.startswith(f"tools: {COMMON.fewest_tools - 1};")


def test_a_tool_that_stands_out_is_named_and_no_other() -> None:
    rng = np.random.default_rng(6)
    lot = lot_of(rng, 20, np.zeros(7))
    odd = lot.tools[7]
    moved = ToolScores("odd", odd.score + odd.information @ np.array([2.0, 0, 0, 0, 0, 0, 0]), odd.information)
    lot = LotScores("lot", ENTRIES, AMPLITUDES, (*lot.tools[:7], moved, *lot.tools[8:]))
    (tested,) = judge([lot], NAMES)
    assert [one.tool for one in tested.outliers] == ["odd"]
    assert "a" in tested.outliers[0].same
    assert tested.outliers[0].departure[0] == pytest.approx(2.0, abs=0.5)


def test_no_tool_of_a_lot_that_is_alike_stands_out() -> None:
    """1 % of fleets may call one out: 4 or more of 60 has probability 0.003."""
    out = 0
    for seed in range(60):
        rng = np.random.default_rng(2000 + seed)
        (tested,) = judge([lot_of(rng, 12, np.zeros(7), scatter=0.05)], NAMES)
        out += bool(tested.outliers)
    assert out <= 3


def test_p_of_an_outlier_is_even_where_there_is_none() -> None:
    rng = np.random.default_rng(8)
    p = []
    for _ in range(150):
        lot = lot_of(rng, 15, np.zeros(7), scatter=0.2)
        p.append(outlying(*lot.of(0)[:2], 4))
    # a tenth lies below 0.1: 4 % to 18 % of 150 is passed with probability 0.999
    assert 0.04 <= np.mean(np.array(p) < 0.1) <= 0.18


def test_the_place_of_a_change_is_found() -> None:
    rng = np.random.default_rng(9)
    before, behind = lot_of(rng, 15, np.zeros(7)), lot_of(rng, 15, 1.0 * np.eye(7)[5])
    tools = tuple(ToolScores(f"tool {i}", t.score, t.information) for i, t in enumerate((*before.tools, *behind.tools)))
    (tested,) = judge([LotScores("lot", ENTRIES, AMPLITUDES, tools, ordered=True)], NAMES)
    changed = _change_of(tested, "d")
    assert changed is not None and changed.split()[1] in {"13", "14", "15"}


def _change_of(tested: LotTested, effect: str) -> str | None:
    return next((one.change.after for one in tested.common if one.effect == effect and one.change is not None), None)


def test_a_tool_that_says_nothing_of_an_effect_costs_nothing() -> None:
    rng = np.random.default_rng(10)
    lot = lot_of(rng, 12, np.zeros(7))
    blind = ToolScores("blind", np.zeros(7), np.zeros((7, 7)))
    with_it = LotScores("lot", ENTRIES, AMPLITUDES, (*lot.tools, blind))
    assert pool(*with_it.of(0)[:2]).mean == pytest.approx(pool(*lot.of(0)[:2]).mean)
    assert len(with_it.of(0)[2]) == 12


def test_an_effect_that_lies_within_another_is_of_its_class_and_ends_nothing() -> None:
    """e is b by another name: beside b nothing of it is left in any tool."""
    rng = np.random.default_rng(12)
    lot = lot_of(rng, 12, 3.0 * np.eye(7)[3])
    doubled = tuple(
        ToolScores(
            t.tool,
            np.append(t.score, t.score[3]),
            np.block([[t.information, t.information[:, 3:4]], [t.information[3:4], t.information[3:4, 3:4]]]),
        )
        for t in lot.tools
    )
    (tested,) = judge([LotScores("lot", (*ENTRIES, "e"), (*AMPLITUDES, (7,)), doubled)], (*NAMES, "e"))
    assert {"b", "e"} <= set(tested.common[0].same)
    assert not any({"b", "e"} & set(one.same) for one in tested.common[1:])


def _within_a_plane(rng: np.random.Generator) -> Array:
    """Information of three amplitudes that a session shows in two directions only."""
    ways = rng.standard_normal((3, 2)) * [[1e3], [1.0], [1e-2]]
    return np.asarray(ways @ ways.T)


def test_amplitudes_that_show_only_together_are_proved_together() -> None:
    """Two of four amplitudes that a session shows as one had no estimate of their own, and with that no proof: an
    effect of ten standard deviations of the lot's mean was not named."""
    rng = np.random.default_rng(23)
    of_a_tool = _within_a_plane(rng)
    values, vectors = np.linalg.eigh(of_a_tool)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    truth = rng.standard_normal(3)
    truth *= 1.5 / np.sqrt(truth @ of_a_tool @ truth)
    tools = [ToolScores(f"t{i}", of_a_tool @ truth + root @ rng.standard_normal(3), of_a_tool) for i in range(40)]
    (tested,) = judge([LotScores("lot", ("one",), ((0, 1, 2),), tuple(tools))], ["a", "b", "c"])
    assert [one.effect for one in tested.common] == ["one"] and tested.common[0].proof.holds


def test_p_of_several_amplitudes_together_is_even_where_nothing_is_in_common() -> None:
    """Below 1 in 100 no oftener than that, of 400 lots of 25 tools with three amplitudes that hang together: at most 10
    of them by a chance of 0.003."""
    rng = np.random.default_rng(29)
    low = 0
    for _ in range(400):
        ways = rng.standard_normal((3, 5)) + 2.0
        one = ways @ ways.T
        root = np.linalg.cholesky(one)
        low += pool((root @ rng.standard_normal((3, 25))).T, np.broadcast_to(one, (25, 3, 3)).copy()).p < 0.01
    assert low <= 10
