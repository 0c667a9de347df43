"""A calibration made ready for use: equal to the model it comes from, one by one and in blocks, with its covariance."""

from __future__ import annotations

import math
import timeit
from dataclasses import replace

import numpy as np
import pytest

from highside.calibration.correction import (
    OUTSIDE_ZONE,
    TEMPERATURE_OUTSIDE,
    TEMPERATURE_UNKNOWN,
    Covariance,
    TemperatureTrust,
)
from highside.calibration.linear_correction import LinearCorrection
from highside.calibration.sensor import CROSS_NAMES, CUBIC_NAMES, MATRIX_NAMES, OFFSET_NAMES, QUADRATIC_NAMES
from highside.calibration.student import UPPER
from highside.calibration.zone import Parameters, TemperatureRange, Zone
from highside.errors import InputError
from highside.physics.gravity import gravity_direction

NOISE: Covariance = (1e-10, 2e-11, -1e-11, 3e-10, 4e-11, 2e-10)
EVERYTHING = MATRIX_NAMES + OFFSET_NAMES + QUADRATIC_NAMES + CUBIC_NAMES + CROSS_NAMES


def zone_of(
    names: tuple[str, ...],
    seed: int = 1,
    *,
    center: float | None = None,
    limits: tuple[float, float] = (0.0, math.pi),
    temperature: TemperatureRange | None = None,
    size: float = 2e-3,
) -> Zone:
    """A sensor with random parameters of a few mg and a full random covariance."""
    rng = np.random.default_rng(seed)
    values = size * rng.standard_normal(len(names))
    for i, name in enumerate(names):
        if name in ("A_xx", "A_yy", "A_zz"):
            values[i] += 1.0
    root = 1e-5 * rng.standard_normal((len(names), len(names)))
    return Zone("test", center, *limits, Parameters(names, values, root @ root.T), 1.0, temperature)


