"""Where a mismatch sits: groups of smooth functions of each covariate on each channel, tested after the base fit.

A group is small on purpose (a harmonic series, a polynomial): it locates, it does not name. Products of covariates are
among them, because an interaction without a group of its own goes unseen or is taken for something else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.candidates import CHANNELS
from highside.diagnosis.regression import Race, outside, span
from highside.diagnosis.result import Location
from highside.physics.state import ChainState

Array = NDArray[np.float64]

HARMONICS = 8


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
    tf, inc, n = state.tf_rad, state.inc_rad, state.n
    tf_deg = np.mod(np.degrees(tf), 360.0)
    inc_deg = np.degrees(inc)
    x, y, z = force
    bases: list[Basis] = []

    def add(covariate: str, along: Array, functions: Sequence[Array], harmonics: tuple[int, ...] = ()) -> None:
        bases.append(Basis(covariate, np.asarray(along), np.stack(functions), harmonics))

    stations = np.unique(state.station).size
    orders = tuple(k for k in range(1, HARMONICS + 1) if 2 * k <= stations)
    if orders:
        add("tf_ref_deg", tf_deg, [f(k * tf) for k in orders for f in (np.cos, np.sin)], orders)
    rings = np.unique(state.ring).size
    if rings > 1:
        add("inc_ref_deg", inc_deg, [f(k * inc) for k in range(1, min(4, rings)) for f in (np.cos, np.sin)])
        if orders:
            add("inc_ref_deg x tf_ref_deg", inc_deg, [z * f(k * tf) for k in orders[:4] for f in (np.cos, np.sin)])
    square = [x * x, y * y, x * y, x * z, y * z]
    cubic = [x**3, y**3, z**3, x * x * y, x * x * z, y * y * z, x * y * z]
    add("gravity_direction", inc_deg, [*square, *cubic])
    if np.ptp(state.direction) > 0:
        d = np.asarray(state.direction)
        add("direction", d, [d])
        add("direction x tf_ref_deg", tf_deg, [d * np.cos(tf), d * np.sin(tf)])
        add("direction x gravity_direction", inc_deg, [d * z, *(d * term for term in square)])
    if np.ptp(state.temp_c) > 0.5:
        q = (state.temp_c - state.temp_c.mean()) / state.temp_c.std()
        add("temp_c", state.temp_c, [q, q**2, q**3])
        if orders:
            add("temp_c x tf_ref_deg", state.temp_c, [q * f(k * tf) for k in orders[:4] for f in (np.cos, np.sin)])
        add("temp_c x gravity_direction", state.temp_c, [q * x, q * y, q * z, *(q * term for term in square)])
    if np.ptp(state.vibration_rms_g) > 0:
        add("vibration_rms_g", state.vibration_rms_g, [state.vibration_rms_g, state.vibration_rms_g**2])
    u = (state.t_s - state.t_s[0]) / max(float(np.ptp(state.t_s)), 1e-9)
    add("t_s", state.t_s, [np.cos(np.pi * k * u) for k in range(1, max(2, min(7, n // 6)))])
    return bases


def on_channel(functions: Array, channel: int) -> Array:
    """(k, n) -> (k, 3, n) on one channel."""
    columns = np.zeros((functions.shape[0], 3, functions.shape[1]))
    columns[:, channel] = functions
    return columns


@dataclass(frozen=True)
class Scan:
    """All groups of a session, whitened: `cells` are (channel, basis) in the order of the race."""

    bases: list[Located]
    cells: tuple[tuple[int, int], ...]
    race: Race
    white: tuple[Array, ...]
    freedom: Array
    """(cells,) degrees of freedom that the noise is known with where a cell looks"""


def scan_of(
    bases: Sequence[Located], whitened: Sequence[Array], cells: Sequence[tuple[int, int]], freedom: Array | float
) -> Scan:
    """`whitened` are the groups (k, 3 n) of `cells`."""
    known = np.broadcast_to(np.asarray(freedom, dtype=float), (len(cells),))
    return Scan(list(bases), tuple(cells), Race(whitened), tuple(whitened), known)


def locate(scan: Scan, signal: Array, base: Array, p: float, share: float) -> tuple[Location, ...]:
    """Where a signal (3 n,) of poses, whitened and outside of the base space, sits."""
    rows = signal.reshape(3, -1)
    sought = followed(scan, signal, [slice(c * rows.shape[1], (c + 1) * rows.shape[1]) for c in range(3)], base)
    if sought is None:
        return ()
    channels, chosen = sought
    assert isinstance(chosen, Basis)
    return (
        Location(
            channels=tuple(CHANNELS[c] for c in channels),
            covariate=chosen.covariate,
            intervals=intervals(chosen.along, np.sum(rows[channels] ** 2, axis=0)),
            harmonic=_harmonic(chosen, rows[channels]),
            share_of_misfit=share,
            p=p,
        ),
    )


def followed(scan: Scan, signal: Array, parts: Sequence[slice], base: Array) -> tuple[list[int], Located] | None:
    """The channels that a whitened signal sits on, and the covariate it follows; `parts` are the channels' numbers.

    The covariate is the simplest one that explains nine tenths of what the best explains.
    """
    by_channel = np.array([float(np.sum(signal[part] ** 2)) for part in parts])
    total = float(by_channel.sum())
    if total <= 0:
        return None
    channels = [c for c in range(len(parts)) if by_channel[c] > 0.1 * by_channel.max()]
    explained, sizes = np.zeros(len(scan.bases)), np.full(len(scan.bases), np.inf)
    for k in range(len(scan.bases)):
        own = [scan.white[i] for i, (c, b) in enumerate(scan.cells) if b == k and c in channels]
        if own:
            explained[k] = float(np.sum((span(outside(base, np.vstack(own))) @ signal) ** 2)) / total
            sizes[k] = len(own[0])
    good = np.flatnonzero(explained >= 0.9 * explained.max())
    return channels, scan.bases[int(good[np.argmin(sizes[good])])]


def _harmonic(basis: Basis, signal: Array) -> int | None:
    """The harmonic of the toolface that carries most of a signal (channels, n)."""
    if not basis.harmonics:
        return None
    power = (signal @ basis.functions.T) ** 2
    by_order = power.sum(axis=0).reshape(-1, 2).sum(axis=1)
    return basis.harmonics[int(np.argmax(by_order))]


def intervals(along: Array, energy: Array, bins: int = 24) -> tuple[tuple[float, float], ...]:
    """Ranges of a covariate where the mean energy is above a quarter of its largest."""
    values = np.unique(np.round(along, 6))
    if values.size <= bins:
        edges = [(float(v), float(v)) for v in values]
    else:
        cuts = np.quantile(along, np.linspace(0, 1, bins + 1))
        edges = [(float(a), float(b)) for a, b in pairwise(cuts.tolist())]
    mean = np.array([
        float(energy[(along >= low - 1e-6) & (along <= high + 1e-6)].mean()) for low, high in edges
    ])  # fmt: skip
    found: list[tuple[float, float]] = []
    open_run = False
    for (low, high), one in zip(edges, mean, strict=True):
        if one < 0.25 * mean.max():
            open_run = False
        elif open_run:
            found[-1] = (found[-1][0], high)
        else:
            found.append((low, high))
            open_run = True
    return tuple(found)
