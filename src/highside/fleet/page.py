"""The report of a fleet: which lot shares which physics, how sure, which tools stand out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from highside.fleet.common import Common, LotTested, Outlier
from highside.fleet.summary import FleetSummary, LotView
from highside.physics.covariates import covariate
from highside.physics.effects import all_effects
from highside.physics.law import PREFIX
from highside.physics.places import PLACES
from highside.report.document import Page
from highside.report.plots import new_figure, plotting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["page_of", "sentence_of"]

_COMMON, _OUT, _GREY = "#2f7fd1", "#c2447d", "#9aa3ab"
MOST_NAMES = 60
"""tools whose names are written below a figure; more would overlap"""


def page_of(summary: FleetSummary, title: str) -> str:
    """The report as HTML. Raises InputError where matplotlib is not installed."""
    with plotting():
        page = Page(f"Fleet: {title}")
        kind = "found" if summary.common or any(lot.outliers for lot in summary.lots) else "good"
        page.badge(f"{len(summary.common)} in common", kind, sentence_of(summary))
        page.facts(
            [
                ("Recordings", f"{summary.recordings} of {summary.tools} tools, grouped by {summary.grouped_by}"),
                ("Verdicts", ", ".join(f"{name}: {count}" for name, count in summary.verdicts.items())),
                ("The same content twice", str(summary.repeated) if summary.repeated else ""),
            ]
        )
        for one in summary.common:
            _common(page, summary, one)
        outliers = [one for lot in summary.lots for one in lot.outliers]
        if outliers:
            _outliers(page, outliers)
        _lots(page, summary.lots)
        if summary.errors:
            page.heading("Recordings that failed")
            page.table(["recording", "why"], [list(pair) for pair in summary.errors], words=(0, 1))
        return page.html()


def sentence_of(summary: FleetSummary) -> str:
    """The answer in one sentence."""
    judged = [lot for lot in summary.lots if not lot.refused]
    refused = [lot for lot in summary.lots if lot.refused]
    words = [f"{_lot(one.lot)}: {_names(one.same)} (q = {one.q:.1g})" for one in summary.common]
    if not judged:
        return "No lot has enough tools to tell what they share from chance."
    said = "; ".join(words) if words else f"Nothing in common was found in {len(judged)} lots"
    out = sum(len(lot.outliers) for lot in summary.lots)
    said += f". {out} tools stand out" if out else ". No tool stands out"
    return said + (f"; {len(refused)} lots have too few tools." if refused else ".")


def _lot(name: str) -> str:
    return f"lot {name}" if name else "no lot"


def _names(entries: Sequence[str]) -> str:
    return " or ".join(map(_name, entries))


def _name(entry: str) -> str:
    """The title of an effect, with its shape where there are several: `cogging[k=3]`."""
    effect, _, shape = entry.partition("[")
    if effect.startswith(PREFIX):
        place, channel, along = effect.removeprefix(PREFIX).split("_", 2)
        words = f"a law without a name: {PLACES[place].title} {channel}, by {covariate(along).title}"
        return f"{words} ({shape.removesuffix(']')})"
    known = all_effects().get(effect)
    title = effect if known is None else known.title
    return title if not shape else f"{title} ({shape.removesuffix(']')})"


def _common(page: Page, summary: FleetSummary, one: Common) -> None:
    page.heading(f"{_lot(one.lot)}: {_names(one.same)}")
    units = summary.units[one.effect]
    page.table(
        ["parameter", "mean", "standard deviation", "from tool to tool", "unit"],
        [
            [name, f"{mean:.3g}", f"{std:.2g}", f"{scatter:.2g}", unit]
            for name, mean, std, scatter, unit in zip(
                one.parameters, one.pooled.mean, one.pooled.std, one.pooled.scatter, units, strict=True
            )
        ],
        caption=f"{_name(one.effect)}, {one.pooled.tools} tools; false discovery rate {one.q:.1g}",
        words=(0, 4),
    )
    page.facts(
        [
            (
                "Proof",
                f"tools left out one at a time: log likelihood +{one.proof.gain:.1f} +- {one.proof.std:.1f} with it",
            ),
            ("Not distinguished from", _names(one.same[1:])),
            ("Changes", f"after tool {one.change.after} (p = {one.change.p:.1g})" if one.change is not None else ""),
        ]
    )
    page.figure(
        _tools_figure(summary.views[one.lot, one.effect], one),
        "Each tool's own estimate with its standard deviation; the band is the mean of the lot with twice its own. "
        "No single tool need show it.",
    )


def _tools_figure(view: LotView, one: Common) -> Figure:
    largest = int(np.argmax(np.abs(one.pooled.t)))
    figure, ((axes,),) = new_figure(1, 1)
    at = np.arange(len(view.tools))
    finite = np.isfinite(view.std[:, largest])
    axes.errorbar(
        at[finite],
        view.estimate[finite, largest],
        view.std[finite, largest],
        fmt="o",
        markersize=3,
        linewidth=0.8,
        color=_GREY,
        label="each tool",
    )
    mean, std = one.pooled.mean[largest], one.pooled.std[largest]
    axes.axhline(mean, color=_COMMON, label="in common")
    axes.axhspan(mean - 2 * std, mean + 2 * std, color=_COMMON, alpha=0.2)
    axes.axhline(0.0, color=_OUT, linestyle=":", label="nothing")
    axes.set(xlabel="tool", ylabel=f"{one.parameters[largest]}, {view.units[largest]}")
    if len(view.tools) <= MOST_NAMES:
        axes.set_xticks(at, view.tools, rotation=90, fontsize=6)
    axes.legend(loc="best", fontsize="small")
    return figure


def _outliers(page: Page, outliers: list[Outlier]) -> None:
    page.heading("Tools that stand out")
    page.table(
        ["lot", "tool", "by", "p"],
        [[one.lot, one.tool, _names(one.same), f"{one.p:.1g}"] for one in outliers],
        caption="against what the other tools of the lot predict, the number of tools and effects counted in",
        words=(0, 1, 2),
    )


def _lots(page: Page, lots: tuple[LotTested, ...]) -> None:
    page.heading("Lots")
    page.table(
        ["lot", "tools", "in common", "stand out", "remark"],
        [
            [
                lot.lot or "-",
                str(lot.tools),
                ", ".join(_name(one.effect) for one in lot.common) or ("-" if lot.refused else "nothing found"),
                ", ".join(one.tool for one in lot.outliers) or "-",
                lot.refused,
            ]
            for lot in lots
        ],
        words=(0, 2, 3, 4),
    )
