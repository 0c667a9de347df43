"""`report.html` of a diagnosis: what was left out and how sure that is on the first screen, the evidence below."""

from __future__ import annotations

import numpy as np

from highside.diagnosis.core.result import Claim, Diagnosis, Location
from highside.diagnosis.engine import Picture
from highside.diagnosis.table.engine import SummaryPicture
from highside.physics.effects import title_of
from highside.report.diagnosis_figures import over_time, residuals, table_misfit, table_values
from highside.report.diagnosis_words import (
    KINDS,
    VERDICTS,
    axis_name,
    blame,
    headline,
    proof,
    quantity,
    ranges,
    sizes,
    sureness,
    where,
)
from highside.report.document import Page
from highside.report.plots import can_plot, plotting

__all__ = ["VERDICTS", "page_of"]

NO_FIGURES = "without figures: they need matplotlib (pip install 'highside[plot]')"
"""Said in the page and at the terminal where matplotlib is not installed."""
DRAWN = 4
"""At most so many places are drawn."""


def page_of(diagnosis: Diagnosis, picture: Picture | SummaryPicture | None, recording: str) -> str:
    """The whole page as HTML; where matplotlib is not installed it is without figures, and says so."""
    if not can_plot():
        return _page_of(diagnosis, None, recording, NO_FIGURES)
    with plotting():
        return _page_of(diagnosis, picture, recording)


def _page_of(
    diagnosis: Diagnosis, picture: Picture | SummaryPicture | None, recording: str, remark: str | None = None
) -> str:
    page = Page(headline(diagnosis))
    page.badge(diagnosis.verdict, KINDS.get(diagnosis.verdict, "open"), f"Diagnosis of {recording}")
    page.facts(_facts(diagnosis))
    if picture is not None:
        _figures(page, diagnosis, picture)
    if remark is not None:
        page.paragraph(f"This page is {remark}.", look="soft")
    if len(diagnosis.intake) > 0:
        page.heading("Faults of the data")
        page.table(
            ["check", "channels", "p", "what to do"],
            [[f.check, ", ".join(f.channels), f"{f.p:.1e}", f.remedy] for f in diagnosis.intake],
            words=(1, 3),
        )
    for claim in diagnosis.claims:
        _evidence(page, claim)
    _remainder(page, diagnosis)
    if diagnosis.not_testable:
        page.heading("What this recording could not show")
        page.table(
            ["effect", "why", "what it needs"],
            [[n.effect, n.why, n.needs] for n in diagnosis.not_testable],
            "These were not tested; that they were not found says nothing.",
            words=(1, 2),
        )
    if diagnosis.minimum_detectable:
        page.heading("The smallest sizes that would have been seen")
        rows = [[name, quantity(d.value, d.unit)] for name, d in diagnosis.minimum_detectable.items()]
        page.table(["effect", "size (80 % probability)"], rows)
    page.paragraph(f"highside {diagnosis.version}, seed {diagnosis.seed}.", look="soft")
    return page.html()


