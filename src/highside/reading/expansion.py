"""How much may come out of a packed file: the rule that gzip is held to while it is read (`files`), for containers."""

from __future__ import annotations

from highside.errors import InputError
from highside.reading import files
from highside.reading.files import IF_MEANT, MAX_RATIO, RATIO_FROM_BYTES, allowed_bytes, in_words


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
