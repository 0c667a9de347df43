"""Global heaps of an HDF5 file, where texts of any length lie: those that its library would walk for ever are refused.

A heap is a collection `GCOL` of a stated size, filled with objects, each with its number and size before it; object 0
is what is left free, its size that of all of it. The library (seen with 2.0) goes from object to object by these sizes
without looking at them: a free object of size 0 keeps it where it is, a size beyond the collection leads it anywhere.
"""

from __future__ import annotations

from highside.errors import InputError

_HEAP = b"GCOL\x01"
_HEADER, _OBJECT = 16, 16
"""bytes before the first object of a heap, and before what an object holds, where sizes have eight bytes"""


def refuse_endless_heaps(data: bytes, *, where: str) -> None:
    """Raises InputError for a file in which a global heap cannot be walked to its end."""
    at = data.find(_HEAP)
    while at >= 0:
        if _endless(data, at):
            what = f"is a damaged HDF5 file (the heap at byte {at} has no end)"
            raise InputError(what, where=where, remedy="give the right file")
        at = data.find(_HEAP, at + 1)


def _endless(data: bytes, start: int) -> bool:
    end = start + int.from_bytes(data[start + 8 : start + _HEADER], "little")
    if end > len(data):
        # the library does not read what is not there
        return False
    at = start + _HEADER
    while at + _OBJECT <= end:
        number = int.from_bytes(data[at : at + 2], "little")
        size = int.from_bytes(data[at + 8 : at + _OBJECT], "little")
        step = size if number == 0 else _OBJECT + (size + 7) // 8 * 8
        if not 0 < step <= end - at:
            return True
        at += step
    return False
