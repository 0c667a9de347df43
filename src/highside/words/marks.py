"""How a message is marked that is made in one place and translated in another."""

from __future__ import annotations


def said_later(message: str) -> str:
    """Mark a message that is made here and translated where it is shown."""
    return message
