"""The files of the journal of acts: lines of JSON chained by hashes, in files of bounded size.

    acts.jsonl              the newest lines
    acts-000001.jsonl, ...  those before, the oldest first: full, and not written any more

`h` at the end of a line is the first 32 digits of the SHA-256 of the `h` before it and of this line without it, through
all files: a line that is changed, taken out or put in between is found. Not found is what is cut off at the end, as of
any journal that lies where it is written. Lines of earlier versions have no `h`; the chain begins after them.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from highside.errors import InputError
from highside.reading import parse_json, read_bytes
from highside.reading.files import OPEN_FLAGS
from highside.recording.files import flush_directory
from highside.recording.locks import lock

FILE_MAX = 1_000_000
"""Bytes of one file: some 4,000 acts."""
TAIL = 64_000
"""Bytes from the end in which the last line is looked for; the longest act has some 2,000."""
_HASH = re.compile(r',"h":"([0-9a-f]{32})"\}$')


@dataclass(frozen=True, slots=True)
class Checked:
    """What a journal's chain says. `trouble`: where it breaks first, empty where it does not."""

    lines: int
    files: int
    trouble: str = ""


class ChainedLines:
    """The files of one journal, named by the newest. Several processes may write."""

    def __init__(self, path: Path, file_max: int = FILE_MAX) -> None:
        self.path = path
        self._file_max = file_max

    def append(self, line: Mapping[str, Any]) -> None:
        """One line, on the disk when this returns. Raises OSError."""
        text = json.dumps(line, ensure_ascii=False).encode("utf-8", "replace").decode()
        with self._locked():
            tail = _tail(self.path)
            if not tail and (full := self.full()):
                tail = _tail(full[-1])
            chained = _chained(_last_hash(tail), text).encode()
            size = self.path.stat().st_size if self.path.exists() else 0
            if size and size + len(chained) > self._file_max:
                self._set_aside()
            elif tail and not tail.endswith(b"\n") and size:
                # the power went in the middle of a line: it stays what it is, a line of its own
                chained = b"\n" + chained
            descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | OPEN_FLAGS, 0o600)
            try:
                os.write(descriptor, chained)
                os.fsync(descriptor)
            finally:
                os.close(descriptor)

    def full(self) -> list[Path]:
        """The files that are not written any more, the oldest first."""
        return sorted(self.path.parent.glob(f"{self.path.stem}-[0-9][0-9][0-9][0-9][0-9][0-9]{self.path.suffix}"))

    def files(self) -> list[Path]:
        """All of them, the oldest first."""
        return self.full() + ([self.path] if self.path.exists() else [])

    def check(self) -> Checked:
        """Follow the chain through all files. Raises InputError where one cannot be read."""
        before, begun, count, files = "", False, 0, self.files()
        for number, path in enumerate(self.full(), 1):
            if not path.stem.endswith(f"-{number:06d}"):
                return Checked(0, len(files), f"{self._numbered(number).name} is missing")
        for path in files:
            for number, raw in enumerate(read_bytes(path).split(b"\n"), 1):
                text = raw.decode("utf-8", "replace")
                if not text.strip():
                    continue
                found = _HASH.search(text)
                if found is None and (not begun or _is_torn(text)):
                    continue
                if found is None or _digest(before, text[: found.start()] + "}") != found[1]:
                    return Checked(count, len(files), f"{path.name} line {number} does not follow from the one before")
                before, begun, count = found[1], True, count + 1
        return Checked(count, len(files))

    def _set_aside(self) -> None:
        full = self.full()
        number = 1 + (int(full[-1].stem[-6:]) if full else 0)
        self.path.rename(self._numbered(number))
        flush_directory(self.path.parent)

    def _numbered(self, number: int) -> Path:
        return self.path.with_name(f"{self.path.stem}-{number:06d}{self.path.suffix}")

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Held while the last line is read and the next one written, of one process against another."""
        descriptor = os.open(self.path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | OPEN_FLAGS, 0o600)
        try:
            lock(descriptor, wait=True)
            yield
        finally:
            os.close(descriptor)


def _tail(path: Path) -> bytes:
    """The end of a file; nothing of one that is not there."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - TAIL))
            return file.read(TAIL)
    except FileNotFoundError:
        return b""


def _last_hash(tail: bytes) -> str:
    """Of the last whole line; nothing where none has one."""
    for raw in reversed(tail.split(b"\n")[:-1]):
        if (found := _HASH.search(raw.decode("utf-8", "replace"))) is not None:
            return found[1]
    return ""


def _chained(before: str, text: str) -> str:
    return f'{text[:-1]},"h":"{_digest(before, text)}"}}\n'


def _digest(before: str, text: str) -> str:
    return hashlib.sha256((before + text).encode("utf-8", "replace")).hexdigest()[:32]


def _is_torn(text: str) -> bool:
    """Whether a line is no JSON: what the end of the power left of one."""
    try:
        parse_json(text)
    except InputError:
        return True
    return False
