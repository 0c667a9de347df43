"""What the name of a column says: its quantity, its axis, its unit. `Accel X (mg)`, `gyro_x_rads`, `t [us]`, `wz`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from highside.importing.core.units import SUFFIXES, Quantity, Unit, unit_named

_LONGEST_NAME = 255
"""characters: a longer one is no name that says anything"""
_IN_BRACKETS = re.compile(r"[\[(<{]([^\])>}]*)[\])>}]")
_WORDS = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_ACCEL = _words(
    "a acc accel accelerometer acceleration accelerations accl xacc yacc zacc specific imuacc total f force gforce"
    " beschleunigung akselerasjon versnelling accelerazione aceleracion"
)
_GYRO = _words(
    "gyr gyro gyroscope gyros w omega angular rotation angularrate rotationrate angvel rot"
    " drehrate winkelgeschwindigkeit vinkelhastighet angulaire"
)
_OTHER = _words(
    "mag magnetometer magnetic m compass field std var cov covariance bias quat q quaternion"
    " orientation pos position vel velocity lat lon gps noise sigma rms"
)
_TIME = _words(
    "t time timestamp timestamps ts stamp datetime date epoch millis micros nanos"
    " elapsed clock utc seconds times sampletime uptime"
    " zeit tid temps tijd tempo tiempo"
)
_TEMPERATURE = frozenset({"temp", "temperature", "tmp", "temperatures", "temperatur", "temperatuur"})
_REFERENCE = frozenset({"ref", "reference", "table", "bench", "true", "truth", "set", "nominal", "target"})
_REFERENCES = ("inc_ref_deg", "tf_ref_deg", "azi_ref_deg")
_NAMED_WITH_BLANKS = frozenset({"m_s2", "rad_s", "deg_s"})
"""units that end a name in two words"""
_AXIS_ALONE = frozenset({"axis"})
_OF_ROSTOPIC = "field."
"""before each name of what `rostopic echo -p` prints"""
_GLUED = re.compile(r"(a|acc|accel|acceleration|g|gyr|gyro|gyroscope|w|omega|f|m|mag)_?([xyz])", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a name says. `quantity` None where it says none; `axis` 0, 1, 2; `group` is the name without axis and unit,
    which the three columns of one triad share; `target` the column of ours it is by itself (`t_s`, `temp_c`)."""

    quantity: Quantity | None
    axis: int | None
    group: str
    unit: Unit | None
    target: str | None = None


def meaning(name: str, own_unit: str | None, known: frozenset[str], *, reference: bool = False) -> Meaning:
    """Read a name; `own_unit` is what the file says of the unit elsewhere, `known` the names of our own columns.

    `reference`: the file is the reference itself, so that an inclination in it is one.
    """
    if name in known:
        return _own(name, own_unit)
    if len(name) > _LONGEST_NAME:
        return Meaning(None, None, name, None)
    brackets = [text.strip() for text in _IN_BRACKETS.findall(name)]
    bare = _IN_BRACKETS.sub(" ", name).strip().removeprefix(_OF_ROSTOPIC)
    chunks = re.split(r"[\s_.]+", bare)
    if len(chunks) > 2 and "_".join(chunks[-2:]).lower() in _NAMED_WITH_BLANKS:
        chunks = [*chunks[:-2], "_".join(chunks[-2:])]
    tail = chunks[-1].lower() if len(chunks) > 1 and chunks[-1].lower() in SUFFIXES | _NAMED_WITH_BLANKS else None
    words = [word.lower() for word in _WORDS.findall(" ".join(chunks[:-1]) if tail else bare)]
    words = [*words, tail] if tail else words
    index = next((int(text) for text in brackets if text in ("0", "1", "2")), None)
    unit_text = own_unit or next((text for text in brackets if text not in ("0", "1", "2")), None)
    unit = unit_named(unit_text) if unit_text else None
    if unit is None and len(words) > 1 and words[-1] in SUFFIXES | _NAMED_WITH_BLANKS:
        unit = unit_named(words[-1])
        words = words[:-1] if unit is not None else words
    elif unit is None and bare and bare.lower() in ("millis", "micros", "seconds", "milliseconds", "microseconds"):
        unit = unit_named(bare)
    axis, words = _axis(words, index)
    quantity, target = _quantity(words, axis, reference)
    if quantity is None and axis is None and unit is not None:
        # words that are not known, of a unit that but one of our columns has
        target = {Quantity.TIME: "t_s", Quantity.TEMPERATURE: "temp_c"}.get(unit.quantity)
        quantity = unit.quantity if target else None
    if quantity is None and axis is not None and unit is not None and set(words) <= _AXIS_ALONE:
        # `x-axis (g)`: the unit alone says of what
        quantity = unit.quantity if unit.quantity in (Quantity.ACCELERATION, Quantity.RATE) else None
        words = [unit.quantity.value] if quantity else words
    if unit is not None and quantity is not None and unit.quantity is not quantity:
        # a name may speak of two things at once; the last word was none of this quantity
        unit = unit_named(unit_text, quantity) if unit_text else None
    return Meaning(quantity, axis, " ".join(words), unit, target)


