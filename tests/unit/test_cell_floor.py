"""The floor of means over cells of a rotation, in noise that is correlated from row to row."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from highside.arrays import Array
from highside.diagnosis.cell_floor import floor_of_cell_means, shares_of_means
from highside.diagnosis.law_cells import CellMeans, cells_of
from highside.diagnosis.law_sessions import ChainSession
from highside.diagnosis.laws.cell_noise import CellNoise, borders_of_groups
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.search import Search
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from studies import diagnosis_deck as deck
from studies import rotation_cases as cases

SIGMA = 8e-5
FURTHER = pytest.mark.further


def coloured(rng: np.random.Generator, shape: tuple[int, ...], phi: float) -> Array:
    """Rows (..., n) of noise whose neighbours are correlated by `phi`."""
    drawn = rng.standard_normal((*shape[:-1], shape[-1] + 200))
    return np.asarray(SIGMA * lfilter([np.sqrt(1 - phi**2)], [1.0, -phi], drawn, axis=-1)[..., 200:])


def rows_of(seed: int, rows: int) -> ChainState:
    """Ten rates of both senses, up to two turns a second, with ramps between them."""
    return cases.design(seed, seconds=rows / 50)


def test_the_share_of_a_mean_is_what_its_rows_have_in_common() -> None:
    rng = np.random.default_rng(1)
    number = np.where(rng.uniform(size=120) < 0.1, -1, rng.integers(0, 6, 120))
    count = np.bincount(number[number >= 0]).astype(float)
    at = np.cumsum(rng.uniform(0.01, 1.0, 120))
    found = shares_of_means(CellMeans(number, count, np.zeros(6, dtype=np.intp)), at)
    for k in range(6):
        own = at[number == k]
        assert found[k] == pytest.approx(np.exp(-np.abs(own[:, None] - own)).mean(), rel=1e-12)


def _among_one_another() -> CellMeans:
    """Ten cells among one another in each 40 rows, some rows in none."""
    number = np.concatenate([10 * k + np.random.default_rng(2).integers(0, 10, 40) for k in range(10)])
    number[50:60] = -1
    number = np.where(number < 0, -1, np.searchsorted(np.unique(number[number >= 0]), number))
    count = np.bincount(number[number >= 0]).astype(float)
    return CellMeans(number, count, np.array([np.flatnonzero(number == k)[0] for k in range(count.size)]))


@pytest.mark.parametrize("t_s", [0.05 * np.arange(400), np.cumsum(np.random.default_rng(9).uniform(0, 0.5, 400))])
@pytest.mark.parametrize(("lengths", "variance"), [((), 0.0), ((5.0,), 3.0), ((500.0,), 1e4), ((1.0, 4.0, 50.0), 0.3)])
def test_means_are_whitened_as_noise_of_their_rows_makes_them(
    t_s: Array, lengths: tuple[float, ...], variance: float
) -> None:
    cells = _among_one_another()
    borders = borders_of_groups(cells, 8)
    assert len(borders) > 4
    # noise of rows that is correlated within groups alone, as the floor is taken to be
    forgets, rows = 0.4, np.arange(400)
    weights = (cells.number == np.arange(cells.count.size)[:, None]) / cells.count[:, None]
    colour = weights @ np.exp(-forgets * np.abs(rows[:, None] - rows)) @ weights.T
    group = np.searchsorted(borders, np.arange(cells.count.size), side="right")
    colour *= group[:, None] == group
    floor = np.linspace(1.0, 2.0, cells.count.size)
    size = floor / np.sqrt(np.mean(floor**2) * np.diagonal(colour))
    apart = np.abs(t_s[:, None] - t_s)
    level = sum((np.exp(-apart / length) for length in lengths), np.zeros_like(apart))
    whole = colour * np.outer(size, size) + variance * weights @ level @ weights.T
    noise = CellNoise(cells, t_s, floor[None], np.array([forgets]), 8).filter(0, lengths, variance)
    columns = np.random.default_rng(3).normal(size=(4, cells.count.size))
    white, solved = noise.scaled(2.0).white(columns), columns @ np.linalg.inv(4.0 * whole)
    np.testing.assert_allclose(white[0] @ white[0].T, columns @ solved.T, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(noise.scaled(2.0).transposed(white)[0], solved, rtol=1e-5, atol=1e-7)
    assert noise.scaled(2.0).log_determinant[0] == pytest.approx(np.linalg.slogdet(4.0 * whole)[1], abs=1e-5)


@pytest.mark.parametrize("phi", [0.0, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("rows", [12_000, 45_000])
def test_means_scatter_as_their_floor_says_and_are_white_behind_its_filter(phi: float, rows: int) -> None:
    """Means of cells that are passed slowly scattered up to three times as much as they were thought to, and those of
    ramps were correlated with their neighbours beyond what any noise that was offered allowed."""
    state, rng = rows_of(3, rows), np.random.default_rng(int(100 * phi))
    residual = coloured(rng, (3, state.n), phi)
    laws = ChainSession.of_rotation(RotationSession(residual, state), (), residual)
    assert laws.cells is not None
    means = np.stack([laws.cells.mean(coloured(rng, (3, state.n), phi)) for _ in range(40)])
    of_cells = np.sqrt(np.mean((means / laws.floor) ** 2, axis=(0, 1)))
    # of a session of four minutes the rows of slow passages alone say how large noise is that remembers
    assert np.all(np.abs(np.quantile(of_cells, [0.02, 0.98]) - [0.87, 1.13]) < (0.08 if rows > 12_000 else 0.25))
    problem = laws.problem(ForwardModel.of({}), laws.cells.mean(residual))
    white = Whitener(problem, LawNoise.floor_alone(problem)).white(means)
    assert np.sqrt(np.mean(white**2)) == pytest.approx(1.0, abs=0.06)
    assert np.mean(white[..., 1:] * white[..., :-1]) == pytest.approx(0.0, abs=0.07)


@pytest.mark.parametrize("sectors", [30, 60, 120])
def test_what_is_slow_beside_a_turn_is_as_uncertain_as_its_noise_makes_it(sectors: int) -> None:
    """Of narrow sectors the next one is passed in another turn: taken as a chain, means were correlated too little, and
    what was slow had twice the variance that it was thought to have (four false laws in eight draws of noise)."""
    state, rng, phi = rows_of(3, 45_000), np.random.default_rng(sectors), 0.6
    residual = coloured(rng, (1, state.n), phi)
    cells = cells_of(RotationSession(np.repeat(residual, 3, axis=0), state), sectors)
    forgets = -float(np.log(phi))
    floor = SIGMA * np.sqrt(shares_of_means(cells, forgets * np.arange(state.n, dtype=np.float64)))
    noise = CellNoise(cells, state.t_s, floor[None], np.array([forgets])).filter(0).scaled(np.sqrt(np.mean(floor**2)))
    means = noise.white(np.stack([cells.mean(coloured(rng, (state.n,), phi)) for _ in range(150)]))[0]
    elapsed = state.t_s[cells.middle] - state.t_s[0]
    part = np.floor(12 * elapsed / (elapsed[-1] + 1.0)).astype(int)
    tf = state.tf_rad[cells.middle]
    ratios = []
    for k in np.unique(part):
        for shape in (np.ones(tf.size), np.cos(tf), np.sin(2 * tf)):
            course = noise.white(((part == k) * shape)[None])[0, 0]
            ratios.append(float(np.mean((means @ course) ** 2) / (course @ course)))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("phi", [0.0, 0.6])
@pytest.mark.parametrize(("size", "most"), [(10.0, 1.05), (100.0, 1.4), (1e3, 8.0)])
def test_what_follows_the_toolface_hardly_raises_the_floor(phi: float, size: float, most: float) -> None:
    """A misfit of a hundred times the noise made it ten times as large: what is straight within a cell is no noise."""
    state, rng = rows_of(4, 20_000), np.random.default_rng(5)
    noise = coloured(rng, (3, state.n), phi)
    misfit = size * SIGMA * np.stack([np.cos(state.tf_rad), np.sin(2 * state.tf_rad), state.t_s / state.t_s[-1]])
    cells = cells_of(RotationSession(noise, state))
    slopes = cells.from_middle(state.tf_rad), state.t_s
    alone, beside = (floor_of_cell_means(one, cells, np.zeros(3), slopes)[0] for one in (noise, noise + misfit))
    assert np.all(np.median(beside / alone, axis=1) < most)


def found_in(seed: int, rows: int, kind: str) -> int:
    """How many laws are found in noise alone."""
    state = rows_of(seed, rows)
    rng = np.random.default_rng([seed, rows])
    sensor, _ = deck.sensor_and_base(state, rng)
    noise = cases.noise_of(kind, state, rng).draw(rng)
    laws = ChainSession.of_rotation(RotationSession(sensor.predict(state) + noise, state), cases.FREE, noise)
    return len(Search(laws.problem(sensor, laws.residual(sensor))).run().terms)


@pytest.mark.parametrize(
    ("seed", "rows"),
    [
        (14, 12_000),
        (12, 45_000),
        pytest.param(13, 45_000, marks=FURTHER),
        pytest.param(14, 45_000, marks=FURTHER),
        pytest.param(11, 90_000, marks=FURTHER),
    ],
)
def test_noise_that_is_correlated_from_row_to_row_is_no_law(seed: int, rows: int) -> None:
    """One to six laws of the acceleration, the vibration, the toolface were found in each of these: they were what
    told the rows of a ramp from others."""
    assert found_in(seed, rows, "coloured") == 0


@pytest.mark.parametrize(
    ("seed", "rows"),
    [(14, 12_000), pytest.param(13, 45_000, marks=FURTHER), pytest.param(19, 90_000, marks=FURTHER)],
)
def test_an_offset_that_wanders_within_blocks_is_no_law(seed: int, rows: int) -> None:
    """All cells of a block hold what wandered within it: taken as a chain they did not, and filtered temperatures
    explained it."""
    assert found_in(seed, rows, "random walk") == 0
