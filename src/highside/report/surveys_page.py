"""The page of a multi-station analysis: verdict, Gtotal of each survey, parameters, and what could be seen at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from highside.report.document import Page
from highside.report.plots import new_figure
from highside.report.watch_page import COLOURS, add_found
from highside.watch.result import WatchResult
from highside.watch.surveys import Detectable
from highside.words import _, said_later

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PRIORS = {
    "record": said_later("the covariance of the record"),
    "iscwsa": said_later("accelerometer terms of the ISCWSA MWD model (no record was given)"),
}


@dataclass(frozen=True, slots=True)
class SurveyPoint:
    """A survey that was used: time since the first in s, Gtotal less what it should be, mg, and attitude, deg."""

    t_s: float
    error_mg: float
    inc_deg: float
    tf_deg: float | None


def page_of(
    found: WatchResult,
    detectable: Sequence[Detectable],
    points: Sequence[SurveyPoint],
    source: str,
    prior: str,
    notes: Sequence[str] = (),
) -> str:
    """The page as HTML; without figures where matplotlib is not installed."""
    page = Page(_("Multi-station analysis: does the calibration hold?"))
    add_found(
        page,
        found,
        (_("Surveys"), source),
        more=[(_("Known beforehand"), _(PRIORS[prior]))],
        first=lambda: _figure(points),
        caption=_(
            "Gtotal of each survey less what it should be, over time, inclination and toolface: what the analysis"
            " explains."
        ),
    )
    page.heading(_("What these surveys could show"))
    page.table(
        [_("departure"), _("found from"), _("standard deviation"), _("unit"), _("looks like")],
        [_row(one) for one in detectable],
        _(
            "A departure that was there from the first survey on: the size that is found with 95 %% probability, the"
            " Cramer-Rao bound of its standard deviation, and the others that could not be told from it at that size."
        )
        % {},
        words=(0, 3, 4),
    )
    if notes:
        page.heading(_("Notes"))
        page.bullets(list(notes))
    return page.html()


def _row(one: Detectable) -> list[str]:
    return [
        one.name,
        _("cannot be seen") if one.found_from is None else f"{one.found_from:.2g}",
        "" if one.std is None else f"{one.std:.2g}",
        one.unit,
        ", ".join(one.alike),
    ]


def _figure(points: Sequence[SurveyPoint]) -> Figure:
    figure, ((by_time, by_inc, by_tf),) = new_figure(1, 3, height=2.6)
    error = [one.error_mg for one in points]
    for axis, x, label in (
        (by_time, [one.t_s / 3600.0 for one in points], _("hours")),
        (by_inc, [one.inc_deg for one in points], _("inclination, deg")),
        (by_tf, [float("nan") if one.tf_deg is None else one.tf_deg for one in points], _("toolface, deg")),
    ):
        axis.plot(x, error, ".", color=COLOURS[0])
        axis.axhline(0.0, color="0.5", linewidth=0.8)
        axis.set_xlabel(label)
    by_time.set_ylabel(_("Gtotal error, mg"))
    return figure
