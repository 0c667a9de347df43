"""What the single words in a tool's messages mean: states of its parts, flags of an attitude, reasons of a survey.

Messages carry them as identifiers, for programs; a page says them in the reader's language. A word that is not known
here, of a tool of another version, is shown as it came.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from highside.web.words import _, said_later, told

LINK = {
    "connecting": said_later("being opened, or no data yet"),
    "up": said_later("data arrive"),
    "stale": said_later("open, but silent"),
    "down": said_later("not open; tried again"),
    "ended": said_later("replay has ended"),
}
RECORDER = {
    "off": said_later("switched off"),
    "idle": said_later("ready"),
    "recording": said_later("writing to the disk"),
    "failing": said_later("the disk refuses"),
}
MOTION = {
    "none": said_later("no gyro data"),
    "vibrating": said_later("vibrating"),
    "turning": said_later("turning"),
    "quiet": said_later("quiet"),
    "still": said_later("still"),
}
"""of the filter that follows the azimuth"""
REASONS = {
    "moved": said_later("moved"),
    "g_total_low": said_later("Gtotal too low"),
    "g_total_high": said_later("Gtotal too high"),
    "too_cold": said_later("too cold"),
    "too_hot": said_later("too hot"),
    "temperature_unknown": said_later("temperature unknown"),
    "shock": said_later("shock"),
    "uncertain": said_later("too uncertain"),
    "no_correction": said_later("no calibration holds there"),
    "sensor_stuck": said_later("an axis is stuck"),
    "calibration_departs": said_later("the calibration departs"),
}
"""why a survey is refused, or doubted"""
FLAGS = {
    "uncalibrated": said_later("uncalibrated"),
    "no_calibration": said_later("no calibration was ever put in force"),
    "calibration_refused": said_later("calibration refused"),
    "calibration_kept": said_later("the calibration of before is kept"),
    "calibration_age_unknown": said_later("whether the calibration has expired is unknown"),
    "calibration_departs": said_later("the calibration departs"),
    "outside_zone": said_later("outside of the calibration's zone"),
    "temperature_outside": said_later("temperature outside of the calibrated range"),
    "temperature_unknown": said_later("temperature unknown"),
    "law_outside_range": said_later("a law of the calibration is outside of its range"),
    "law_not_applied": said_later("a law of the calibration is not applied"),
    "rolling_bias": said_later("the cross-axis offset of this turn-on is corrected"),
    "toolface_undefined": said_later("toolface undefined: too near vertical"),
    "low_inclination": said_later("toolface uncertain at this inclination"),
    "moving": said_later("moving"),
    "g_total": said_later("Gtotal is not one g"),
    "stuck_ax": said_later("x is stuck"),
    "stuck_ay": said_later("y is stuck"),
    "stuck_az": said_later("z is stuck"),
    "frozen": said_later("every reading is the same"),
    "gyro_saturated": said_later("gyro saturated"),
    "rotor_unknown": said_later("rotor angle unknown"),
    "rotation_outside": said_later("outside of the rotor-angle compensation"),
    "rotation_gap": said_later("a gap of the rotor-angle compensation"),
    "rotation_refused": said_later("rotor-angle compensation refused"),
    "rotation_kept": said_later("the rotor-angle compensation of before is kept"),
}
"""of an attitude; the README lists them"""

_FLAG = re.compile(r"flag (\w+)( is over)?")
_REFUSED = "survey refused: "


def meant(word: str, of: Mapping[str, str]) -> str:
    """A word of a message in the reader's language; one that is not known as it is."""
    return _(of[word]) if word in of else word


def all_meant(words: Iterable[str], of: Mapping[str, str]) -> str:
    """Several, in a line."""
    return ", ".join(meant(word, of) for word in words)


def event_words(what: str) -> str:
    """A line of a tool's log."""
    if found := _FLAG.fullmatch(what):
        return told(f"flag {meant(found[1], FLAGS)}{found[2] or ''}")
    if what.startswith(_REFUSED):
        return told(_REFUSED + all_meant(what.removeprefix(_REFUSED).split(", "), REASONS))
    return told(what)
