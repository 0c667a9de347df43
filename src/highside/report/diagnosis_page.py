"""`report.html` of a diagnosis: what was left out and how sure that is on the first screen, the evidence below."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.engine import Picture
from highside.diagnosis.result import Claim, Diagnosis, Location
from highside.physics.effects import all_effects
from highside.report.page import Page, new_figure, plotting

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

BEFORE, AFTER, SHADE = "#d9822b", "#2f7fd1", "#808890"
VERDICTS = {
    "nothing_left_out": "Nothing was left out: the simulation explains this recording to within its noise.",
    "named": "The simulation leaves out",
    "named_plus": "The simulation leaves out (with a small remainder beyond it)",
    "partial": "Something was left out that the library does not fully explain; no name is given.",
    "unknown": "Something was left out that the library has no name for.",
    "wander": "The zero offsets wander; slow effects cannot be told from that.",
    "implausible_fit": "The only explanation found has parameters that are not plausible; no name is given.",
    "not_testable": "This recording cannot show what was asked.",
    "bad_data": "The data are not what they claim to be; physics was not asked.",
}
AXIS_NAMES = {
    "tf_ref_deg": "toolface, deg",
    "inc_ref_deg": "inclination, deg",
    "temp_c": "temperature, C",
    "t_s": "time, s",
    "direction": "direction of approach",
    "vibration_rms_g": "vibration, g rms",
    "reading_g": "reading, g",
}


def page_of(diagnosis: Diagnosis, picture: Picture | None, recording: str) -> str:
    """The whole page as HTML. Raises InputError where matplotlib is not installed."""
    with plotting():
        return _page_of(diagnosis, picture, recording)


def _page_of(diagnosis: Diagnosis, picture: Picture | None, recording: str) -> str:
    effects = all_effects()
    words = VERDICTS[diagnosis.verdict]
    titles = [effects[claim.effect].title.lower() for claim in diagnosis.claims]
    page = Page(f"{words.rstrip('.')}: {' and '.join(titles)}" if titles else words)
    page.paragraph(f"Recording: {recording}. Verdict: {diagnosis.verdict}.", soft=True)
    for claim in diagnosis.claims:
        page.paragraph(f"{effects[claim.effect].title}. {claim.story}")
        page.paragraph(_sureness(claim))
    if diagnosis.fit and diagnosis.fit.heldout_gain_low is not None and diagnosis.fit.heldout_gain_high is not None:
        fit = diagnosis.fit
        page.paragraph(
            f"Misfit {1e6 * fit.rmse_before:.1f} ug before, {1e6 * fit.rmse_after:.1f} ug after (noise "
            f"{1e6 * fit.noise_floor:.1f} ug); on readings that the fit had not seen"
            f" {1e6 * (fit.heldout_rmse_before or 0):.1f} and {1e6 * (fit.heldout_rmse_after or 0):.1f} ug:"
            f" {fit.heldout_gain_low:.0%} to {fit.heldout_gain_high:.0%} of the mean square removed "
            f"({fit.how_held_out})."
        )
    if diagnosis.intake:
        page.heading("Faults of the data")
        page.table(
            ["check", "channels", "p", "what to do"],
            [[f.check, ", ".join(f.channels), f"{f.p:.1e}", f.remedy] for f in diagnosis.intake],
            words=(1, 3),
        )
    if picture is not None:
        page.heading("Where the mismatch sits")
        drawn = tuple(place for place in diagnosis.location if place.covariate != "reading_g")
        for location in drawn or (Location(picture.channels[:3], "t_s", (), None, 0.0, 1.0),):
            page.figure(_residuals(picture, location), _caption(location))
    for claim in diagnosis.claims:
        _rivals(page, claim)
    if diagnosis.remainder.hints or diagnosis.remainder.resembles:
        page.heading("What remains")
        page.bullets(list(diagnosis.remainder.hints))
        if diagnosis.remainder.resembles:
            page.paragraph(f"It resembles, without being it: {', '.join(diagnosis.remainder.resembles)}.")
    if diagnosis.not_testable:
        page.heading("What this recording could not show")
        page.table(
            ["effect", "why", "what it needs"],
            [[n.effect, n.why, n.needs] for n in diagnosis.not_testable],
            words=(1, 2),
        )
    if diagnosis.minimum_detectable:
        page.heading("The smallest sizes that would have been seen")
        rows = [[name, f"{d.value:.2g} {d.unit}"] for name, d in diagnosis.minimum_detectable.items()]
        page.table(["effect", "size (80 % probability)"], rows)
    return page.html()


def _sureness(claim: Claim) -> str:
    others = [name for name in claim.equivalence_class if name != claim.effect]
    alike = (
        f"Cannot be told apart here: {', '.join(others)}. " if others else "No other known effect explains it as well. "
    )
    values = ", ".join(
        f"{name} = {p.value:.3g} ({p.low:.3g} to {p.high:.3g}) {p.unit}" for name, p in claim.parameters.items()
    )
    return f"By chance in {claim.p_familywise:.1e} of recordings. {alike}{values}. Next: {claim.next_manoeuvre}."


def _caption(location: Location) -> str:
    where = "; ".join(f"{low:g} to {high:g}" for low, high in location.intervals)
    channels = ", ".join(location.channels)
    if not where:
        return "Residual of each channel over time."
    harmonic = f", harmonic {location.harmonic}" if location.harmonic else ""
    return (
        f"Residual of {channels} against {AXIS_NAMES.get(location.covariate, location.covariate)}{harmonic}: before "
        f"(orange) and after (blue) the effect is added; shaded where the mismatch sits ({where})."
    )


def _residuals(picture: Picture, location: Location) -> Figure:
    along, label = _along(picture, location.covariate)
    figure, axes = new_figure(1, len(location.channels))
    for axis, name in zip(axes[0], location.channels, strict=True):
        channel = picture.channels.index(name)
        for low, high in location.intervals:
            pad = 0.01 * float(np.ptp(along) or 1.0)
            axis.axvspan(low - pad, high + pad, color=SHADE, alpha=0.18, linewidth=0)
        axis.plot(along, 1e6 * picture.before[channel], ".", color=BEFORE, label="before")
        axis.plot(along, 1e6 * picture.after[channel], ".", color=AFTER, label="after")
        axis.set(xlabel=label, ylabel="residual, ug", title=name)
        axis.legend()
    return figure


def _along(picture: Picture, covariate: str) -> tuple[Array, str]:
    state = picture.session.state
    last: Sequence[str] = covariate.split(" x ")
    name = last[-1] if last[-1] in AXIS_NAMES else last[0]
    if covariate.startswith("temp_c"):
        name = "temp_c"
    columns = {
        "tf_ref_deg": np.mod(np.degrees(state.tf_rad), 360.0),
        "inc_ref_deg": np.degrees(state.inc_rad),
        "temp_c": state.temp_c,
        "t_s": state.t_s,
        "direction": state.direction,
        "vibration_rms_g": state.vibration_rms_g,
    }
    if name not in columns:
        name = "inc_ref_deg"
    return np.asarray(columns[name], dtype=float), AXIS_NAMES[name]


def _rivals(page: Page, claim: Claim) -> None:
    if claim.rivals_ruled_out:
        page.heading(f"Rivals of {claim.effect} that the data speak against")
        page.table(
            ["rival", "BIC against it"], [[r.effect, f"{r.delta_bic:.1f}"] for r in claim.rivals_ruled_out],
            "Beyond 6 is strong, beyond 10 decisive.",
        )  # fmt: skip
    page.paragraph(f"Formula: {claim.formula} (stage: {claim.stage}).", soft=True)
