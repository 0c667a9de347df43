"""Where a mismatch sits: groups of smooth functions of each covariate on each channel, tested after the base fit.

A group is small on purpose (a harmonic series, a polynomial): it locates, it does not name. Products of covariates are
among them, because an interaction without a group of its own goes unseen or is taken for something else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import CHANNELS
from highside.diagnosis.core.policy import CANDIDATES, PLACES, SUPPORT
from highside.diagnosis.core.regression import ScoreTest, outside, span
from highside.diagnosis.core.result import Location
from highside.diagnosis.core.support import Cells, Window, cells_of, runs, support
from highside.physics.state import ChainState

TOOLFACE = "tf_ref_deg"


class Located(Protocol):
    """A covariate with its values (n,), and the harmonics that its functions are."""

    @property
    def covariate(self) -> str: ...
    @property
    def along(self) -> Array: ...
    @property
    def harmonics(self) -> tuple[int, ...]: ...


@dataclass(frozen=True, slots=True)
class Basis:
    """Functions (k, n) of a covariate; `along` (n,) is what intervals are given in."""

    covariate: str
    along: Array
    functions: Array
    harmonics: tuple[int, ...] = ()


def pose_bases(state: ChainState, force: Array) -> list[Basis]:
    """The covariates of a session of poses that vary in it; `force` (3, n) in g."""
    x, y, z = force
    square = [x * x, y * y, x * y, x * z, y * z]
    cubic = [x**3, y**3, z**3, x * x * y, x * x * z, y * y * z, x * y * z]
    stations = np.unique(state.toolface_station).size
    orders = tuple(k for k in range(1, PLACES.harmonics + 1) if 2 * k <= stations)
    return [
        *_attitude_bases(state, z, orders),
        _basis("gravity_direction", np.degrees(state.inc_rad), [*square, *cubic]),
        *_direction_bases(state, z, square),
        *_temperature_bases(state, force, square, orders),
        *_vibration_bases(state),
        _time_basis(state),
    ]


def _basis(covariate: str, along: Array, functions: Sequence[Array], harmonics: tuple[int, ...] = ()) -> Basis:
    return Basis(covariate, np.asarray(along), np.stack([np.asarray(f, dtype=float) for f in functions]), harmonics)


def _harmonics(angle: Array, orders: Iterable[int]) -> list[Array]:
    """cos and sin of each order."""
    return [f(k * angle) for k in orders for f in (np.cos, np.sin)]


def _attitude_bases(state: ChainState, z: Array, orders: tuple[int, ...]) -> list[Basis]:
    tf, inc = state.tf_rad, state.inc_rad
    inc_deg = np.degrees(inc)
    bases: list[Basis] = []
    if orders:
        bases.append(_basis("tf_ref_deg", np.mod(np.degrees(tf), 360.0), _harmonics(tf, orders), orders))
    stations = np.unique(state.inclination_station).size
    if stations <= 1:
        return bases
    smooth = _harmonics(inc, range(1, min(PLACES.inclination_orders, stations)))
    bases.append(_basis("inc_ref_deg", inc_deg, smooth))
    if stations > CANDIDATES.inclination_stations and CANDIDATES.least_at_station * stations <= state.n:
        # one inclination station may be off: no smooth function shows that
        bases.append(
            _basis(
                "inc_ref_deg", inc_deg, [state.inclination_station == k for k in np.unique(state.inclination_station)]
            )
        )
    if orders:
        product = [z * f for f in _harmonics(tf, orders[: PLACES.product_orders])]
        bases.append(_basis("inc_ref_deg x tf_ref_deg", inc_deg, product))
    return bases


def _direction_bases(state: ChainState, z: Array, square: list[Array]) -> list[Basis]:
    if not np.ptp(state.direction) > 0:
        return []
    tf, d = state.tf_rad, np.asarray(state.direction)
    return [
        _basis("direction", d, [d]),
        _basis("direction x tf_ref_deg", np.mod(np.degrees(tf), 360.0), [d * np.cos(tf), d * np.sin(tf)]),
        _basis("direction x gravity_direction", np.degrees(state.inc_rad), [d * z, *(d * term for term in square)]),
    ]


def _temperature_bases(state: ChainState, force: Array, square: list[Array], orders: tuple[int, ...]) -> list[Basis]:
    if not np.ptp(state.temp_c) > PLACES.warm_span_c:
        return []
    q = (state.temp_c - state.temp_c.mean()) / state.temp_c.std()
    bases = [_basis("temp_c", state.temp_c, [q, q**2, q**3])]
    if orders:
        product = [q * f for f in _harmonics(state.tf_rad, orders[: PLACES.product_orders])]
        bases.append(_basis("temp_c x tf_ref_deg", state.temp_c, product))
    loaded = [*(q * axis for axis in force), *(q * term for term in square)]
    return [*bases, _basis("temp_c x gravity_direction", state.temp_c, loaded)]


def _vibration_bases(state: ChainState) -> list[Basis]:
    rms = state.vibration_rms_g
    return [_basis("vibration_rms_g", rms, [rms, rms**2])] if np.ptp(rms) > 0 else []


def _time_basis(state: ChainState) -> Basis:
    u = (state.t_s - state.t_s[0]) / max(float(np.ptp(state.t_s)), 1e-9)
    orders = max(2, min(PLACES.time_orders, state.n // PLACES.poses_a_wave))
    return _basis("t_s", state.t_s, [np.cos(np.pi * k * u) for k in range(1, orders)])


def on_channel(functions: Array, channel: int, channels: int = 3) -> Array:
    """(k, n) -> (k, C, n) on one channel."""
    columns = np.zeros((functions.shape[0], channels, functions.shape[1]))
    columns[:, channel] = functions
    return columns


@dataclass(frozen=True)
class Scan:
    """All groups of a session, whitened: `cells` are (channel, basis) in the order of the score test."""

    bases: list[Located]
    cells: tuple[tuple[int, int], ...]
    score_test: ScoreTest
    white: tuple[Array, ...]
    freedom: Array
    """(cells,) degrees of freedom that the noise is known with where a cell looks"""


def scan_of(
    bases: Sequence[Located], whitened: Sequence[Array], cells: Sequence[tuple[int, int]], freedom: Array | float
) -> Scan:
    """`whitened` are the groups (k, 3 n) of `cells`."""
    known = np.broadcast_to(np.asarray(freedom, dtype=float), (len(cells),))
    return Scan(list(bases), tuple(cells), ScoreTest(whitened), tuple(whitened), known)


def locate(
    scan: Scan, signal: Array, base: Array, p: float, share: float, names: Sequence[str] = CHANNELS
) -> tuple[Location, ...]:
    """Where a signal (C n,) of readings on the named channels, whitened and outside of the base space, sits."""
    rows = signal.reshape(len(names), -1)
    parts = [slice(c * rows.shape[1], (c + 1) * rows.shape[1]) for c in range(len(names))]
    sought = followed(scan, signal, parts, base)
    if sought is None:
        return ()
    channels, chosen = sought
    assert isinstance(chosen, Basis)
    return (
        Location(
            channels=tuple(names[c] for c in channels),
            covariate=chosen.covariate,
            intervals=intervals(chosen.covariate, chosen.along, np.sum(rows[channels] ** 2, axis=0)),
            harmonic=_harmonic(chosen, rows[channels]),
            share_of_misfit=share,
            p=p,
        ),
    )


def locate_whole(
    scan: Scan, cells: Sequence[Cells], white: Callable[[Array], Array], residual: Array, base: Array, signal: Array
) -> tuple[list[int], str, tuple[tuple[float, float], ...], int | None] | None:
    """Channels, covariate, intervals and harmonic of a mismatch of poses that nothing has a name for.

    `residual`, and `signal`, what of it chance does not explain (3 n,), whitened and outside of `base`; `white` takes
    (k, 3, n) to (k, 3 n). A range of one covariate in which anything may be is preferred to functions of more.
    """
    n = residual.size // 3
    parts = [slice(c * n, (c + 1) * n) for c in range(3)]

    def windows(channels: list[int]) -> list[Window]:
        return [support(one, *products(white(_each(one, channels)), residual, base)) for one in cells]

    sought = followed(scan, signal, parts, base, windows)
    if sought is None:
        return None
    channels, chosen = sought
    if isinstance(chosen, Window):
        return channels, chosen.covariate, chosen.intervals, None
    assert isinstance(chosen, Basis)
    rows = signal.reshape(3, -1)[channels]
    energy = np.sum(rows**2, axis=0)
    return channels, chosen.covariate, intervals(chosen.covariate, chosen.along, energy), _harmonic(chosen, rows)


def _each(cells: Cells, channels: Sequence[int]) -> Array:
    """(B k, 3, n): each cell on each of k channels."""
    functions = cells.functions()
    columns = np.zeros((cells.count, len(channels), 3, functions.shape[1]))
    for k, channel in enumerate(channels):
        columns[:, k, channel] = functions
    return columns.reshape(-1, 3, functions.shape[1])


def products(columns: Array, residual: Array, base: Array) -> tuple[Array, Array, Array]:
    """Inner products (K, K), (K,) of whitened columns outside of a base, and their squared lengths before, (K,)."""
    bare = outside(base, columns)
    return bare @ bare.T, bare @ residual, np.sum(columns**2, axis=1)


def pose_cells(state: ChainState) -> list[Cells]:
    """The covariates of a session of poses that a mismatch may have a range of."""
    found = []
    for covariate, along, count in (
        (TOOLFACE, np.mod(np.degrees(state.tf_rad), 360.0), SUPPORT.cells),
        ("inc_ref_deg", np.degrees(state.inc_rad), SUPPORT.cells),
        ("temp_c", np.asarray(state.temp_c), SUPPORT.cells),
        ("t_s", np.asarray(state.t_s), PLACES.time_cells),
    ):
        if np.ptp(along) > 0:
            found.append(cells_of(covariate, along, circular=covariate == TOOLFACE, count=count))
    return found


def followed(
    scan: Scan,
    signal: Array,
    parts: Sequence[slice],
    base: Array,
    windows: Callable[[list[int]], Sequence[Window]] | None = None,
) -> tuple[list[int], Located | Window] | None:
    """The channels that a whitened signal sits on, and the covariate it follows; `parts` are the channels' numbers.

    The covariate is the simplest one that explains nine tenths of what the best explains; `windows` gives, for the
    channels, the ranges of covariates that may stand in place of functions.
    """
    by_channel = np.array([float(np.sum(signal[part] ** 2)) for part in parts])
    total = float(by_channel.sum())
    if total <= 0:
        return None
    channels = [c for c in range(len(parts)) if by_channel[c] > PLACES.channel_share * by_channel.max()]
    ranges = list(windows(channels)) if windows is not None else []
    explained, sizes = np.zeros(len(scan.bases)), np.full(len(scan.bases), np.inf)
    for k in range(len(scan.bases)):
        own = [scan.white[i] for i, (c, b) in enumerate(scan.cells) if b == k and c in channels]
        if own:
            explained[k] = float(np.sum((span(outside(base, np.vstack(own))) @ signal) ** 2))
            sizes[k] = len(own) * len(own[0])
    every: list[Located | Window] = [*scan.bases, *ranges]
    explained = np.concatenate([explained, [max(w.gain - w.dof, 0.0) for w in ranges]])
    sizes = np.concatenate([sizes, [float(w.dof) if w.dof else np.inf for w in ranges]])
    good = np.flatnonzero(explained >= PLACES.explained * explained.max())
    return channels, every[int(good[np.argmin(sizes[good])])]


def _harmonic(basis: Basis, signal: Array) -> int | None:
    """The harmonic of the toolface that carries most of a signal (channels, n)."""
    if not basis.harmonics:
        return None
    power = (signal @ basis.functions.T) ** 2
    by_order = power.sum(axis=0).reshape(-1, 2).sum(axis=1)
    return basis.harmonics[int(np.argmax(by_order))]


def intervals(
    covariate: str, along: Array, energy: Array, count: int = SUPPORT.cells
) -> tuple[tuple[float, float], ...]:
    """Ranges of a covariate (n,) where the mean energy (n,) is above a quarter of its largest."""
    cells = cells_of(covariate, along, circular=covariate == TOOLFACE, count=count)
    rows = np.bincount(cells.of, minlength=cells.count)
    mean = np.bincount(cells.of, energy, minlength=cells.count) / np.maximum(rows, 1)
    # a cell without rows is like its neighbour
    filled = np.maximum.accumulate(np.where(rows > 0, np.arange(cells.count), 0))
    return runs(cells, (mean > PLACES.ranged * mean.max())[filled])
