"""A compensation to keep: the curves of the channels, where they hold, a version and a hash of all of it.

The content is plain data; its id is the SHA-256 of its canonical JSON, and whoever changes a digit is found out.
Coefficients of roll, pitch and heading depend on the attitude of the vehicle (an encoder error of 1' is 0.17' of pitch
at a roll of 10 degrees), so the attitude at which they were fitted is part of it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from highside.errors import InputError, Refused
from highside.printable import printable
from highside.reading import MALFORMED, parse_json
from highside.rotation.curve import ErrorCurve
from highside.rotation.direction import RotorMotion
from highside.version import __version__

SCHEMA = "highside.rotation/1"
UNIT = "arcmin"


@dataclass(frozen=True, slots=True)
class Validity:
    """The attitude at which it was fitted, deg, and for how far from it it may be used; None: not stated."""

    inclination_deg: float | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    within_deg: float = 5.0

    def to_dict(self) -> dict[str, float | None]:
        return {
            "inclination_deg": self.inclination_deg,
            "roll_deg": self.roll_deg,
            "pitch_deg": self.pitch_deg,
            "within_deg": self.within_deg,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Raises KeyError, TypeError or ValueError for data that `to_dict` did not make."""

        def number(name: str) -> float | None:
            return None if data[name] is None else float(data[name])

        return cls(
            number("inclination_deg"), number("roll_deg"), number("pitch_deg"), within_deg=float(data["within_deg"])
        )


@dataclass(frozen=True, slots=True)
class Compensation:
    """Curves by channel (`roll`, `pitch`, `heading`, or any name), in arcminutes; `source` names the recording,
    `motion` says how the rotor moved in it (None: not known)."""

    curves: Mapping[str, ErrorCurve]
    validity: Validity
    source: str
    source_sha256: str
    motion: RotorMotion | None = None
    software_version: str = __version__
    """that made it: a part of its id, which stays the same whichever version reads it"""

    def content(self) -> dict[str, Any]:
        """Everything but the id, as plain data."""
        # absent where it is not known, so that compensations made without keep their ids
        motion = {} if self.motion is None else {"motion": self.motion.to_dict()}
        return {
            **motion,
            "schema": SCHEMA,
            "unit": UNIT,
            "software": {"name": "highside", "version": self.software_version},
            "source": {"name": self.source, "sha256": self.source_sha256},
            "validity": self.validity.to_dict(),
            "curves": {name: curve.to_dict() for name, curve in self.curves.items()},
        }

    def to_json(self) -> str:
        """The file's text: the content and its id."""
        content = self.content()
        return json.dumps({"id": content_hash(content), **content}, indent=1, allow_nan=False) + "\n"

    @property
    def id(self) -> str:
        return content_hash(self.content())

    @classmethod
    def from_json(cls, text: str | bytes, *, where: str | None = None) -> Self:
        """Raises InputError for what is no compensation, Refused for one that was changed or is of another version."""
        remedy = "give a file made by rotation fit"
        data = parse_json(text, where=where, kind="compensation", remedy=remedy)
        if not isinstance(data, dict) or "schema" not in data or "id" not in data:
            raise InputError("is no compensation", where=where, remedy=remedy)
        at = f"{where}: " if where else ""
        if data["schema"] != SCHEMA:
            raise Refused(
                f"{at}its schema is {printable(str(data['schema']))[:60]!r}, this version reads {SCHEMA!r}: fit the"
                " recording again with rotation fit"
            )
        content = {name: value for name, value in data.items() if name != "id"}
        if content_hash(content) != data["id"]:
            raise Refused(f"{at}its content is not the one its id was made from: it was changed; fit again")
        if data.get("unit") != UNIT:
            raise Refused(f"{at}its unit is {data.get('unit')!r}, not {UNIT!r}")
        try:
            validity = Validity.from_dict(data["validity"])
            curves = {str(name): ErrorCurve.from_dict(one) for name, one in data["curves"].items()}
            motion = None if "motion" not in data else RotorMotion.from_dict(data["motion"])
            source, version = data["source"], str(data["software"]["version"])
            found = cls(curves, validity, str(source["name"]), str(source["sha256"]), motion, version)
            _ = found.id  # a text that reads as `nan` would be found out only when it is used
            return found
        except MALFORMED as error:
            raise InputError(f"is no whole compensation ({error})", where=where, remedy=remedy) from None


def content_hash(content: Mapping[str, Any]) -> str:
    """SHA-256 of the canonical JSON (sorted keys, no spaces)."""
    return hashlib.sha256(
        json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    ).hexdigest()
