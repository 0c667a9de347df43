"""The columns of a recording beside another program's prediction: effects, unnamed products, locating groups.

As `design`, with everything at hand as rows: what is compared is short enough for that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate, Unobservable, Variant
from highside.diagnosis.core.policy import REGRESSION
from highside.diagnosis.core.regression import span
from highside.diagnosis.rows.bases import BasisGroup
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.spectrum import strongest_line
from highside.diagnosis.simulation.policy import SIMULATION_CHOICE, SIMULATION_COLUMNS
from highside.diagnosis.simulation.session import SimulationSession
from highside.physics.channel_effect import ChannelEffect, OnChannels
from highside.physics.channels import ChannelTerm, kind_of
from highside.physics.effect import Effect, Stage
from highside.physics.effects import on_channels, registry
from highside.physics.effects.bias_step import EFFECT as BIAS_STEP
from highside.physics.effects.bias_step import BiasStep
from highside.physics.effects.gyro_bias_step import EFFECT as GYRO_BIAS_STEP
from highside.physics.effects.tone import EFFECT as TONE

Ints = NDArray[np.intp]

TONE_SHAPE = next(p.name for p in TONE.parameters if p.line_over)

PREDICTED, SLOPE = "the prediction", "the change of the prediction"
"""What a factor and a delay act on, as covariates of a place."""

Without = Mapping[str, str]
"""effects that are no candidates, by id, each with the reason"""
NONE: Without = MappingProxyType({})
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

    def __init__(
        self,
        session: SimulationSession,
        free: Sequence[str],
        about: About,
        without: Without = NONE,
    ) -> None:
        session = session.about(about)
        super().__init__(session, free)
        self.about = about
        self.without = without
        """Effects that are no candidates, by id, with the reason"""
        self._rows: list[list[Array]] = [[] for _ in session.names]
        self.tangents: dict[str, Ints] = {}
        """Of effects that move the clock the columns by which they are fitted"""
        self._again: set[int] = set()
        """Columns of steps at instants beyond the first"""
        self._add_effects(session)
        self._add_products(session)
        self._add_line(session)
        for step in (BIAS_STEP, GYRO_BIAS_STEP):
            self._add_step(session, step)
        self.groups = _groups(session)
        for b, functions in enumerate(_functions(session)):
            for c in range(len(session.names)):
                self.cell_of.append((c, b))
                self.cells.append(np.array([self._put_on(c, f) for f in functions[c]], dtype=np.intp))
        self.where = np.array(self._columns)
        self.sizes = [len(rows) for rows in self._rows]
        self._stacked = [np.stack(rows) for rows in self._rows]
        again = self.where[sorted(self._again)].T if self._again else [np.empty(0, dtype=np.intp)] * len(self.sizes)
        self.before_noise = [np.setdiff1d(np.arange(n), own) for n, own in zip(self.sizes, again, strict=True)]
        """(m,) functions of each channel beside which the noise is learned: a step at one instant of a random walk is
        enough for it not to pass for colour, and more would take the random walk itself"""

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
            if effect.id in self.without:
                continue
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
        self.unobservable += [
            Unobservable(OnChannels(registry()[name]), why) for name, why in self.without.items() if name in shown
        ]

    def _left(self, session: SimulationSession) -> Array:
        """(C, n) what all effects leave of the readings; 0 in rows that are left out."""
        kept = _kept(session)
        left = np.empty_like(session.readings)
        for c in range(len(left)):
            target = (session.readings[c] - session.original[c]) * kept
            left[c] = target - (target @ self._space(c, kept).T) @ self._space(c, kept)
        return left

    def _space(self, channel: int, kept: Array) -> Array:
        """(r, n) orthonormal: what effects, an offset among them, do on a channel in the rows that are kept."""
        rows = np.vstack([np.ones(kept.size), *self._rows[channel]]) * kept
        rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
        return span(rows)

    def _add_line(self, session: SimulationSession) -> None:
        """The strongest line of fixed frequency in what all effects leave: a filter that learns the noise would take it
        for colour."""
        left = self._left(session)
        size = left.std(axis=1, keepdims=True)
        shown = size[:, 0] > SIMULATION_COLUMNS.nothing
        rows, step_s = _within_band(session, left[shown] / size[shown])
        found = strongest_line(rows, np.arange(rows.shape[1], dtype=float)) if shown.any() else None
        if found is not None and TONE.id not in self.free:
            self._add_found(session, TONE, [{TONE_SHAPE: found / step_s}], max(session.n // 2, 1))

    def _add_step(self, session: SimulationSession, effect: BiasStep) -> None:
        """The strongest step of the channels that an effect acts on, at the instants where it explains most: beside all
        effects, and beside those alone that explain more than it does."""
        kinds = session.as_channels(self.about).kinds()
        members = [c for kind, own in kinds.items() if effect.steps_on(kind) for c in own]
        if effect.id in self.free:
            return
        kept = _kept(session)
        instants: list[float] = []
        for spaces in ([self._space(c, kept) for c in members], [self._clearer(session, c, kept) for c in members]):
            best: tuple[float, float] | None = None
            for c, space in zip(members, spaces, strict=True):
                left = (session.readings[c] - session.original[c]) * kept
                left = left - (left @ space.T) @ space
                size = float(left.std())
                gain, at = _best_step(left, space, kept) if size > SIMULATION_COLUMNS.nothing else (0.0, 0)
                if gain > 0.0 and (best is None or gain / size**2 > best[0]):
                    best = gain / size**2, self._instant(session, left, space, kept, at)
            if best is not None and all(abs(best[1] - one) >= session.step_s for one in instants):
                instants.append(best[1])
        (epoch,) = (p.name for p in effect.parameters if p.epoch)
        self._add_found(session, effect, [{epoch: since_s} for since_s in instants], session.n)

    def _clearer(self, session: SimulationSession, channel: int, kept: Array) -> Array:
        """(r, n) orthonormal: of an offset and a channel's columns those that explain more than any step beside them.

        All columns together do most of what a step does, though each alone does little of it.
        """
        rows = np.vstack([kept, *self._rows[channel]]) * kept
        rows = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
        space = np.empty((0, kept.size))
        left = (session.readings[channel] - session.original[channel]) * kept
        for _ in range(SIMULATION_CHOICE.most_named):
            left = left - (left @ space.T) @ space
            bare = rows - (rows @ space.T) @ space
            norm = np.sum(bare**2, axis=1)
            gain = np.where(norm > REGRESSION.independent, (bare @ left) ** 2 / np.maximum(norm, 1e-300), 0.0)
            best = int(np.argmax(gain))
            if gain[best] <= _best_step(left, space, kept)[0]:
                break
            space = np.vstack([space, bare[best] / np.sqrt(norm[best])])
        return space

    @staticmethod
    def _instant(session: SimulationSession, left: Array, space: Array, kept: Array, row: int) -> float:
        """Seconds since the first row at which a step near a row explains most of what is left (n,)."""
        finer = np.arange(-SIMULATION_COLUMNS.finer, SIMULATION_COLUMNS.finer + 1) / SIMULATION_COLUMNS.finer
        tried = session.elapsed_s[row] + finer * session.step_s
        steps = np.stack([session.risen(float(t)) for t in tried]) * kept
        bare = steps - (steps @ space.T) @ space
        return float(tried[int(np.argmax((bare @ left) ** 2 / np.maximum(np.sum(bare**2, axis=1), 1e-9)))])

    def _add_found(
        self, session: SimulationSession, found: Effect, shapes: Sequence[dict[str, float]], searched: int
    ) -> None:
        """A candidate whose shape was searched, with each of those that were found."""
        variants: list[Variant] = []
        effect, tries = None, 0
        for shape in shapes:
            about = {**self.about, found.id: tuple(shape.values())}
            for term in found.on_channels(session.as_channels(about)):
                effect = OnChannels(found, term)
                tried = [[self._put(column) for column in columns] for columns in term.columns]
                if shape is not shapes[0]:
                    self._again |= {number for numbers in tried for number in numbers if number >= 0}
                own = [replace(v, shape=shape) for v in _variants(effect, tried)]
                # it was searched on each channel
                tries = max(tries, searched * max(len(own), 1))
                variants += own
        if effect is not None:
            names = tuple(p.name for p in effect.parameters)
            self.candidates.append(Candidate(effect.id, effect, names, tuple(variants), searched=tries))

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


def parts_of_amounts(design: SimulationDesign, amounts: Mapping[str, Sequence[tuple[int, float]]]) -> dict[str, Array]:
    """(C, n) what each effect does to the channels, by its id, of so much of each of its columns."""
    return {
        name: np.sum([amount * design.column(number) for number, amount in own], axis=0)
        for name, own in amounts.items()
        if own
    }


def _within_band(session: SimulationSession, rows: Array) -> tuple[Array, float]:
    """Rows (C, n) and their step as they would be had nothing been low-passed, in as few as hold the band: at the edge
    of a low-pass noise falls so steeply that what is just below it stands out of its neighbourhood like a line."""
    n, step_s = session.n, session.step_s
    last = int(SIMULATION_COLUMNS.line_band * session.band_hz * n * step_s)
    if not session.low_passed or 2 * last >= n or not last:
        return rows, step_s
    share = np.arange(last + 1) / (n * step_s) / session.band_hz
    # the low-pass of both sides, forwards and backwards, is a Butterworth filter of the fourth order
    waves = np.fft.rfft(rows, axis=1)[:, : last + 1] * (1 + share**SIMULATION_COLUMNS.steepness)
    return np.asarray(np.fft.irfft(waves, n=2 * last, axis=1)), n * step_s / (2 * last)


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


def _changing(session: SimulationSession) -> list[tuple[str, list[list[Array]]]]:
    """Of each channel's factor and delay how they may follow time: name, and functions of each channel, of what changes
    of the prediction, as an offset that follows time is another place."""
    u = np.linspace(0.0, 1.0, session.n)
    waves = [np.cos(np.pi * k * u) for k in range(1, SIMULATION_COLUMNS.factor_waves + 1)]
    fields = {f"t_s x {PREDICTED}": session.predicted, f"t_s x {SLOPE}": session.slope}
    return [
        (name, [[wave * (row - row.mean()) / max(float(np.std(row)), 1e-12) for wave in waves] for row in rows])
        for name, rows in fields.items()
    ]


def _groups(session: SimulationSession) -> list[BasisGroup]:
    found = [BasisGroup(name, along, lambda _: [], (), slow) for name, along, _, slow in _covariates(session)]
    return found + [BasisGroup(name, session.state.t_s, lambda _: [], ()) for name, _ in _changing(session)]


def _functions(session: SimulationSession) -> list[list[list[Array]]]:
    """Of each group, on each channel, its functions."""
    channels = range(len(session.names))
    found = [[functions for _ in channels] for _, _, functions, _ in _covariates(session)]
    return found + [functions for _, functions in _changing(session)]


def _best_step(left: Array, space: Array, kept: Array) -> tuple[float, int]:
    """What the best step explains of what a space (r, n) leaves (n,), and its row.

    Of steps at each row there counts what lies outside of the space, in the rows that are kept.
    """
    margin = max(2, round(SIMULATION_COLUMNS.margin * left.size))
    after = np.cumsum(space[:, ::-1], axis=1)[:, ::-1]
    bare = np.cumsum(kept[::-1])[::-1] - np.sum(after**2, axis=0)
    moment = np.cumsum(left[::-1])[::-1]
    gain = np.where(bare > SIMULATION_COLUMNS.least_step, moment**2 / np.maximum(bare, 1e-9), 0.0)
    gain[:margin] = gain[left.size - margin :] = 0.0
    at = int(np.argmax(gain))
    return float(gain[at]), at


def _kept(session: SimulationSession) -> Array:
    """(n,) 1 in the rows that are taken, 0 in those that are left out."""
    return np.ones(session.n) if session.omitted is None else np.asarray(1.0 - session.omitted, dtype=float)
