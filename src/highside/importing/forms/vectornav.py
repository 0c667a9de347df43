"""Lines of VectorNav sensors (`$VNYMR,...*CS`): checked by their sum, in the units of the data sheet (m/s2, rad/s).

Source: VN-100 user manual, asynchronous ASCII outputs. The lines carry no time: the rate is for the user to say.
"""

from __future__ import annotations

import re
from collections import Counter

import numpy as np

from highside.errors import InputError
from highside.importing.core.source import SourceTable, number_column
from highside.reading import decode_foreign

_MAG, _ACCEL, _GYRO = ("mag_x", "mag_y", "mag_z"), ("accel_x", "accel_y", "accel_z"), ("gyro_x", "gyro_y", "gyro_z")
LINES: dict[str, tuple[str, ...]] = {
    "VNYMR": ("yaw", "pitch", "roll", *_MAG, *_ACCEL, *_GYRO),
    "VNIMU": (*_MAG, *_ACCEL, *_GYRO, "temperature", "pressure"),
    "VNMAR": (*_MAG, *_ACCEL, *_GYRO),
}
"""name of a line to its fields"""
_UNITS = dict.fromkeys(_ACCEL, "m/s2") | dict.fromkeys(_GYRO, "rad/s") | {"temperature": "C"}
_LINE = re.compile(r"\$(VN[A-Z]{3}),([-+0-9.,eE]+)\*([0-9A-Fa-f]{2})\s*")
_BEGINS = re.compile(rb"(?m)^\$VN(?:YMR|IMU|MAR),")
_STARTS = tuple(f"${name}," for name in LINES)
HEAD = 4096
"""bytes by which it is recognised"""


def is_vectornav(data: bytes) -> bool:
    """Whether a line near the beginning is one of those above."""
    return _BEGINS.search(data[:HEAD]) is not None


def read_vectornav(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The lines of the kind that comes most often. Raises InputError where none passes its sum."""
    text, _ = decode_foreign(data, where=where)
    rows: dict[str, list[list[float]]] = {}
    failed: list[int] = []
    passed_over = 0
    for number, line in enumerate(text.split("\n"), 1):
        found = _LINE.fullmatch(line.strip())
        name = found[1] if found else ""
        if found is None or name not in LINES:
            if line.lstrip().startswith(_STARTS):
                failed.append(number)
            else:
                passed_over += bool(line.strip())
            continue
        try:
            values = [float(cell) for cell in found[2].split(",")]
        except ValueError:
            values = []
        if _sum_of(f"{name},{found[2]}") != int(found[3], 16) or len(values) != len(LINES[name]):
            failed.append(number)
            continue
        rows.setdefault(name, []).append(values)
    if not rows:
        raise InputError(
            "no line of VectorNav passes its sum", where=where, remedy="the file is torn, or of another kind"
        )
    kinds = Counter({name: len(found) for name, found in rows.items()})
    name = kinds.most_common(1)[0][0]
    block = np.array(rows[name]).T
    remarks = []
    if failed:
        shown = ", ".join(f"line {number}" for number in failed[:5])
        remarks.append(f"{len(failed)} lines fail their sum, omitted: {shown}{', ...' if len(failed) > 5 else ''}")
    other = sum(kinds.values()) - kinds[name] + passed_over
    if other:
        remarks.append(f"{other} other lines passed over")
    columns = tuple(
        number_column(field, values, _UNITS.get(field)) for field, values in zip(LINES[name], block, strict=True)
    )
    return (SourceTable(columns, f"VectorNav ASCII, {name}", where, stem, remarks=tuple(remarks)),)


def _sum_of(text: str) -> int:
    total = 0
    for byte in text.encode():
        total ^= byte
    return total
