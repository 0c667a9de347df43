"""Two poses whose angles were exchanged are said, whatever they differ by; physics is none."""

import numpy as np
import pytest

from highside.api.diagnosis import Diagnosis, diagnose
from highside.config.model import Model
from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.poses.exchanged import exchanged_pairs
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.state import ChainState
from tests.unit.test_diagnosis_outlying import MODEL, SIGMA, session

FURTHER = pytest.mark.further
FREE = ("bias", "scale", "misalignment")
NAMES_ALONE = ProcedureParts.without("laws")
ANGLES = ("inc_ref_deg", "tf_ref_deg")
N = 40


def exchanged(made: Diagnosis) -> list[str]:
    return [finding.remedy for finding in made.intake if finding.check == "exchanged_poses"]


def with_angles_of(columns: dict[str, np.ndarray], one: int, other: int) -> dict[str, np.ndarray]:
    order = np.arange(columns["tf_ref_deg"].size)
    order[[one, other]] = other, one
    return {name: values[order] if name in ANGLES else values for name, values in columns.items()}


@pytest.mark.parametrize(("one", "other"), [(10, 11), pytest.param(3, 60, marks=FURTHER)])
def test_an_exchange_is_said_and_nothing_else_is_claimed(one: int, other: int) -> None:
    made = diagnose(with_angles_of(session(4, {}), one, other), MODEL)
    assert made.verdict == "nothing_left_out"
    (said,) = exchanged(made)
    assert said.startswith(f"poses {one + 1} of 72 and {other + 1} of 72 read as each other should")


def poses(seed: int, apart_deg: float) -> tuple[ChainState, np.ndarray]:
    """Poses at random, the readings of 10 and 11 exchanged, whose angles are so far apart."""
    rng = np.random.default_rng(seed)
    inc, tf = rng.uniform(10, 170, N), rng.uniform(0, 360, N)
    inc[11], tf[11] = inc[10] + 0.6 * apart_deg, tf[10] + 0.8 * apart_deg
    load = np.asarray(gravity_direction(np.radians(inc), np.radians(tf)), dtype=float)
    read = (np.eye(3) + rng.normal(0, 2e-3, (3, 3))) @ load + rng.normal(0, 1e-2, (3, 1))
    read = read + rng.normal(0, SIGMA / 10, read.shape)
    read[:, [10, 11]] = read[:, [11, 10]]
    table = {"t_s": 30.0 * np.arange(N), "inc_ref_deg": inc, "tf_ref_deg": tf, "pose": np.arange(N, dtype=float)}
    return ChainState.from_columns(table), read


@pytest.mark.parametrize("apart_deg", [0.03, 0.3, 3.0, 30.0])
def test_whatever_the_angles_differ_by(apart_deg: float) -> None:
    for seed in range(3):
        (found,) = exchanged_pairs(*poses(seed, apart_deg), ForwardModel.of({}), FREE)
        assert found[0] == (10, 11)
        assert found[2] < 2 * SIGMA / 10 < found[1]


def test_of_exchanges_too_small_to_be_seen_none_is_said() -> None:
    assert not exchanged_pairs(*poses(1, 1e-4), ForwardModel.of({}), FREE)


@pytest.mark.parametrize("size_g", [0.0, 1e-3, 0.1])
def test_a_law_is_no_exchange_whatever_its_size(size_g: float) -> None:
    for seed in range(5 if size_g else 1):
        made = diagnose(session(10 + seed, {}, size_g), Model.model_validate(MODEL), method=NAMES_ALONE)
        assert not exchanged(made)


def test_three_exchanges_are_no_exception_any_more() -> None:
    state, read = poses(2, 5.0)
    read[:, [1, 5, 20, 30]] = read[:, [5, 1, 30, 20]]
    assert not exchanged_pairs(state, read, ForwardModel.of({}), FREE)
