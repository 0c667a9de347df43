"""The groups of smooth functions that are tried: place x covariate, pairs of covariates, shapes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.policy import LAW_GROUPS
from highside.diagnosis.laws.problem import LawProblem, PlaceField, functions_of
from highside.physics.covariates import COVARIATES, FILTERED, joined, lag_of
from highside.physics.effect import AXES
from highside.physics.law import Axis
from highside.physics.law_functions import Function
from highside.physics.places import PLACES

ANGLES = frozenset({"inclination", "toolface", "level", "timing"})
"""places that act on where the tool is, not on a sensor"""
SET_ANGLES = frozenset({"inclination", "toolface"})
"""of these the ones that a bench bends under a load"""
HISTORY = ("time_since_move", "previous_load")
LAGGING = ("temp_filtered_300", "temp_filtered_1200")
"""the temperatures that lag of which every place is tried; the time constant of one that is found is then estimated"""
PAIRED = (
    ("load", "temp"),
    ("load", "time"),
    ("load", "rate"),
    ("load", "vibration"),
    ("load", "previous_load"),
    ("load", "time_since_move"),
    ("inc", "tf"),
    ("inc", "temp"),
    ("inc", "time"),
    ("inc", "rate"),
    ("tf", "temp"),
    ("tf", "time"),
    ("tf", "rate"),
    ("tf", "rate_sign"),
    ("temp", "time"),
    ("temp", "rate"),
    ("temp", "temp_rate"),
    ("temp", "time_since_move"),
    ("rate", "acceleration"),
    ("rate", "vibration"),
    ("load_x", "load_y"),
    ("load_y", "load_z"),
    ("load_x", "load_z"),
    ("load_x", "temp"),
    ("load_y", "temp"),
    ("load_z", "temp"),
)
"""Pairs of covariates whose products are tried, where a session does not ask for every pair."""
SETS_IN = ("step", "ramp", "decay")
"""functions that begin at some value"""
WAVE = ("sine", "cosine_of")
"""functions of one period"""
ONE_QUANTITY = (
    frozenset({"tf", "tf_fraction"}),
    frozenset({"inc", "load_z"}),
    frozenset(FILTERED),
)
"""covariates of which no two make a product: they are one quantity"""


@dataclass(frozen=True, eq=False)
class LawGroup:
    """Places that act alike with the same functions: one prior for all."""

    units: tuple[PlaceField, ...]
    axes: tuple[Axis, ...]
    order: Array
    """(m,) order of each function, of which the prior's variance falls"""
    basis: Array
    """(u, m, n) the functions for each unit"""
    tries: float = 1
    """how many like it are tried side by side: places of a step, centres of a dent"""
    effect: str = ""
    """id of the library's effect whose columns these are; empty for a law"""

    @property
    def place(self) -> str:
        """Name of the place."""
        return self.units[0].place

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Names of the covariates."""
        return tuple(axis.covariate for axis in self.axes)

    @property
    def label(self) -> str:
        """Place, channels and covariates in one word."""
        return f"{self.place}_{''.join(u.channel for u in self.units)}_{joined(self.depends_on)}"

    @property
    def kind(self) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
        """What is reported of it: place, channels, covariates."""
        return self.place, tuple(u.channel for u in self.units), tuple(sorted(self.depends_on))

    @cached_property
    def channels(self) -> tuple[int, ...]:
        """Channels that it acts on."""
        if len(self.units) == 1:
            return self.units[0].channels
        return tuple(sorted({channel for unit in self.units for channel in unit.channels}))

    @cached_property
    def orders(self) -> Array:
        """(u m,) order of each column."""
        return self.order if len(self.units) == 1 else np.tile(self.order, len(self.units))

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(self.units) * int(self.order.size)

    def columns(self, out: Array | None = None) -> Array:
        """(u m, c, n) what one unit of each coefficient does to the channels that it acts on; in `out` where that is
        given."""
        ch, n = list(self.channels), self.basis.shape[-1]
        made = np.empty((self.size, len(ch), n)) if out is None else out
        for i, (unit, basis) in enumerate(zip(self.units, self.basis, strict=True)):
            np.multiply(basis[:, None], unit.field[None, ch], out=made[i * len(basis) : (i + 1) * len(basis)])
        return made


class Bases:
    """What the groups of many places have in common: which covariates vary there, and the functions of them."""

    def __init__(self, problem: LawProblem) -> None:
        self.problem = problem
        self._varying: dict[tuple[str, int], list[tuple[str, Array, int]]] = {}
        self._of_time: dict[int, list[Array]] = {}  # by the list of axes
        self._of: dict[tuple[tuple[Axis, ...], tuple[int, ...]], Array] = {}

    def varying(self, units: tuple[PlaceField, ...]) -> list[tuple[str, Array, int]]:
        """Names, values and number of distinct values of the covariates that vary."""
        key = units[0].place, units[0].own
        if key not in self._varying:
            self._varying[key] = list(varying(self.problem, units))
        return self._varying[key]

    @cached_property
    def in_time(self) -> list[Axis]:
        """Steps, ramps and decays in time."""
        t = self.problem.covariates["time"]
        edges = np.unique(t)
        middle = (edges[1:] + edges[:-1]) / 2
        knots = middle[np.unique(np.linspace(0, middle.size - 1, LAW_GROUPS.steps).astype(int))]
        low, high = float(t.min()), float(t.max())
        shapes = [Function("step", (float(at),)) for at in knots]
        shapes += [Function("ramp", (float(at),)) for at in knots[1:]]
        shapes += [Function("decay", (float(at), s * (high - low))) for at in (low, *knots) for s in LAW_GROUPS.decays]
        return [Axis("time", low, high, (shape,)) for shape in shapes]

    @cached_property
    def waves(self) -> list[Axis]:
        """Waves of time, from those of a few turns to those that a pose averages away."""
        t = self.problem.covariates["time"]
        low, high = float(t.min()), float(t.max())
        counts = LAW_GROUPS.wave_step * np.arange(LAW_GROUPS.waves) + LAW_GROUPS.first_wave
        periods = (high - low) / counts[counts <= LAW_GROUPS.a_value * np.unique(t).size]
        return [Axis("time", low, high, wave_of(float(period))) for period in periods]

    def of_time(self, units: tuple[PlaceField, ...], axes: list[Axis]) -> Iterator[LawGroup]:
        """The shapes in time, or the waves, in a place: their functions (1, m, n) are the same in every place."""
        if id(axes) not in self._of_time:
            self._of_time[id(axes)] = [product_of(self.problem, units[:1], (axis,)) for axis in axes]
        order = np.zeros(len(axes[0].functions)) if axes else np.empty(0)
        for axis, basis in zip(axes, self._of_time[id(axes)], strict=True):
            yield LawGroup(units, (axis,), order, _for_each(units, basis), len(axes))

    def group(self, units: tuple[PlaceField, ...], axes: tuple[Axis, ...], order: Array, tries: float = 1) -> LawGroup:
        """The functions of axes in a place; units that know the same values share them."""
        differs = any(self.problem.covariates[axis.covariate].ndim == 2 for axis in axes)
        key = axes, tuple(unit.own if differs else -1 for unit in units)
        if key not in self._of:
            made = product_of(self.problem, units if differs else units[:1], axes)
            self._of[key] = _for_each(units, made)
        return LawGroup(units, axes, order, self._of[key], tries)


def _for_each(units: tuple[PlaceField, ...], basis: Array) -> Array:
    """(u, m, n) functions (u or 1, m, n) for each of the units."""
    return basis if len(basis) == len(units) else np.broadcast_to(basis, (len(units), *basis.shape[1:]))


def wave_of(period: float) -> tuple[Function, ...]:
    """A sine and a cosine of one period."""
    return tuple(Function(kind, (period,)) for kind in WAVE)


def is_wave(axis: Axis) -> bool:
    """Whether it is a sine and a cosine of one period."""
    return tuple(function.kind for function in axis.functions) == WAVE


def groups_of(problem: LawProblem) -> list[LawGroup]:
    """All that is tried."""
    found: list[LawGroup] = []
    bases = Bases(problem)
    for units in each_place(problem.places):
        if any(unit.channels for unit in units):
            found += _singles(units, bases)
            found += _pairs(units, bases)
            found += _shapes(units, bases)
    if problem.every_pair:
        found += _of_all_axes(bases)
    return found


def each_place(places: tuple[PlaceField, ...]) -> list[tuple[PlaceField, ...]]:
    """Each place and channel by itself, but for those that do what one before them does; the two angles of the level
    together as well."""
    level = tuple(p for p in places if p.place == "level")
    alone = [p for i, p in enumerate(places) if not any(same_angle(p, other) for other in places[:i])]
    return [*((p,) for p in alone), *([level] if len(level) > 1 else [])]


def same_angle(one: PlaceField, other: PlaceField) -> bool:
    """Whether two places of angles do the same: a lean about the axis of the inclination is an error of that."""
    return (
        one.place in ANGLES
        and other.place in ANGLES
        and one is not other
        and bool(np.allclose(one.field, other.field, rtol=0.0, atol=LAW_GROUPS.distinct * np.abs(one.field).max()))
    )


def _fits(place: str, name: str, tilts: bool) -> bool:
    """Whether a covariate is one that a place may follow; `tilts`: the inclination varies."""
    loads = name.startswith("load")
    if place in SET_ANGLES and name in ("load_x", "load_y"):
        # at one inclination that is the toolface's first order; a load on z is the inclination's cosine
        return tilts
    if place == "offset" or place.startswith("channel"):
        return True
    if place in ("scale", "matrix", "scale_all"):
        return not loads and name not in HISTORY[1:]
    if place in ANGLES:
        return not loads or name == "previous_load"
    return True


def values_of(problem: LawProblem, name: str, unit: PlaceField) -> Array:
    """(n,) a covariate as a unit knows it."""
    values = problem.covariates[name]
    return values[unit.own] if values.ndim == 2 else values


def varying(problem: LawProblem, units: tuple[PlaceField, ...]) -> Iterator[tuple[str, Array, int]]:
    """Names, values and number of distinct values of the covariates that vary."""
    unit = units[0]
    tilts = "inc" in problem.covariates and float(np.ptp(problem.covariates["inc"])) > 0.0
    for name, every in problem.covariates.items():
        if not _fits(unit.place, name, tilts) or (every.ndim == 2 and unit.own < 0):
            continue
        if lag_of(name) and name not in LAGGING:
            continue
        if unit.own >= 0 and name == "load_" + "xyz"[unit.own]:
            continue
        values = values_of(problem, name, unit)
        if float(np.ptp(values)) > LAW_GROUPS.constant * max(float(np.abs(values).max()), 1.0):
            yield name, values, distinct_of(values)


def distinct_of(values: Array) -> int:
    """How many values of a covariate (n,) are not the same."""
    return int(np.unique(np.round(values / (LAW_GROUPS.distinct * max(float(np.ptp(values)), 1e-300)))).size)


def product_of(problem: LawProblem, units: tuple[PlaceField, ...], axes: Sequence[Axis]) -> Array:
    """(u, m, n) the products of all functions of the axes, for each unit."""
    made = []
    for unit in units:
        result = functions_of(problem.covariates, axes[0], unit.own)
        for axis in axes[1:]:
            own = functions_of(problem.covariates, axis, unit.own)
            result = (result[:, None] * own[None]).reshape(-1, own.shape[1])
        made.append(result)
    return np.stack(made)


def axis_of(name: str, values: Array, count: int, *, constant: bool, turns: int) -> tuple[Axis, Array]:
    """The axis of a covariate with so many functions, and the order (m,) of each."""
    known = COVARIATES.get(name)
    zero = [Function("one")] if constant else []
    if known is not None and known.periodic:
        functions = [Function(kind, (float(k),)) for k in range(1, turns + 1) for kind in ("cos", "sin")]
        orders = [0.0] * len(zero) + [float(k) for k in range(1, turns + 1) for _ in range(2)]
        return Axis(name, 0.0, 360.0, (*zero, *functions)), np.array(orders)
    # cosines over the range visited have no slope at its ends, which a curve has
    smooth = (*zero, *(Function("wide_cosine", (float(k),)) for k in range(1, count + 1)))
    axis = Axis(name, float(values.min()), float(values.max()), smooth)
    return axis, np.array([0.0] * len(zero) + [float(k) for k in range(1, count + 1)])


def _singles(units: tuple[PlaceField, ...], bases: Bases) -> Iterator[LawGroup]:
    constant = PLACES[units[0].place].constant
    for name, values, distinct in bases.varying(units):
        if name == "tf_fraction":
            continue
        count = min(LAW_GROUPS.cosines, distinct - 1)
        turns = min(LAW_GROUPS.orders, max(1, distinct // 2))
        axis, order = axis_of(name, values, count, constant=constant, turns=turns)
        yield bases.group(units, (axis,), order, len(FILTERED) if lag_of(name) else 1)


def _of_all_axes(bases: Bases) -> Iterator[LawGroup]:
    """Offsets of all three axes that follow one quantity, each in its own way: what acts on the whole triad. Three laws
    of one axis each would be found one by one, and a lean of the bench that does most of the three before them."""
    units = tuple(p for p in bases.problem.places if p.place == "offset")
    if len(units) < len(AXES):
        return
    for group in _singles(units, bases):
        if not group.depends_on[0].startswith("load"):
            yield group
    yield from _in_time(units, bases)


def _pairs(units: tuple[PlaceField, ...], bases: Bases) -> Iterator[LawGroup]:
    every_pair = bases.problem.every_pair
    if units[0].place in ("matrix", "timing") and not every_pair:
        return
    if every_pair and len(units) > 1:
        # each angle by itself is tried
        return
    known = {name: (values, distinct) for name, values, distinct in bases.varying(units)}
    if every_pair:
        names = [name for name in known if name != "tf_fraction" and name != LAGGING[0]]
        pairs = [pair for pair in combinations(names, 2) if not any(one.issuperset(pair) for one in ONE_QUANTITY)]
    else:
        listed = (*PAIRED, *((name, "temp") for name in known if name not in COVARIATES))
        pairs = [pair for pair in listed if known.keys() >= set(pair)]
    tries = max(LAW_GROUPS.pairs, len(pairs))
    for pair in pairs:
        yield product_group(units, pair, known, bases, tries)


def product_group(
    units: tuple[PlaceField, ...],
    pair: tuple[str, str],
    known: dict[str, tuple[Array, int]],
    bases: Bases,
    tries: float,
) -> LawGroup:
    """A smooth function of two covariates in a place; `known`: values (n,) and number of distinct values of each."""
    made = []
    for name in pair:
        values, distinct = known[name]
        count = min(LAW_GROUPS.pair_orders - 1, distinct - 1)
        turns = min(LAW_GROUPS.pair_turns, max(1, distinct // 2))
        made.append(axis_of(name, values, count, constant=True, turns=turns))
    (first, k), (second, j) = made
    return bases.group(units, (first, second), np.hypot(k[:, None], j[None]).reshape(-1), tries)


def _shapes(units: tuple[PlaceField, ...], bases: Bases) -> Iterator[LawGroup]:
    """Steps, ramps and decays in time, dents in toolface, orders that are no whole numbers: one or two columns each."""
    if units[0].place in ("matrix", "timing"):
        return
    yield from _in_time(units, bases)
    known = {name: values for name, values, _ in bases.varying(units)}
    if "tf" in known:
        centres = np.arange(LAW_GROUPS.dents) * (360.0 / LAW_GROUPS.dents)
        dents = [Function("dent", (float(c), w)) for c in centres for w in LAW_GROUPS.dent_widths_deg]
        for shape in dents:
            yield bases.group(units, (Axis("tf", 0.0, 360.0, (shape,)),), np.zeros(1), len(dents))
    yield from _lines(units, known, bases)
    if "tf" in known:
        # each by itself, too: one order alone is likelier than the twelve together, and than its fractions
        for whole in range(1, LAW_GROUPS.orders + 1):
            yield _one_order(units, float(whole), None, bases, LAW_GROUPS.orders)
    if "tf_fraction" in known:
        for k in range(1, LAW_GROUPS.fractions):
            order = k * LAW_GROUPS.fraction_step
            if abs(order - round(order)) >= LAW_GROUPS.distinct:
                yield _one_order(units, order, known["tf_fraction"], bases, LAW_GROUPS.fractions)


def _in_time(units: tuple[PlaceField, ...], bases: Bases) -> Iterator[LawGroup]:
    """Steps, ramps and decays; of an offset in poses a wave."""
    if any(name == "time" for name, _, _ in bases.varying(units)):
        yield from bases.of_time(units, bases.in_time)
        if units[0].place == "offset" and bases.problem.every_pair:
            # over the rows of a rotation it is an effect of the library
            yield from bases.of_time(units, bases.waves)


def _lines(units: tuple[PlaceField, ...], known: dict[str, Array], bases: Bases) -> Iterator[LawGroup]:
    """Orders of the turn at which the readings have a line: on a channel that order, of an angle one more or less, as
    the load it acts on turns once."""
    near = {order + step for order in bases.problem.orders for step in (-1.0, 0.0, 1.0)}
    for order in sorted(near):
        whole = order == round(order)
        name = "tf" if whole else "tf_fraction"
        if name not in known or order <= 0 or (whole and order <= LAW_GROUPS.orders):
            continue
        yield _one_order(units, order, None if whole else known[name], bases, LAW_GROUPS.lines)


def _one_order(
    units: tuple[PlaceField, ...], order: float, fraction: Array | None, bases: Bases, tries: float
) -> LawGroup:
    """A cosine and a sine of one order of toolface: a whole one, or with `fraction` (n,) in deg one over its range."""
    both = tuple(Function(kind, (order,)) for kind in ("cos", "sin"))
    axis = Axis("tf", 0.0, 360.0, both)
    if fraction is not None:
        axis = Axis("tf_fraction", float(fraction.min()), float(fraction.max()), both)
    return bases.group(units, (axis,), np.zeros(2), tries)


def confounded(one: Array, other: Array, share: float) -> bool:
    """Whether a covariate (n,) is a smooth function of another in this session, or that of it."""
    return _explains(one, other) > share or _explains(other, one) > share


def one_quantity(one: Array, other: Array, share: float) -> bool:
    """Whether each of two covariates (n,) is a smooth function of the other in this session."""
    return min(_explains(one, other), _explains(other, one)) > share


def _explains(by: Array, what: Array) -> float:
    if not np.ptp(by) or not np.ptp(what):
        return 0.0
    u = np.pi * (by - by.min()) / np.ptp(by)
    basis = np.stack([np.cos(k * u) for k in range(min(LAW_GROUPS.cosines, by.size // 4) + 1)])
    left = what - np.linalg.lstsq(basis.T, what, rcond=None)[0] @ basis
    return 1.0 - float(left.var() / what.var())


def within_another(group: LawGroup, other: LawGroup) -> bool:
    """Whether a group is a dent of the place and the channels of another dent, no further from its centre than the
    wider of the two is wide."""
    own, its = dent_of(group), dent_of(other)
    if own is None or its is None or group.kind != other.kind:
        return False
    return abs((own[0] - its[0] + 180.0) % 360.0 - 180.0) <= max(own[1], its[1])


def dent_of(group: LawGroup) -> tuple[float, float] | None:
    """Centre and width in degrees of a group that is one dent."""
    if len(group.axes) != 1 or len(group.axes[0].functions) != 1:
        return None
    kind, numbers = group.axes[0].functions[0].kind, group.axes[0].functions[0].numbers
    return (numbers[0], numbers[1]) if kind == "dent" else None
