"""A law: physics without a name, learnt from a recording: `place x covariates -> smooth function`.

    value(channel, row) = sum over k of coefficient[channel, k] * product over axes of function_k(covariate(row))

An axis is a covariate (`covariates.COVARIATES`, or a numeric column's own name) with the range that was visited and
the functions of it; several axes stand for all products of their functions. What the value does in the chain the place
says (`places.PLACES`). A closed formula is the same with functions that have one (power, step, decay ...). Beyond the
range that was visited nothing is known: the value falls to 0, the mean of the prior, and `inside` says so. Functions
with coefficients of 0 are there for the covariance: the band of a law also holds the curves that its recording has as
well.

In a file (model file `[[laws]]`, `claims[].law` of `diagnosis.json`) a law is plain values:

    slug = "offset_x_temp"                      its effect is called `law:offset_x_temp`
    place = "offset"                            a name of `PLACES`
    channels = ["x"]                            of that place
    formula = "8e-05 (temp - 25)^2"             text, or "" for a curve
    coefficients = [[0.1, -0.2]]                one list for each channel, in the unit of the place
    covariance = [[1e-6, 0.0], [0.0, 1e-6]]     of all coefficients, channel by channel; may be omitted
    [[laws.axes]]
    covariate = "temp"
    low = 18.0                                  the range that was visited
    high = 61.0
    functions = [["cosine", 1], ["cosine", 2]]  names of `FUNCTIONS` with their numbers
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import AnyArray
from highside.errors import InputError
from highside.physics.covariates import COVARIATES, OWN, covariate
from highside.physics.effect import AXES, Effect, Parameter, Stage
from highside.physics.gravity import gravity_direction
from highside.physics.law_functions import FUNCTIONS, Function, cosines_up_to, wider
from highside.physics.places import PLACES, Place
from highside.physics.state import ChainState

AGAIN = "--"
"""before the number of a law that follows the same in the same place as another"""
PREFIX = "law:"
"""what the id of a law's effect begins with"""
TAPER = 0.1
"""Share of the range visited over which a law falls off beyond it. Source: chosen; the prior's mean there is zero"""
DIGITS = 8
"""significant digits of numbers in a file"""


@dataclass(frozen=True)
class Axis:
    """A covariate, the range of it that was visited, and the functions of it."""

    covariate: str
    low: float
    high: float
    functions: tuple[Function, ...]

    @property
    def periodic(self) -> bool:
        """Whether it comes round: an angle has no end beyond which nothing is known."""
        return covariate(self.covariate).periodic or (
            bool(self.functions) and all(f.kind in ("cos", "sin", "one") for f in self.functions)
        )

    @property
    def sets_in(self) -> bool:
        """Whether it is nothing but a step in time."""
        return self.covariate == "time" and [f.kind for f in self.functions] == ["step"]

    def basis(self, u: AnyArray) -> AnyArray:
        """(m, n) the functions at values (n,), tapered beyond the range."""
        span, (held, fall) = (self.low, self.high), self.held(u)
        if count := self._consecutive:
            wide = wider(span) if self.functions[-1].kind == "wide_cosine" else span
            others = [f(held, span)[None] for f in self.functions[:-count]]
            return np.asarray(np.concatenate([*others, cosines_up_to(held, wide, count)]) * fall)
        if self._orders is not None:
            waves = FUNCTIONS[self.functions[0].kind][0]
            return np.asarray(waves(held, span, self._orders) * fall)
        return np.asarray(np.stack([f(held, span) for f in self.functions]) * fall)

    @cached_property
    def _orders(self) -> AnyArray | None:
        """(m, 1) of functions that are cosines all of one kind: these are computed together."""
        if {f.kind for f in self.functions} not in ({"cosine"}, {"wide_cosine"}):
            return None
        return np.array([f.numbers for f in self.functions])

    @cached_property
    def _consecutive(self) -> int:
        """How many cosines of orders 1, 2, ... the functions end with, if no other is a cosine of the range; else 0."""
        ranged = ("cosine", "wide_cosine")
        first = next((k for k, f in enumerate(self.functions) if f.kind in ranged), len(self.functions))
        waves = self.functions[first:]
        regular = [f.numbers for f in waves] == [(float(k),) for k in range(1, len(waves) + 1)]
        return len(waves) if regular and {f.kind for f in waves} in ({"cosine"}, {"wide_cosine"}) else 0

    def held(self, u: AnyArray) -> tuple[AnyArray, AnyArray]:
        """Values (n,) held within the range, and the factors (n,) by which what lies beyond it falls off."""
        u = np.asarray(u, dtype=float)
        if self.periodic:
            return u, np.ones(u.size)
        if u.size and self.low <= u.min() and u.max() <= self.high:
            return u, np.ones(u.size)
        held = np.clip(u, self.low, self.high)
        width = TAPER * (self.high - self.low) if self.high > self.low else 1.0
        return held, np.exp(-0.5 * ((u - held) / width) ** 2)

    def inside(self, u: AnyArray) -> NDArray[np.bool_]:
        """(n,) whether a value was visited."""
        if self.periodic:
            return np.ones(np.shape(u), dtype=bool)
        slack = 1e-9 * max(abs(self.low), abs(self.high), self.high - self.low)
        return np.asarray((u >= self.low - slack) & (u <= self.high + slack))


