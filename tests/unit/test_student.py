"""Variances that are estimated widen intervals by as much as they weigh in the whole: Student's law, Satterthwaite's
degrees of freedom."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, t

from highside.calibration.joint import joint
from highside.calibration.poses import PoseSet
from highside.calibration.result import CalibrationResult
from highside.calibration.student import UPPER, six_of, widened, widening, with_widening
from studies.scenario import reference_scenario

Z = 1.96


def symmetric(rng: np.random.Generator, count: int, size: float) -> np.ndarray:
    root = rng.standard_normal((count, 3, 3))
    return size * root @ root.transpose(0, 2, 1)


def full(six: tuple[np.ndarray, ...]) -> np.ndarray:
    out = np.zeros((six[0].size, 3, 3))
    for value, (i, j) in zip(six, UPPER, strict=True):
        out[:, i, j] = out[:, j, i] = value
    return out


@given(seed=st.integers(0, 1000), unit=st.sampled_from([1.0, 1e-10, 1e-14]))
def test_alone_it_is_the_calibrations_own_and_beside_a_known_variance_it_fades(seed: int, unit: float) -> None:
    rng = np.random.default_rng(seed)
    alone, calibration = symmetric(rng, 5, 0.3 * unit), symmetric(rng, 5, unit) + 0.1 * unit * np.eye(3)
    assert np.allclose(with_widening(calibration, alone), calibration + alone, rtol=1e-9, atol=1e-9 * unit)
    rest = 3.0 * calibration  # a known part of three quarters of the whole leaves a quarter of the widening
    assert np.allclose(with_widening(calibration, alone, rest), 4.0 * calibration + 0.25 * alone, rtol=1e-9)
    one = tuple(float(value[0]) for value in six_of(alone)), tuple(float(value[0]) for value in six_of(calibration))
    total = tuple(float(value[0]) for value in six_of(calibration + unit * np.eye(3)))
    by_matrices = alone[0] @ np.linalg.solve(full(tuple(np.array([v]) for v in total))[0], calibration[0])
    expected = 0.5 * (by_matrices + by_matrices.T)
    found = widening(one[0], one[1], total)  # type: ignore[arg-type]
    for value, (i, j) in zip(found, UPPER, strict=True):
        assert value == pytest.approx(expected[i, j], rel=1e-7, abs=1e-9 * unit)


@given(seed=st.integers(0, 1000), ratio=st.floats(0.0, 6.0))
def test_a_stated_covariance_remains_one(seed: int, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    calibration, rest = symmetric(rng, 20, 1.0) + 1e-3 * np.eye(3), symmetric(rng, 20, 0.5)
    root = np.linalg.cholesky(calibration)
    turned = symmetric(rng, 20, 1.0)
    turned /= np.linalg.eigvalsh(turned)[:, -1:, None]
    stated = with_widening(calibration, ratio * root @ turned @ root.transpose(0, 2, 1), rest)
    assert np.linalg.eigvalsh(stated).min() > 0.0


def test_the_widening_of_one_estimated_variance_is_students_quantile() -> None:
    """To the first order in 1 / f."""
    for freedom in (10.0, 30.0):
        covariance = np.array([[2.5e-9]])
        kept, more = widened(covariance, np.array([[2.0 / freedom]]), np.zeros((1, 1)), covariance[None])
        assert kept[0, 0] == covariance[0, 0]
        grown = np.sqrt(1.0 + more[0, 0] / covariance[0, 0])
        assert grown == pytest.approx(t.ppf(0.975, freedom) / Z, rel=2.5 / freedom**2)


@pytest.mark.parametrize("freedom", [8, 16])
@pytest.mark.parametrize("share", [1.0, 0.6, 0.3])
def test_intervals_hold_95_percent_whatever_part_of_the_variance_is_estimated(freedom: int, share: float) -> None:
    """An error of a calibration whose variance is estimated with few degrees of freedom, and a reading's that is known:
    exact coverage by numerical integration over the estimate."""
    quantiles = (np.arange(20000) + 0.5) / 20000
    estimate = share * chi2.ppf(quantiles, freedom) / freedom
    wide = (Z**2 + 1.0) / 4.0 * (2.0 / freedom) * estimate
    zero = np.zeros_like(estimate)

    def six(x: np.ndarray) -> tuple[np.ndarray, ...]:
        return x, zero, zero, x, zero, x

    total = estimate + (1.0 - share)
    stated = total + widening(six(wide), six(estimate), six(total))[0]  # type: ignore[arg-type]
    held = np.mean(chi2.cdf(Z**2 * stated, 1))
    assert 0.943 < held < 0.957
    if share == 0.3:  # widened as if the reading's noise were not there, intervals are far too wide to be called 95 %
        assert np.mean(chi2.cdf(Z**2 * (total + wide), 1)) > held + 0.002


def test_a_joint_calibration_states_what_widens_it_and_keeps_it_in_its_record() -> None:
    p = reference_scenario(3).poses
    result = joint(PoseSet.build(p.mean, inc_ref_rad=p.inc_ref, tf_ref_rad=p.tf_ref, n=p.n, std=p.std))
    parameters = result.main.parameters
    assert parameters.student is not None
    assert np.linalg.eigvalsh(parameters.student).min() > -1e-9 * np.trace(parameters.student)
    back = CalibrationResult.from_dict(result.to_dict())
    assert back.main.parameters.student is not None
    assert np.array_equal(back.main.parameters.student, parameters.student)
    inc, tf = np.full(8, np.pi / 2), np.arange(8) * np.pi / 4 + 0.1
    known = result.to_dict()
    del known["zones"][0]["parameters"]["student"]
    plain = CalibrationResult.from_dict(known)

    def widens(noise_g: float) -> float:
        """Of the variance of T."""
        wide, narrow = (one.predict_std(inc, tf, noise_g)[1] for one in (result, plain))
        return float(np.mean(wide**2 - narrow**2))

    alone = widens(0.0)
    assert alone > 0.05 * float(np.mean(plain.predict_std(inc, tf, 0.0)[1] ** 2))
    assert 0.15 * alone < widens(50e-6) < 0.6 * alone
    assert widens(1e-2) < 1e-3 * alone
