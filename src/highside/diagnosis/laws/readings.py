"""From a law to physics: what a place, a covariate and a shape may be, and what would tell such readings apart.

Suggestions, and worded so: the law is the finding. To add one, add a row.
"""

from __future__ import annotations

from dataclasses import dataclass

from highside.physics.covariates import FILTERED, lag_of


@dataclass(frozen=True)
class Reading:
    """Where it applies (empty: anywhere) and what it says. `shapes` are kinds of functions of a formula."""

    places: tuple[str, ...]
    covariates: tuple[str, ...]
    shapes: tuple[str, ...]
    meaning: str
    apart: str


READINGS = (
    Reading(("offset",), ("temp",), (), "temperature drift of the zero offset", "a ramp up and one down"),
    Reading(
        ("offset",),
        (*FILTERED, "temp_rate"),
        (),
        "temperature differences within the sensor, or a thermometer away from it",
        "hold a temperature until nothing changes",
    ),
    Reading(
        ("scale",),
        ("temp", *FILTERED),
        (),
        "temperature coefficient of one axis' scale",
        "the same poses at two temperatures",
    ),
    Reading(
        ("scale_all",),
        ("temp", "time"),
        (),
        "the reference voltage of the converter drifts",
        "record the reference, or a second sensor on it",
    ),
    Reading(
        ("matrix",),
        ("temp", *FILTERED),
        (),
        "the axes turn against the housing as it warms",
        "the same poses at two temperatures",
    ),
    Reading(
        ("offset",),
        ("load",),
        ("modulus", "odd_power"),
        "a suspension with two sides, or a converter that differs in sign",
        "poses close to zero load",
    ),
    Reading(
        ("offset",),
        ("load",),
        ("power", ""),
        "a response of the axis that is no straight line",
        "poses all over its range, both signs",
    ),
    Reading(
        ("offset",),
        ("load", "load_x", "load_y", "load_z"),
        (),
        "response to the load, on the axis or across it",
        "poses in which the loads differ",
    ),
    Reading(
        (),
        ("previous_load",),
        (),
        "hysteresis: the sensor or its mounting remembers the pose before",
        "the same pose from two others",
    ),
    Reading((), ("time_since_move",), (), "settling or creep after a move", "hold one pose for long"),
    Reading(
        ("offset", "scale"),
        ("time",),
        ("step",),
        "a shock, or a contact that changed",
        "look at what happened then; return to the first pose",
    ),
    Reading(
        ("offset", "scale", "scale_all"),
        ("time",),
        ("decay", "exponential"),
        "warming up after power came on",
        "start cold again",
    ),
    Reading(
        ("offset",),
        ("time",),
        ("sine",),
        "a line of the mains that is sampled too slowly, a pump, or a controller that hunts",
        "hold one pose for some periods; record at another rate",
    ),
    Reading(
        ("offset", "scale", "scale_all"),
        ("time",),
        (),
        "ageing or a slow drift, or what was not recorded",
        "return to the first pose from time to time; record the temperature",
    ),
    Reading(
        ("inclination", "toolface"),
        ("tf",),
        ("dent", "bump"),
        "a dent or a particle in the bearing, at one toolface",
        "turn the tool against the rotor and repeat",
    ),
    Reading(
        ("offset", "inclination", "toolface"),
        ("tf_fraction",),
        (),
        "a gear, or a cage of a bearing: an order that is no whole number",
        "two full turns and more",
    ),
    Reading(
        ("inclination",),
        ("inc",),
        (),
        "eccentric or stretched scale of the inclination encoder, or sag",
        "the same inclinations from the other side",
    ),
    Reading(
        ("toolface",),
        ("tf",),
        (),
        "eccentric or stretched scale of the toolface encoder",
        "turn the encoder against the shaft and repeat",
    ),
    Reading(
        ("inclination", "level"),
        ("time",),
        (),
        "the bench leans more and more",
        "level it between rounds; record a level",
    ),
    Reading(
        ("inclination", "level"),
        ("temp",),
        (),
        "the bench bends with temperature",
        "the same poses at another temperature of the room",
    ),
    Reading((), ("tf",), (), "something that comes round with each turn", "turn the tool against the rotor and repeat"),
    Reading(
        ("offset", "gyro_offset"),
        ("rate",),
        (),
        "electrical pick-up, or friction: it follows the rate and not its square",
        "both senses of rotation at each rate",
    ),
    Reading(
        (),
        ("rate_sign",),
        (),
        "backlash, or friction that turns with the sense of rotation",
        "the same stations from both sides",
    ),
    Reading((), ("acceleration",), (), "a flexible shaft, or a sensor away from the axis", "other ramps"),
    Reading((), ("vibration",), (), "rectified vibration", "the same pose with the shaker off"),
    Reading(
        ("gyro_offset",),
        ("temp", "time"),
        (),
        "offset of the gyros over temperature or after power came on",
        "stand still at two temperatures",
    ),
    Reading(
        ("timing", "channel_delay"), (), (), "a clock, or a filter whose delay changes", "a sharp move every minute"
    ),
    Reading(("channel_factor",), (), (), "a constant of the simulation that is none", "vary it alone"),
)


def readings_of(place: str, depends_on: tuple[str, ...], shapes: tuple[str, ...]) -> tuple[str, ...]:
    """What a law may be, the nearest first."""
    # what one lag may be, every lag may
    names = {FILTERED[0] if lag_of(name) else name for name in depends_on}
    found = [
        f"{r.meaning} (to tell: {r.apart})"
        for r in READINGS
        if (not r.places or place in r.places)
        and (not r.covariates or names & set(r.covariates))
        and (not r.shapes or set(shapes or ("",)) & set(r.shapes))
    ]
    return tuple(dict.fromkeys(found))[:MOST]


MOST = 3
"""readings that are reported of one law"""
