"""A changed configuration before it is saved: whether `highside check` takes it, and what a reload would change.

It is written beside the file, so that relative names in it mean the same, checked by a process of its own, and removed.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from highside.config.settings import Settings, load
from highside.config.tools import has_tools, load_tools
from highside.errors import HighsideError, Refused
from highside.reading import decode_text, parse_toml, read_bytes
from highside.recording.files import write_whole
from highside.service.reload import ONLY_BY_RESTART
from highside.web.words import _, said
from highside.words import language
from highside.words.errors import error_told

TEXT_MAX = 100_000
"""Letters of a configuration; the longest of the examples has 9,000."""
CHECK_WITHIN_S = 60.0
FORCE_TABLES = ("calibration", "rotation", "watch", "drift")
"""Tables that decide which calibration counts and what is believed of it: for who may put in force."""


@dataclass(frozen=True, slots=True)
class FieldChange:
    """One field that a reload would change. `restart`: only a restart does."""

    field: str
    before: str
    after: str
    restart: bool


@dataclass(frozen=True, slots=True)
class Proposal:
    """What was found. `trouble`: why it cannot be saved; `said`: what the check says, as on a terminal; `by_check`:
    `trouble` is in English."""

    trouble: str | None
    said: str
    changes: tuple[FieldChange, ...] = ()
    by_check: bool = False

    @property
    def for_force(self) -> bool:
        """Whether it changes which calibration counts."""
        return any(table in change.field.split(".") for change in self.changes for table in FORCE_TABLES)


def read_text(path: Path) -> tuple[str, str]:
    """The file's text and its SHA-256, by which a change meanwhile is noticed. Raises InputError."""
    data = read_bytes(path, max_bytes=4 * TEXT_MAX)
    return decode_text(data, where=path.name, expected="TOML file"), hashlib.sha256(data).hexdigest()


def propose(path: Path, text: str) -> Proposal:
    """Check a text that is to take the file's place. Raises InputError where it cannot be written beside the file."""
    if len(text) > TEXT_MAX:
        return Proposal(_("has %(count)s characters: at most %(most)s") % {"count": len(text), "most": TEXT_MAX}, "")
    with _beside(path, text) as candidate:
        try:
            if "plan" in parse_toml(text, where=path.name):
                return Proposal(f"{path.name}: " + _("is the file of a bench session"), "")
            after = _every(candidate)
        except HighsideError as error:
            trouble = error_told(error, "settings")
            return Proposal(_told(trouble, candidate, path), "", by_check=trouble == str(error))
        done = subprocess.run(
            [sys.executable, "-c", _CHECK, "check", "--language", language(), str(candidate)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=CHECK_WITHIN_S,
            check=False,
        )
        heard = _told((done.stdout + done.stderr).strip(), candidate, path)
    if done.returncode != 0:
        return Proposal(heard or _("the check failed"), "")
    try:
        before = _every(path)
    except HighsideError:
        # the file as it is cannot be loaded: everything is new
        before = {}
    return Proposal(None, heard, tuple(_changes(before, after)))


def save(path: Path, text: str, seen: str) -> Path:
    """Put a checked text in the file's place, and keep the old one; where that is kept. Raises Refused where the file
    is not the one that was `seen`, InputError where it cannot be written."""
    old, now = read_text(path)
    if now != seen:
        raise Refused(said("the file was changed meanwhile: look at it again"))
    kept = path.with_name(f"{path.name}.{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{secrets.token_hex(2)}")
    mode = path.stat().st_mode & 0o777
    write_whole(kept, old.encode())
    kept.chmod(mode)
    write_whole(path, text.encode())
    path.chmod(mode)
    return kept


_CHECK = "import sys; from highside.cli.commands import run; sys.exit(run(sys.argv[1:]))"


def _every(path: Path) -> dict[str, Settings]:
    """The settings by tool."""
    found = load_tools(path) if has_tools(path) else (load(path),)
    return {settings.tool.id: settings for settings in found}


def _changes(before: Mapping[str, Settings], after: Mapping[str, Settings]) -> Iterator[FieldChange]:
    one = len(after) == 1 and len(before) <= 1
    if one and list(before) != list(after) and before:
        # one tool under another name: compared as the same
        before = {next(iter(after)): next(iter(before.values()))}
    for tool in sorted({*before, *after}):
        old = _flat(before[tool].model_dump(mode="json")) if tool in before else {}
        new = _flat(after[tool].model_dump(mode="json")) if tool in after else {}
        for field in sorted({*old, *new}):
            if old.get(field) != new.get(field):
                named = field if one else f"{tool}: {field}"
                restart = any(field == fixed or field.startswith(f"{fixed}.") for fixed in ONLY_BY_RESTART)
                yield FieldChange(named, old.get(field, "–"), new.get(field, "–"), restart)


def _flat(tables: Any, name: str = "") -> dict[str, str]:
    if isinstance(tables, dict) and tables:
        return {
            field: value
            for key, table in tables.items()
            for field, value in _flat(table, f"{name}.{key}" if name else str(key)).items()
        }
    return {name: "–" if tables is None else str(tables)}


@contextlib.contextmanager
def _beside(path: Path, text: str) -> Iterator[Path]:
    candidate = path.with_name(f".{path.stem}.{secrets.token_hex(6)}.toml")
    write_whole(candidate, text.encode())
    try:
        yield candidate
    finally:
        with contextlib.suppress(OSError):
            candidate.unlink()


def _told(text: str, candidate: Path, path: Path) -> str:
    """With the name of the file that it is about, and without the place on this machine's disk."""
    for name in (str(candidate), str(candidate.resolve()), candidate.name):
        text = text.replace(name, path.name)
    return text.replace(f"{path.resolve().parent}{os.sep}", "")
