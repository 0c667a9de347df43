"""Sentences that may have no translation: where they have none, a page marks them as English, for a screen reader."""

from __future__ import annotations

from markupsafe import Markup

from highside.words.catalogue import language, told


def in_words(text: str, original: str | None = None, of: str = "") -> Markup | str:
    """A sentence in the reader's language, or marked as the English that it is. `original`: as it was before a letter
    of it was made large. `of`: of what more sentences are known (`told`)."""
    if language() == "en" or not text:
        return text
    known = told(text if original is None else original, of)
    if known == (text if original is None else original) and any(letter.isalpha() for letter in known):
        return Markup('<span lang="en">{}</span>').format(text)
    return known[:1].upper() + known[1:] if original is not None else known
