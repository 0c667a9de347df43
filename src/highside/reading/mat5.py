"""Arrays of MATLAB 5 files from bytes: those of numbers, alone or in structures; all others are passed over.

An element is a tag (type, bytes) and its content; an array is an element of elements: flags with its class, dimensions,
name, values (MathWorks, "MAT-File Format", 2023, chapter 1). Each element is held against the one around it, so that
neither a length nor a dimension can ask for more than stands in the file, and what is nested is followed `DEEPEST` far.
A library that follows cells to any depth ends with the process.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.errors import InputError
from highside.reading.expansion import too_packed
from highside.reading.files import allowed_bytes

DEEPEST = 8
"""structures within structures"""
MOST_ARRAYS = 4096
"""arrays and fields of one file; a log of an autopilot has some hundred"""
_HEADER_BYTES = 128
_ARRAY, _PACKED = 14, 15
"""types of elements that hold others"""
_NUMBERS = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
"""types of elements of numbers"""
_CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""classes of arrays of numbers, and what their values are, however narrow they are stored"""
_STRUCTURE, _OBJECT = 2, 3
_COMPLEX = 0x08
_MOST_DIMENSIONS = 32
_PIECE = 1 << 20

Numbers = NDArray[np.generic]


@dataclass(frozen=True, slots=True)
class _Element:
    kind: int
    content: memoryview


def mat5_arrays(data: bytes, *, where: str) -> dict[str, Numbers]:
    """The arrays of numbers by name, those of structures as `outer.inner`. Raises InputError."""
    order = ">" if data[126:128] == b"MI" else "<"
    reader = _Reader(order, where)
    found: dict[str, Numbers] = {}
    unpacked = 0
    for element in reader.elements(memoryview(data)[_HEADER_BYTES:], "its last array is not whole"):
        content = element
        if element.kind == _PACKED:
            plain = _unpacked(element.content, len(data), unpacked, where)
            unpacked += len(plain)
            content = next(reader.elements(memoryview(plain), "a packed array is not whole"), element)
        if content.kind == _ARRAY:
            found.update(reader.arrays(content.content, None, 0))
    return found


class _Reader:
    def __init__(self, order: str, where: str) -> None:
        self._order, self._where = order, where
        self._count = 0

    def elements(self, content: memoryview, torn: str) -> Iterator[_Element]:
        """One after the other. Raises InputError where one is longer than what it stands in."""
        place = 0
        while place + 8 <= len(content):
            first, size = self._numbers(content[place : place + 8], "u4")
            if first >> 16:
                # up to four bytes stand within the tag itself
                kind, size = int(first) & 0xFFFF, int(first) >> 16
                if size > 4:
                    raise self._damaged("a short element has more than 4 bytes")
                yield _Element(kind, content[place + 4 : place + 4 + size])
                place += 8
                continue
            begin, size = place + 8, int(size)
            if begin + size > len(content):
                raise self._damaged(torn)
            yield _Element(int(first), content[begin : begin + size])
            # packed elements alone are not filled up to 8 bytes
            place = begin + size + (0 if first == _PACKED else -size % 8)

    def arrays(self, content: memoryview, name: str | None, depth: int) -> Iterator[tuple[str, Numbers]]:
        """The array in this content, or those of its fields. `name`: as the structure around it calls it."""
        self._count += 1
        if self._count > MOST_ARRAYS:
            raise InputError(f"holds more than {MOST_ARRAYS} arrays", where=self._where, remedy="give the right file")
        parts = self.elements(content, "an array is not whole")
        head = [part for _, part in zip(range(3), parts, strict=False)]
        if len(head) < 3 or len(head[0].content) < 8:
            return  # an empty field
        flags = int(self._numbers(head[0].content[:8], "u4")[0])
        shape = tuple(int(size) for size in self._values(head[1]))
        if not 2 <= len(shape) <= _MOST_DIMENSIONS or min(shape) < 0:
            raise self._damaged("dimensions that no array has")
        name = bytes(head[2].content).decode("latin-1") if name is None else name
        if not name:
            return  # what MATLAB keeps for itself
        kind = flags & 0xFF
        if kind in _CLASSES and not (flags >> 8) & _COMPLEX:
            values = next(parts, None)
            if values is None or (found := self._values(values)).size != math.prod(shape):
                raise self._damaged(f"{name}: not as many values as its dimensions say")
            yield name, found.astype(self._order + _CLASSES[kind]).reshape(shape, order="F")
        elif kind in (_STRUCTURE, _OBJECT) and math.prod(shape) == 1 and depth < DEEPEST:
            if kind == _OBJECT:
                next(parts, None)  # its class
            for field, inner in zip(self._fields(parts), parts, strict=False):
                if inner.kind == _ARRAY:
                    yield from self.arrays(inner.content, f"{name}.{field}", depth + 1)

    def _fields(self, parts: Iterator[_Element]) -> Sequence[str]:
        """The names of a structure's fields, each filled up to the same length."""
        length, names = next(parts, None), next(parts, None)
        if length is None or names is None or (sizes := self._values(length)).size != 1 or (size := int(sizes[0])) < 1:
            raise self._damaged("a structure without names of its fields")
        text = bytes(names.content)
        if len(text) // size > MOST_ARRAYS:
            raise self._damaged(f"a structure of more than {MOST_ARRAYS} fields")
        return [text[k : k + size].split(b"\0")[0].decode("latin-1") for k in range(0, len(text), size)]

    def _values(self, element: _Element) -> Numbers:
        if element.kind not in _NUMBERS:
            raise self._damaged(f"an element of type {element.kind} in place of numbers")
        return self._numbers(element.content, _NUMBERS[element.kind])

    def _numbers(self, content: memoryview, kind: str) -> Numbers:
        dtype = np.dtype(self._order + kind)
        return np.frombuffer(content, dtype, len(content) // dtype.itemsize)

    def _damaged(self, what: str) -> InputError:
        return InputError(f"is a damaged MATLAB file ({what})", where=self._where, remedy="give the whole file")


def _unpacked(packed: memoryview, of: int, before: int, where: str) -> bytes:
    """What comes out, held against the limits while it does. `of`: bytes of the file, `before`: what came out of it."""
    stream, pieces, count = zlib.decompressobj(), list[bytes](), before
    try:
        piece = stream.decompress(packed, _PIECE)
        while piece:
            pieces.append(piece)
            count += len(piece)
            if count > allowed_bytes() or too_packed(count, of):
                raise InputError(
                    "expands to more than any recording does", where=where, remedy="save it without compression"
                )
            piece = stream.decompress(stream.unconsumed_tail, _PIECE)
    except zlib.error as error:
        raise InputError(f"is a damaged MATLAB file ({error})", where=where, remedy="give the right file") from None
    return b"".join(pieces)
