"""What the parameters of effects are called in a report: their ids are those of formulas and files."""

from __future__ import annotations

from highside.physics.effects import all_effects
from highside.words import _, said_later

_COSINE, _SINE = said_later("cosine amplitude"), said_later("sine amplitude")
_TAU = said_later("time constant")
_AMPLITUDE = said_later("amplitude")
_STEP = said_later("size of the step")
_WHEN = said_later("time of the step")
_HYSTERESIS = said_later("hysteresis")
OF_EFFECTS = {
    ("clock_skew", "eps"): said_later("share of the rate"),
    ("time_offset", "t0"): said_later("time offset"),
    ("axis_nonorthogonality", "eps"): said_later("error of the right angle"),
    ("backlash", "h_tf"): said_later("backlash of the toolface"),
    ("backlash", "h_inc"): said_later("backlash of the inclination"),
    ("wobble", "ck"): said_later("cosine amplitude of inclination"),
    ("wobble", "sk"): said_later("sine amplitude of inclination"),
    ("wobble", "dk"): said_later("cosine amplitude across"),
    ("wobble", "tk"): said_later("sine amplitude across"),
    ("reference_twist", "k"): said_later("twist"),
    ("sag", "s"): said_later("deflection"),
    ("stiction", "w"): said_later("lost motion"),
    ("base_tilt", "tilt_x"): said_later("tilt in the plane of inclination"),
    ("base_tilt", "tilt_y"): said_later("tilt across the plane of inclination"),
    ("mounting", "tilt_x"): said_later("tilt about x"),
    ("mounting", "tilt_y"): said_later("tilt about y"),
    ("mounting", "roll"): said_later("roll about z"),
    ("size_effect", "x_x"): said_later("place of the x sensor along x"),
    ("size_effect", "y_x"): said_later("place of the x sensor along y"),
    ("size_effect", "x_y"): said_later("place of the y sensor along x"),
    ("size_effect", "y_y"): said_later("place of the y sensor along y"),
    ("aliased_vibration", "c"): _COSINE,
    ("aliased_vibration", "s"): _SINE,
    ("tone", "c"): _COSINE,
    ("tone", "s"): _SINE,
    ("bias_step", "a"): _STEP,
    ("gyro_bias_step", "a"): _STEP,
    ("thermal_lag", "c"): said_later("temperature coefficient"),
}
"""Titles of parameters that are called otherwise elsewhere, by the effect and the name, or what stands before the axis
in it."""
TITLES = {
    "a": _AMPLITUDE,
    "b": said_later("zero offset"),
    "b2": said_later("second-order temperature coefficient"),
    "b3": said_later("third-order temperature coefficient"),
    "bit": said_later("binary digit"),
    "bt": said_later("temperature coefficient"),
    "c": _COSINE,
    "c1": _COSINE,
    "c2": _COSINE,
    "ck": _COSINE,
    "d": said_later("drift"),
    "density": said_later("noise density"),
    "e_inc": said_later("share of the move of inclination"),
    "e_tf": said_later("share of the move of toolface"),
    "f": said_later("frequency"),
    "g": said_later("sensitivity"),
    "h": _HYSTERESIS,
    "inc_pose": said_later("scatter of inclination by pose"),
    "inc_station": said_later("scatter of inclination by station"),
    "k": said_later("order"),
    "k2": said_later("quadratic coefficient"),
    "k3": said_later("cubic coefficient"),
    "ka": said_later("asymmetry"),
    "ko": said_later("odd quadratic coefficient"),
    "kv": said_later("rectification"),
    "level": said_later("level"),
    "limit": said_later("limit"),
    "lost": said_later("share of lost frames"),
    "lsb": said_later("step of the converter"),
    "m": said_later("misalignment"),
    "mt": said_later("temperature coefficient"),
    "n": said_later("order"),
    "q": said_later("noise by vibration"),
    "r": said_later("distance from the axis"),
    "repeated": said_later("share of repeated frames"),
    "s": said_later("scale factor error"),
    "s1": _SINE,
    "s2": _SINE,
    "share": said_later("share"),
    "sigma": said_later("standard deviation"),
    "sk": _SINE,
    "st": said_later("temperature coefficient"),
    "stuck": said_later("stuck"),
    "t0": _WHEN,
    "tau": _TAU,
    "tf_pose": said_later("scatter of toolface by pose"),
    "tf_station": said_later("scatter of toolface by station"),
    "v": said_later("velocity"),
    "vd": said_later("change per second"),
    "vt": said_later("change per degree"),
    "width": said_later("width"),
}
"""Titles of the others."""


def parameter_name(effect: str, name: str) -> str:
    """A parameter of an effect in the reader's language, with its axis and, where it has any, the inputs that act on
    it; what is not known as it is, as a parameter of an effect that somebody has added."""
    if effect not in all_effects():
        return name
    if (whole := OF_EFFECTS.get((effect, name)) or TITLES.get(name)) is not None:
        return _(whole)
    base, _mark, rest = name.partition("_")
    title = OF_EFFECTS.get((effect, base)) or TITLES.get(base)
    if base == "k" and effect == "cross_product":
        title = said_later("response")
    axis, inputs = (rest[:1], rest[1:].lstrip("_"))
    if title is None or axis not in ("x", "y", "z") or set(inputs) - set("xyz"):
        return name
    if inputs:
        return _("%(what)s of %(axis)s by %(inputs)s", what=_(title), axis=axis, inputs="×".join(inputs))
    return _("%(what)s of %(axis)s", what=_(title), axis=axis)
