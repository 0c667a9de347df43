"""Inner products under all settings of the noise: from one pass there and back they are those of whitened columns."""

from __future__ import annotations

import numpy as np
import pytest

from highside.arrays import Array
from highside.diagnosis.law_cells import CellMeans
from highside.diagnosis.laws.cell_noise import CellNoise
from highside.diagnosis.laws.learning import FREE, _Columns, _near, _Products
from highside.diagnosis.laws.noise_filters import LADDERS, CellFilters, RowFilters, SettingFilters

N = 150


def _columns(rng: np.random.Generator, key: str, count: int) -> _Columns:
    """Of two channels, the first column absent from the second."""
    raw = rng.standard_normal((count, 2, N))
    raw[0, 1] *= count == 1
    return _Columns(key, raw, rng.standard_normal((count, count)))


ALL = np.arange(LADDERS[-1] + 1)


def _of_whitened(filters: SettingFilters, parts: list[_Columns], channel: int) -> Array:
    rows = np.concatenate([np.tensordot(part.turn, part.raw[:, channel], 1) for part in parts])
    found = np.empty((ALL.size, len(rows), len(rows)))
    for run, whiten, _ in filters.runs(ALL):
        white = whiten(rows)
        found[run] = white @ white.transpose(0, 2, 1)
    return found


def _filters(t_s: Array, white: Array, cells: bool) -> SettingFilters:
    """Of values that are single rows, or means over cells of some that lie among one another."""
    if not cells:
        return RowFilters.of(np.asarray(white / white.mean()), t_s)
    number = np.concatenate([10 * k + np.tile(np.arange(10), 4) for k in range(N // 10)])
    rows = np.linspace(t_s[0], t_s[-1], number.size)
    means = CellMeans(number, np.full(N, 4.0), np.array([np.flatnonzero(number == k)[1] for k in range(N)]))
    return CellFilters(CellNoise(means, rows, np.sqrt(white)[None], np.array([0.5])), 0, t_s)


@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize(("even", "cells"), [(True, False), (False, False), (True, True)])
def test_products_are_those_of_whitened_columns(channel: int, even: bool, cells: bool) -> None:
    """Also where some are known from before, and whichever of two parts has fewer columns."""
    rng = np.random.default_rng(7)
    t_s = np.asarray(np.arange(N) * 0.02 if even else np.cumsum(rng.uniform(0.5, 2.0, N)), dtype=np.float64)
    white = rng.uniform(0.5, 2.0, N)
    filters = _filters(t_s, white, cells)
    free, group, wide = _columns(rng, FREE, 5), _columns(rng, "group", 3), _columns(rng, "wide", 8)
    residual, clipped = _columns(rng, "residual", 1), _columns(rng, "clipped", 1)
    products = _Products(channel, filters, 2.5, N)
    for parts in ([free, residual], [free, group, residual], [free, wide, group, residual], [free, wide, clipped]):
        some = _near(50, [50, int(LADDERS[2])])
        wanted = _of_whitened(filters, parts, channel) / 2.5
        first = products.settings(parts, some).inner
        found = products.settings(parts, ALL).inner
        assert np.array_equal(found[some], first)
        size = np.sqrt(np.einsum("sii->si", wanted))
        np.testing.assert_array_less(
            np.abs(found - wanted), (1e-11 if cells else 1e-13) * size[:, :, None] * size[:, None, :] + 1e-300
        )