def directions(count: int, seed: int = 2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return gravity_direction(np.arccos(rng.uniform(-1, 1, count)), rng.uniform(0, 2 * np.pi, count))


def matrix(six: Covariance) -> np.ndarray:
    out = np.zeros((3, 3))
    for value, (i, j) in zip(six, UPPER, strict=True):
        out[i, j] = out[j, i] = value
    return out


def vector(m: np.ndarray) -> tuple[float, float, float]:
    x, y, z = m.tolist()
    return x, y, z


@pytest.mark.parametrize(
    "names", [MATRIX_NAMES + OFFSET_NAMES, MATRIX_NAMES, EVERYTHING], ids=["affine", "matrix", "all"]
)
def test_a_reading_of_the_model_comes_back_as_the_vector_that_made_it(names: tuple[str, ...]) -> None:
    zone = zone_of(names)
    correction = LinearCorrection(zone)
    for g in directions(50).T:
        out = correction.correct(vector(zone.model().forward(g)))
        assert np.allclose((out.gx, out.gy, out.gz), g, atol=1e-12)
        assert out.zone == "test"
        assert out.flags == ()


@pytest.mark.parametrize("names", [MATRIX_NAMES + OFFSET_NAMES, EVERYTHING], ids=["affine", "all"])
def test_covariance_is_that_of_the_parameters_plus_the_reading_carried_through(names: tuple[str, ...]) -> None:
    zone = zone_of(names)
    correction = LinearCorrection(zone)
    C = zone.model().C
    for g in directions(20).T:
        out = correction.correct(vector(zone.model().forward(g)), NOISE)
        expected = zone.covariance_of(g) + C @ matrix(NOISE) @ C.T
        assert np.allclose(matrix(out.cov), expected, rtol=1e-9, atol=1e-20)


def test_stated_covariance_is_the_scatter_over_sensors_drawn_from_it() -> None:
    zone = zone_of(MATRIX_NAMES + OFFSET_NAMES, size=1e-3)
    rng = np.random.default_rng(5)
    g = gravity_direction(np.array([0.3]), np.array([1.1]))[:, 0]
    correction = LinearCorrection(zone)
    root = np.linalg.cholesky(zone.parameters.covariance + 1e-16 * np.eye(12))
    got = []
    for _ in range(4000):
        theta = zone.parameters.values + root @ rng.standard_normal(12)
        m = theta[:9].reshape(3, 3) @ g + theta[9:]
        got.append(correction.correct(vector(m))[:3])
    stated = matrix(correction.correct(vector(zone.model().forward(g))).cov)
    ratio = np.linalg.eigvals(np.linalg.solve(stated, np.cov(np.array(got).T))).real
    assert np.all(np.abs(ratio - 1.0) < 0.12)  # five standard deviations of a variance of 4000 draws


@pytest.mark.parametrize("names", [MATRIX_NAMES + OFFSET_NAMES, EVERYTHING], ids=["affine", "all"])
def test_what_widens_a_covariance_fades_with_noise_one_by_one_in_blocks_and_in_the_model(
    names: tuple[str, ...],
) -> None:
    known = zone_of(names)
    zone = replace(known, parameters=replace(known.parameters, student=0.4 * known.parameters.covariance))
    correction, plain = LinearCorrection(zone), LinearCorrection(known)
    g = directions(20)
    readings = zone.model().forward(g)
    C = zone.model().C
    for noise in (0.0, 1e-5, 1e-2):
        block = correction.corrected_block(readings, noise)
        J = np.einsum("ij,jpn->nip", C, zone.design(g))
        expected = zone.stated_covariance(J, g, None, noise**2 * (C @ C.T))
        for k in range(20):
            one = correction.correct(vector(readings[:, k]), (noise**2, 0.0, 0.0, noise**2, 0.0, noise**2))
            assert np.allclose(block.cov[:, k], one.cov, rtol=1e-9, atol=1e-20)
            assert np.allclose(matrix(one.cov), expected[k], rtol=1e-7, atol=1e-18)
            bare = matrix(plain.correct(vector(readings[:, k])).cov)
            if noise == 0.0:
                assert np.allclose(matrix(one.cov), 1.4 * bare, rtol=1e-9)
                assert np.allclose(zone.covariance_of(g[:, k]), 1.4 * bare, rtol=1e-9)
            if noise == 1e-2:
                assert np.allclose(matrix(one.cov), bare + noise**2 * C @ C.T, rtol=0.0, atol=1e-2 * bare.max())
        assert np.allclose(block.reading[0], noise**2 * (C @ C.T)[0, 0])


@pytest.mark.parametrize("names", [MATRIX_NAMES + OFFSET_NAMES, EVERYTHING], ids=["affine", "all"])
def test_blocks_equal_single_readings(names: tuple[str, ...]) -> None:
    zone = zone_of(names)
    correction = LinearCorrection(zone, trust=TemperatureTrust(20.0, 30.0))
    readings = zone.model().forward(directions(64))
    temps = np.linspace(15.0, 35.0, 64)
    block = correction.corrected_block(readings, 1e-5, temps)
    for k in range(64):
        one = correction.correct(vector(readings[:, k]), (1e-10, 0.0, 0.0, 1e-10, 0.0, 1e-10), float(temps[k]))
        assert np.allclose(block.g[:, k], one[:3], rtol=0, atol=1e-14)
        assert np.allclose(block.cov[:, k], one.cov, rtol=1e-9, atol=1e-20)
        assert block.temperature_outside[k] == (TEMPERATURE_OUTSIDE in one.flags)


def test_bulk_attitude_equals_single_readings() -> None:
    zone = zone_of(EVERYTHING)
    correction = LinearCorrection(zone)
    readings = zone.model().forward(directions(500))
    inc, tf = correction.attitude(readings)
    for k in range(500):
        x, y, z = correction.correct(vector(readings[:, k]))[:3]
        assert inc[k] == pytest.approx(math.atan2(math.hypot(x, y), z), abs=1e-12)
        assert math.remainder(tf[k] - math.atan2(y, x), 2 * math.pi) == pytest.approx(0.0, abs=1e-11)


def test_a_local_correction_gives_no_vector_outside_of_its_zone() -> None:
    zone = zone_of(MATRIX_NAMES + OFFSET_NAMES, center=0.02, limits=(0.0, 0.04))
    correction = LinearCorrection(zone)
    inside, outside = gravity_direction(np.array([0.03, 1.5]), np.array([1.0, 1.0])).T
    assert correction.correct(vector(zone.model().forward(inside))).flags == ()
    out = correction.correct(vector(zone.model().forward(outside)))
    assert out.flags == (OUTSIDE_ZONE,)
    assert out.zone == "none"
    assert all(math.isnan(value) for value in (*out[:3], *out.cov))
    block = correction.corrected_block(zone.model().forward(np.stack([inside, outside], axis=1)), 1e-5)
    assert block.zone.tolist() == [0, -1]
    assert np.isnan(block.g[:, 1]).all()
    inc, tf = correction.attitude(zone.model().forward(np.stack([inside, outside], axis=1)))
    assert np.isfinite([inc[0], tf[0]]).all()
    assert np.isnan([inc[1], tf[1]]).all()


def test_outside_of_the_calibrated_temperatures_the_uncertainty_grows_and_a_flag_is_set() -> None:
    zone = zone_of(MATRIX_NAMES + OFFSET_NAMES)
    correction = LinearCorrection(zone, trust=TemperatureTrust(20.0, 30.0, growth_g_per_c=50e-6))
    m = vector(zone.model().forward(directions(1)[:, 0]))
    inside, outside = correction.correct(m, temp_c=29.0), correction.correct(m, temp_c=40.0)
    assert inside.flags == ()
    assert outside.flags == (TEMPERATURE_OUTSIDE,)
    assert outside[:3] == inside[:3]
    for i in (0, 3, 5):
        assert outside.cov[i] - inside.cov[i] == pytest.approx((10.0 * 50e-6) ** 2, rel=1e-6)


def test_temperature_polynomials_follow_the_frames_own_temperature() -> None:
    names = MATRIX_NAMES + OFFSET_NAMES + tuple(f"{n}@1" for n in MATRIX_NAMES + OFFSET_NAMES) + ("b_x@2",)
    zone = zone_of(names, temperature=TemperatureRange(75.0, 50.0, 25.0, 125.0))
    correction = LinearCorrection(zone, trust=TemperatureTrust(25.0, 125.0))
    g = directions(1)[:, 0]
    for temp in (25.0, 60.0, 125.0, 150.0):
        out = correction.correct(vector(zone.model(temp).forward(g)), temp_c=temp)
        assert np.allclose(out[:3], g, atol=1e-12)
        grown = (max(0.0, temp - 125.0) * 50e-6) ** 2
        assert np.allclose(matrix(out.cov), zone.covariance_of(g, temp) + grown * np.eye(3), rtol=1e-9, atol=1e-20)
        assert (TEMPERATURE_OUTSIDE in out.flags) == (temp > 125.0)
    assert correction.correct(vector(g)).flags == (TEMPERATURE_UNKNOWN,)


def test_noise_in_temperature_does_not_grow_the_memory() -> None:
    zone = zone_of(MATRIX_NAMES + OFFSET_NAMES + ("b_x@1",), temperature=TemperatureRange(25.0, 50.0, 0.0, 100.0))
    correction = LinearCorrection(zone)
    for temp in np.linspace(0.0, 100.0, 1500).tolist():
        correction.correct((0.1, 0.2, 0.97), temp_c=temp)
    assert len(correction._by_step) <= 512


def test_a_range_of_temperature_must_be_one() -> None:
    with pytest.raises(InputError):
        TemperatureTrust(30.0, 20.0)


def test_a_reading_costs_a_few_microseconds() -> None:
    correction = LinearCorrection(zone_of(MATRIX_NAMES + OFFSET_NAMES), trust=TemperatureTrust(20.0, 30.0))
    cov = (1e-10, 0.0, 0.0, 1e-10, 0.0, 1e-10)
    seconds = min(timeit.repeat(lambda: correction.correct((0.1, 0.2, 0.97), cov, 25.0), number=500, repeat=10)) / 500
    assert seconds < 50e-6  # 5 us expected
