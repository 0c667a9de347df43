"""Zones side by side: continuous, honest, and silent where nothing holds."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from highside.attitude import attitude, attitude_with_std
from highside.calibration.balance import balance
from highside.calibration.conventional import conventional
from highside.calibration.correction import OUTSIDE_ZONE, TEMPERATURE_OUTSIDE, TemperatureTrust
from highside.calibration.inclination_windows import InclinationWindow, key_of_inclination, windows
from highside.calibration.linear_correction import LinearCorrection
from highside.calibration.linear_errors import BenchAccuracy, linear_parameters
from highside.calibration.poses import PoseSet
from highside.calibration.schedule import ScheduledCorrection, key_of
from highside.calibration.student import UPPER
from highside.calibration.zone import Parameters, TemperatureRange
from highside.errors import InputError
from highside.physics.gravity import bench_gravity, gravity_direction

INCLINATIONS_DEG = (0.612, 1.206, 3.0, 5.0, 10.0, 20.0, 30.0, 45.0)
A = np.eye(3) + 3e-3 * np.random.default_rng(7).standard_normal((3, 3))
B = np.array([1.5e-3, -0.8e-3, 2e-3])


def reading(inc_rad: float, tf_rad: float) -> tuple[float, float, float]:
    x, y, z = (A @ gravity_direction(np.array([inc_rad]), np.array([tf_rad]))[:, 0] + B).tolist()
    return x, y, z


def session(inclinations_deg: tuple[float, ...] = INCLINATIONS_DEG) -> PoseSet:
    inc = np.deg2rad(np.repeat(inclinations_deg, 4))
    tf = np.deg2rad(np.tile([45.0, 135.0, 225.0, 315.0], len(inclinations_deg)))
    noise = 5e-5 * np.random.default_rng(3).standard_normal((3, inc.size))
    return PoseSet.build(
        A @ gravity_direction(inc, tf) + B[:, None] + noise, inc_ref_rad=inc, tf_ref_rad=tf, n=100.0, std=5e-4
    )


def schedule(*, with_fallback: bool, inclinations_deg: tuple[float, ...] = INCLINATIONS_DEG) -> ScheduledCorrection:
    poses = session(inclinations_deg)
    zones = tuple(LinearCorrection(zone, guarded=False) for zone in balance(poses).zones)
    whole = LinearCorrection(conventional(poses).main) if len(inclinations_deg) > 1 else None
    if with_fallback:
        return ScheduledCorrection(zones, fallback=whole)
    return ScheduledCorrection(zones, guide=whole)


WITH, WITHOUT = schedule(with_fallback=True), schedule(with_fallback=False)


def widened(one: ScheduledCorrection, factor: float) -> ScheduledCorrection:
    """With a fallback whose variances are estimated."""
    assert one.fallback is not None
    zone = one.fallback.zone
    parameters = replace(zone.parameters, student=factor * zone.parameters.covariance)
    return replace(one, fallback=LinearCorrection(replace(zone, parameters=parameters)))


WIDENED = widened(WITH, 0.5)


@settings(max_examples=300, deadline=None)
@given(inc=st.floats(0.0, math.pi), tf=st.floats(0.0, 2 * math.pi), step=st.floats(1e-9, 1e-6), way=st.floats(0.0, 7.0))
def test_a_small_step_of_the_reading_makes_a_small_step_of_the_vector(
    inc: float, tf: float, step: float, way: float
) -> None:
    m = reading(inc, tf)
    n = (m[0] + step * math.cos(way), m[1] + step * math.sin(way), m[2] + step * math.sin(2.0 * way))
    one, other = WITH.correct(m), WITH.correct(n)
    # weights change over 0.2 deg at the fastest, corrections differ by some mg: no more than a few times the step
    assert math.dist(one[:3], other[:3]) < 4.0 * step


@pytest.mark.usefixtures("engine")
def test_no_jump_of_inclination_or_toolface_over_a_sweep_through_all_zones() -> None:
    inc = np.linspace(np.deg2rad(0.4), np.deg2rad(47.0), 40001)
    readings = A @ gravity_direction(inc, np.full_like(inc, 1.0)) + B[:, None]
    for one in (WITH, schedule(with_fallback=False, inclinations_deg=(0.612, 1.206, 2.0, 3.0, 5.0))):
        got_inc, got_tf = one.attitude(readings)
        held = np.isfinite(got_inc[:-1]) & np.isfinite(got_inc[1:])
        assert held.sum() > 3000
        step = inc[1] - inc[0]
        assert np.max(np.abs(np.diff(got_inc))[held] - step) < 1.5 * step
        arc = np.abs(np.angle(np.exp(1j * np.diff(got_tf)))) * np.sin(inc[1:])
        assert np.max(arc[held]) < step


def test_weights_of_neighbours_sum_to_one_and_each_rules_its_own_inclination() -> None:
    zones = [part.zone for part in WITH.zones]
    for zone, window in zip(zones, windows(zones), strict=True):
        assert window.weight(key_of_inclination(zone.inc_center_rad or 0.0)) == 1.0
    for tf in (0.1, 2.0, 4.0):
        for inc_deg in np.linspace(0.1, 179.0, 400):
            parts = WITH.weights(reading(math.radians(inc_deg), tf))
            assert sum(w for _, w in parts) == pytest.approx(1.0, abs=1e-12)
            assert all(w > 0.0 for _, w in parts)


def test_every_output_names_what_made_it() -> None:
    assert WITH.correct(reading(math.radians(0.3), 1.0)).zone == "zone 0.612"
    assert WITH.correct(reading(math.radians(0.9), 1.0)).zone == "zone 0.612 + zone 1.206"
    assert WITH.correct(reading(math.radians(120.0), 1.0)).zone == "global"


def test_nothing_is_extrapolated_where_no_zone_holds() -> None:
    out = WITHOUT.correct(reading(math.radians(90.0), 1.0))
    assert OUTSIDE_ZONE in out.flags
    assert out.zone == "none"
    assert all(math.isnan(value) for value in out[:3])
    assert WITHOUT.correct(reading(math.radians(3.0), 1.0)).flags == ()


def test_a_gap_between_zones_is_refused_too() -> None:
    apart = schedule(with_fallback=False, inclinations_deg=(1.206, 45.0))
    states = [OUTSIDE_ZONE in apart.correct(reading(math.radians(inc), 1.0)).flags for inc in (1.0, 10.0, 45.0, 80.0)]
    assert states == [False, True, False, True]


@pytest.mark.usefixtures("engine")
@pytest.mark.parametrize("which", [WITH, WITHOUT, WIDENED], ids=["fallback", "zones only", "widened"])
@pytest.mark.parametrize("spread", ["log", "all attitudes"])
def test_blocks_equal_single_readings(which: ScheduledCorrection, spread: str) -> None:
    rng = np.random.default_rng(11)
    count = 3000
    inc = np.linspace(0.001, 0.9, count) if spread == "log" else np.arccos(rng.uniform(-1.0, 1.0, count))
    readings = A @ gravity_direction(inc, rng.uniform(0.0, 2 * np.pi, count)) + B[:, None]
    block = which.corrected_block(readings, 1e-5)
    plain = which.correct_block(readings)
    got_inc, got_tf = which.attitude(readings)
    for k in range(0, count, 7):
        one = which.correct(tuple(readings[:, k].tolist()), (1e-10, 0.0, 0.0, 1e-10, 0.0, 1e-10))
        assert np.allclose(block.g[:, k], one[:3], rtol=0, atol=1e-13, equal_nan=True)
        assert np.allclose(plain[:, k], one[:3], rtol=0, atol=1e-13, equal_nan=True)
        assert np.allclose(block.cov[:, k], one.cov, rtol=1e-6, equal_nan=True)
        assert (block.zone[k] < 0) == (OUTSIDE_ZONE in one.flags)
        expected = math.atan2(math.hypot(one.gx, one.gy), one.gz)
        assert got_inc[k] == pytest.approx(expected, abs=1e-12, nan_ok=True)
        arc = math.remainder(got_tf[k] - math.atan2(one.gy, one.gx), 2 * math.pi) * math.sin(inc[k])
        assert math.isnan(arc) if math.isnan(one.gx) else abs(arc) < 1e-12


def test_a_schedule_over_temperature_is_the_same_in_bulk() -> None:
    """Offsets that drift with temperature: the bulk path takes every reading at its own."""
    rng = np.random.default_rng(31)
    window = TemperatureRange(75.0, 50.0, 25.0, 125.0)
    drift = {"b_x@1": 3e-3, "b_y@1": -2e-3, "b_z@1": 1e-3}

    def heated(part: LinearCorrection, *, guarded: bool) -> LinearCorrection:
        p = part.zone.parameters
        covariance = np.zeros((len(p.names) + 3,) * 2)
        covariance[:-3, :-3] = p.covariance
        names, values = (*p.names, *drift), np.concatenate([p.values, list(drift.values())])
        zone = replace(part.zone, parameters=Parameters(names, values, covariance), temperature=window)
        return LinearCorrection(zone, trust=TemperatureTrust(25.0, 125.0), guarded=guarded)

    assert WITH.fallback is not None
    hot = ScheduledCorrection(tuple(heated(z, guarded=False) for z in WITH.zones), heated(WITH.fallback, guarded=True))
    temps = rng.uniform(20.0, 130.0, 300)
    inc, tf = rng.uniform(0.0, 1.0, 300), rng.uniform(0.0, 6.0, 300)
    shift = np.outer(list(drift.values()), (temps - 75.0) / 50.0)
    readings = A @ gravity_direction(inc, tf) + B[:, None] + shift
    got_inc, got_tf = hot.attitude(readings, temps)
    for k in range(300):
        one = hot.correct(tuple(readings[:, k].tolist()), temp_c=float(temps[k]))
        assert got_inc[k] == pytest.approx(math.atan2(math.hypot(one.gx, one.gy), one.gz), abs=1e-12)
        assert abs(math.remainder(got_tf[k] - math.atan2(one.gy, one.gx), 2 * math.pi)) * math.sin(inc[k]) < 1e-12
        assert got_inc[k] == pytest.approx(inc[k], abs=3e-4)
        assert (TEMPERATURE_OUTSIDE in one.flags) == (not 25.0 <= temps[k] <= 125.0)


@pytest.mark.usefixtures("engine")
def test_bulk_does_not_depend_on_how_the_readings_are_cut() -> None:
    rng = np.random.default_rng(12)
    count = 40000
    inc = np.concatenate([np.linspace(0.005, 0.05, count // 2), rng.uniform(0.0, 1.5, count - count // 2)])
    readings = A @ gravity_direction(inc, rng.uniform(0.0, 2 * np.pi, count)) + B[:, None]
    for which in (WITH, WITHOUT):
        whole = which.attitude(readings)
        parts = [which.attitude(np.ascontiguousarray(readings[:, lo : lo + 1777])) for lo in range(0, count, 1777)]
        for k in (0, 1):
            assert np.allclose(
                whole[k], np.concatenate([part[k] for part in parts]), rtol=0, atol=1e-10, equal_nan=True
            )


APART = schedule(with_fallback=False, inclinations_deg=(1.206, 45.0))
coordinate = st.one_of(
    st.floats(-2.0, 2.0), st.sampled_from([0.0, -0.0, 1e-300, 5e-324, math.nan, math.inf, -math.inf])
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=40), degrees=st.booleans())
@pytest.mark.parametrize("which", [WITH, WITHOUT, APART], ids=["fallback", "zones only", "gap"])
def test_any_readings_in_bulk_are_the_single_ones(
    engine: str, which: ScheduledCorrection, rows: list[tuple[float, float, float]], degrees: bool
) -> None:
    unit = 180.0 / math.pi if degrees else 1.0
    with np.errstate(all="ignore"):
        inc, tf = which.attitude(np.array(rows).T.copy(), degrees=degrees)
    for k, row in enumerate(rows):
        if not all(map(math.isfinite, row)):
            assert math.isnan(inc[k])
            assert math.isnan(tf[k])
            continue
        one = which.correct(row)
        assert math.isnan(inc[k]) == (OUTSIDE_ZONE in one.flags)
        if OUTSIDE_ZONE in one.flags:
            continue
        i, t = attitude(one.gx, one.gy, one.gz)
        length = math.hypot(one.gx, one.gy, one.gz)
        assert abs(inc[k] / unit - i) * length < 1e-13 + 1e-12 * length
        assert 0.0 <= tf[k] < 2.0 * math.pi * unit
        assert (
            abs(math.remainder(tf[k] / unit - t, 2.0 * math.pi)) * math.hypot(one.gx, one.gy) < 1e-13 + 1e-12 * length
        )


@pytest.mark.usefixtures("engine")
@pytest.mark.parametrize("view", ["rows of a larger table", "columns", "read only"])
def test_readings_may_lie_in_memory_as_they_like(view: str) -> None:
    inc = np.linspace(0.005, 0.8, 1000)
    readings = A @ gravity_direction(inc, np.linspace(0, 60, 1000)) + B[:, None]
    if view == "columns":
        other = np.ascontiguousarray(readings.T).T
    elif view == "read only":
        other = readings.copy()
        other.flags.writeable = False
    else:
        other = np.vstack([np.zeros((1, 1000)), readings])[1:]
    for k in (0, 1):
        assert np.array_equal(WITH.attitude(other)[k], WITH.attitude(readings)[k])


@pytest.mark.usefixtures("engine")
def test_a_missing_reading_spoils_only_itself() -> None:
    readings = A @ gravity_direction(np.full(100, 0.03), np.linspace(0, 6, 100)) + B[:, None]
    broken = readings.copy()
    broken[1, 40] = np.nan
    for which in (WITH, WITHOUT):
        whole, hurt = which.attitude(readings), which.attitude(broken)
        for k in (0, 1):
            assert np.flatnonzero(np.isnan(hurt[k])).tolist() == [40]
            assert np.allclose(np.delete(hurt[k], 40), np.delete(whole[k], 40), rtol=0, atol=1e-13)


def test_the_covariance_of_a_blend_is_never_below_its_true_scatter() -> None:
    """Two zones whose errors are independent, the same, or opposite: the stated covariance bounds each."""
    rng = np.random.default_rng(21)
    low, high = (part.zone for part in schedule(with_fallback=False, inclinations_deg=(3.0, 5.0)).zones)
    inc = math.radians(4.0)
    g = gravity_direction(np.array([inc]), np.array([0.7]))[:, 0]
    root = np.linalg.cholesky(1e-9 * np.eye(12))
    flat = linear_parameters(np.eye(3), np.zeros(3), root @ root.T)
    parts = [
        type(zone)(zone.name, zone.inc_center_rad, zone.inc_min_rad, zone.inc_max_rad, flat, 1.0)
        for zone in (low, high)
    ]
    blend = ScheduledCorrection(tuple(LinearCorrection(zone, guarded=False) for zone in parts))
    (_, w), (_, u) = blend.weights((float(g[0]), float(g[1]), float(g[2])))
    stated = np.zeros((3, 3))
    for value, (i, j) in zip(blend.correct(tuple(g.tolist())).cov, UPPER, strict=True):
        stated[i, j] = stated[j, i] = value
    lever = np.concatenate([g, [1.0]])
    for correlation in (-1.0, 0.0, 1.0):
        one = rng.standard_normal((4000, 3, 4))
        other = correlation * one if correlation else rng.standard_normal((4000, 3, 4))
        errors = math.sqrt(1e-9) * (w * one + u * other) @ lever
        excess = np.linalg.eigvalsh(stated - np.cov(errors.T))
        assert excess.min() > -0.08 * np.trace(stated) / 3.0
    assert np.trace(stated) == pytest.approx(3.0 * 2.0 * 1e-9, rel=1e-6)


def test_the_unknown_offset_acts_on_neighbouring_zones_with_opposite_signs() -> None:
    """A level bench, inclinations close enough to blend: what the offset does between them is stated with its sign."""
    rng = np.random.default_rng(4)
    inclinations, places = (15.0, 20.0), np.deg2rad([15.0, 16.0, 17.5, 19.0, 20.0])
    inc = np.deg2rad(np.repeat(inclinations, 4))
    tf = np.deg2rad(np.tile([45.0, 135.0, 225.0, 315.0], len(inclinations)))
    g = gravity_direction(places, np.full(places.size, 0.7))
    level, noise, std = BenchAccuracy(tilt_rad=1e-9, pose_rad=1e-9), 1e-6, 2e-3
    errors, stated, levers = [], [], []
    for _ in range(500):
        offset = std * rng.standard_normal(3)
        a = A @ gravity_direction(inc, tf) + offset[:, None] + noise / 10.0 * rng.standard_normal((3, inc.size))
        poses = PoseSet.build(a, inc_ref_rad=inc, tf_ref_rad=tf, n=100.0, std=noise)
        zones = balance(poses, bench=level, offset_std_g=std).zones
        blend = ScheduledCorrection(
            tuple(LinearCorrection(zone, guarded=False) for zone in zones),
            guide=LinearCorrection(replace(zones[0], inc_center_rad=None)),
        )
        out = blend.corrected_block(A @ g + offset[:, None], 0.0)
        errors.append(out.g - g)
        stated.append(out.cov[[0, 3, 5]])
        levers.append([zone.outside_error(places, std) for zone in zones])
    scatter, expected = np.std(errors, axis=0), np.sqrt(np.mean(stated, axis=0))
    assert np.allclose(scatter, expected, rtol=0.16)  # five standard deviations of 500 draws
    # either zone alone, or both as if they were independent, would be wrong by far in the middle
    one, other = np.mean(levers, axis=0)[:, 2]
    assert np.all(expected[:, 2] < 0.25 * math.hypot(0.5 * one, 0.5 * other))


def test_estimated_variances_widen_a_blend_by_the_fallbacks_share_and_less_beside_noise() -> None:
    assert WITH.fallback is not None and WIDENED.fallback is not None
    for inc_deg in (0.9, 14.0, 25.0, 39.0, 120.0):
        m = reading(math.radians(inc_deg), 2.0)
        share = {part is WITH.fallback: w for part, w in WITH.weights(m)}.get(True, 0.0)
        own, sizes = 1.0 - (1.0 - share) ** 2, []
        for noise in (0.0, 1e-2):
            of_reading = (noise**2, 0.0, 0.0, noise**2, 0.0, noise**2)
            blend, whole = (
                np.array(wide.correct(m, of_reading).cov) - np.array(plain.correct(m, of_reading).cov)
                for wide, plain in ((WIDENED, WITH), (WIDENED.fallback, WITH.fallback))
            )
            if share in (0.0, 1.0) or noise:
                # where noise is nearly all of the variance, the fallback's part counts with the square of its share
                assert np.allclose(blend, own**2 * whole, rtol=0.03, atol=1e-3 * np.abs(whole).max() * own**2)
            sizes.append(np.abs(whole).max())
        assert sizes[1] < 0.2 * sizes[0]


@given(inc=st.floats(0.0, math.pi), tf=st.floats(0.0, 6.3), size=st.floats(0.9, 1.1))
def test_the_key_orders_readings_as_inclination_does(inc: float, tf: float, size: float) -> None:
    x, y, z = (size * gravity_direction(np.array([inc]), np.array([tf]))[:, 0]).tolist()
    assert key_of(x, y, z) == pytest.approx(key_of_inclination(inc), abs=1e-12)
    assert key_of_inclination(min(inc + 1e-3, math.pi)) >= key_of_inclination(inc) - 1e-15


def test_window_weights_are_the_same_one_by_one_and_in_arrays() -> None:
    window = InclinationWindow(0.3, 0.1, 0.6, 0.2, 0.3)
    keys = np.linspace(-0.1, 1.0, 500)
    assert np.allclose(window.weights(keys), [window.weight(float(k)) for k in keys], rtol=0, atol=1e-15)
    assert window.weight(0.1) == window.weight(0.6) == 0.0
    assert window.weight(0.3) == 1.0


def test_a_schedule_without_corrections_or_with_guarded_zones_is_refused() -> None:
    with pytest.raises(InputError):
        ScheduledCorrection(())
    with pytest.raises(InputError):
        ScheduledCorrection((LinearCorrection(WITH.zones[0].zone),))
    assert WITH.fallback is not None
    with pytest.raises(InputError):
        ScheduledCorrection((LinearCorrection(WITH.fallback.zone, guarded=False),))


def test_stated_intervals_hold_the_truth_within_between_and_beyond_the_zones() -> None:
    """Sensors and benches drawn from what the calibrations assume: 95 % intervals of I and T, nearly vertical too."""
    rng = np.random.default_rng(1)
    inc = np.deg2rad(np.repeat((*INCLINATIONS_DEG, 60.0), 4))
    tf = np.deg2rad(np.tile([45.0, 135.0, 225.0, 315.0], len(INCLINATIONS_DEG) + 1))
    noise, tilt, pose = 1e-4, math.radians(0.05), math.radians(0.0052)
    places = (0.2, 0.9, 2.0, 4.0, 7.0, 44.0, 100.0)
    hits = np.zeros((len(places), 2))
    sensors, readings = 150, 3
    for _ in range(sensors):
        A, b = np.eye(3) + 3e-3 * rng.standard_normal((3, 3)), 2e-3 * rng.standard_normal(3)
        errors = pose * rng.standard_normal((2, inc.size))
        a = A @ bench_gravity(inc + errors[0], tf + errors[1], *(tilt * rng.standard_normal(2))) + b[:, None]
        a += noise / 10.0 * rng.standard_normal(a.shape)
        poses = PoseSet.build(a, inc_ref_rad=inc, tf_ref_rad=tf, n=100.0, std=noise)
        zones = tuple(LinearCorrection(zone, guarded=False) for zone in balance(poses).zones)
        blend = ScheduledCorrection(zones, fallback=LinearCorrection(conventional(poses).main))
        for row, place in enumerate(places):
            for _ in range(readings):
                truth = math.radians(place), rng.uniform(0.0, 2.0 * math.pi)
                m = (
                    A @ gravity_direction(np.array([truth[0]]), np.array([truth[1]]))[:, 0]
                    + b
                    + noise * rng.standard_normal(3)
                )
                out = blend.correct((float(m[0]), float(m[1]), float(m[2])), (noise**2, 0, 0, noise**2, 0, noise**2))
                got = attitude_with_std(out.gx, out.gy, out.gz, out.cov)
                hits[row, 0] += abs(got.inc_rad - truth[0]) < 1.96 * got.inc_std_rad
                hits[row, 1] += abs(math.remainder(got.tf_rad - truth[1], 2 * math.pi)) < 1.96 * got.tf_std_rad
    coverage = hits / (sensors * readings)
    # three readings of a sensor share its calibration: 250 independent trials at best, 1.4 % a standard deviation
    assert np.all(coverage > 0.95 - 0.042)
    # the bound on a blend errs on the safe side, by not much
    assert np.all(coverage < 0.996)
    assert 0.93 < coverage.mean() < 0.975
