"""Units of accelerations and rates by their values: |a| of one g, the turn of gravity that gyros must explain."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from highside.importing.core.converters import RATE_COUNTS, sphere_of, steps_of_rates
from highside.importing.core.policy import POLICY, ImportPolicy
from highside.importing.core.units import STANDARD_GRAVITY, Quantity, Unit, unit_named

Block = NDArray[np.float64]
_BY_VALUE = (("g", 1.0), ("m/s2", STANDARD_GRAVITY), ("mg", 1000.0))
_LEAST_ROWS = 16
"""rows below which the turn of gravity is not looked at"""


@dataclass(frozen=True, slots=True)
class UnitGuess:
    """A unit and the reasons for it. `open`: what stays undecided; `likely`: by values alone."""

    unit: Unit | None
    evidence: tuple[str, ...]
    open: str | None = None
    likely: bool = False


def magnitude(block: Block, policy: ImportPolicy = POLICY) -> float:
    """Median of |a| of a (3, N) block; NaN where nothing is finite."""
    size = np.linalg.norm(block[:, :: max(1, block.shape[1] // policy.judged_rows)], axis=0)
    size = size[np.isfinite(size)]
    return float(np.median(size)) if size.size else float("nan")


def acceleration_unit(block: Block, named: Unit | None, whole: bool, policy: ImportPolicy = POLICY) -> UnitGuess:
    """The unit of a triad (3, N) as it stands in the file; `whole`: whether all its numbers are whole."""
    size = magnitude(block, policy)
    shown = f"median |a| {size:.5g}"
    if not np.isfinite(size) or size == 0.0:
        return UnitGuess(None, (shown,), "holds no acceleration")
    if named is not None:
        in_g = magnitude((block - named.zero) * named.factor, policy)
        evidence = (f"named {named.name}", f"median |a| {in_g:.4f} g")
        if abs(in_g - 1.0) <= policy.named_gravity_share:
            # 1,024 counts a g pass for mg that are 2 % off
            nearer = [n for n in policy.resolutions if abs(size / n - 1.0) < policy.counts_share]
            if whole and nearer and abs(in_g - 1.0) > policy.counts_share:
                what = f"named {named.name} ({in_g:.3f} g), but its whole numbers are nearer to {nearer[0]} counts a g"
                return UnitGuess(named, evidence, what)
            return UnitGuess(named, evidence)
        return UnitGuess(named, evidence, f"named {named.name}, but then |a| is {in_g:.3g} g")
    fits = [name for name, one_g in _BY_VALUE if abs(size / one_g - 1.0) <= policy.gravity_share]
    if whole:
        fits += [f"lsb/{n}" for n in policy.resolutions if abs(size / n - 1.0) <= policy.gravity_share]
    if len(fits) == 1:
        return UnitGuess(_unit(fits[0]), (f"no unit named; {shown}: one g in {fits[0]}",), likely=True)
    if fits:
        return UnitGuess(_unit(fits[0]), (f"no unit named; {shown}",), f"its unit may be {' or '.join(fits)}")
    sphere = sphere_of(block, policy) if whole else None
    if sphere is not None:
        at = f"@{sphere.zero:g}" if sphere.zero else ""
        unit = Unit(f"lsb/{sphere.counts:.6g}{at}", Quantity.ACCELERATION, 1.0 / sphere.counts, zero=sphere.zero)
        said = f"counts; at {sphere.rests} rests all round |a| is {sphere.counts:.5g} from {sphere.zero:g}"
        return UnitGuess(unit, (said, f"to {100 * sphere.rms_share:.1g} %"), likely=True)
    if whole:
        return UnitGuess(None, (f"no unit named; {shown}",), f"{shown} is one g in counts of no usual converter")
    return UnitGuess(None, (f"no unit named; {shown}",), f"{shown} is one g in no known unit")


def _unit(name: str) -> Unit:
    if name.startswith("lsb/"):
        return Unit(name, Quantity.ACCELERATION, 1.0 / float(name[4:]))
    unit = unit_named(name, Quantity.ACCELERATION)
    assert unit is not None
    return unit


def rate_unit(
    block: Block,
    named: Unit | None,
    gravity: Block | None,
    t_s: Block | None,
    whole: bool,
    policy: ImportPolicy = POLICY,
) -> UnitGuess:
    """The unit of a triad of rates (3, N), by its name and by the turn of gravity (3, N) over t_s (N,).

    `whole`: whether all numbers are whole, as counts of a converter are: then their size shows nothing.
    """
    finite = block[np.isfinite(block)]
    largest = float(np.abs(finite).max()) if finite.size else float("nan")
    evidence = [f"largest {largest:.4g}"]
    turn = None if gravity is None or t_s is None else turn_ratio(block, gravity, t_s, policy)
    steps = None if whole else steps_of_rates(block, policy)
    if named is not None:
        dps = largest * abs(named.factor)
        evidence = [f"named {named.name}", f"largest {dps:.4g} deg/s"]
        problem = f"named {named.name}, but then a rate is {dps:.4g} deg/s" if dps > policy.rate_dps else None
        if turn is not None:
            # `turn` is rad/s of gravity per number in the file
            ratio = np.degrees(turn) / named.factor
            evidence.append(f"gravity turns {ratio:.3g} times as fast as they say")
            if abs(ratio - 1.0) > policy.kinematic_share:
                problem = f"named {named.name}, but gravity turns {ratio:.3g} times as fast"
        elif steps is not None and named.name in ("deg/s", "rad/s") and steps.unit != named.name:
            problem = f"named {named.name}, but in steps of {steps.counts:g} counts per deg/s if they are {steps.unit}"
        return UnitGuess(named, tuple(evidence), problem)
    if turn is not None and whole:
        return _of_counts(turn, evidence, policy)
    if turn is not None:
        # mdeg/s is believed only where it is named: times in ms that pass for s make deg/s look like it
        for name in ("deg/s", "rad/s"):
            unit = unit_named(name, Quantity.RATE)
            assert unit is not None
            if abs(np.degrees(turn) / unit.factor - 1.0) <= policy.kinematic_share:
                if steps is not None and steps.unit != name:
                    what = (
                        f"gravity turns as they say in {name}, but their steps are those of a converter in {steps.unit}"
                    )
                    return UnitGuess(None, tuple(evidence), what)
                return UnitGuess(unit, (f"no unit named; gravity turns as they say in {name}",), likely=True)
        return UnitGuess(None, tuple(evidence), "gravity does not turn as they say in any known unit")
    if whole and largest > 1.0:
        return UnitGuess(None, tuple(evidence), "its unit is not named, and whole numbers may be counts")
    if steps is not None:
        said = f"no unit named; in steps of {steps.counts:g} counts per deg/s if they are {steps.unit}"
        return UnitGuess(unit_named(steps.unit, Quantity.RATE), (said,), likely=True)
    if turn is None and gravity is not None and t_s is not None and _moved(block, gravity, t_s, policy):
        return UnitGuess(None, tuple(evidence), "its unit is not named, and gravity does not turn as they say")
    if largest > policy.rate_rad_s and largest <= policy.rate_dps:
        return UnitGuess(unit_named("deg/s", Quantity.RATE), (f"no unit named; {evidence[0]}: no rad/s",), likely=True)
    return UnitGuess(None, tuple(evidence), "its unit is not named, and nothing moves enough to show it")


def _of_counts(turn: float, evidence: list[str], policy: ImportPolicy) -> UnitGuess:
    """Counts whose turn is `turn` rad/s each: of a known converter, or of none."""
    counts = 1.0 / np.degrees(turn)
    known = [value for value in RATE_COUNTS if abs(counts / value - 1.0) <= policy.counts_of_rates_share]
    said = f"no unit named; gravity turns as they say with {counts:.4g} counts per deg/s"
    if len(known) == 1:
        unit = Unit(f"lsb/{known[0]:g}", Quantity.RATE, 1.0 / known[0])
        return UnitGuess(unit, (said,), likely=True)
    if abs(np.degrees(turn) - 1.0) <= policy.kinematic_share:
        return UnitGuess(unit_named("deg/s", Quantity.RATE), (said,), likely=True)
    return UnitGuess(
        None, (*evidence, said), f"its unit is not named, and {counts:.4g} counts per deg/s are no usual ones"
    )


def turn_ratio(rates: Block, gravity: Block, t_s: Block, policy: ImportPolicy = POLICY) -> float | None:
    """How fast gravity turns, in rad/s, per unit of the rates: k of du/dt = -k w x u by least squares.

    None where it turns too little, or where the two do not go together (another frame, lost rows).
    """
    turns = _turns(rates, gravity, t_s, policy)
    return None if turns is None else _ratio(*turns, policy)


def turn_arrangement(rates: Block, gravity: Block, t_s: Block, policy: ImportPolicy = POLICY) -> str | None:
    """The arrangement of the axes of the rates, as `AxisMap` writes it, with which gravity turns where it does not with
    the axes as they stand: rates of another frame, a sign or a name that is wrong. None where there is none."""
    turns = _turns(rates, gravity, t_s, policy)
    if turns is None or _ratio(*turns, policy) is not None:
        return None
    u, w, dt, turn, usable = turns
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            arranged = np.array(signs)[:, None] * w[list(order)]
            ratio = _ratio(u, arranged, dt, turn, usable, policy)
            # the opposite of all signs turns the other way: of the two the one that turns as the rates say
            if ratio is not None and ratio > 0:
                return "".join(("-" if sign < 0 else "") + "xyz"[axis] for sign, axis in zip(signs, order, strict=True))
    return None


def _moved(rates: Block, gravity: Block, t_s: Block, policy: ImportPolicy) -> bool:
    """Whether gravity points elsewhere at some time, further than noise takes it."""
    turns = _turns(rates, gravity, t_s, policy)
    if turns is None:
        return False
    u = turns[0] / np.linalg.norm(turns[0], axis=0)
    return bool((u[:, :1] * u).sum(axis=0).min() < np.cos(policy.kinematic_turn_rad))


def _turns(
    rates: Block, gravity: Block, t_s: Block, policy: ImportPolicy
) -> tuple[Block, Block, Block, Block, NDArray[np.bool_]] | None:
    """Of windows: directions of gravity and rates at their middles, times between, turns, and which count."""
    good = np.isfinite(rates).all(axis=0) & np.isfinite(gravity).all(axis=0) & np.isfinite(t_s)
    rates, gravity, t_s = rates[:, good], gravity[:, good], t_s[good]
    n = t_s.size
    if n < _LEAST_ROWS:
        return None
    # over windows of about 0.1 s or four rows: noise of the accelerometer is no turn
    step = float(np.median(np.diff(t_s)))
    width = max(4, min(round(0.1 / step) if step > 0 else 4, n // 4))
    count = n // width
    means = gravity[:, : count * width].reshape(3, count, width).mean(axis=2)
    size = np.linalg.norm(means, axis=0)
    if (size == 0).any():
        return None
    u = means / size
    w = rates[:, : count * width].reshape(3, count, width).mean(axis=2)
    centre = t_s[: count * width].reshape(count, width).mean(axis=1)
    dt = np.diff(centre)
    usable = (dt > 0) & (dt < 3 * width * step)
    turn = np.diff(u, axis=1)
    if float(np.linalg.norm(turn, axis=0)[usable].sum()) < policy.kinematic_turn_rad:
        return None
    return 0.5 * (u[:, 1:] + u[:, :-1]), 0.5 * (w[:, 1:] + w[:, :-1]), dt, turn, usable


def _ratio(u: Block, w: Block, dt: Block, turn: Block, usable: NDArray[np.bool_], policy: ImportPolicy) -> float | None:
    predicted = -np.cross(w, u, axis=0) * dt
    for share in (0.0, policy.kinematic_fast):
        # at rest noise alone turns; where it moves fast there is least of it
        size = np.linalg.norm(predicted, axis=0)
        fast = usable & (size >= share * (float(size[usable].max()) if usable.any() else 0.0))
        a, b = predicted[:, fast].ravel(), turn[:, fast].ravel()
        power = float(a @ a)
        if power == 0.0 or (share and int(fast.sum()) < _LEAST_ROWS):
            return None
        if abs(float(a @ b)) >= policy.kinematic_correlation * float(np.sqrt(power * (b @ b))):
            return float(a @ b) / power
    return None
