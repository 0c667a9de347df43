"""Damage to files and messages: by bytes, by numbers, and by the structure of a JSON document.

All of it is seeded. Every act is as likely as every other, so that no kind of damage is rare; an input gets one to
three.
"""

from __future__ import annotations

import copy
import gzip
import random
import re
from collections.abc import Callable, Iterator
from typing import Any

NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
TEXT = re.compile(rb'"[^"\n]{0,80}"')
HOSTILE_NUMBERS = (
    b"NaN", b"nan", b"Infinity", b"-inf", b"1e999", b"-1e999", b"1e308", b"5e-324", b"0", b"-0", b"-1", b"1e-400",
    b"9" * 5000, b"1." + b"3" * 5000, b"18446744073709551616", b"4294967295", b"62|4294967295", b"0x10", b"1_000", b"",
    b"true", b"null", b'"1"', b"[" * 3000, b'{"a":' * 3000, b"2026-11-22T10:00:00Z",
)  # fmt: skip
HOSTILE_TEXTS = (
    b'""', b'"\\ud800"', b'"\\u0000"', b'"\\u202e\\u001b[2J"', b'"' + b"a" * 70_000 + b'"', b"null", b"1e999", b"NaN",
    b"[]", b"{}", b'["\\udfff"]', b'"../../etc/passwd"', b'"/dev/null"', b"'''", b"true", b"-1",
)  # fmt: skip
HOSTILE_BYTES = (
    b"\0", b"\r", b"\n", b"\xff\xfe", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\x1b[2J", b"\x1f\x8b", b'"', b",", b"[", b"{",
    b"}", b"a." * 200, b"\xe2\x80\xae", b"\\", b"=", b"#", b"\n\n", b"[[x]]\n", b"[a.b]\n",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1 << 63, 1 << 70, 10**400, 0.5, -0.0, 1e308, -1e308, 5e-324, float("nan"), float("inf"),
    "", "x", "nan", "1e999", "\ud800", "\0", "\x1b[2J", "a" * 1000, [], {}, [[]], [None], [1, "x"], {"a": 1}, [0.0] * 3,
)  # fmt: skip


def _span(rng: random.Random, size: int, longest: int = 40) -> tuple[int, int]:
    start = rng.randrange(size + 1)
    return start, min(size, start + rng.randrange(1, longest))


def flip(work: bytearray, rng: random.Random) -> None:
    if work:
        work[rng.randrange(len(work))] ^= 1 << rng.randrange(8)


def cut(work: bytearray, rng: random.Random) -> None:
    start, stop = _span(rng, len(work))
    del work[start:stop]


def tear(work: bytearray, rng: random.Random) -> None:
    del work[rng.randrange(len(work) + 1) :]


def double(work: bytearray, rng: random.Random) -> None:
    start, stop = _span(rng, len(work), 400)
    work[start:start] = work[start:stop]


def noise(work: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(work) + 1)
    work[at:at] = rng.randbytes(rng.randrange(1, 20))


def hostile_bytes(work: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(work) + 1)
    work[at:at] = rng.choice(HOSTILE_BYTES)


def swap_lines(work: bytearray, rng: random.Random) -> None:
    lines = bytes(work).split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[i], lines[j] = lines[j], lines[i]
    work[:] = b"\n".join(lines)


def hostile_number(work: bytearray, rng: random.Random) -> None:
    _replace(work, rng, NUMBER, rng.choice(HOSTILE_NUMBERS))


def hostile_text(work: bytearray, rng: random.Random) -> None:
    _replace(work, rng, TEXT, rng.choice(HOSTILE_TEXTS))


def other_number(work: bytearray, rng: random.Random) -> None:
    """A digit more or less, another sign, another size."""
    _replace(work, rng, NUMBER, b"%g" % (rng.choice((1, -1)) * 10 ** rng.uniform(-12, 25)))


def _replace(work: bytearray, rng: random.Random, what: re.Pattern[bytes], by: bytes) -> None:
    # from a random place on, so that a long input is not searched whole
    found = what.search(work, rng.randrange(len(work) + 1)) or what.search(work)
    if found is not None:
        work[found.start() : found.end()] = by


ACTS: tuple[Callable[[bytearray, random.Random], None], ...] = (
    flip, cut, tear, double, noise, hostile_bytes, swap_lines, hostile_number, hostile_text, other_number,
)  # fmt: skip


def damaged(data: bytes, rng: random.Random) -> bytes:
    """One to three acts of damage."""
    work = bytearray(data)
    for _ in range(rng.randrange(1, 4)):
        rng.choice(ACTS)(work, rng)
    return bytes(work)


def damaged_gzip(data: bytes, rng: random.Random) -> bytes:
    """Damage inside or outside of the packing, in turn."""
    if rng.random() < 0.5:
        return gzip.compress(damaged(data, rng), 1, mtime=0)
    return damaged(gzip.compress(data, 1, mtime=0), rng)


Path = tuple[Any, ...]
"""keys and indices from the top of a document to one of its values"""


class Document:
    """A document of which damaged versions are made. What they have in common is shared: only what holds a changed
    value is copied, and where the values stand is found once."""

    def __init__(self, sound: Any) -> None:
        self._sound = sound
        self._paths = list(_paths(sound))

    def damaged(self, rng: random.Random) -> Any:
        """One to three values replaced, taken away, doubled, or put under another name; to be read, not changed."""
        out = self._sound
        for _ in range(rng.randrange(1, 4)):
            out = self._damaged_once(out, rng)
        return out

    def _damaged_once(self, document: Any, rng: random.Random) -> Any:
        path = next((path for path in (rng.choice(self._paths) for _ in range(8)) if _there(document, path)), None)
        if path is None:
            return rng.choice(VALUES)
        out, holder = _copied(document, path)
        key = path[-1]
        act = rng.randrange(5)
        if act == 0:
            del holder[key]
        elif act == 1 and isinstance(holder, list):
            holder.insert(key, holder[key])
        elif act == 1:
            holder[rng.choice(("x", "", "\ud800", str(key) + "_"))] = holder.pop(key)
        elif act == 2:
            other = rng.choice(self._paths)
            # of the sound one: a value can never be put into itself
            holder[key] = _at(self._sound, other)
        else:
            holder[key] = rng.choice(VALUES)
        return out


def _paths(value: Any, above: Path = ()) -> Iterator[Path]:
    keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        yield (*above, key)
        yield from _paths(value[key], (*above, key))


def _at(document: Any, path: Path) -> Any:
    for key in path:
        document = document[key]
    return document


def _there(document: Any, path: Path) -> bool:
    for key in path:
        in_list = isinstance(document, list) and isinstance(key, int) and key < len(document)
        if not in_list and not (isinstance(document, dict) and key in document):
            return False
        document = document[key]
    return True


def _copied(document: Any, path: Path) -> tuple[Any, Any]:
    """The document with copies of all that is on the way to a value, and the copy that holds it."""
    out = holder = copy.copy(document)
    for key in path[:-1]:
        holder[key] = copy.copy(holder[key])
        holder = holder[key]
    return out, holder
