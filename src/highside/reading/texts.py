"""Text from bytes: UTF-8, with or without the mark that Windows writes before it; anything else is named."""

from __future__ import annotations

import codecs

from highside.errors import InputError

_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def decode_text(data: bytes, *, where: str | None = None, expected: str = "text") -> str:
    """UTF-8 text without its mark; `expected` names the kind. Raises InputError for UTF-16, other bytes and NUL."""
    if data.startswith(_UTF16):
        raise InputError("is UTF-16 text", where=where, remedy="save it as UTF-8")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            "is not text", where=at_line(where, line), remedy=f"{_with_article(expected)} in UTF-8 is expected"
        ) from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError(
            "holds a NUL character: it is not text, or was torn by a loss of power",
            where=at_line(where, line),
            remedy=f"{_with_article(expected)} is expected",
        )
    return text


def at_line(where: str | None, line: int) -> str:
    """A line of a file, as errors name it."""
    return f"{where}: line {line}" if where else f"line {line}"


def _with_article(kind: str) -> str:
    return kind if kind == "text" else f"a {kind}"
