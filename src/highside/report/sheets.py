"""A document of numbered A4 sheets in one HTML file: what is seen on the screen is what is printed, page for page.

The sheets are laid out here and not by the browser, so that "page n of N" stands on every one of them whatever prints
it: each part knows its height (from the length of its words and the width of its columns, on the safe side), tables are
split between rows, and a heading never stands alone at the foot of a sheet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

from highside.report.page import as_svg

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_MM = 178.0
HEIGHT_MM = 242.0
"""Room for the parts on a sheet, header and footer apart."""
_TEXT_CHAR_MM, _TEXT_LINE_MM = 1.86, 4.8
_CELL_CHAR_MM, _CELL_LINE_MM, _CELL_PAD_MM = 1.57, 3.85, 1.5
_CELL_SIDES_MM = 2.6

_STYLE = """
/* where none of the usual faces is there, the widest one that systems fall back to, at their width */
@font-face { font-family: "as wide"; src: local("DejaVu Sans"), local("Verdana"); size-adjust: 86%; }
@font-face { font-family: "as wide"; font-weight: 700; src: local("DejaVu Sans Bold"), local("Verdana Bold");
             size-adjust: 84%; }
@page { size: A4; margin: 0; }
* { box-sizing: border-box; }
html { color-scheme: light; }
body { margin: 0; background: #d9dde1; color: #14181c;
       font: 10pt/4.7mm "Liberation Sans", Arial, Helvetica, "as wide", sans-serif;
       font-variant-ligatures: none; }  /* so that words are found in what is printed */
