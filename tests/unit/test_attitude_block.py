"""Blocks of readings: equal to the single-reading path, whatever the threads, the shapes and the odd values."""

from __future__ import annotations

import math
import sys
from decimal import Decimal, getcontext
from itertools import pairwise

import numpy as np
import pytest

from highside.attitude import (
    attitude,
    attitude_block,
    attitude_std_block,
    attitude_with_std,
    block,
    compiled,
    correct_and_attitude,
    toolface_std,
    toolface_std_block,
)
from highside.attitude.compiled import attitude_by_half_angles


def random_vectors(n: int, seed: int = 1) -> np.ndarray:
    """Directions everywhere, a third of them within a degree of the axis, of lengths about 1."""
    rng = np.random.default_rng(seed)
    g = rng.normal(size=(3, n))
    g[:2, ::3] *= 10.0 ** rng.uniform(-8, -2, g[:, ::3].shape[1])
    return g * (rng.uniform(0.9, 1.1, n) / np.sqrt((g * g).sum(axis=0)))


def test_blocks_equal_single_readings() -> None:
    g = random_vectors(100_000)
    inc, tf = attitude_block(g)
    single = np.array([attitude(*column) for column in g.T.tolist()]).T
    assert np.abs(inc - single[0]).max() < 1e-14
    assert np.abs(np.angle(np.exp(1j * (tf - single[1])))).max() < 1e-14
    assert inc.min() >= 0.0
    assert tf.min() >= 0.0
    assert tf.max() < 2 * math.pi


@pytest.mark.usefixtures("engine")
def test_correction_equals_single_readings() -> None:
    raw = random_vectors(20_000, seed=2)
    rng = np.random.default_rng(3)
    C, b = np.eye(3) + rng.normal(0, 1e-2, (3, 3)), rng.normal(0, 5e-3, 3)
    inc, tf = correct_and_attitude(raw, C, b, degrees=True)
    for k in range(0, raw.shape[1], 7):
        g = C @ (raw[:, k] - b)
        i, t = attitude(*g.tolist())
        # the last bit of g turns T by 1 / sin I times as much
        bound = 1e-13 + math.degrees(4e-16 / math.sin(i))
        assert abs(inc[k] - math.degrees(i)) < 1e-12
        assert abs(math.remainder(tf[k] - math.degrees(t), 360.0)) < bound + 1e-12


@pytest.mark.usefixtures("engine")
@pytest.mark.parametrize("n", [0, 1, 17, block.BLOCK - 1, block.BLOCK + 1, block.THREADS_FROM + 12_345])
def test_the_number_of_threads_changes_no_bit(n: int) -> None:
    raw = random_vectors(n, seed=4)
    C, b = np.diag([1.001, 0.999, 1.002]), np.array([1e-3, -2e-3, 5e-4])
    one = correct_and_attitude(raw, C, b, threads=1)
    three = correct_and_attitude(raw, C, b, threads=3)
    default = correct_and_attitude(raw, C, b)
    for k in (0, 1):
        np.testing.assert_array_equal(one[k], three[k])
        np.testing.assert_array_equal(one[k], default[k])


def test_outputs_given_are_the_outputs_returned() -> None:
    g = random_vectors(1000)
    both = np.empty((2, 2000))[:, ::2]
    inc, tf = attitude_block(g, both[0], both[1])
    assert inc.base is both.base
    np.testing.assert_array_equal(both[1], attitude_block(g)[1])
    np.testing.assert_array_equal(tf, both[1])


def test_odd_vectors() -> None:
    tiny = 1e-300
    columns = [(0, 0, 1), (0, 0, -1), (0, 0, 0), (1, -tiny, 0), (-1, 0, 0), (-1, -0.0, 0), (0, -1, 0), (1, 0, 1)]
    g = np.array(columns, dtype=float).T
    inc, tf = attitude_block(g)
    expected = np.array([attitude(*column) for column in g.T.tolist()])
    np.testing.assert_allclose(inc, expected[:, 0], atol=1e-14)
    np.testing.assert_allclose(np.exp(1j * tf), np.exp(1j * expected[:, 1]), atol=1e-14)
    assert (tf < 2 * math.pi).all()


def test_a_value_that_is_not_a_number_stays_where_it_is() -> None:
    g = random_vectors(1000)
    g[:, 3] = (0.0, 0.0, 1.0)
    g[:, 4] = (1.0, -1e-300, 0.0)
    clean = attitude_block(g)
    g[1, 10] = np.nan
    inc, tf = attitude_block(g)
    assert math.isnan(inc[10])
    assert math.isnan(tf[10])
    keep = np.arange(1000) != 10
    np.testing.assert_array_equal(inc[keep], clean[0][keep])
    np.testing.assert_array_equal(tf[keep], clean[1][keep])


def test_rows_for_columns_are_refused() -> None:
    with pytest.raises(ValueError, match="transpose"):
        attitude_block(np.zeros((10, 3)))
    with pytest.raises(ValueError, match=r"\(3, N\)"):
        correct_and_attitude(np.zeros(3), np.eye(3), np.zeros(3))
    with pytest.raises(ValueError, match="shape"):
        correct_and_attitude(np.zeros((3, 5)), np.eye(2), np.zeros(3))
    with pytest.raises(ValueError, match="output"):
        attitude_block(np.zeros((3, 5)), np.empty(4))
    with pytest.raises(ValueError, match="output"):
        attitude_block(np.zeros((3, 5)), np.empty(5, dtype=np.float32))
    with pytest.raises(ValueError, match="covariance"):
        attitude_std_block(np.zeros((3, 5)), np.zeros((3, 3)))


