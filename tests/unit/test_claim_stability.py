"""The size of a claim must agree over parts of the recording; claims are ordered by their share."""

from __future__ import annotations

import numpy as np
import pytest

from highside.arrays import Array
from highside.diagnosis.core.checked import _widened
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.result import Claim, DiagnosisResult, FittedParameter
from highside.diagnosis.core.stability import Stability, splits_of, stability
from highside.diagnosis.engine import diagnose_poses
from highside.diagnosis.poses.session import PoseSession
from highside.physics.forward import ForwardModel
from studies import diagnosis_deck as deck

STATE = deck.design()
FURTHER = pytest.mark.further


def white(columns: Array) -> Array:
    return columns.reshape(len(columns), -1)


def one(factor: Array, seed: int = 1, strength: float = 400.0) -> tuple[float, bool, str]:
    """A claim that is in truth `factor` (n,) times its column, in unit noise."""
    rng = np.random.default_rng(seed)
    column = rng.standard_normal((1, 3, STATE.n))
    column *= np.sqrt(strength) / np.linalg.norm(column)
    residual = white(factor * column)[0] + rng.standard_normal(3 * STATE.n)
    others = np.linalg.qr(rng.standard_normal((3 * STATE.n, 9)))[0].T
    residual = residual - (residual @ others.T) @ others
    found = stability(column, white, others, residual, 300.0, splits_of(STATE))
    assert found is not None
    return found.log_p, found.stable, found.words


def test_a_constant_is_stable_at_every_strength() -> None:
    for strength in (50.0, 400.0, 1e4, 1e7):
        assert all(one(np.ones(STATE.n), seed, strength)[1] for seed in range(10)), strength


def test_a_size_that_drifts_or_follows_the_inclination_is_not() -> None:
    drifting = np.linspace(0.2, 1.8, STATE.n)
    log_p, stable, words = one(drifting)
    assert not stable and log_p > 5 and "thirds of the session" in words
    leaning = np.where(STATE.inc_rad > np.median(STATE.inc_rad), 1.8, 0.4)
    assert not one(leaning)[1]


@pytest.mark.parametrize(
    "method",
    [
        pytest.param(ProcedureParts.without("laws"), id="names alone"),
        pytest.param(WHOLE, id="with laws", marks=FURTHER),
    ],
)
def test_claims_are_ordered_by_their_share(method: ProcedureParts) -> None:
    rng = np.random.default_rng(4)
    sensor, _ = deck.sensor_and_base(STATE, rng)
    effects = {"sag": {"s": 2e-4}, "backlash": {"h_tf": 6e-4, "h_inc": 0.0}}
    mean = sensor.with_effects(effects).predict(STATE) + deck.white_noise(STATE, rng)
    found = deck.diagnosed(PoseSession(mean, np.ones(STATE.n), STATE), method)
    shares = [claim.share or 0.0 for claim in found.claims]
    assert [claim.effect for claim in found.claims] == ["backlash", "sag"]
    assert shares == sorted(shares, reverse=True) and abs(sum(shares) - 1) < 1e-9
    assert all(claim.stable and claim.channels for claim in found.claims)


@FURTHER
def test_a_size_that_changes_half_way_is_not_named_as_a_constant() -> None:
    """A bench that sags twice as much in the second half of the session."""
    rng = np.random.default_rng(5)
    sensor, _ = deck.sensor_and_base(STATE, rng)
    plain = sensor.predict(STATE)
    sagging = sensor.with_effects({"sag": {"s": 1e-3}}).predict(STATE) - plain
    mean = plain + np.linspace(0.0, 2.0, STATE.n) * sagging + deck.white_noise(STATE, rng)
    found, _ = diagnose_poses(PoseSession(mean, np.ones(STATE.n), STATE), ForwardModel.of({}), deck.FREE)
    assert "sag" not in {claim.effect for claim in found.claims}


def test_sizes_beside_a_large_remainder_are_as_wide_as_it_makes_them() -> None:
    size = FittedParameter(1e-3, 1e-5, 9.8e-4, 1.02e-3, "rad")
    claim = Claim("sag", "", "", "pose", {"s": size}, 1e-9, ("sag",), (), "")
    found = DiagnosisResult("named_plus", claims=(claim,))
    steady = Stability("thirds of the session", 0.1, 0.0, (0.9, 1.0, 1.1))
    assert _widened(found, 1.1, [steady]) == found
    wide = _widened(found, 9.0, [steady])
    stated = wide.claims[0].parameters["s"]
    assert (stated.std, stated.low, stated.high) == pytest.approx((3e-5, 9.4e-4, 1.06e-3))
    assert "0.90 / 1.00 / 1.10" in wide.remainder.hints[-1]
