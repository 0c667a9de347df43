"""Letters of a picture: how wide they are about, and the SVG of them."""

from __future__ import annotations

import math
from typing import Literal
from xml.etree.ElementTree import Element, SubElement

__all__ = ["LABEL", "LEGEND", "TICK", "TITLE", "Anchor", "in_two", "raised", "text", "whole_on_rest", "width", "within"]

TITLE, LABEL, LEGEND, TICK = 9.0, 8.0, 8.0, 7.5
"""sizes of letters, pt"""
Anchor = Literal["start", "middle", "end"]
ELLIPSIS = "\N{HORIZONTAL ELLIPSIS}"
_NARROW, _WIDE = frozenset("iIjl.,:;'|!()[] ft"), frozenset("mwMW@%")
_RAISED = str.maketrans(
    "-0123456789",
    "\N{SUPERSCRIPT MINUS}\N{SUPERSCRIPT ZERO}\N{SUPERSCRIPT ONE}\N{SUPERSCRIPT TWO}\N{SUPERSCRIPT THREE}"
    "\N{SUPERSCRIPT FOUR}\N{SUPERSCRIPT FIVE}\N{SUPERSCRIPT SIX}\N{SUPERSCRIPT SEVEN}\N{SUPERSCRIPT EIGHT}"
    "\N{SUPERSCRIPT NINE}",
)


def width(words: str, size: float) -> float:
    """About how wide words are in a font without serifs, pt; rather too wide, since the page's font is not known."""
    ems = sum(0.37 if c in _NARROW else 0.92 if c in _WIDE else 0.68 if c.isupper() else 0.6 for c in words)
    return size * ems


def within(words: str, size: float, most: float) -> str:
    """Words that are about `most` pt wide or less: of longer ones the beginning and an ellipsis."""
    if width(words, size) <= most:
        return words
    kept = words
    while kept and width(kept + ELLIPSIS, size) > most:
        kept = kept[:-1]
    return kept.rstrip() + ELLIPSIS


def in_two(words: str, size: float, most: float) -> list[str]:
    """Words in a line that is about `most` pt wide or less, or in two: the first has as many whole words as fit in."""
    if width(words, size) <= most:
        return [words]
    ends = [k for k, c in enumerate(words) if c == " " and width(words[:k], size) <= most]
    return [words[: ends[-1]], words[ends[-1] + 1 :]] if ends else [words]


def raised(power: int) -> str:
    """A power of ten."""
    return "10" + str(power).translate(_RAISED)


def text(
    x: float,
    y: float,
    words: str,
    size: float,
    anchor: Anchor = "start",
    turned: float = 0.0,
    most: float = math.inf,
) -> Element:
    """Words whose baseline begins, is centred or ends at a point, turned by degrees clockwise about it; those that are
    wider than `most` pt are cut short, and whole where the pointer rests on them."""
    made = Element("text", {"x": f"{x:.1f}", "y": f"{y:.1f}", "font-size": f"{size:g}"})
    if anchor != "start":
        made.set("text-anchor", anchor)
    if turned:
        made.set("transform", f"rotate({turned:g} {x:.1f} {y:.1f})")
    made.text = within(words, size, most)
    return whole_on_rest(made, words, words)


def whole_on_rest(made: Element, words: str, whole: str) -> Element:
    """Letters made of `words`: where these were cut short, the `whole` shows where the pointer rests on them."""
    if made.text != words:
        for title in made.findall("title") or [SubElement(made, "title")]:
            title.text = whole
    return made