def test_uncertainties_equal_single_readings() -> None:
    g = random_vectors(3000, seed=5)
    g[:, 0], g[:, 1] = (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    rng = np.random.default_rng(6)
    roots = rng.normal(0, 1e-4, (g.shape[1], 3, 3))
    cov = (roots @ roots.transpose(0, 2, 1))[:, *np.triu_indices(3)].T
    inc_std, tf_std, undefined = attitude_std_block(g, cov)
    single = [attitude_with_std(*v, tuple(c)) for v, c in zip(g.T.tolist(), cov.T.tolist(), strict=True)]  # type: ignore[arg-type]
    np.testing.assert_allclose(inc_std, [s.inc_std_rad for s in single], rtol=1e-9)
    np.testing.assert_allclose(tf_std, [s.tf_std_rad for s in single], rtol=1e-9)
    np.testing.assert_array_equal(undefined, [s.toolface_undefined for s in single])
    assert undefined.any()
    assert not undefined.all()
    same = attitude_std_block(g, cov[:, 5])
    np.testing.assert_array_equal(same[0], attitude_std_block(g, np.repeat(cov[:, 5:6], g.shape[1], axis=1))[0])


def test_the_law_of_the_toolface_is_the_same_in_both_paths() -> None:
    s = np.array([0.0, 0.3, 1.0, 5.0, 100.0, 1e5, 1e7, math.inf])
    np.testing.assert_allclose(toolface_std_block(s), [toolface_std(x) for x in s.tolist()], rtol=1e-14)


def exact_arctangent(u: Decimal) -> Decimal:
    halvings = 0
    while u > Decimal("0.01"):
        u, halvings = u / (1 + (1 + u * u).sqrt()), halvings + 1
    total, term, k = Decimal(0), u, 1
    while abs(term) > Decimal("1e-60"):
        total, term, k = total + term / k, -term * u * u, k + 2
    return total * 2**halvings


def test_the_rational_arctangent_meets_the_exact_one() -> None:
    getcontext().prec = 60
    worst = Decimal(0)
    for k in range(1, 401):
        u = Decimal(k) / 400
        w = u * u
        poles = sum((Decimal(c) / (w + Decimal(e)) for c, e in block.ATAN_POLES), Decimal(block.ATAN_CONSTANT))
        worst = max(worst, abs(poles * u / exact_arctangent(u) - 1))
    assert worst < Decimal("3.5e-15")
    # and it touches it, changing sign, as often as an interpolant at eleven points must
    signs = []
    for k in range(1, 2001):
        w = Decimal(k) / 2000
        poles = sum((Decimal(c) / (w + Decimal(e)) for c, e in block.ATAN_POLES), Decimal(block.ATAN_CONSTANT))
        signs.append(poles * w.sqrt() > exact_arctangent(w.sqrt()))
    assert sum(a != b for a, b in pairwise(signs)) >= 9


@pytest.mark.parametrize("inc_deg", [0.0, 0.3, 1.0, 89.9, 178.5, 179.9])
@pytest.mark.parametrize("degrees", [False, True])
def test_a_block_near_one_inclination_is_as_exact_as_any(inc_deg: float, degrees: bool) -> None:
    """Logs take a series in place of the second arc tangent; one reading elsewhere in the block must not mislead it."""
    rng = np.random.default_rng(5)
    inc = np.clip(np.deg2rad(inc_deg) + 0.004 * rng.uniform(-1.0, 1.0, 5001), 0.0, np.pi)
    tf = rng.uniform(0.0, 2.0 * np.pi, inc.size)
    for stray in (None, np.pi - np.deg2rad(inc_deg), np.deg2rad(inc_deg) + 0.5 * np.pi, np.nan):
        at = inc.copy()
        if stray is not None:
            at[1234] = stray
        g = 1.01 * np.stack([np.sin(at) * np.cos(tf), np.sin(at) * np.sin(tf), np.cos(at)])
        got, _ = attitude_block(g, degrees=degrees, threads=1)
        expected = np.arctan2(np.hypot(g[0], g[1]), g[2])
        scale = 180.0 / np.pi if degrees else 1.0
        assert np.allclose(got, expected * scale, rtol=0, atol=8e-15 * scale, equal_nan=True)
        assert np.all((got >= 0.0) | np.isnan(got))


def test_one_reading_by_half_angles_is_the_one_by_arc_tangents() -> None:
    for g in [*random_vectors(20_000, seed=8).T.tolist(), [0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [1.0, -0.0, 0.0]]:
        inc, tf = attitude_by_half_angles(*g)
        expected = attitude(*g)
        assert abs(inc - expected[0]) < 1e-14
        assert abs(math.remainder(tf - expected[1], 2 * math.pi)) < 1e-14
        assert 0.0 <= tf < 2 * math.pi


def test_without_a_folder_to_keep_it_in_the_loop_is_compiled_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    from numba.core import caching

    monkeypatch.setattr(caching.CompileResultCacheImpl, "_locator_classes", [])
    compiled.compiled.cache_clear()
    monkeypatch.setattr(compiled, "COMPILED_FROM", 0)
    raw = random_vectors(100, seed=9)
    by_loop = correct_and_attitude(raw, np.eye(3), np.zeros(3))
    compiled.compiled.cache_clear()
    for one, other in zip(by_loop, attitude_block(raw), strict=True):
        assert np.abs(np.angle(np.exp(1j * (one - other)))).max() < 1e-14


def test_without_the_compiler_numpy_does_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "COMPILED_FROM", 0)
    monkeypatch.setitem(sys.modules, "numba", None)
    compiled._compiler.cache_clear()
    try:
        assert not compiled.wanted(10_000_000)
        inc, _ = correct_and_attitude(np.array([[0.0], [0.0], [1.0]]), np.eye(3), np.zeros(3))
        assert inc[0] < 1e-14
    finally:
        compiled._compiler.cache_clear()
