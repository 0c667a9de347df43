"""Text from outside, made harmless for a terminal and a log.

A terminal obeys what it prints: an escape sequence clears the screen, sets the window's title or forges a line; a
bidirectional override makes a reader see another word than was written. Whatever came from a network, a file or a name
goes through `printable` on its way to either. The log's formatter does it for every line.
"""

from __future__ import annotations

LONGEST_LINE = 2000
"""Characters of a line for people."""


def printable(text: str) -> str:
    """`text` in one line, each character that is not printed as itself written as its escape (`\\x1b`, `\\u202e`).

    These are all control characters (C0, DEL, C1), line and paragraph separators, format characters (direction marks
    and overrides, zero widths) and lone surrogates; letters of any script, spaces and symbols stay.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in _SPACES else c.encode("unicode_escape").decode("ascii") for c in text)


def one_line(text: str) -> str:
    """The same with white space of any kind, line breaks too, drawn together to one space.

    Too long a line loses its middle: what is quoted may be a whole file that has no line end.
    """
    line = " ".join(text.split())
    if len(line) > LONGEST_LINE:
        line = f"{line[: LONGEST_LINE * 3 // 4]} ... {line[-LONGEST_LINE // 4 :]}"
    return printable(line)


_SPACES = frozenset("\u00a0\u2007\u2009\u202f\u3000")
"""Spaces of our own typography and of others', which Python does not call printable."""
