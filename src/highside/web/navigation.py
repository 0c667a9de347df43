"""What leads from one page to the others."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Link:
    """A page and the word for it."""

    path: str
    text: str
