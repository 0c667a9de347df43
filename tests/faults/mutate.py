"""Damage to files and messages: by bytes, by numbers, and by the structure of a JSON document.

All of it is seeded. Every act is as likely as every other, so that no kind of damage is rare; an input gets one to
three.
"""

from __future__ import annotations

import copy
import gzip
import json
import random
import re
from collections.abc import Callable
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


def damaged_document(document: Any, rng: random.Random) -> Any:
    """A copy with one to three values replaced, taken away, doubled, or put under another name."""
    out = json.loads(json.dumps(document))
    for _ in range(rng.randrange(1, 4)):
        places = list(_places(out))
        if not places:
            return copy.deepcopy(rng.choice(VALUES))
        holder, key = rng.choice(places)
        act = rng.randrange(5)
        if act == 0:
            del holder[key]
        elif act == 1 and isinstance(holder, list):
            holder.insert(key, json.loads(json.dumps(holder[key])))
        elif act == 1:
            holder[rng.choice(("x", "", "\ud800", str(key) + "_"))] = holder.pop(key)
        elif act == 2:
            other, name = rng.choice(places)
            holder[key] = json.loads(json.dumps(other[name])) if _there(other, name) else None
        else:
            # a copy: a value that stands in two places could be put into itself
            holder[key] = copy.deepcopy(rng.choice(VALUES))
    return out


def _there(holder: Any, key: Any) -> bool:
    return key < len(holder) if isinstance(holder, list) else key in holder


def _places(value: Any, most: int = 3000) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    waiting = [value]
    while waiting and len(found) < most:
        one = waiting.pop()
        keys = list(one) if isinstance(one, dict) else list(range(len(one))) if isinstance(one, list) else []
        found += [(one, key) for key in keys]
        waiting += [one[key] for key in keys if isinstance(one[key], dict | list)]
    return found
