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
from highside.report.diagnosis_words import VERDICT_NAMES
from highside.report.document import Page
from highside.report.parameter_names import parameter_name
from highside.report.plots import new_figure, plotting
from highside.words import _, said_later, several, told
from highside.words.marked import in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["page_of", "sentence_of"]

_COMMON, _OUT, _GREY = "#2f7fd1", "#c2447d", "#9aa3ab"
FAILED = said_later("failed")
MOST_NAMES = 60
"""tools whose names are written below a figure; more would overlap"""


def page_of(summary: FleetSummary, title: str) -> str:
    """The report as HTML. Raises InputError where matplotlib is not installed."""
    with plotting():
        page = Page(_("Fleet: %(title)s", title=title))
        kind = "found" if summary.common or any(lot.outliers for lot in summary.lots) else "good"
        page.badge(_("%(count)s in common", count=len(summary.common)), kind, sentence_of(summary))
        recordings = _(
            "%(count)s of %(tools)s tools, grouped by %(column)s",
            count=summary.recordings,
            tools=summary.tools,
            column=summary.grouped_by,
        )
        verdicts = ", ".join(f"{_verdict(name)}: {count}" for name, count in summary.verdicts.items())
        repeated = str(summary.repeated) if summary.repeated else ""
        page.facts([(_("Recordings"), recordings), (_("Verdicts"), verdicts), (_("The same content twice"), repeated)])
        for one in summary.common:
            _common(page, summary, one)
        outliers = [one for lot in summary.lots for one in lot.outliers]
        if outliers:
            _outliers(page, outliers)
        _lots(page, summary.lots)
        if summary.errors:
            page.heading(_("Recordings that failed"))
            rows = [[uri, in_words(why, of="diagnosis")] for uri, why in summary.errors]
            page.table([_("recording"), _("why")], rows, words=(0, 1))
        return page.html()


def sentence_of(summary: FleetSummary) -> str:
    """The answer in one sentence."""
    judged = sum(not lot.refused for lot in summary.lots)
    refused = len(summary.lots) - judged
    if not judged:
        return _("No lot has enough tools to tell what they share from chance.")
    words = [
        _("%(lot)s: %(names)s (q = %(q)s)", lot=_lot(one.lot), names=_names(one.same), q=f"{one.q:.1g}")
        for one in summary.common
    ]
    nothing = several(
        "Nothing in common was found in %(count)s lot", "Nothing in common was found in %(count)s lots", judged
    )
    out = sum(len(lot.outliers) for lot in summary.lots)
    stands_out = several("%(count)s tool stands out", "%(count)s tools stand out", out) % {"count": out}
    sentences = [
        "; ".join(words) if words else nothing % {"count": judged},
        stands_out if out else _("No tool stands out"),
    ]
    if refused:
        few = several("%(count)s lot has too few tools", "%(count)s lots have too few tools", refused)
        sentences[-1] += "; " + few % {"count": refused}
    return ". ".join(sentences) + "."


def _verdict(name: str) -> str:
    return _(VERDICT_NAMES[name]) if name in VERDICT_NAMES else _(FAILED) if name == "error" else name


def _lot(name: str) -> str:
    return _("lot %(name)s", name=name) if name else _("no lot")


def _names(entries: Sequence[str]) -> str:
    return _(" or ").join(map(_name, entries))


def _name(entry: str) -> str:
    """The title of an effect, with its shape where there are several: `cogging[k=3]`."""
    effect, _mark, shape = entry.partition("[")
    if effect.startswith(PREFIX):
        place, channel, along = effect.removeprefix(PREFIX).split("_", 2)
        acts_on = f"{told(PLACES[place].title, 'diagnosis')} {channel}"
        words = _("a law without a name: %(place)s, by %(along)s", place=acts_on, along=told(covariate(along).title))
        return f"{words} ({shape.removesuffix(']')})"
    known = all_effects().get(effect)
    title = effect if known is None else told(known.title)
    return title if not shape else f"{title} ({shape.removesuffix(']')})"


def _common(page: Page, summary: FleetSummary, one: Common) -> None:
    page.heading(f"{_lot(one.lot)}: {_names(one.same)}")
    units = summary.units[one.effect]
    page.table(
        [_("parameter"), _("mean"), _("standard deviation"), _("from tool to tool"), _("unit")],
        [
            [_parameter(one.effect, name), f"{mean:.3g}", f"{std:.2g}", f"{scatter:.2g}", unit]
            for name, mean, std, scatter, unit in zip(
                one.parameters, one.pooled.mean, one.pooled.std, one.pooled.scatter, units, strict=True
            )
        ],
        caption=_(
            "%(name)s, tools: %(tools)s; false discovery rate %(rate)s",
            name=_name(one.effect),
            tools=one.pooled.tools,
            rate=f"{one.q:.1g}",
        ),
        words=(0, 4),
    )
    proof = _(
        "tools left out one at a time: log likelihood %(gain)s with it",
        gain=f"{one.proof.gain:+.1f} +- {one.proof.std:.1f}",
    )
    facts = [(_("Proof"), proof), (_("Not distinguished from"), _names(one.same[1:]))]
    if one.change is not None:
        facts.append(
            (_("Changes"), _("after tool %(tool)s (p = %(p)s)", tool=one.change.after, p=f"{one.change.p:.1g}"))
        )
    page.facts(facts)
    page.figure(
        _tools_figure(summary.views[one.lot, one.effect], one),
        _(
            "Each tool's own estimate with its standard deviation; the band is the mean of the lot with twice its own."
            " No single tool need show it."
        ),
    )


def _parameter(effect: str, name: str) -> str:
    """Its title, where it has one."""
    return parameter_name(effect.partition("[")[0], name)


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
        label=_("each tool"),
    )
    mean, std = one.pooled.mean[largest], one.pooled.std[largest]
    axes.axhline(mean, color=_COMMON, label=_("in common"))
    axes.axhspan(mean - 2 * std, mean + 2 * std, color=_COMMON, alpha=0.2)
    axes.axhline(0.0, color=_OUT, linestyle=":", label=_("nothing"))
    axes.set(xlabel=_("tool"), ylabel=f"{_parameter(one.effect, one.parameters[largest])}, {view.units[largest]}")
    if len(view.tools) <= MOST_NAMES:
        axes.set_xticks(at, view.tools, rotation=90, fontsize=6)
    axes.legend(loc="best", fontsize="small")
    return figure


def _outliers(page: Page, outliers: list[Outlier]) -> None:
    page.heading(_("Tools that stand out"))
    page.table(
        [_("lot"), _("tool"), _("effect"), "p"],
        [[one.lot, one.tool, _names(one.same), f"{one.p:.1g}"] for one in outliers],
        caption=_("against what the other tools of the lot predict, the number of tools and effects counted in"),
        words=(0, 1, 2),
    )


def _lots(page: Page, lots: tuple[LotTested, ...]) -> None:
    page.heading(_("Lots"))
    page.table(
        [_("lot"), _("tools"), _("in common"), _("stand out"), _("remark")],
        [
            [
                lot.lot or "-",
                str(lot.tools),
                ", ".join(_name(one.effect) for one in lot.common) or ("-" if lot.refused else _("nothing found")),
                ", ".join(one.tool for one in lot.outliers) or "-",
                told(lot.refused),
            ]
            for lot in lots
        ],
        words=(0, 2, 3, 4),
    )
