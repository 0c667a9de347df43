"""What the watch tells a person to do, and why something cannot be seen, in plain sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from highside.watch.claims import SECOND
from highside.watch.parameters import AXES
from highside.watch.policy import WatchPolicy
from highside.watch.present import Sight
from highside.watch.result import Deviation, NoiseChange, NotObservable, TakenBack, Verdict, WatchClaim

__all__ = [
    "advice",
    "noise_advice",
    "noise_words",
    "not_observable",
    "roll_test",
    "state_advice",
    "taken_back_advice",
    "why_unseen",
]

ANTISYMMETRIC = "S_xy-S_yx"
"""a toolface offset: in `not_observable` always"""

_STEEP_RAD = math.radians(75.0)
_ALONG = "b_z, S_zz and gravity are told apart by a spread of inclinations, and are out of sight near horizontal"
_SIDE = {"b_z": _ALONG, "S_zz": _ALONG}
_NEVER = {
    "tilt_x": "a bent collar reads like an antisymmetric misalignment of x or y against z",
    "tilt_y": "a bent collar reads like an antisymmetric misalignment of x or y against z",
    "gravity": "an error of the site's gravity reads like a common scale",
    "growth": "gravity's growth with depth runs together with time and temperature",
}


def why_unseen(name: str, turns: int) -> str:
    """Why a parameter has not been seen so far."""
    if name in ("S_xy", "S_yx"):
        return "S_xy - S_yx is a toolface offset and never observable; the sum needs toolfaces beside 0, 90, 180, 270"
    if name in _NEVER:
        return _NEVER[name]
    if name.startswith("kT"):
        return "needs temperatures apart from that of the calibration"
    if name.startswith("kV"):
        return "needs a recorded vibration (column vibration_rms_g) that changes"
    if name.startswith("arm"):
        return "needs rotation at rates that differ"
    if not turns:
        return "needs other attitudes, or rotation with gyros: at rest one number is seen, the length of gravity"
    return _SIDE.get(name, "needs other inclinations: at one of them it is not told from its neighbours")


def not_observable(parameters: Mapping[str, Deviation], turns: int) -> tuple[NotObservable, ...]:
    """What was not seen so far, and what never is."""
    never = NotObservable(
        ANTISYMMETRIC, "a toolface offset, never seen in a hole: toolface zero is as the bench left it"
    )
    return (
        *(NotObservable(name, why_unseen(name, turns)) for name, one in parameters.items() if not one.observable),
        never,
    )


def roll_test(inc_rad: float) -> str:
    """The manoeuvre that tells most, and what it will tell."""
    names = "b_x, b_y, S_xx, S_yy and S_xy + S_yx"
    if math.degrees(inc_rad) < 5.0:
        names = "only b_z with the scale of z (little more can be seen in a vertical hole)"
    return (
        f"take a roll test here: eight toolfaces 45 deg apart, a minute each (four at right angles cannot see"
        f" S_xy + S_yx); it tells {names}. A second one after 10 to 30 deg of build tells b_z from S_zz and b_x from"
        " S_xz"
    )


def advice(
    verdict: Verdict,
    claims: Sequence[WatchClaim],
    sight: Sight,
    inc_rad: float | None,
    policy: WatchPolicy,
) -> tuple[str, ...]:
    """What to do next, the first first."""
    if claims and claims[0].error is None:
        return ("the readings are not those of gravity: use none of them, pull the tool",)
    unseen, never = sight.unseen, sight.never
    if inc_rad is None or unseen is None or never is None:
        return ("nothing was measured: let the tool lie still, or turn with gyros recorded",)
    if verdict == "holds":
        return (
            "go on",
            f"never seen in a hole, and as the bench left it: toolface zero (S_xy - S_yx), and what reads like a bent"
            f" collar; the record and the tool's class state {never.tf_sin_inc_deg:.2g} deg of toolface times sin I and"
            f" {never.inc_deg:.2g} deg of inclination for both (3 standard deviations)",
        )
    if verdict == "learning":
        side = (
            " Near horizontal b_z and S_zz stay out of sight: a still at another inclination is needed."
            if inc_rad > _STEEP_RAD
            else ""
        )
        return (
            f"not yet known: an error of up to {unseen.inc_deg:.2g} deg of inclination and"
            f" {unseen.tf_sin_inc_deg:.2g} deg of toolface times sin I would not have been seen.{side}",
            roll_test(inc_rad),
        )
    claim, lines = claims[0], []
    alike = [name for name in claim.equivalence_class if name != SECOND]
    if SECOND in claim.equivalence_class:
        lines.append(
            "one departure does not explain what was seen: there is a second one, the first has gone again, or noise"
            " has grown; trust no size, acknowledge and restart the watch, and calibrate again at surface"
        )
    if len(alike) > 1:
        lines.append(f"{', '.join(alike)} are not told apart so far: {roll_test(inc_rad)}")
    error = claim.error
    if error is not None and max(abs(error.inc_deg), abs(error.tf_sin_inc_deg)) > policy.pull_deg:
        lines.append("the error is large: pull the tool")
    else:
        lines.append("check the next surveys against another tool, and calibrate again when this one is at surface")
    return tuple(lines)


def taken_back_advice(taken: TakenBack | None) -> tuple[str, ...]:
    """Where a departure is not said any more."""
    if taken is None:
        return ()
    return (
        f"what was said to depart at {taken.alarm_s:.0f} s was taken back at {taken.at_s:.0f} s: later measurements"
        " speak against it, or it has gone again; check the surveys in between",
    )


def noise_words(change: NoiseChange) -> str:
    """An axis whose readings scatter otherwise than before, in one line."""
    way = "grown" if change.factor > 1.0 else "fallen"
    return (
        f"noise of {change.axis} has {way}: at rest {change.of} scatter {change.factor:.2g} times what they did"
        f" ({1e3 * change.scatter_g:.2g} mg), since {change.since_s:.0f} s, in {change.rests} rests"
    )


def state_advice(age_s: float | None, misfit_g: float | None, undecided: int) -> tuple[str, ...]:
    """Where what is said is old (`age_s`; None: it is not), where the last reading is not gravity at all (`misfit_g`),
    and where it is not known yet whether noise has grown or something departs (`undecided` measurements)."""
    lines = []
    if age_s is not None:
        lines.append(
            f"for {age_s / 3600.0:.1f} h no rest and no rotation could be used: what is said here is of then; let the"
            " tool lie still, or turn with gyros recorded"
        )
    if misfit_g is not None:
        lines.append(
            f"the last reading does not fit: its length is {1e3 * misfit_g:+.0f} mg from gravity's; use it for nothing,"
            " and take another at once: a second one says that an axis is broken"
        )
    if undecided:
        last = "the last measurement is" if undecided == 1 else f"the last {undecided} measurements are"
        lines.append(
            f"{last} far from what was expected: noise that has grown, or a departure; take two"
            " or three rests more, which tell it, and trust no survey before"
        )
    return tuple(lines)


def noise_advice(changes: Sequence[NoiseChange]) -> tuple[str, ...]:
    """What to do about noise that has changed; nothing of the calibration departs by it."""
    grown = [one for one in changes if one.factor > 1.0]
    fallen = [one for one in changes if one.factor <= 1.0]
    lines = []
    if len(grown) == len(AXES):
        times = ", ".join(f"{one.axis} {one.factor:.2g} times" for one in grown)
        lines.append(
            f"all axes have become noisier ({times}): the tool shakes (pumps, rotation elsewhere in the string) or its"
            " supply is noisy; repeat the rest with the pumps off"
        )
    else:
        lines += [
            f"{one.axis} has become {one.factor:.2g} times as noisy, which is no departure: take longer rests, and look"
            " at that sensor, its plug and its supply at surface"
            for one in grown
        ]
    lines += [
        f"{one.axis} scatters {one.factor:.2g} times what it did: a filter was set, or the axis begins to stick;"
        " compare it in another attitude"
        for one in fallen
    ]
    return tuple(lines)
