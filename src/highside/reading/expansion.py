"""How much may come out of a packed file: the rule that gzip is held to while it is read (`files`), for containers."""

from __future__ import annotations

import bz2
import importlib
from collections.abc import Callable
from typing import Any

from highside.errors import InputError
from highside.reading import files
from highside.reading.files import IF_MEANT, MAX_RATIO, RATIO_FROM_BYTES, allowed_bytes, in_words

_PIECE = 1 << 20


def too_packed(unpacked: int, packed: int) -> bool:
    """Whether more comes out of a file than out of any recording, unless the user said that it is meant so."""
    return not files._configured and unpacked > RATIO_FROM_BYTES and unpacked > MAX_RATIO * packed


def refuse_expansion(unpacked: int, packed: int, *, where: str) -> None:
    """Raises InputError where a file of `packed` bytes takes more memory than any may, or than any recording does."""
    if unpacked > allowed_bytes():
        raise InputError(f"expands to more than {in_words(allowed_bytes())}", where=where, remedy=IF_MEANT)
    if too_packed(unpacked, packed):
        raise InputError(
            f"expands to more than {MAX_RATIO} times its size, as no recording does", where=where, remedy=IF_MEANT
        )


def bounded_unpacking(unpack: Callable[[bytes], bytes], size: int, where: str) -> Callable[[bytes], bytes]:
    """A decompressor of bz2 or lz4 (another is returned as it is), in pieces that are counted: what a chunk says of its
    size binds nobody. `size`: bytes of the file. It raises InputError as `refuse_expansion` does, EOFError for a chunk
    that is not whole.
    """
    if unpack is bz2.decompress:
        streams: Callable[[], Any] = bz2.BZ2Decompressor
    elif unpack.__module__.startswith("lz4"):
        streams = importlib.import_module("lz4.frame").LZ4FrameDecompressor
    else:
        return unpack

    def bounded(packed: bytes) -> bytes:
        stream, pieces, count, given = streams(), list[bytes](), 0, packed
        while not stream.eof:
            pieces.append(stream.decompress(given, max_length=_PIECE))
            count, given = count + len(pieces[-1]), b""
            refuse_expansion(count, size, where=where)
            if not pieces[-1] and stream.needs_input:
                raise EOFError("a chunk is not whole")
        return b"".join(pieces)

    return bounded