.sheet { position: relative; width: 210mm; height: 297mm; margin: 6mm auto; padding: 12mm 16mm; background: #fff;
         overflow: hidden; box-shadow: 0 1mm 4mm #0003; break-after: page; }
.sheet:last-of-type { break-after: auto; }
@media print { body { background: #fff; } .sheet { margin: 0; box-shadow: none; height: 296.9mm; } }
@media screen and (max-width: 820px) { body { width: 210mm; } }
header, footer { position: absolute; left: 16mm; right: 16mm; display: flex; justify-content: space-between;
                 font-size: 8pt; color: #454d55; }
header { top: 8mm; border-bottom: .3mm solid #14181c; padding-bottom: 1.2mm; }
footer { bottom: 7mm; border-top: .2mm solid #8a939b; padding-top: 1.2mm; }
main { position: absolute; top: 19mm; left: 16mm; right: 16mm; }
h1 { font-size: 19pt; line-height: 9mm; height: 11mm; margin: 0; }
h2 { font-size: 12pt; line-height: 6mm; margin: 0; padding: 4mm 0 1mm; }
p { margin: 0 0 1.6mm; } ul { margin: 0 0 1.6mm; padding-left: 5mm; } li { margin: 0 0 .8mm; }
.verdict { border: .5mm solid #14181c; padding: 2mm 3mm; font-weight: 700; }
table { border-collapse: collapse; table-layout: fixed; width: 178mm; margin: 0 0 3mm; font-size: 8.5pt;
        line-height: 3.8mm; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-size: 8.5pt; line-height: 3.9mm; padding-bottom: 1mm; color: #454d55; }
th, td { text-align: right; padding: .6mm 1.2mm; vertical-align: top; border-bottom: .2mm solid #c3c9cf;
         overflow-wrap: anywhere; }
thead th { border-bottom: .4mm solid #14181c; vertical-align: bottom; }
.words { text-align: left; } .pairs th { text-align: left; font-weight: 400; color: #454d55; }
.pairs td { text-align: left; }
figure { margin: 0 0 2mm; } figure svg { display: block; width: 178mm; height: auto; color: #14181c; }
figcaption { font-size: 8.5pt; line-height: 3.9mm; color: #454d55; }
.sign { margin-top: 14mm; border-top: .3mm solid #14181c; width: 90mm; padding-top: 1mm; }
code { font: 8pt "Liberation Mono", "Courier New", monospace; overflow-wrap: anywhere; }
"""


@dataclass
class _Part:
    """Something that is not split: `mm` high; `keep` holds it together with the part after it."""

    html: str
    mm: float
    keep: bool = False


@dataclass
class _Rows:
    """A table: it may be split between rows; its head is repeated."""

    head: str
    rows: list[tuple[str, float]]
    head_mm: float
    caption: str = ""
    caption_mm: float = 0.0
    keep: bool = False
    whole: bool = False
    """not split where a sheet can hold it"""


@dataclass
class Sheets:
    """The document in the making. `head`: what stands at the top of every sheet, left and right; `foot` at the bottom
    left, beside "page n of N"."""

    title: str
    head: tuple[str, str]
    foot: str
    _parts: list[_Part | _Rows] = field(default_factory=list)
    _figures: int = 0

    def title_line(self, text: str) -> None:
        self._parts.append(_Part(f"<h1>{escape(text)}</h1>", 12.0, keep=True))

    def heading(self, text: str) -> None:
        self._parts.append(_Part(f"<h2>{escape(text)}</h2>", 11.5, keep=True))

    def paragraph(self, text: str, *, css: str = "") -> None:
        mm = _lines(text, WIDTH_MM - (7.0 if css else 0.0), _TEXT_CHAR_MM) * _TEXT_LINE_MM + (7.0 if css else 1.8)
        self._parts.append(_Part(f'<p class="{css}">{escape(text)}</p>' if css else f"<p>{escape(text)}</p>", mm))

    def code(self, label: str, text: str) -> None:
        mm = _lines(f"{label} {text}", WIDTH_MM, _TEXT_CHAR_MM) * _TEXT_LINE_MM + 1.8
        self._parts.append(_Part(f"<p>{escape(label)} <code>{escape(text)}</code></p>", mm))

    def bullets(self, items: Sequence[str]) -> None:
        for item in items:
            mm = _lines(item, WIDTH_MM - 6.0, _TEXT_CHAR_MM) * _TEXT_LINE_MM + 2.6
            self._parts.append(_Part(f"<ul><li>{escape(item)}</li></ul>", mm))

    def pairs(self, items: Sequence[tuple[str, str]], *, label_mm: float = 48.0) -> None:
        """Label and value, one line each; values that are empty are left out."""
        widths = (label_mm, WIDTH_MM - label_mm)
        rows = []
        for label, value in items:
            if value:
                html = f"<tr><th>{escape(label)}</th><td>{escape(value)}</td></tr>"
                rows.append((html, _row_mm((label, value), widths)))
        head = f'<table class="pairs">{_columns(widths)}<tbody>'
        self._parts.append(_Rows(head, rows, 3.2))

    def table(
        self,
        headers: Sequence[str],
        rows: Sequence[Sequence[str]],
        widths_mm: Sequence[float],
        *,
        caption: str = "",
        words: Sequence[int] = (),
        whole: bool = False,
    ) -> None:
        """`widths_mm` of the columns are scaled to the width of the sheet; `words`: columns that are set flush left;
        `whole`: not split between sheets."""
        scale = WIDTH_MM / sum(widths_mm)
        widths = tuple(width * scale for width in widths_mm)

        def row(tag: str, cells: Sequence[str]) -> str:
            marked = (f'<{tag} class="words">' if i in words else f"<{tag}>" for i in range(len(cells)))
            return "<tr>" + "".join(f"{m}{escape(c)}</{tag}>" for m, c in zip(marked, cells, strict=True)) + "</tr>"

        head = f"{_columns(widths)}<thead>{row('th', headers)}</thead><tbody>"
        body = [(row("td", cells), _row_mm(cells, widths)) for cells in rows]
        caption_mm = _lines(caption, WIDTH_MM, _CELL_CHAR_MM) * _CELL_LINE_MM + 1.2 if caption else 0.0
        self._parts.append(_Rows(head, body, _row_mm(headers, widths) + 3.4, caption, caption_mm, whole=whole))

    def figure(self, figure: Figure, caption: str) -> None:
        """A figure drawn within `plotting`; its height follows from its shape."""
        self._figures += 1
        width, height = figure.get_size_inches()
        mm = WIDTH_MM * height / width + _lines(caption, WIDTH_MM, _CELL_CHAR_MM) * _CELL_LINE_MM + 3.0
        svg = as_svg(figure, self._figures)
        self._parts.append(_Part(f"<figure>{svg}<figcaption>{escape(caption)}</figcaption></figure>", mm))

    def signature(self, text: str) -> None:
        self._parts.append(_Part(f'<p class="sign">{escape(text)}</p>', 14.0 + 3.0 * _TEXT_LINE_MM))

    def new_sheet(self) -> None:
        self._parts.append(_Part("", HEIGHT_MM + 1.0))

    def sheets(self) -> list[str]:
        """What stands on each sheet."""
        return _lay_out(self._parts)

    def html(self) -> str:
        done = self.sheets()
        left, right = (escape(text) for text in self.head)
        body = "\n".join(
            f'<section class="sheet" aria-label="page {n} of {len(done)}"><header><span>{left}</span>'
            f"<span>{right}</span></header><main>{content}</main><footer><span>{escape(self.foot)}</span>"
            f"<span>page {n} of {len(done)}</span></footer></section>"
            for n, content in enumerate(done, 1)
        )
        return (
            f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(self.title)}</title>'
            f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>\n'
            f"<body>\n{body}\n</body></html>\n"
        )


def _lines(text: str, width_mm: float, char_mm: float) -> int:
    return max(1, math.ceil(len(text) * char_mm / width_mm))


def _row_mm(cells: Sequence[str], widths: Sequence[float]) -> float:
    room = (max(width - _CELL_SIDES_MM, 2.0) for width in widths)
    most = max(_lines(cell, width, _CELL_CHAR_MM) for cell, width in zip(cells, room, strict=True))
    return most * _CELL_LINE_MM + _CELL_PAD_MM


def _columns(widths: Sequence[float]) -> str:
    return "<colgroup>" + "".join(f'<col style="width:{width:.2f}mm">' for width in widths) + "</colgroup>"


def _lay_out(parts: Sequence[_Part | _Rows]) -> list[str]:
    """Parts to sheets, first fit; a part taller than a sheet stands alone on one."""
    done: list[list[str]] = [[]]
    left = HEIGHT_MM

    def turn() -> None:
        nonlocal left
        if done[-1]:
            done.append([])
        left = HEIGHT_MM

    for k, part in enumerate(parts):
        if isinstance(part, _Part):
            if not part.html:
                turn()
                continue
            if _needed(parts, k) > left:
                turn()
            done[-1].append(part.html)
            left -= part.mm
            continue
        if _first_mm(part) > left:
            turn()
        rows = list(part.rows)
        caption = part.caption
        while True:
            left -= part.head_mm + (part.caption_mm if caption else 0.0)
            taken: list[str] = []
            while rows and (rows[0][1] <= left or not taken):
                left -= rows[0][1]
                taken.append(rows.pop(0)[0])
            title = f"<caption>{escape(caption)}</caption>" if caption else ""
            opening = part.head if part.head.startswith("<table") else f"<table>{title}{part.head}"
            done[-1].append(f"{opening}{''.join(taken)}</tbody></table>")
            if not rows:
                break
            turn()
            caption = f"{part.caption} (continued)" if part.caption else ""
    return ["".join(sheet) for sheet in done if sheet]


def _first_mm(rows: _Rows) -> float:
    """A table begins with its head and two rows at the least, or is not split."""
    head = rows.head_mm + rows.caption_mm
    everything = head + sum(mm for _, mm in rows.rows)
    return everything if rows.whole and everything <= HEIGHT_MM else head + sum(mm for _, mm in rows.rows[:2])


def _needed(parts: Sequence[_Part | _Rows], k: int) -> float:
    """Height of part `k` with what it is kept together with."""
    mm = 0.0
    for part in parts[k:]:
        mm += part.mm if isinstance(part, _Part) else _first_mm(part)
        if not part.keep:
            break
    return mm
