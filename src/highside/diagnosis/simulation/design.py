"""The columns of a recording beside another program's prediction: effects, unnamed products, locating groups.

As `design`, with everything at hand as rows: what is compared is short enough for that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate, Unobservable, Variant
from highside.diagnosis.rows.bases import BasisGroup
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.spectrum import strongest_line
from highside.diagnosis.simulation.policy import SIMULATION_COLUMNS
from highside.diagnosis.simulation.session import SimulationSession
from highside.physics.channels import ChannelEffect, ChannelTerm, OnChannels, kind_of
from highside.physics.effect import Effect, Stage
from highside.physics.effects import on_channels, registry
from highside.physics.effects.tone import EFFECT as TONE

Ints = NDArray[np.intp]

About = Mapping[str, tuple[float, ...]]
"""where effects that are not linear are taken: the values of their parameters, by id; empty at nothing"""


def acting(session: SimulationSession, about: About) -> list[tuple[OnChannels, ChannelTerm]]:
    """The effects of the library that may act on these channels, with what each may have done, in the order tried."""
    channels = session.about(about).as_channels(about)
    terms = [(effect, term) for effect in on_channels() for term in effect.on_channels(channels)]
    return [(OnChannels(effect, term), term) for effect, term in sorted(terms, key=lambda pair: pair[1].place)]


class SimulationDesign(Design):
    """The columns of a session beside a base of the effects `free`, which are adjusted anyway."""

    session: SimulationSession

    def __init__(self, session: SimulationSession, free: Sequence[str], about: About) -> None:
        session = session.about(about)
        super().__init__(session, free)
        self.about = about
        self._rows: list[list[Array]] = [[] for _ in session.names]
        self.tangents: dict[str, Ints] = {}
        """Of effects that move the clock the columns by which they are fitted"""
        self._add_effects(session)
        self._add_products(session)
        self._add_line(session)
        self.groups = _groups(session)
        for b, functions in enumerate(_functions(session)):
            for c in range(len(session.names)):
                self.cell_of.append((c, b))
                self.cells.append(np.array([self._put_on(c, f) for f in functions], dtype=np.intp))
        self.where = np.array(self._columns)
        self.sizes = [len(rows) for rows in self._rows]
        self._stacked = [np.stack(rows) for rows in self._rows]

    def _add_effects(self, session: SimulationSession) -> None:
        """The base, the effects of the library that may act on these channels, and why others cannot be seen."""
        base: list[int] = []
        shown: set[str] = set()
        too_small: list[str] = []
        scatter = np.maximum((session.readings - session.original).std(axis=1), 1e-12)
        for effect, term in acting(session, self.about):
            if term.tangents is not None:
                self.tangents[effect.id] = np.array([self._put(column) for column in term.tangents], dtype=np.intp)
            if term.adjusted:
                base += [number for number in self.tangents[effect.id].tolist() if number >= 0]
                continue
            shown.add(effect.id)
            tried = [self._put_visible(effect, columns, scatter) for columns in term.columns]
            if effect.id in self.free:
                base += [number for number in tried[0] if number >= 0]
                continue
            variants = _variants(effect, tried)
            names = tuple(p.name for p in effect.parameters)
            if variants:
                self.candidates.append(Candidate(effect.id, effect, names, tuple(variants)))
            else:
                too_small.append(effect.id)
        self.base = np.array(base, dtype=np.intp)
        absent = [e for e in on_channels() if e.channel_needs and e.id not in shown]
        # what was not recorded first, then what the alignment of the two has taken away
        absent.sort(key=lambda effect: (effect.stage is Stage.TIMING, isinstance(effect, ChannelEffect)))
        self.unobservable = [Unobservable(OnChannels(e), e.channel_needs) for e in absent]
        small = "even the largest size that is plausible would not show in this recording"
        self.unobservable += [Unobservable(OnChannels(registry()[name]), small) for name in too_small]

    def _add_line(self, session: SimulationSession) -> None:
        """The strongest line of fixed frequency in what all effects leave: a filter that learns the noise would take it
        for colour."""
        kept = np.ones(session.n) if session.omitted is None else 1.0 - session.omitted
        left = np.empty_like(session.readings)
        for c, made in enumerate(self._rows):
            rows = np.vstack([np.ones(session.n), *made]) * kept
            rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
            target = (session.readings[c] - session.original[c]) * kept
            left[c] = target - np.linalg.lstsq(rows.T, target, rcond=1e-9)[0] @ rows
        size = left.std(axis=1, keepdims=True)
        shown = size[:, 0] > SIMULATION_COLUMNS.nothing
        found = strongest_line(left[shown] / size[shown], session.places) if shown.any() else None
        if found is None or TONE.id in self.free:
            return
        hz = found / session.step_s
        channels = session.as_channels({**self.about, TONE.id: (hz,)})
        (term,) = TONE.on_channels(channels)
        effect = OnChannels(TONE, term)
        tried = [[self._put(column) for column in columns] for columns in term.columns]
        variants = [replace(v, shape={"f": hz}) for v in _variants(effect, tried)]
        names = tuple(p.name for p in effect.parameters)
        searched = max(session.n // 2, 1)
        self.candidates.append(Candidate(effect.id, effect, names, tuple(variants), searched=searched))

    def _put_visible(self, effect: Effect, columns: Array, scatter: Array) -> list[int]:
        """Numbers of columns (k, C, n); -1 for those that even at the largest plausible size are small beside the
        scatter (C,) of the readings."""
        limits = np.array([max(abs(g) for g in p.gate) for p in effect.parameters])
        size = limits * np.linalg.norm(columns / scatter[:, None], axis=(1, 2))
        return [
            self._put(column if s > SIMULATION_COLUMNS.marginal else np.zeros_like(column))
            for column, s in zip(columns, size, strict=True)
        ]

    def functions(self, part: slice, below: Array | None = None, only: Sequence[Ints] | None = None) -> list[Array]:
        """As those of a `Design`."""
        made = [r[:, part] if only is None else r[only[c]][:, part] for c, r in enumerate(self._stacked)]
        return made if below is None else [np.vstack([m, below[c : c + 1, part]]) for c, m in enumerate(made)]

    def effect_of(self, number: int) -> Effect:
        """The effect of a candidate."""
        effect = self.candidates[number].effect
        assert effect is not None
        return effect

    def column(self, number: int) -> Array:
        """(C, n) what a column adds to the readings."""
        return self.readings_of(number, 1.0, slice(0, self.session.n))

    def _put(self, column: Array) -> int:
        """Number of a column (C, n); -1 for one that is nothing."""
        shows = np.max(np.abs(column), axis=1) > SIMULATION_COLUMNS.nothing
        if not shows.any():
            return -1
        own = np.full(len(self._rows), -1, dtype=np.intp)
        for c in np.flatnonzero(shows):
            own[c] = len(self._rows[c])
            self._rows[c].append(column[c])
        return self._add(own)

    def _put_on(self, channel: int, function: Array) -> int:
        column = np.zeros((len(self._rows), function.size))
        column[channel] = function
        return self._put(column)

    def _add_products(self, session: SimulationSession) -> None:
        """Unnamed products, so that they are not given the name of the nearest effect."""
        scaled = [s / max(float(np.abs(s).max()), 1e-12) for s in session.predicted]
        u = np.linspace(-1.0, 1.0, session.n)
        tables: dict[str, dict[str, Array]] = {
            "time": {n: u * s for n, s in zip(session.names, scaled, strict=True)},
            "prediction": {
                f"{session.names[i]} {session.names[j]}": scaled[i] * scaled[j]
                for i in range(len(scaled))
                for j in range(i, len(scaled))
            },
        }
        for name, terms in tables.items():
            variants = []
            for c in range(len(session.names)):
                own = f"{session.names[c]} {session.names[c]}"
                named = kind_of(session.names[c], session.units[c]) == "accel"
                for label, term in terms.items():
                    # of an acceleration the square of its own is an effect of the library
                    number = -1 if named and label == own else self._put_on(c, term)
                    if number >= 0:
                        variants.append(
                            Variant({}, np.array([number]), f"{name} x {label} on {session.names[c]}", whole=True)
                        )
            if variants:
                self.candidates.append(Candidate(f"interaction:{name}", None, ("a",), tuple(variants)))


def _variants(effect: Effect, tried: Sequence[Sequence[int]]) -> list[Variant]:
    """The parts of an effect that may act alone, of each set of its columns, where one shows."""
    variants = []
    for numbers in tried:
        for part in effect.parts:
            own = np.array([numbers[k] for k in part], dtype=np.intp)
            if np.any(own >= 0):
                variants.append(Variant({}, own, whole=len(part) == len(numbers)))
    return variants


def _covariates(session: SimulationSession) -> list[tuple[str, Array, list[Array], bool]]:
    """Name, values, functions, and whether it is slow."""
    found: list[tuple[str, Array, list[Array], bool]] = []
    for name, s in zip(session.names, session.predicted, strict=True):
        x = (s - s.mean()) / max(float(s.std()), 1e-12)
        found.append((name, s, [x, x**2, x**3], False))
    for axis, rate in session.rates.items():
        x = rate / max(float(rate.std()), 1e-12)
        found.append((f"g{axis}_dps", np.degrees(rate), [x, np.abs(x), x * x], False))
    if session.speed is not None:
        x = (session.speed - session.speed.mean()) / max(float(session.speed.std()), 1e-12)
        found.append(("speed_mps", session.speed, [x, x * x], False))
    if session.warm:
        t = session.state.temp_c
        x = (t - t.mean()) / t.std()
        found.append(("temp_c", t, [x, x * x, x**3], True))
    u = np.linspace(0.0, 1.0, session.n)
    found.append(
        ("t_s", session.state.t_s, [np.cos(np.pi * k * u) for k in range(1, SIMULATION_COLUMNS.time_waves + 1)], True)
    )
    return found


def covariates_of(session: SimulationSession) -> dict[str, Array]:
    """(n,) what residuals can be drawn over."""
    return {name: along for name, along, _, _ in _covariates(session)}


def _groups(session: SimulationSession) -> list[BasisGroup]:
    return [BasisGroup(name, along, lambda _: [], (), slow) for name, along, _, slow in _covariates(session)]


def _functions(session: SimulationSession) -> list[list[Array]]:
    return [functions for _, _, functions, _ in _covariates(session)]
