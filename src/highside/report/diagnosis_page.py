"""`report.html` of a diagnosis: what was left out and how sure that is on the first screen, the evidence below."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from highside.diagnosis.core.result import Claim, DiagnosisResult, Location
from highside.diagnosis.engine import ReportData
from highside.physics.law import Law
from highside.report.diagnosis_chart import misfit_chart
from highside.report.diagnosis_claims import (
    claim_title,
    claims_table,
    covariate_label,
    first_sentence,
    is_law,
    law_words,
    ordered,
    title_of_any,
)
from highside.report.diagnosis_figures import law_curve, law_surface, over_time, residuals, table_misfit, table_values
from highside.report.diagnosis_hints import check_name, hint
from highside.report.diagnosis_words import (
    KINDS,
    VERDICTS,
    along,
    blame,
    effect_name,
    effect_within,
    proof,
    quantity,
    ranges,
    sizes,
    tested,
    verdict_name,
    verdict_words,
    where,
    within_sentence,
)
from highside.report.document import Page
from highside.report.misfit_steps import ALL_FOUND, Steps, shares_of_misfit, steps_of
from highside.report.misfit_waterfall import waterfall
from highside.shown.screen import can_draw
from highside.words import _
from highside.words.marked import in_words

if TYPE_CHECKING:
    from highside.diagnosis.table.engine import SummaryReportData

__all__ = ["VERDICTS", "page_of"]

MAGNITUDE = "g_total"
"""The one channel of a recording of which only |g| is known."""
DRAWN = 4
"""At most so many places are drawn."""


def page_of(diagnosis: DiagnosisResult, report_data: ReportData | SummaryReportData | None, recording: str) -> str:
    """The whole page as HTML."""
    rows = report_data if isinstance(report_data, ReportData) else None
    steps = None if rows is None else steps_of(rows)
    shares = {} if steps is None else shares_of_misfit(diagnosis, steps)
    page = Page(first_sentence(diagnosis, shares, verdict_words(diagnosis)))
    page.badge(
        verdict_name(diagnosis),
        KINDS.get(diagnosis.verdict, "open"),
        _("Diagnosis of %(recording)s.", recording=recording) + tested(diagnosis),
    )
    if diagnosis.intake:
        _faults(page, diagnosis)
    if rows is not None and steps is not None:
        page.figure(waterfall(steps, _titles(diagnosis, steps)), _waterfall_caption(steps))
        page.figure(over_time(rows), _over_time_caption(rows))
    elif report_data is not None and not isinstance(report_data, ReportData):
        _table_figures(page, diagnosis, report_data)
    if diagnosis.claims:
        headers, lines = claims_table(diagnosis.claims, shares)
        page.table(headers, lines, words=(0, 1, 3, 4))
    page.facts(_facts(diagnosis))
    for claim in ordered(diagnosis.claims, shares):
        _claim(page, diagnosis, claim, rows)
    if rows is not None and not diagnosis.claims:
        _residuals(page, diagnosis, rows)
    if report_data is not None:
        _closer(page, report_data)
    _remainder(page, diagnosis)
    _details(page, diagnosis, shares)
    made = _("highside %(version)s, seed %(seed)s.", version=diagnosis.version, seed=diagnosis.seed)
    page.paragraph(made, look="soft")
    return page.html()


def _titles(diagnosis: DiagnosisResult, steps: Steps) -> dict[str, str]:
    """Words beside the bars; what was fitted and not believed says so."""
    claimed = {c.effect: law_words(c) if is_law(c) else claim_title(c) for c in diagnosis.claims}
    claimed[ALL_FOUND] = _(ALL_FOUND)
    return {name: claimed.get(name) or _("%(effect)s (not believed)", effect=effect_name(name)) for name in steps.names}


def _facts(diagnosis: DiagnosisResult) -> list[tuple[str, str]]:
    """What a reader does with the answer; figures of the proof stand below."""
    rows: list[tuple[str, str]] = []
    if not diagnosis.claims and diagnosis.location:
        rows.append((_("Where"), where(diagnosis.location)))
    if not diagnosis.claims and diagnosis.remainder.resembles:
        names = ", ".join(effect_name(name) for name in diagnosis.remainder.resembles)
        rows.append((_("It resembles"), _("%(names)s (not believed: see below)", names=names)))
    if diagnosis.fit is not None:
        rows.append((_("Proof") if diagnosis.claims else _("Misfit"), proof(diagnosis.fit, diagnosis.noise)))
    if diagnosis.claims:
        words = blame(diagnosis, lambda claim: within_sentence(claim_title(claim)))
        rows += [(_("To blame"), words)] if words else []
        rows += [(_("Do next") if k == 0 else "", words) for k, words in enumerate(_advice(diagnosis))]
    elif diagnosis.remainder.hints:
        rows += [
            (_("What is known") if k == 0 else "", hint(one)) for k, one in enumerate(diagnosis.remainder.hints[:4])
        ]
    if diagnosis.verdict == "nothing_left_out" and diagnosis.minimum_detectable:
        few = list(diagnosis.minimum_detectable.items())[:6]
        words = ", ".join(
            _("%(effect)s of %(size)s", effect=effect_within(name), size=quantity(d.value, d.unit)) for name, d in few
        )
        rows.append((_("Would have been detected"), f"{words} ..."))
    return rows


def _advice(diagnosis: DiagnosisResult) -> list[str]:
    """What to measure next, once for all claims it serves."""
    wanted: dict[str, list[str]] = {}
    for claim in diagnosis.claims:
        if claim.next_manoeuvre:
            wanted.setdefault(claim.next_manoeuvre, []).append(claim_title(claim))
    needed = {words: names for words, names in wanted.items() if not words.startswith("none needed")} or wanted
    if len(diagnosis.claims) == 1 or all(words.startswith("none needed") for words in needed):
        return [hint(words) for words in needed]
    return [Markup("{}: {}").format(_(" and ").join(names), hint(words)) for words, names in needed.items()]


def _faults(page: Page, diagnosis: DiagnosisResult) -> None:
    page.heading(_("Faults of the data"))
    page.table(
        [_("check"), _("channels"), "p", _("what to do")],
        [[check_name(f.check), ", ".join(f.channels), f"{f.p:.1e}", hint(f.remedy)] for f in diagnosis.intake],
        words=(1, 3),
    )


def _table_figures(page: Page, diagnosis: DiagnosisResult, report_data: SummaryReportData) -> None:
    page.figure(
        table_misfit(report_data, diagnosis.location),
        _(
            "Misfit of each cell of the table in sigma, before (orange) and after (blue) what was found is simulated;"
            " rows shaded where it acts, the band is one sigma."
        ),
    )
    page.figure(
        table_values(report_data),
        _("The table beside the simulated chain. A sigma is what chance and the scatter beyond it do to a cell."),
    )


def _waterfall_caption(steps: Steps) -> str:
    words = _(
        "The misfit step by step: the simulation as given, what each effect takes away, and what is left. The noise of"
        " a row is subtracted from every bar."
    )
    return words + (" " + _against(steps.left, steps.floor) if steps.names else "")


def _against(left: float, floor: float) -> str:
    if left <= floor:
        return _("What is left is within the noise.")
    return _("What is left is %(times)s times what noise alone would leave.", times=f"{left / floor:.1f}")


def _claim(page: Page, diagnosis: DiagnosisResult, claim: Claim, rows: ReportData | None) -> None:
    """One claim: what it is, the residual without the others, its law, and what would tell more."""
    page.heading(claim_title(claim))
    page.paragraph(_story(claim))
    if rows is not None and rows.channels == (MAGNITUDE,) and claim.effect in rows.parts:
        seen = float(np.ptp(rows.parts[claim.effect]))
        size = quantity(seen, "g")
        page.paragraph(_("Over the recording it changes the magnitude of gravity by %(size)s.", size=size))
    if is_law(claim) and claim.curve is not None and rows is not None:
        law = None if claim.law is None else Law.from_dict(claim.law)
        pair = law is not None and len(law.lasting().axes) > 1
        drawn = law_surface(law) if law is not None and pair else law_curve(claim.curve, covariate_label(claim))
        page.figure(drawn, _curve_caption(claim, pair=pair))
    if rows is not None:
        for place, effect in _places(diagnosis, rows, claim):
            page.panels(residuals(rows, place, effect), _caption(place, effect))
    if claim.readings:
        page.paragraph(_("What could act like this (suggestions, not findings):"))
        page.bullets([hint(one) for one in claim.readings])
    if claim.confirm:
        words = _("Another session confirms or refutes it:")
        page.paragraph(Markup("{} {}.").format(words, hint(claim.confirm)))


def _story(claim: Claim) -> Markup | str:
    if not is_law(claim):
        return in_words(claim.story[:1].upper() + claim.story[1:], claim.story)
    words = _("%(law)s: no effect of the library, a law learnt from this recording.", law=law_words(claim))
    return words[:1].upper() + words[1:]


def _curve_caption(claim: Claim, *, pair: bool) -> str:
    within = ""
    if claim.shape_within:
        share = f"{100 * claim.shape_within:.0f}"
        within = " " + _("Another shape within %(share)s %% of it fits as well.", share=share)
    if pair:
        drawn = _("The law that was found, over both of what it follows, and how uncertain it is.")
    elif claim.law is not None and claim.law.get("formula"):
        drawn = _("The formula that was found, with twice the standard deviation of a curve in its place as a band.")
    else:
        drawn = _("The law that was found, with twice its standard deviation as a band.")
    if not pair and claim.curve is not None and claim.curve.unread:
        drawn += " " + _("Nothing was read where it is shaded: there it follows from its neighbours alone.")
    beyond = _("Beyond the range that was visited nothing is known of it.")
    return f"{drawn} {beyond}{within}"


def _residuals(page: Page, diagnosis: DiagnosisResult, rows: ReportData) -> None:
    left = diagnosis.verdict == "nothing_left_out"
    page.heading(_("What is left") if left else _("Where the mismatch sits"))
    for place, effect in _places(diagnosis, rows)[:DRAWN]:
        page.panels(residuals(rows, place, effect), _caption(place, effect))


def _closer(page: Page, report_data: ReportData | SummaryReportData) -> None:
    """Every row, to zoom and hover in; nothing where what draws that is not installed."""
    if can_draw():
        page.heading(_("Look closer"))
        page.chart(
            misfit_chart(report_data, ""),
            _(
                "The residual of each channel before (orange) and with what was found (blue): draw a box to zoom in,"
                " point at a line for its values, the arrow in a circle goes back. Of long recordings the extremes of"
                " intervals are shown."
            ),
        )


def _details(page: Page, diagnosis: DiagnosisResult, shares: Mapping[str, float]) -> None:
    """What few readers want, behind lines that open it."""
    if diagnosis.claims:
        with page.folded(_("Formulas and rivals")):
            for claim in ordered(diagnosis.claims, shares):
                _evidence(page, claim)
    if diagnosis.not_testable:
        with page.folded(_("What this recording could not show (%(count)s)", count=len(diagnosis.not_testable))):
            page.table(
                [_("effect"), _("why"), _("what it needs")],
                [[effect_name(n.effect), hint(n.why), hint(n.needs)] for n in diagnosis.not_testable],
                _("These were not tested; that they were not found says nothing."),
                words=(0, 1, 2),
            )
    if diagnosis.minimum_detectable:
        with page.folded(_("The smallest sizes that would have been detected")):
            rows = [[effect_name(name), quantity(d.value, d.unit)] for name, d in diagnosis.minimum_detectable.items()]
            page.table([_("effect"), _("size (80 %% probability)") % {}], rows)


def _places(
    diagnosis: DiagnosisResult, report_data: ReportData, claim: Claim | None = None
) -> list[tuple[Location, str | None]]:
    """What is drawn: the place of each claim (or of one) with its effect, or where the mismatch sits; none twice."""
    claimed = len(diagnosis.location) == len(diagnosis.claims)
    effects = [c.effect for c in diagnosis.claims] if claimed else [None] * len(diagnosis.location)
    found: list[tuple[Location, str | None]] = []
    for place, effect in (
        *zip(diagnosis.location, effects, strict=True),
        *((place, None) for place in (() if diagnosis.location else diagnosis.remainder.location)),
    ):
        if claim is not None and effect != claim.effect:
            continue
        own = effect if effect in report_data.parts else None
        same = any((p.channels, p.covariate, e) == (place.channels, place.covariate, own) for p, e in found)
        if place.covariate != "reading_g" and not same:
            found.append((place, own))
    if found or claim is not None:
        return found
    return [(Location(report_data.channels, "t_s", (), None, 0.0, 1.0), None)]


def _over_time_caption(report_data: ReportData) -> str:
    above = (
        _("Above, the readings and the simulation before and after what was found is added, where it misses most;")
        if report_data.recorded is not None
        else _("Above, what the simulation leaves before and after what was found is added, where it misses most;")
    )
    below = _(
        "in the middle what is left there, in units of the noise of one row (the band is two); below, the misfit over"
        " the whole recording."
    )
    return f"{above} {below}"


def _caption(place: Location, effect: str | None) -> str:
    if not place.intervals:
        return _("Residual of each channel over time.")
    shade, where = ranges(place), along(place)
    if effect is not None:
        titled = title_of_any(effect)
        return _(
            "%(effect)s: residual of %(where)s, all other effects that were found taken off (orange), what it does as"
            " fitted (dashed), and below what is left, in units of the noise of one row; largest at %(range)s.",
            effect=titled[0].upper() + titled[1:],
            where=where,
            range=shade,
        )
    return _(
        "Residual of %(where)s before what was found is added (orange), and below what is left, in units of the noise"
        " of one row; the mismatch is largest at %(range)s.",
        where=where,
        range=shade,
    )


def _evidence(page: Page, claim: Claim) -> None:
    formula = ""
    if claim.formula:
        formula = _("formula %(formula)s (stage: %(stage)s).", formula=claim.formula, stage=claim.stage) + " "
    page.paragraph(f"{claim_title(claim)} ({claim.effect}): {formula}{sizes(claim)}.")
    if claim.rivals_ruled_out:
        page.table(
            [_("rival"), _("BIC against it")],
            [[effect_name(r.effect), f"{r.delta_bic:,.0f}"] for r in claim.rivals_ruled_out],
            _("Rivals that the data speak against: beyond 6 is strong, beyond 10 decisive."),
        )


def _remainder(page: Page, diagnosis: DiagnosisResult) -> None:
    remainder = diagnosis.remainder
    if not remainder.hints and not remainder.resembles:
        return
    page.heading(_("What remains"))
    page.bullets([hint(one) for one in remainder.hints])
    if remainder.resembles:
        names = ", ".join(effect_name(name) for name in remainder.resembles)
        page.paragraph(_("It resembles, without being it: %(names)s.", names=names))
    if remainder.location:
        page.paragraph(_("It sits at: %(where)s.", where=where(remainder.location)))
