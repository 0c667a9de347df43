"""A sentence with values in it, made in English, that can still be told in another language."""

from __future__ import annotations

from typing import Any


class Said(str):
    """The sentence in English, for programs, files and terminals: a text like any other. `message` and `fields` are
    what it was made of, so that a page can tell it in its reader's language; what is read back from a file is a plain
    text."""

    __slots__ = ("fields", "message")
    message: str
    fields: dict[str, Any]

    def __new__(cls, message: str, fields: dict[str, Any] | None = None) -> Said:
        made = super().__new__(cls, message % (fields or {}))
        made.message = message
        made.fields = fields or {}
        return made

    def __getnewargs__(self) -> tuple[str, dict[str, Any]]:  # type: ignore[override]
        return self.message, self.fields


def said(message: str, **fields: Any) -> Said:
    """A message of the catalogue (`%(name)s` stands for a value) with its values; a value may be such a sentence
    itself, and is then told too. Other texts, which may be anybody's names, stay as they are."""
    return Said(message, fields)