def slug_beside(slug: str, ids: Collection[str]) -> str:
    """The slug, with a number where a law of these ids has it already: `offset_x_temp`, `offset_x_temp--2`, ..."""
    found, number = slug, 1
    while PREFIX + found in ids:
        number += 1
        found = f"{slug}{AGAIN}{number}"
    return found


@dataclass(frozen=True)
class Law:
    """One law; make it from a file's values with `Law.from_dict`."""

    slug: str
    place: str
    channels: tuple[str, ...]
    axes: tuple[Axis, ...]
    coefficients: tuple[tuple[float, ...], ...]
    """one list for each channel: of two axes the second's functions run fastest"""
    covariance: tuple[tuple[float, ...], ...] = ()
    """of all coefficients, channel by channel; empty: not known"""
    formula: str = ""
    """a closed formula as text; empty for a curve"""

    @property
    def id(self) -> str:
        """What its effect is called."""
        return PREFIX + self.slug

    @property
    def depends_on(self) -> tuple[str, ...]:
        """Names of its covariates."""
        return tuple(axis.covariate for axis in self.axes)

    @property
    def at(self) -> Place:
        """The place it acts in."""
        return PLACES[self.place]

    @cached_property
    def _table(self) -> AnyArray:
        return np.asarray(self.coefficients, dtype=float)

    def basis(self, covariates: Sequence[AnyArray]) -> AnyArray:
        """(m, n) all products of the axes' functions at the values (n,) of each covariate."""
        result = self.axes[0].basis(covariates[0])
        for axis, u in zip(self.axes[1:], covariates[1:], strict=True):
            own = axis.basis(u)
            result = (result[:, None] * own[None]).reshape(-1, own.shape[1])
        return np.asarray(result)

    def value(self, covariates: Sequence[AnyArray], channel: int = 0) -> AnyArray:
        """(n,) what it does to a channel, in the unit of the place."""
        return np.asarray(self._table[channel] @ self.basis(covariates))

    def std(self, covariates: Sequence[AnyArray], channel: int = 0) -> AnyArray:
        """(n,) standard deviation of `value`; 0 where the law knows none."""
        basis = self.basis(covariates)
        if not self.covariance:
            return np.zeros(basis.shape[1])
        m = len(basis)
        own = np.asarray(self.covariance, dtype=float)[channel * m : (channel + 1) * m, channel * m : (channel + 1) * m]
        return np.asarray(np.sqrt(np.maximum(np.einsum("in,ij,jn->n", basis, own, basis), 0.0)))

    @property
    def sets_in_s(self) -> float | None:
        """Since when in its session a law of something else acts, s; None of one that acts all the time."""
        onsets = [axis.functions[0].numbers[0] for axis in self.axes if axis.sets_in]
        return onsets[0] if onsets and len(self.axes) > len(onsets) else None

    def lasting(self) -> Law:
        """What it is after its session: a law of something else that set in at some time there acts all the time."""
        kept = tuple(axis for axis in self.axes if not axis.sets_in)
        return replace(self, axes=kept) if kept else self

    def inside(self, covariates: Sequence[AnyArray]) -> NDArray[np.bool_]:
        """(n,) whether all covariates are within what was visited."""
        return np.logical_and.reduce([a.inside(np.asarray(u)) for a, u in zip(self.axes, covariates, strict=True)])

    def axis_of(self, channel: str) -> int:
        """Axis of the triad whose load is the channel's own."""
        if self.at.triad:
            return AXES.index(channel)
        return AXES.index(channel[1]) if self.place == "matrix" else OWN

    def covariates(self, state: ChainState, load: AnyArray, channel: str) -> list[AnyArray]:
        """The values (n,) of each covariate at the rows of a state under a load (3, n) in g."""
        axis = self.axis_of(channel)
        return [np.real(covariate(name).of(state, load, axis)) for name in self.depends_on]

    # -- files

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON and TOML."""
        plain: dict[str, Any] = {
            "slug": self.slug,
            "place": self.place,
            "channels": list(self.channels),
            "formula": self.formula,
            "coefficients": [[_short(v) for v in row] for row in self.coefficients],
        }
        if self.covariance:
            plain["covariance"] = [[_short(v) for v in row] for row in self.covariance]
        plain["axes"] = [
            {
                "covariate": a.covariate,
                "low": _short(a.low),
                "high": _short(a.high),
                "functions": [[f.kind, *(_short(v) for v in f.numbers)] for f in a.functions],
            }
            for a in self.axes
        ]
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any], where: str | None = None) -> Law:
        """The law of a file's values. Raises InputError that names the field."""
        if not isinstance(plain, Mapping):
            raise InputError("must be a table", where=where, field="laws")
        slug = plain.get("slug")
        if not isinstance(slug, str) or not slug or not all(c.isalnum() or c in "_-" for c in slug):
            raise InputError(
                f"needs a name of letters, digits, _ and - (given {slug!r})", where=where, field="laws.slug"
            )

        def fail(field: str, what: str, remedy: str | None = None) -> InputError:
            return InputError(what, where=where, field=f"laws.{slug}.{field}", remedy=remedy)

        unknown = set(plain) - {"slug", "place", "channels", "formula", "coefficients", "covariance", "axes"}
        if unknown:
            raise fail(sorted(unknown)[0], "is unknown", "a law has slug, place, channels, formula, coefficients, axes")
        place, channels = plain.get("place"), plain.get("channels")
        if place not in PLACES:
            raise fail("place", f"{place!r} is unknown", f"known are: {', '.join(PLACES)}")
        allowed = PLACES[place].channels
        if not isinstance(channels, list | tuple) or not channels or not all(isinstance(c, str) for c in channels):
            raise fail("channels", "must be a list of names", f"of: {', '.join(allowed)}")
        wrong = [c for c in channels if allowed and c not in allowed]
        if wrong or len(set(channels)) != len(channels):
            raise fail("channels", f"{(wrong or channels)[0]!r} is not possible or twice there", ", ".join(allowed))
        axes = plain.get("axes")
        if not isinstance(axes, list | tuple) or not axes:
            raise fail("axes", "is missing", "give one table [[laws.axes]] for each covariate")
        made = tuple(_axis_of(axis, fail) for axis in axes)
        count = math.prod(len(axis.functions) for axis in made)
        rows = _numbers(plain.get("coefficients"), (len(channels), count), "coefficients", fail)
        whole = len(channels) * count
        spread = plain.get("covariance") or []
        covariance = _numbers(spread, (whole, whole), "covariance", fail) if spread else ()
        formula = plain.get("formula", "") or ""
        if not isinstance(formula, str):
            raise fail("formula", "must be text")
        return cls(slug, str(place), tuple(channels), made, rows, covariance, formula)


