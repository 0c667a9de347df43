"""A law of one order of toolface is told as that order, and beside it the order that a grid cannot tell from it."""

from pathlib import Path

import numpy as np
import pytest

from highside.api.diagnosis import diagnose
from highside.config.model import Model
from highside.physics.covariates import covariate
from highside.physics.state import ChainState
from studies.open_world import judging
from studies.open_world.score import every_case, run_case

FURTHER = pytest.mark.further
SIGMA = 2e-4
MODEL = Model.model_validate({"sensor": {"noise_g": SIGMA}})


def poses(seed: int, order: int, size_g: float, toolfaces: int) -> dict[str, np.ndarray]:
    """Six inclinations at equally spaced toolfaces; an offset of x of one order of toolface."""
    rng = np.random.default_rng(seed)
    inc = np.tile(np.arange(6) * 30.0, toolfaces)
    tf = np.repeat(np.arange(toolfaces) * 360.0 / toolfaces, 6)
    s, c = np.sin(np.radians(inc)), np.cos(np.radians(inc))
    read = np.vstack([s * np.cos(np.radians(tf)), s * np.sin(np.radians(tf)), c])
    read = (np.eye(3) + rng.normal(0, 2e-3, (3, 3))) @ read + rng.normal(0, 3e-3, (3, 1))
    read[0] += size_g * np.sin(order * np.radians(tf) + 1.0)
    read += rng.normal(0, SIGMA, read.shape)
    temp = 20 + 40 * ((np.arange(inc.size) * 5) % inc.size) / inc.size
    return {
        "inc_ref_deg": inc,
        "tf_ref_deg": tf,
        "temp_c": temp,
        **dict(zip(("ax", "ay", "az"), read, strict=True)),
    }


@pytest.mark.parametrize("size_g", [pytest.param(1e-3, marks=FURTHER), pytest.param(1e-2, marks=FURTHER), 1e-1])
@pytest.mark.parametrize(
    ("order", "toolfaces", "alike"),
    [
        (5, 12, 7),
        pytest.param(5, 18, None, marks=FURTHER),
        pytest.param(7, 18, 11, marks=FURTHER),
        pytest.param(3, 18, None, marks=FURTHER),
        (8, 24, None),
    ],
)
def test_one_whole_order_is_told_as_it_is(order: int, toolfaces: int, alike: int | None, size_g: float) -> None:
    made = diagnose(poses(order, order, size_g, toolfaces), MODEL)
    (claim,) = made.claims
    assert (claim.place, claim.channels, claim.depends_on) == ("offset", ("ax",), ("tf",))
    assert claim.formula is not None
    size = f"{size_g * np.sin(1.0):.2g}"[:3]
    told = claim.formula.split(" or ")
    assert any(f" cos({order} tf)" in text and text.startswith(size) for text in told), (claim.formula, size)
    if alike is None:
        assert len(told) == 1
    else:
        assert any(f" cos({alike} tf)" in text for text in told)


def turns_of(inc_deg: list[float], tf_deg: list[float], **more: np.ndarray) -> np.ndarray:
    state = ChainState.build(np.radians(inc_deg), np.radians(tf_deg), **more)
    return np.asarray(covariate("tf_fraction").of(state, np.zeros((3, state.n)), 0))


def test_a_table_goes_on_past_a_turn_from_pose_to_pose_of_a_station() -> None:
    # the short way up, and back down; at the next station it begins within a turn again
    inc = [10.0] * 6 + [40.0] * 3
    tf = [300.0, 350.0, 20.0, 70.0, 350.0, 290.0, 200.0, 300.0, 10.0]
    expected = [300.0, 350.0, 380.0, 430.0, 350.0, 290.0, 200.0, 300.0, 370.0]
    np.testing.assert_allclose(turns_of(inc, tf), expected)
    # an encoder's noise makes no station, and rows of a pose share its turns
    pose = np.array([0, 0, 1, 1, 2, 2])
    several = turns_of([10.0, 10.0, 10.01, 10.01, 10.0, 10.0], [340.0, 340.0, 10.0, 10.0, 40.0, 40.0], pose=pose)
    np.testing.assert_allclose(several, [340.0, 340.0, 370.0, 370.0, 400.0, 400.0])


def test_turns_that_are_known_are_kept() -> None:
    # written down beyond a turn, or in motion, where the reader counts them
    np.testing.assert_allclose(turns_of([10.0] * 3, [300.0, 400.0, 30.0]), [300.0, 400.0, 30.0])
    moving = turns_of([10.0] * 3, [300.0, 500.0, 800.0], pose=np.zeros(3, dtype=int))
    np.testing.assert_allclose(moving, [300.0, 500.0, 800.0])
    assert turns_of([], []).size == 0


def test_a_gear_of_no_whole_ratio_is_an_order_of_the_turns(tmp_path: Path) -> None:
    # 175 poses at eleven stations, each turned on past 360: folded into one turn the line was a surface of inclination
    # and toolface that predicted worse than nothing
    case = every_case("5facfe7873890125adef8629e7cf0b440555daf8", ("law",))["law/148"]()
    assert case.first is not None and float(np.ptp(np.degrees(case.first.tf))) > 360.0
    row = run_case(case, tmp_path)
    assert judging.judged(row)["exact"]
    assert row["closed"] > 0.999
