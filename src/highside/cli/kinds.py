"""What a file is that stands where an answer is to be written, by its content.

An answer takes the place of one of its own kind, so that a command can be run again; of nothing else. Two recordings
cannot be told apart by what they are: one that somebody imported is of the same kind as one that was simulated.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from highside.errors import InputError

MODEL_MARK = "# Written by highside diagnose."
"""first line of a model file that a command wrote; a person's has none"""
_PAGE_MARK = b'<meta name="generator" content="highside">'


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of answer: what it is called, and whether a file is one."""

    words: str
    is_one: Callable[[Path], bool]


def refuse_another_kind(path: Path, kind: Kind, option: str) -> None:
    """Raises InputError where a file stands that is not of this kind; an empty one is nobody's."""
    if not path.is_file():
        return
    try:
        if path.stat().st_size == 0 or kind.is_one(path):
            return
    except OSError:
        return  # whoever writes will say why it cannot be
    raise InputError(
        f"is there already and is not {kind.words}, and so is not replaced",
        where=str(path),
        field=option,
        remedy="name another file, or take this one away",
    )


def _head(path: Path) -> bytes:
    """As `peek.head`. Numerics are loaded with the readers: a command without a file to look at needs them not yet."""
    from highside.reading import peek

    return peek.head(path)


def _document(path: Path) -> dict[str, Any]:
    """The JSON object of a file; empty for any other."""
    from highside.reading import parse_json, peek
    from highside.reading.files import read_bytes

    try:
        found = parse_json(read_bytes(path)) if path.stat().st_size <= peek.LONGEST_BYTES else None
    except InputError:
        return {}
    return found if isinstance(found, dict) else {}


def _of_schema(*names: str) -> Callable[[Path], bool]:
    return lambda path: str(_document(path).get("schema", "")).split("/")[0] in names


def _has(*names: str) -> Callable[[Path], bool]:
    """Whether a table has a column for each name (a regular expression)."""

    def is_one(path: Path) -> bool:
        from highside.reading import peek

        columns = peek.column_names(path)
        return all(any(re.fullmatch(name, column) for column in columns) for name in names)

    return is_one


def _is_table(path: Path) -> bool:
    """A recording or a pose table, in any form that is written."""
    start = _head(path)[:64]
    if start.startswith(b"\x89MCAP"):
        return b"highside" in start
    return any(is_one(path) for is_one in (_has("t_s"), _is_poses, _has("inc_ref_deg", "tf_ref_deg")))


def _is_poses(path: Path) -> bool:
    return _has("ax", "ay", "az")(path) and not _has("t_s")(path)


def _is_page(path: Path) -> bool:
    return _PAGE_MARK in _head(path)[:4096]


def _is_certificate(path: Path) -> bool:
    """HTML, or a PDF that was made from it: its creator is in one of its packed streams."""
    from highside.reading import peek

    if _head(path).startswith(b"%PDF-"):
        return any(b"(highside)" in part for part in peek.pdf_streams(path))
    return _is_page(path)


RECORD = Kind("a calibration record", _of_schema("highside.calibration"))
COMPENSATION = Kind("a compensation", _of_schema("highside.rotation"))
TABLE = Kind("a recording or a pose table", _is_table)
RECORDING = Kind("a recording", _has("t_s"))
POSES = Kind("a pose table", _is_poses)
CORRECTED = Kind("a table of corrected readings", _has("inc_std_deg", "tf_std_deg"))
COMPENSATED = Kind("a table of compensated rows", _has(r"\w+_comp_(deg|arcmin)"))
AZIMUTHS = Kind("a table of azimuths", _has("t_s", "azi_deg", "azi_std_deg"))
VERIFICATION = Kind("a verification", lambda path: _document(path).get("kind") in ("verification", "roll_test"))
ERROR_MODEL = Kind("a tool model of ours", lambda path: "highside" in _document(path))
PAGE = Kind("a page of ours", _is_page)
CERTIFICATE = Kind("a certificate", _is_certificate)
DIGITAL = Kind(
    "a digital certificate of ours",
    lambda path: b"digitalCalibrationCertificate" in (start := _head(path)) and b"highside" in start,
)
MODEL = Kind("a model file of a diagnosis", lambda path: _head(path).startswith(MODEL_MARK.encode()))
STATIONS = Kind(
    "a survey list of ours",
    lambda path: _has("inc_deg", "md_m|seq|t")(path) or (_head(path)[:1] in b"~<" and b"highside" in _head(path)),
)
TRUTH = Kind("a simulation's truth", _of_schema("highside.truth", "highside.drift-truth"))
ANALYSIS = {
    name: Kind(f"a {name} of ours", _of_schema(f"highside.{schema}"))
    for name, schema in (("diagnosis.json", "diagnosis"), ("watch.json", "watch"), ("surveys.json", "surveys"))
}
PAPER = Kind(
    "the numbers of a paper", _of_schema(*(f"highside.reproduce-{name}" for name in ("balance", "rotation", "drift")))
)
SIGNATURE = Kind("a signature", lambda path: _document(path).get("scheme") == "highside.signature/1")