Fail = Callable[..., InputError]


def _short(value: float) -> float:
    return float(f"{float(value):.{DIGITS}g}")


def _numbers(rows: Any, shape: tuple[int, int], field: str, fail: Fail) -> tuple[tuple[float, ...], ...]:
    """A table of finite numbers of that shape."""
    try:
        table = np.asarray(rows, dtype=float)
    except (TypeError, ValueError):
        raise fail(field, "must be lists of numbers") from None
    if table.shape != shape:
        raise fail(field, f"must be {shape[0]} lists of {shape[1]} numbers")
    if not np.isfinite(table).all():
        raise fail(field, "holds a number that is not finite")
    return tuple(tuple(float(v) for v in row) for row in table)


def _axis_of(plain: Any, fail: Fail) -> Axis:
    if not isinstance(plain, Mapping) or set(plain) != {"covariate", "low", "high", "functions"}:
        raise fail("axes", "each needs covariate, low, high, functions, and nothing else")
    name, low, high = plain["covariate"], plain["low"], plain["high"]
    if not isinstance(name, str) or not name:
        raise fail("axes.covariate", "must be a name", f"one of {', '.join(COVARIATES)}, or a column's own")
    for field, value in (("low", low), ("high", high)):
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise fail(f"axes.{field}", f"must be a finite number (given {value!r})")
    if low > high:
        raise fail("axes.low", "is above high")
    functions = plain["functions"]
    if not isinstance(functions, list | tuple) or not functions:
        raise fail("axes.functions", "must be a list of lists, as [['cosine', 1]]")
    return Axis(name, float(low), float(high), tuple(_function_of(f, fail) for f in functions))


