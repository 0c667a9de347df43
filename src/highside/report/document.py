"""Documents of headings, words, tables and plots, each one HTML file that needs nothing beside it.

A document is a list of parts; a template (`report/templates`) says how each looks. A `Page` is read on a screen;
`Sheets` are printed: page numbers, running heads and breaks are the printer's work (paged-media CSS), and `pdf` prints
them here. Templates escape what they are given; only plots, which are drawn here, are put in as they are.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

from jinja2 import Environment
from markupsafe import Markup

from highside.errors import InputError
from highside.report.drawing import Picture
from highside.report.plots import as_svg
from highside.shown.plot import Plot
from highside.shown.screen import can_draw, chart_part, library_part
from highside.words import in_language, language
from highside.words.worded import worded

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Part:
    """One part: the macro of `templates/parts.html` that draws it, and what that is given."""

    kind: str
    values: dict[str, Any]


class Document:
    """A document in the making, in the language of the present reader; each method adds a part, `html` gives the
    whole."""

    TEMPLATE: ClassVar[str]

    def __init__(self, title: str) -> None:
        self._title = title
        self._language = language()
        self._parts: list[Part] = []
        self._figures = 0

    def title(self, text: str) -> None:
        self._add("title", text=text)

    def letterhead(self, logo: str | None, code: Markup | None) -> None:
        """A logo (`data:` address) at the left, a code to be scanned (SVG of our own) at the right."""
        if logo is not None or code is not None:
            self._add("letterhead", logo=logo, code=code)

    def heading(self, text: str) -> None:
        self._add("heading", text=text)

    def paragraph(self, text: str, *, look: str = "") -> None:
        """`look`: a class of the style sheet, as "soft" for what is beside the point or "verdict" for what decides."""
        self._add("paragraph", text=text, look=look)

    def badge(self, text: str, kind: str, words: str) -> None:
        """A word that stands out (`kind` is good, bad, open or found) and a sentence beside it."""
        self._add("badge", text=text, kind=kind, words=words)

    def code(self, label: str, text: str) -> None:
        """Words, and something that is compared letter by letter."""
        self._add("code", label=label, text=text)

    def facts(self, rows: Sequence[tuple[str, str]]) -> None:
        """Pairs of a question and its answer, one below the other; an empty question goes on with the last answer.

        Where there is no answer the question is omitted.
        """
        answers: list[tuple[str, list[str]]] = []
        for name, text in rows:
            if text and (name or not answers):
                answers.append((name, [text]))
            elif text:
                answers[-1][1].append(text)
        self._add("facts", rows=answers)

    def bullets(self, items: Sequence[str]) -> None:
        self._add("bullets", items=items)

    def table(
        self,
        headers: Sequence[str],
        rows: Sequence[Sequence[str]],
        caption: str = "",
        *,
        words: Sequence[int] = (),
        whole: bool = False,
    ) -> None:
        """`words`: columns that hold text and are set flush left; where there are such, a narrow screen shows each row
        as lines with the headers before them. `whole`: not split between sheets, where one can hold it."""
        self._add("table", headers=headers, rows=rows, caption=caption, words=words, whole=whole)

    def figure(self, figure: Figure | Picture, caption: str) -> None:
        """Embed a picture, or a matplotlib figure drawn within `plotting`."""
        self._add("figure", svg=self._drawn(figure), caption=caption)

    def photograph(self, jpeg: bytes, caption: str) -> None:
        """A photograph, and what is said of it."""
        self._add("photograph", data=base64.b64encode(jpeg).decode("ascii"), caption=caption)

    def panels(self, figures: Sequence[Figure | Picture], caption: str) -> None:
        """Figures beside one another, or below where the screen is narrow, under one caption."""
        self._add("panels", svgs=[self._drawn(figure) for figure in figures], caption=caption)

    def chart(self, chart: Plot, caption: str) -> None:
        """Embed a chart to zoom and hover in, where what draws it is installed; it is not printed."""
        if can_draw():
            self._add("chart", drawn=chart_part(chart), caption=caption)

    @contextmanager
    def folded(self, summary: str) -> Iterator[None]:
        """What is added within stands behind a line that opens it; printed it is open."""
        self._add("fold", summary=summary)
        yield
        self._add("unfold")

    def signature(self, text: str) -> None:
        """A line to sign on, and who does."""
        self._add("signature", text=text)

    def new_sheet(self) -> None:
        """What follows begins on a sheet of its own."""
        self._add("new_sheet")

    def html(self) -> str:
        template = _environment().get_template(self.TEMPLATE)
        with in_language(self._language):
            values = {"title": self._title, "parts": self._parts, "language": self._language}
            return template.render(**values, **self._frame())

    def _frame(self) -> dict[str, str]:
        """What the template needs besides the parts."""
        return {}

    def _has(self, kind: str) -> bool:
        return any(part.kind == kind for part in self._parts)

    def _add(self, _kind: str, **values: Any) -> None:
        self._parts.append(Part(_kind, values))

    def _drawn(self, figure: Figure | Picture) -> Markup:
        if isinstance(figure, Picture):
            return Markup(figure.svg())  # drawn here, with the words in it escaped
        self._figures += 1
        return Markup(as_svg(figure, self._figures))  # drawn here; matplotlib escapes the words in it


class Page(Document):
    """A page for the screen, which prints well; it begins with its title."""

    TEMPLATE = "page.html"

    def __init__(self, title: str) -> None:
        super().__init__(title)
        self.title(title)

    def _frame(self) -> dict[str, str]:
        """What draws its charts: once, however many they are."""
        return {"library": library_part() if self._has("chart") else ""}


def need_pdf() -> Any:
    """What makes a PDF of a page. Raises InputError where WeasyPrint, or Pango below it, is missing."""
    try:
        from weasyprint import HTML
    except ImportError as error:
        remedy = "pip install 'highside[pdf]'; or write HTML and print it from a browser"
        raise InputError("PDF needs WeasyPrint, which is not installed", remedy=remedy) from error
    except OSError as error:
        remedy = "on Debian: apt install libpangoft2-1.0-0; or write HTML and print it from a browser"
        raise InputError("PDF needs the library Pango, which is not installed", remedy=remedy) from error
    return HTML


class Sheets(Document):
    """A document of numbered A4 sheets. `head`: what stands at the top of each, left and right; `foot`: at the bottom
    left, beside "page n of N"."""

    TEMPLATE = "sheets.html"

    def __init__(self, title: str, head: tuple[str, str], foot: str) -> None:
        super().__init__(title)
        self._head, self._foot = head, foot

    def pdf(self) -> tuple[bytes, int]:
        """The sheets as PDF, and how many. Raises InputError where WeasyPrint, or Pango below it, is missing."""
        drawn = need_pdf()(string=self.html(), url_fetcher=_fetch_nothing).render()
        return drawn.write_pdf(), len(drawn.pages)

    def _frame(self) -> dict[str, str]:
        left, right = self._head
        return {"left": left, "right": right, "foot": self._foot}


def _fetch_nothing(url: str, *_: Any, **__: Any) -> Any:
    raise ValueError(f"{url}: a document needs nothing beside it")


def css_string(text: str) -> Markup:
    """Any text as a string of CSS inside a page: all but plain letters, figures and blanks by their numbers."""
    plain = (c if c.isascii() and (c.isalnum() or c in " ,.:-") else f"\\{ord(c):06x}" for c in text)
    return Markup(f'"{"".join(plain)}"')


@cache
def _environment() -> Environment:
    """Templates of the pages."""
    found = worded("highside.report", keep_trailing_newline=True)
    found.filters["css_string"] = css_string
    return found