def _facts(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """The first screen."""
    rows: list[tuple[str, str]] = []
    for claim in diagnosis.claims:
        rows.append(("What was left out", f"{title_of(claim.effect)}. {claim.story}"))
        rows.append(("Its size", sizes(claim)))
        rows.append(("How sure", sureness(claim)))
    rows += [(f.check, f"{', '.join(f.channels)}: {f.remedy} (p = {f.p:.1e})") for f in diagnosis.intake[:3]]
    if diagnosis.location:
        rows.append(("Where", where(diagnosis.location)))
    if not diagnosis.claims and diagnosis.remainder.resembles:
        rows.append(("It resembles", ", ".join(diagnosis.remainder.resembles) + " (not believed: see below)"))
    if diagnosis.fit is not None:
        rows.append(("Proof" if diagnosis.claims else "Misfit", proof(diagnosis.fit)))
    if diagnosis.claims:
        rows += [("To blame", words)] if (words := blame(diagnosis)) else []
        advice = list(dict.fromkeys(claim.next_manoeuvre for claim in diagnosis.claims))
        needed = [words for words in advice if not words.startswith("none needed")] or advice
        rows += [("Do next" if k == 0 else "", words) for k, words in enumerate(needed)]
    elif diagnosis.remainder.hints:
        rows += [("What is known" if k == 0 else "", hint) for k, hint in enumerate(diagnosis.remainder.hints[:4])]
    if diagnosis.verdict == "nothing_left_out" and diagnosis.minimum_detectable:
        few = list(diagnosis.minimum_detectable.items())[:6]
        rows.append(
            ("Would have been seen", ", ".join(f"{name} of {quantity(d.value, d.unit)}" for name, d in few) + " ...")
        )
    if diagnosis.not_testable:
        names = [n.effect for n in diagnosis.not_testable]
        more = f" and {len(names) - 6} more" if len(names) > 6 else ""
        rows.append(("Not tested", ", ".join(names[:6]) + more))
    return rows


def _figures(page: Page, diagnosis: Diagnosis, picture: Picture | SummaryPicture) -> None:
    page.heading("Where the mismatch sits")
    if isinstance(picture, SummaryPicture):
        page.figure(
            table_misfit(picture, diagnosis.location),
            "Misfit of each cell of the table in sigma, before (orange) and after (blue) what was found is simulated; "
            "rows shaded where it acts, the band is one sigma.",
        )
        page.figure(
            table_values(picture),
            "The table beside the simulated chain. A sigma is what chance and the scatter beyond it do to a cell.",
        )
        return
    if picture.recorded is not None or not np.array_equal(picture.before, picture.after):
        page.figure(over_time(picture), _over_time_caption(picture))
    for place, effect in _places(diagnosis, picture)[:DRAWN]:
        page.panels(residuals(picture, place, effect), _caption(place, effect if effect in picture.parts else None))


def _places(diagnosis: Diagnosis, picture: Picture) -> list[tuple[Location, str | None]]:
    """What is drawn: the place of each claim with its effect, or where the mismatch sits; none twice."""
    claimed = len(diagnosis.location) == len(diagnosis.claims)
    effects = [claim.effect for claim in diagnosis.claims] if claimed else [None] * len(diagnosis.location)
    found: list[tuple[Location, str | None]] = []
    for place, effect in (
        *zip(diagnosis.location, effects, strict=True),
        *((place, None) for place in (() if diagnosis.location else diagnosis.remainder.location)),
    ):
        own = effect if effect in picture.parts else None
        same = any((p.channels, p.covariate, e) == (place.channels, place.covariate, own) for p, e in found)
        if place.covariate != "reading_g" and not same:
            found.append((place, own))
    return found or [(Location(picture.channels, "t_s", (), None, 0.0, 1.0), None)]


def _over_time_caption(picture: Picture) -> str:
    readings = "the readings and the simulation" if picture.recorded is not None else "what the simulation leaves"
    return (
        f"Above, {readings} before and after what was found is added, where it misses most; in the middle what is left "
        "there, in units of the noise of one row (the band is two); below, the misfit over the whole recording."
    )


def _caption(place: Location, effect: str | None) -> str:
    if not place.intervals:
        return "Residual of each channel over time."
    shade = ranges(place)
    harmonic = f", harmonic {place.harmonic}" if place.harmonic else ""
    where = f"{', '.join(place.channels)} along {axis_name(place.covariate)}{harmonic}"
    if effect is not None:
        return (
            f"{title_of(effect)}: residual of {where}, all other effects that were found taken off (orange), what it "
            f"does as fitted (dashed), and below what is left, in units of the noise of one row; largest at {shade}."
        )
    return (
        f"Residual of {where} before what was found is added (orange), and below what is left, in units of the noise of"
        f" one row; the mismatch is largest at {shade}."
    )


def _evidence(page: Page, claim: Claim) -> None:
    page.heading(f"The case for {claim.effect}")
    page.paragraph(f"Formula: {claim.formula} (stage: {claim.stage}). {sizes(claim)}.")
    if claim.rivals_ruled_out:
        page.table(
            ["rival", "BIC against it"],
            [[r.effect, f"{r.delta_bic:,.0f}"] for r in claim.rivals_ruled_out],
            "Rivals that the data speak against: beyond 6 is strong, beyond 10 decisive.",
        )
    page.paragraph(f"To split or confirm it: {claim.next_manoeuvre}.")


def _remainder(page: Page, diagnosis: Diagnosis) -> None:
    remainder = diagnosis.remainder
    if not remainder.hints and not remainder.resembles:
        return
    page.heading("What remains")
    page.bullets(list(remainder.hints))
    if remainder.resembles:
        page.paragraph(f"It resembles, without being it: {', '.join(remainder.resembles)}.")
    if remainder.location:
        page.paragraph(f"It sits at: {where(remainder.location)}.")