def _function_of(plain: Any, fail: Fail) -> Function:
    if not isinstance(plain, list | tuple) or not plain or plain[0] not in FUNCTIONS:
        kind = plain[0] if isinstance(plain, list | tuple) and plain else plain
        raise fail("axes.functions", f"{kind!r} is unknown", f"known are: {', '.join(FUNCTIONS)}")
    numbers, wanted = plain[1:], FUNCTIONS[plain[0]][1]
    if len(numbers) != wanted or not all(
        isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) for v in numbers
    ):
        raise fail("axes.functions", f"{plain[0]} needs {wanted} finite number{'s' if wanted != 1 else ''}")
    return Function(plain[0], tuple(float(v) for v in numbers))


class LawEffect(Effect):
    """A law as an effect of the chain: its one parameter `share` is 1 for the law as it was learnt."""

    parameters = (Parameter("share", "1", 1.0, (-100.0, 100.0)),)
    story = "No effect of the library: a law that was learnt from a recording."
    complex_safe = False
    turns_the_tool = False
    """of an error of the reference angle that a recording shows it is not known whether the recorded rate has it too:
    what gyros say of it is a law of theirs"""

    def __init__(self, law: Law) -> None:
        stage = law.at.stage
        if stage is None:
            raise InputError(
                "acts on channels beside another program's output alone",
                field=f"laws.{law.slug}.place",
                remedy="it is for diagnose with simulation=",
            )
        self.law = law
        self.id = law.id
        self.title = f"Law of {', '.join(law.depends_on)}"
        self.stage = stage
        self.formula = law.formula or f"curve of {', '.join(law.depends_on)}"
        self.needs = ()
        self.remembers = any(covariate(name).history for name in law.depends_on) or "temp_rate" in law.depends_on
        self.depends_on_input = law.place in ("scale", "scale_all", "matrix", "gyro_scale")

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.asarray(p[0] * self._unit(state, x))

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.asarray(self._unit(state, x)[None])

    def _unit(self, state: ChainState, x: AnyArray) -> AnyArray:
        law = self.law
        loaded = self.stage is Stage.THERMAL
        load = np.real(x) if loaded else gravity_direction(state.inc_rad, state.tf_rad)
        total: AnyArray = np.zeros((1, 1))
        for number, channel in enumerate(law.channels):
            values = law.value(law.covariates(state, load, channel), number)
            total = total + law.at.act(channel, values, x)
        return total


def effect_of(law: Law) -> LawEffect:
    """The law as an effect of the chain. Raises InputError for one that acts in none."""
    return LawEffect(law)
