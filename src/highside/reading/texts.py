"""Text from bytes: UTF-8, with or without the mark that Windows writes before it; anything else is named."""

from __future__ import annotations

import codecs
import re

from highside.errors import InputError

_HEAD = 4096
"""bytes by which the encoding is judged where no mark says it"""
_SHOWN_ENCODING = {
    "utf-8-sig": "UTF-8",
    "utf-16": "UTF-16",
    "utf-16-le": "UTF-16",
    "utf-16-be": "UTF-16",
    "cp1252": "Windows-1252",
}
_NO_TEXT = re.compile("[\x00-\x08\x0e-\x1f\ufffd]")
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


def decode_foreign(data: bytes, *, where: str) -> tuple[str, str]:
    """Text of another program and the name of its encoding: UTF-8, UTF-16 or Windows-1252, line ends made one.

    Raises InputError for bytes that are no text in any of them.
    """
    encoding = _encoding_of(data)
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8-sig":
            raise InputError(
                f"is not text in {_SHOWN_ENCODING[encoding]}: byte {error.start} fits no character",
                where=where,
                remedy="the file is torn, or of another kind",
            ) from None
        encoding = "cp1252"
        text = data.decode(encoding, errors="replace")
    text = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    odd = _NO_TEXT.search(text)
    if odd:
        line = text.count("\n", 0, odd.start()) + 1
        raise InputError(
            "holds bytes that are no text",
            where=at_line(where, line),
            remedy="the file is torn, or of another kind (bytes of a sensor's wire: highside decode)",
        )
    return text, _SHOWN_ENCODING[encoding]


def _encoding_of(data: bytes) -> str:
    if data.startswith(_UTF16):
        return "utf-16"
    head = data[:_HEAD]
    # without a mark: Latin letters leave every second byte zero
    if len(head) >= 2 and head[1::2].count(0) > len(head) // 4 and head[::2].count(0) == 0:
        return "utf-16-le"
    if len(head) >= 2 and head[::2].count(0) > len(head) // 4 and head[1::2].count(0) == 0:
        return "utf-16-be"
    return "utf-8-sig"


def at_line(where: str | None, line: int) -> str:
    """A line of a file, as errors name it."""
    return f"{where}: line {line}" if where else f"line {line}"


def _with_article(kind: str) -> str:
    return kind if kind == "text" else f"a {kind}"
