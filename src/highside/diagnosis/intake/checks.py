"""Is the recording what it claims to be? Faults of the data that no physics explains and no fit can repair.

These are exact detectors, not regressions: each counts something that a healthy recording does not have and gives the
probability of that count by chance. A finding that spoils the data stops the diagnosis (`bad_data`): a fit would give
the fault the name of some effect, and be very sure of it. Others are reported and lived with.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.result import Finding
from highside.diagnosis.intake.clock import chance, clock_findings, duplicates
from highside.diagnosis.intake.impulses import find_impulses
from highside.diagnosis.intake.policy import CHECKS, CLOCK
from highside.physics.effects.clipping import EFFECT as CLIPPING
from highside.physics.effects.dropped_frames import EFFECT as DROPPED_FRAMES
from highside.physics.effects.quantisation import EFFECT as QUANTISATION
from highside.physics.effects.stuck_bit import EFFECT as STUCK_BIT
from highside.physics.gravity import gravity_direction
from highside.units import STANDARD_GRAVITY_MPS2

CHANNELS = ("ax", "ay", "az")
COLUMNS = ("ax_g", "ay_g", "az_g")
UNITS = {"m/s2": STANDARD_GRAVITY_MPS2, "mg": 1e3, "ug": 1e6}


@dataclass(frozen=True, slots=True)
class Intake:
    """What was found, whether it spoils the data, and the share and limit (g) of each channel with a flat top."""

    findings: tuple[Finding, ...]
    spoiled: bool
    clipped: dict[int, tuple[float, float]]
    impulses: NDArray[np.intp]
    """rows whose reading is far off its neighbours"""


def check(
    columns: Mapping[str, Array],
    needed: Sequence[str],
    axes: Sequence[tuple[int, float]],
    *,
    attitude: bool = True,
    every_row: bool = True,
) -> Intake:
    """Check the columns (N,) of a recording. `needed` are those the diagnosis cannot do without.

    `axes` says which channel, with which sign, is the tool's x, y and z. Without a reference `attitude` nothing says
    which axis should feel what. Where not `every_row` counts, as in averages of poses, any number of lost frames
    is reported and does no harm; elsewhere up to `CLOCK.lost_share`: each row has its time.
    """
    incomplete = _incomplete(columns, needed)
    if incomplete:
        return _spoiled([incomplete])
    held = _rows_held(columns)
    clock = [_harmless(*found) if not every_row else found for found in clock_findings(columns, held)]
    time = [finding for finding, _ in clock]
    accel = np.stack([columns[name][held] for name in COLUMNS])
    still = [c for c in range(3) if np.ptp(accel[c]) == 0.0]
    if still:
        names = tuple(CHANNELS[c] for c in still)
        return _spoiled([*time, Finding("constant_channel", names, _all_equal(accel.shape[1]), "check wire and codec")])
    unit = _unit(accel)
    if unit:
        return _spoiled([*time, unit])
    reference = _reference({name: column[held] for name, column in columns.items()}) if attitude else None
    clipped: dict[int, tuple[float, float, float]] = {}
    if reference is not None:
        expected = np.empty_like(reference)
        for tool, (channel, sign) in enumerate(axes):
            expected[channel] = sign * reference[tool]
        clipped = {c: found for c in range(3) if (found := _clipping(accel[c], expected[c]))}
        # a channel that is mostly flat follows no axis map
        mostly = any(share >= CHECKS.clipped_share for share, _, _ in clipped.values())
        frames = [] if mostly else _axes(accel, reference, axes, 0.0 if every_row else CHECKS.few_off)
        if frames:
            return _spoiled([*time, *frames])
    spoiling = [finding for finding, spoils in clock if spoils]
    reported = [finding for finding in time if finding not in spoiling]
    spoiling += duplicates(columns, held, accel)
    for c, (share, limit, p) in clipped.items():
        words = f"{share:.1%} of the readings share the value {limit:g} g: use a larger range"
        flat = Finding(CLIPPING.id, (CHANNELS[c],), p, words)
        (spoiling if share >= CHECKS.clipped_share else reported).append(flat)
    spoiling += [f for c in range(3) if c not in clipped and (f := _stuck_bit(accel[c], c))]
    rows = np.flatnonzero(held)
    impulses: NDArray[np.intp] = rows[:0]
    shocks: list[Finding] = []
    if not clipped and (attitude or "pose" in columns):
        # of a tool that is moved by hand and has no reference, a jerk is no fault
        stops = np.cumsum(np.diff(columns["pose"][held], prepend=np.nan) != 0) if "pose" in columns else 0 * rows
        impulses, shocks = find_impulses(accel, stops, reference)
    reported += [*shocks, *(f for c in range(3) if (f := _quantisation(accel[c], c)))]
    flats = {c: (share, limit) for c, (share, limit, _) in clipped.items()}
    return Intake((*spoiling, *reported), bool(spoiling), flats, rows[impulses])


def _rows_held(columns: Mapping[str, Array]) -> NDArray[np.bool_]:
    """(N,) rows that belong to a pose, or all."""
    return ~np.isnan(columns["pose"]) if "pose" in columns else np.ones(columns["t_s"].size, dtype=bool)


def _incomplete(columns: Mapping[str, Array], needed: Sequence[str]) -> Finding | None:
    """Columns or values that the diagnosis cannot do without and that are not there."""
    missing = [name for name in (*COLUMNS, *needed) if name not in columns]
    if missing:
        return Finding("missing_column", tuple(missing), 0.0, f"record {', '.join(missing)} as well")
    held = _rows_held(columns)
    holes = [name for name in ("t_s", *COLUMNS, *needed) if np.isnan(columns[name][held]).any()]
    if not holes:
        return None
    count = max(int(np.isnan(columns[name][held]).sum()) for name in holes)
    words = f"{count} of {int(held.sum())} values are missing: repeat those poses or leave the rows out"
    return Finding("missing_values", tuple(_short(name) for name in holes), 0.0, words)


def _harmless(finding: Finding, spoils: bool) -> tuple[Finding, bool]:
    """Lost frames where a pose is the average of the rows that are there."""
    if finding.check != DROPPED_FRAMES.id:
        return finding, spoils
    words = finding.remedy.partition(": ")[0]
    return replace(finding, remedy=f"{words}: each pose is averaged from the rows that are there"), False


def _spoiled(findings: Sequence[Finding]) -> Intake:
    return Intake(tuple(findings), True, {}, np.empty(0, dtype=np.intp))


def missing_rows(columns: Mapping[str, Array], needed: Sequence[str]) -> tuple[NDArray[np.bool_], Finding | None]:
    """(N,) rows of which a value that is needed lacks, and what to say of them; none where they are too many to be left
    out, or all of a column."""
    names = [name for name in ("t_s", *COLUMNS, *needed) if name in columns]
    holes = {name: np.isnan(columns[name]) for name in names}
    lost = np.any(list(holes.values()), axis=0)
    if not lost.any() or lost.mean() > CHECKS.missing_share:
        return np.zeros_like(lost), None
    words = f"{int(lost.sum())} of {lost.size} rows lack a value and are left out"
    if "pose" in columns:
        poses = columns["pose"][~np.isnan(columns["pose"])]
        gone = np.setdiff1d(poses, columns["pose"][~lost])
        words += f": each pose is averaged from the rows that are there; poses without any: {gone.size}"
    channels = tuple(_short(name) for name in names if holes[name].any())
    return lost, Finding("missing_values", channels, 0.0, words)


def _short(name: str) -> str:
    return name.removesuffix("_g") if name in COLUMNS else name


def _all_equal(count: int) -> float:
    """Probability that so many readings agree where two do with even odds."""
    return float(2.0 ** -min(count - 1, CHECKS.most_binary))


def _reference(columns: Mapping[str, Array]) -> Array:
    """(3, N) gravity in the tool frame as the bench says."""
    tf = columns["tf_ref_deg"] if "tf_ref_deg" in columns else columns["rotor_deg"]
    return np.asarray(gravity_direction(np.radians(columns["inc_ref_deg"]), np.radians(tf)), dtype=float)


def poses_off(mean: Array, expected: Array, label: Callable[[int], str]) -> Finding | None:
    """The poses whose readings (3, n) are far off what their angles say, by the numbers that `label` gives them, where
    the readings of all do not follow the angles for them."""
    square = np.sum((mean - expected) ** 2, axis=0)
    off = np.flatnonzero(square > CHECKS.off_g2)
    if square.mean() < CHECKS.follows_g**2 or not off.size:
        return None
    named = ", ".join(label(int(pose)) for pose in off[: CHECKS.listed]) + (", ..." if off.size > CHECKS.listed else "")
    words = f"poses {named} read more than 0.2 g off their angles: look at what was written down, and at their rows"
    return Finding("not_gravity", CHANNELS, chance(off.size, mean.shape[1], CLOCK.stray), words)


def _unit(accel: Array) -> Finding | None:
    """The size of gravity tells the unit."""
    size = float(np.median(np.linalg.norm(accel, axis=0)))
    if CHECKS.gravity[0] < size < CHECKS.gravity[1]:
        return None
    guess = next((name for name, one in UNITS.items() if CHECKS.unit[0] < size / one < CHECKS.unit[1]), None)
    words = (
        f"|a| is {size:.6g}: looks like {guess}, divide by {UNITS[guess]:g}"
        if guess
        else (f"|a| is {size:.6g} where gravity is 1: scale the readings to g")
    )
    away = int(np.sum(np.abs(np.linalg.norm(accel, axis=0) - 1) > CHECKS.away_g))
    return Finding("wrong_unit", CHANNELS, chance(away, accel.shape[1], CLOCK.stray), words)


def _axes(accel: Array, reference: Array, axes: Sequence[tuple[int, float]], few: float) -> list[Finding]:
    """Search all 48 signed permutations of the channels for the one that follows the bench; nothing where no more than
    a share `few` of the rows is off it."""
    tool = np.stack([sign * accel[channel] for channel, sign in axes])
    now = np.sum((tool - reference) ** 2, axis=0)
    best: tuple[float, tuple[int, ...], tuple[int, ...]] = (np.inf, (0, 1, 2), (1, 1, 1))
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            misfit = float(np.sum((np.array(signs)[:, None] * tool[list(order)] - reference) ** 2))
            best = min(best, (misfit, order, signs))
    misfit, order, signs = best
    n = accel.shape[1]
    level = np.sqrt(now.mean())
    if level < CHECKS.follows_g or np.mean(now > CHECKS.off_g2) < few:
        return []
    better = np.sum((np.array(signs)[:, None] * tool[list(order)] - reference) ** 2, axis=0)
    wins = int(np.sum(better < now))
    p = chance(wins, n, 0.5)
    if misfit / n > CHECKS.follows_g**2 or np.sqrt(misfit / n) > level / CHECKS.better:
        words = "the readings do not follow the bench's angles under any axis map: are these the right columns?"
        return [Finding("not_gravity", CHANNELS, chance(int(np.sum(now > CHECKS.off_g2)), n, CLOCK.stray), words)]
    found = []
    letters = "xyz"
    mapped = "".join(("-" if s < 0 else "") + letters[o] for o, s in zip(order, signs, strict=True))
    swapped = tuple(CHANNELS[axes[i][0]] for i in range(3) if order[i] != i)
    turned = tuple(CHANNELS[axes[i][0]] for i in range(3) if order[i] == i and signs[i] < 0)
    if swapped:
        words = f"the bench's angles are followed if the channels are read as {mapped}: check wiring or [tool] axes"
        found.append(Finding("swapped_axis", swapped, p, words))
    if turned:
        words = f"the bench's angles are followed if the sign is turned ({mapped}): check [tool] axes"
        found.append(Finding("inverted_axis", turned, p, words))
    return found


def _clipping(values: Array, expected: Array) -> tuple[float, float, float] | None:
    """Share, limit (g) and p of a flat top: readings of one value where different loads are expected."""
    best: tuple[float, float, float] | None = None
    for extreme in (float(values.max()), float(values.min())):
        at = values == extreme
        count = int(at.sum())
        loads = expected[at]
        others = np.unique(values[~at]).size
        if count < CHECKS.least_equal or others < CHECKS.least_equal:
            continue
        # equal loads give equal readings on a coarse converter: count loads that differ by more than its step, and
        # compare the number of equal readings with how often neighbours agree elsewhere
        step = float(np.median(np.diff(np.unique(values[~at]))))
        apart = np.unique(np.round(loads / max(CHECKS.load_steps * step, CHECKS.load_g))).size
        agree = max(float(np.mean(np.diff(values[~at]) == 0)), 1.0 / values.size)
        p = min((1.0 / others) ** (apart - 1), agree ** (count - apart))
        if apart >= 2 and p < CLOCK.sure and np.ptp(loads) > max(CHECKS.span_steps * step, CHECKS.span_g):
            share = count / values.size + (best[0] if best else 0.0)
            best = (share, abs(extreme), min(p, best[2] if best else 1.0))
    return best


def _codes(values: Array) -> tuple[NDArray[np.int64], float] | None:
    """Whole numbers behind the readings and the step of the converter, if there is one."""
    distinct = np.unique(values)
    if distinct.size < CHECKS.least_codes:
        return None
    gaps = np.diff(distinct)
    # sums of rounding errors are no steps
    step = float(gaps[gaps > 1e-9].min())
    step = float(np.ptp(distinct) / np.round(np.ptp(distinct) / step))
    codes = values / step
    if np.max(np.abs(codes - np.round(codes))) > CHECKS.off_code:
        return None
    return np.round(codes).astype(np.int64), step


def _stuck_bit(values: Array, channel: int) -> Finding | None:
    """A binary digit that never changes although the readings pass through both of its states."""
    found = _codes(values)
    if found is None:
        return None
    codes, _ = found
    distinct = np.unique(codes)
    top = int(np.log2(max(int(np.ptp(distinct)), 1))) - 2
    for bit in range(top):
        held = (distinct >> bit) & 1
        if np.ptp(held) == 0:
            # every stretch of 2^(bit+1) codes that was visited had both states to choose from
            visits = np.unique(distinct >> (bit + 1)).size
            p = float(2.0 ** -min(visits - 1, CHECKS.most_binary))
            if p < CLOCK.sure:
                words = f"binary digit {bit} is always {int(held[0])}: the converter or its wire is broken"
                return Finding(STUCK_BIT.id, (CHANNELS[channel],), p, words)
    return None


def _quantisation(values: Array, channel: int) -> Finding | None:
    """A step of the converter so coarse that the noise does not smooth it."""
    found = _codes(values)
    if found is None:
        return None
    codes, step = found
    # unchanged from row to row in most rows: the noise is well below the step
    still = float(np.mean(np.diff(codes) == 0))
    if still < CHECKS.still:
        return None
    words = f"the converter's step of {step:.3g} g is coarser than the noise: errors of up to half of it stay in a mean"
    return Finding(QUANTISATION.id, (CHANNELS[channel],), _all_equal(int(np.sum(np.diff(codes) == 0))), words)
