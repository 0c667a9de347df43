"""Channels beside another program's prediction of them, and how effects act there.

No forward model is at hand, only its output s on each channel. So what an effect may have done is a set of columns over
the rows, each with a parameter of its own:

    offset b; gain k s; cross-coupling m s_d; drift d t; temperature c (T - mean), k s (T - mean)
    sampled at t - t0 - eps t: -(t0 + eps t) ds/dt; first-order lag: (H_tau - 1) s
    lever arm: w x (w x r) + a x r; travel: k v w

The effects are those of the library: each says in `on_channels` what it does to which channels, if anything.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from highside.arrays import AnyArray
from highside.physics.parameter import Groups, Parameter
from highside.units import STANDARD_GRAVITY_MPS2

ANY = (-1e9, 1e9)
"""Gate of what has no size of its own: a channel may be of any unit."""
EACH, ACROSS, TIMED, SLOW, MOVED = range(5)
"""Families in the order in which effects are tried: of each channel, between channels, of time, slow, of motion."""


def kind_of(name: str, unit: str) -> str:
    """What a channel measures: "accel", "rate" or its unit."""
    if unit in ("g", "m/s2"):
        return "accel"
    return "rate" if unit in ("deg/s", "rad/s") else unit


@dataclass(frozen=True)
class ChannelTerm:
    """What an effect may do to channels: one parameter (gate, typical size and unit are the channel's) a column.

    `columns`, each (K, C, n), are one set, or one for each value tried of what is not linear. Terms are tried in the
    order of `place` (family, kind of channel, place within). `relinearised`: the columns are what the values in
    `Channels.about` do, in proportion, and are made anew about those that are fitted. `tangents` (K, C, n), where there
    are any: what a small change of those values does, by which they are fitted. `adjusted`: no finding here, but fitted
    beside all that is.
    """

    parameters: tuple[Parameter, ...]
    columns: tuple[AnyArray, ...]
    place: tuple[int, int, int]
    relinearised: bool = False
    tangents: AnyArray | None = None
    adjusted: bool = False
    groups: Groups = ()
    """parameters that may act alone, by their numbers; where none are given, each"""


@dataclass(frozen=True)
class Channels:
    """n rows of C channels: `readings` and `predicted` (C, n) in the `units` of the channels `names`.

    What else was recorded: `rates` {axis: (n,) rad/s}, `speed` (n,) m/s, `temp_c` (n,) C if it changes. `same_clock`:
    nothing was shifted to lay the two over one another. `about`: of effects that are not linear the values at which
    columns are wanted, by id. `predicted` is what the prediction says with the clock so moved, `slope` (C, n) its
    change per second, and `at(later_s)` what it says an equal time, or (n,) times, earlier than stamped.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    readings: AnyArray
    predicted: AnyArray
    t_s: AnyArray
    step_s: float
    rates: Mapping[str, AnyArray] = field(default_factory=dict)
    speed: AnyArray | None = None
    temp_c: AnyArray | None = None
    same_clock: bool = True
    about: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    slope: AnyArray = field(default_factory=lambda: np.empty((0, 0)))
    at: Callable[[AnyArray], AnyArray] = field(default=lambda later_s: np.empty((0, 0)))
    risen: Callable[[float], AnyArray] = field(default=lambda since_s: np.empty(0))
    """(n,) what a unit step becomes in these rows, so many seconds after the first of them"""
    in_time: int = 0
    """the channel by which the clock is told, where each has a delay of its own"""
    angular: Mapping[str, AnyArray] = field(default_factory=dict)
    """{axis: (n,) rad/s2} how fast the rates change"""
    through: Callable[[Callable[[AnyArray], AnyArray]], AnyArray] | None = None
    """a function of the predicted channels, (C, N) to (K, N), as these rows show it (K, n); None: of what they show"""

    @property
    def n(self) -> int:
        """Number of rows."""
        return self.t_s.size

    @property
    def later_s(self) -> AnyArray:
        """(n,) by how much the clock is taken to be moved."""
        (delay_s,), (rate,) = self.about.get("time_offset", (0.0,)), self.about.get("clock_skew", (0.0,))
        return np.asarray(delay_s + rate * (self.t_s - self.t_s[:1]))

    def made(self, function: Callable[[AnyArray], AnyArray]) -> AnyArray:
        """(K, n) what a function of the channels, (C, N) to (K, N), is of what is predicted."""
        return function(self.predicted) if self.through is None else self.through(function)

    def kinds(self) -> dict[str, list[int]]:
        """Channels by what they measure."""
        found: dict[str, list[int]] = {}
        for c, (name, unit) in enumerate(zip(self.names, self.units, strict=True)):
            found.setdefault(kind_of(name, unit), []).append(c)
        return found

    def others(self) -> Iterator[tuple[int, list[int]]]:
        """Kinds that are neither accelerations nor rates: their place among all kinds, and their channels."""
        for place, (kind, members) in enumerate(self.kinds().items()):
            if kind not in ("accel", "rate"):
                yield place, members

    def of_kind(self, kind: str) -> Iterator[tuple[int, list[int]]]:
        """As `others`, of one kind: once or never."""
        for place, (own, members) in enumerate(self.kinds().items()):
            if own == kind:
                yield place, members

    def on(self, rows: Sequence[tuple[int, AnyArray]]) -> AnyArray:
        """(k, C, n): each function on its channel."""
        columns = np.zeros((len(rows), len(self.names), self.n))
        for k, (c, function) in enumerate(rows):
            columns[k, c] = function
        return columns

    def accel_axes(self) -> dict[int, tuple[str, float]]:
        """Channels that are the acceleration of a named axis: which, and what 1 m/s2 is in their unit."""
        return {
            c: (name[1], 1.0 / STANDARD_GRAVITY_MPS2 if unit == "g" else 1.0)
            for c, (name, unit) in enumerate(zip(self.names, self.units, strict=True))
            if unit in ("g", "m/s2") and name[:1] == "a" and name[1:2] in "xyz" and name[2:3] == "_"
        }

    # -- what several effects are, on one kind of channels or another

    def offsets(self, place: int, members: Sequence[int]) -> ChannelTerm:
        """A constant on each."""
        limits = {"g": 0.3, "m/s2": 3.0, "deg/s": 20.0, "rad/s": 0.35}
        parameters = []
        for c in members:
            limit = limits.get(self.units[c], ANY[1])
            typical = max(0.01 * float(self.predicted[c].std()) or 1e-3, 1e-9)
            parameters.append(Parameter(f"b_{self.names[c]}", self.units[c], typical, (-limit, limit)))
        return ChannelTerm(tuple(parameters), (self.on([(c, np.ones(self.n)) for c in members]),), (EACH, place, 0))

    def gains(self, place: int, members: Sequence[int]) -> ChannelTerm:
        """A share of what is predicted on each."""
        parameters = tuple(Parameter(f"k_{self.names[c]}", "1", 0.01, (-0.5, 0.5)) for c in members)
        return ChannelTerm(parameters, (self.on([(c, self.predicted[c]) for c in members]),), (EACH, place, 1))

    def couplings(self, place: int, members: Sequence[int], unit: str) -> Iterator[ChannelTerm]:
        """A share of each on every other; none of a single one."""
        both = [(c, d) for c in members for d in members if c != d]
        if both:
            parameters = tuple(
                Parameter(f"m_{self.names[c]}_{self.names[d]}", unit, 3e-3, (-0.3, 0.3)) for c, d in both
            )
            yield ChannelTerm(parameters, (self.on([(c, self.predicted[d]) for c, d in both]),), (ACROSS, place, 0))


# -- linear systems on a channel


def lagged(values: AnyArray, step_s: float, tau: float) -> AnyArray:
    """(n,) what a first-order lag changes, for each second of its time constant."""
    return np.asarray((_through(values, step_s, lambda w: 1 / (1 + 1j * w * tau)) - values) / tau)


def changing(values: AnyArray, step_s: float, share: Callable[[Any], Any] = np.ones_like) -> AnyArray:
    """(n,) change per second, of each frequency, Hz, so much as `share` says. Of what has four rows a period a
    difference of neighbours would show 64 %."""
    return _through(values, step_s, lambda w: 1j * w * share(w / (2 * np.pi)))


def _through(values: AnyArray, step_s: float, response: Callable[[Any], Any]) -> AnyArray:
    """Values (n,) through a linear system, exact for what is sampled finely enough; both ends are turned over."""
    n = values.size
    reach = min(n - 1, max(64, n // 8))
    before = 2 * values[0] - values[reach:0:-1]
    after = 2 * values[-1] - values[-2 : -reach - 2 : -1]
    whole = np.concatenate([before, values, after])
    # what the two far ends differ by is no jump: a straight line is taken off, and follows by itself
    at = np.arange(whole.size)
    slope = (whole[-1] - whole[0]) / (whole.size - 1)
    line = whole[0] + slope * at
    omega = np.asarray(2 * np.pi * np.fft.rfftfreq(whole.size, step_s), dtype=float)
    gain = response(omega)
    gain = np.where(np.arange(omega.size) == omega.size - 1, gain.real, gain) if whole.size % 2 == 0 else gain
    turned = np.fft.irfft(np.fft.rfft(whole - line) * gain, whole.size)
    small = 1e-6
    at_rest = float(np.real(response(np.array([0.0], dtype=float))[0]))
    lateness = float(-np.imag(response(np.array([small]))[0]) / small)
    straight = at_rest * line - slope / step_s * lateness
    return np.asarray((turned + straight)[reach : reach + n])