def counted_from_one(names: Sequence[str]) -> dict[str, str]:
    """Names `acc_1` to `acc_3`, as MATLAB numbers the columns of a variable, as `acc_0` to `acc_2`."""
    there, found = set(names), {}
    for name in names:
        stem, number = name[:-1], name[-1:]
        if (
            number in ("1", "2", "3")
            and {f"{stem}{k}" for k in (1, 2, 3)} <= there
            and not ({f"{stem}0", f"{stem}4"} & there)
        ):
            found[name] = f"{stem}{int(number) - 1}"
    return found


def _own(name: str, own_unit: str | None) -> Meaning:
    """Of one of our own names, which carries its unit."""
    tail = name.rsplit("_", 1)[-1]
    kinds = {
        "g": Quantity.ACCELERATION,
        "dps": Quantity.RATE,
        "deg": Quantity.ANGLE,
        "c": Quantity.TEMPERATURE,
        "s": Quantity.TIME,
    }
    quantity = kinds.get(tail, Quantity.NUMBER)
    triad = re.fullmatch(r"([ag])([xyz])_(?:g|dps)", name)
    axis = "xyz".index(triad[2]) if triad else None
    stated = unit_named(own_unit, quantity) if own_unit else None
    return Meaning(quantity, axis, triad[1] if triad else name, stated or unit_named(tail, quantity), name)


def _axis(words: list[str], index: int | None) -> tuple[int | None, list[str]]:
    """The axis, and the words without it."""
    for place in range(len(words) - 1, -1, -1):
        if words[place] in ("x", "y", "z"):
            return "xyz".index(words[place]), words[:place] + words[place + 1 :]
    for place in range(len(words) - 1, -1, -1):
        glued = _GLUED.fullmatch(words[place])
        if glued:
            return "xyz".index(glued[2]), [*words[:place], glued[1], *words[place + 1 :]]
    if index is None and len(words) > 1 and words[-1] in ("0", "1", "2"):
        return int(words[-1]), words[:-1]
    return index, words


def _quantity(words: list[str], axis: int | None, reference: bool) -> tuple[Quantity | None, str | None]:
    """What the words speak of, and which column of ours that is where there is but one of it."""
    spoken = set(words)
    if axis is not None:
        if spoken & _OTHER and not spoken >= {"angular", "velocity"}:
            return None, None
        if spoken & _GYRO or (spoken == {"g"}):
            return Quantity.RATE, None
        return (Quantity.ACCELERATION, None) if spoken & _ACCEL else (None, None)
    if spoken & _TEMPERATURE and not spoken & _TIME:
        return Quantity.TEMPERATURE, "temp_c"
    reference = reference or bool(spoken & _REFERENCE)
    if reference and spoken & {"inc", "inclination", "incl"}:
        return Quantity.ANGLE, "inc_ref_deg"
    if reference and spoken & {"tf", "toolface", "gtf"}:
        return Quantity.ANGLE, "tf_ref_deg"
    if reference and spoken & {"azi", "azimuth", "heading"}:
        return Quantity.ANGLE, "azi_ref_deg"
    if spoken & {"rotor", "encoder"}:
        return (Quantity.RATE, "rotor_rate_dps") if spoken & {"rate", "speed", "rpm"} else (Quantity.ANGLE, "rotor_deg")
    if spoken & _TIME:
        return Quantity.TIME, "t_s"
    return None, None


def possible_references(kept: Sequence[str], taken: Sequence[str]) -> dict[str, str]:
    """Reference columns that no column of the file is taken for, and the first column whose name could speak of each.

    `kept`: names of columns that go over as they are; `taken`: columns of ours that are found. An inclination may be
    what the bench was set to or what the tool made of its own readings; only the user knows.
    """
    found: dict[str, str] = {}
    for name in kept:
        target = meaning(name, None, frozenset(), reference=True).target
        if target in _REFERENCES and target not in taken:
            found.setdefault(target, name)
    return found
