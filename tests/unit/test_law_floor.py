"""Beside a simulation: the floor of the means of cells, in noise that is correlated from row to row."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt, sosfreqz

from highside.diagnosis.law_channels import floor_of_cells
from highside.diagnosis.rows.noise import RotationNoise

ROWS = 1200


def noise(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(n,) rows of unit size, and their autocorrelation."""
    drawn = rng.standard_normal(ROWS + 300)
    if kind == "white":
        return drawn[300:], np.append(1.0, np.zeros(ROWS - 1))
    if kind == "forgetful":
        return lfilter([np.sqrt(1 - 0.81)], [1.0, -0.9], drawn)[300:], 0.9 ** np.arange(ROWS)
    sos = butter(2, 0.16, output="sos")
    power = np.abs(sosfreqz(sos, 4096, whole=True)[1]) ** 2
    known = np.fft.ifft(power).real[:ROWS]
    return sosfilt(sos, drawn)[300:] / np.sqrt(known[0]), known / known[0]


@pytest.mark.parametrize("kind", ["white", "forgetful", "low-passed"])
@pytest.mark.parametrize("longest", [2, 6])
def test_means_of_cells_scatter_as_their_floor_says(kind: str, longest: int) -> None:
    """It was two to five times too small: rows that are alone in their cell counted as without noise, and neighbours as
    independent of one another."""
    rng = np.random.default_rng(3)
    ratios = []
    for _ in range(40):
        rows, known = noise(kind, rng)
        number = np.repeat(np.arange(ROWS), rng.integers(1, longest + 1, ROWS))[:ROWS]
        number[200:230] = -1
        number = np.where(number < 0, -1, np.unique(number, return_inverse=True)[1].reshape(-1) - 1)
        floor = floor_of_cells(rows, number, known, 1e-9)
        used = number >= 0
        count = np.bincount(number[used])
        means = np.bincount(number[used], weights=rows[used]) / count
        assert floor.shape == means.shape
        ratios.append(float(np.sqrt(np.mean((means / floor) ** 2))))
    assert 0.9 < np.mean(ratios) < 1.1


def test_each_row_its_own_cell_has_the_scatter_of_all() -> None:
    rows = np.random.default_rng(4).standard_normal(ROWS)
    floor = floor_of_cells(rows, np.arange(ROWS), np.append(1.0, np.zeros(ROWS - 1)), 1e-9)
    assert floor == pytest.approx(np.full(ROWS, rows.std()))


def test_autocorrelation_of_a_filter_is_that_of_its_process() -> None:
    learned = RotationNoise(
        (np.array([1.0, -0.9]),), np.ones((1, ROWS)), np.ones(1), 1e3, np.zeros(1), np.zeros((1, 3)), 0
    )
    assert learned.autocorrelation(0, 50) == pytest.approx(0.9 ** np.arange(50), abs=1e-9)
