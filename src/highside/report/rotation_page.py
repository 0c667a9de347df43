"""The pages of `rotation fit` and `rotation compare`: the errors against the rotor angle, the curves, what they leave.

A part of the turn that no row saw is shaded: curves are guesses in it. Angles in degrees, errors in arcminutes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from markupsafe import Markup

from highside.arrays import Array
from highside.report.document import Page
from highside.report.plots import new_figure, plotting
from highside.rotation import Compensation, CurveMethod, ErrorCurve, Samples
from highside.rotation.compare import CurveComparison
from highside.rotation.curve import CurveForm
from highside.words import _, said_later
from highside.words.marked import in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_POINTS = 1500
"""rows drawn of a channel; a page needs no more"""
NAMES: Mapping[CurveMethod, str] = {
    CurveMethod.SINE: said_later("1 sine"),
    CurveMethod.HARMONICS2: said_later("2 two harmonics"),
    CurveMethod.POLYNOMIAL9: said_later("3 polynomial"),
    CurveMethod.NETWORK: said_later("4 network"),
    CurveMethod.AUTO: said_later("auto"),
}
COLOURS: Mapping[CurveMethod, str] = {
    CurveMethod.SINE: "#9aa3ab",
    CurveMethod.HARMONICS2: "#d9822b",
    CurveMethod.POLYNOMIAL9: "#7a5bd0",
    CurveMethod.NETWORK: "#c2447d",
    CurveMethod.AUTO: "#2f7fd1",
}
CHANNELS: Mapping[str, str] = {
    "roll": said_later("roll"),
    "pitch": said_later("pitch"),
    "heading": said_later("heading"),
    "inclination": said_later("inclination"),
    "toolface": said_later("toolface"),
}
ORDERS: Mapping[CurveForm, str] = {
    CurveForm.FOURIER: said_later("%(method)s, harmonics: %(order)s"),
    CurveForm.CHEBYSHEV: said_later("%(method)s, degree: %(order)s"),
    CurveForm.NETWORK: said_later("%(method)s, hidden units: %(order)s"),
}
_GREY, _GAP = "#9aa3ab", "#d9822b"


def fit_page(compensation: Compensation, samples: Mapping[str, Samples]) -> str:
    """The page of one compensation, as HTML. Raises InputError where matplotlib is not installed."""
    validity = compensation.validity
    with plotting():
        page = Page(_("Rotor-angle compensation"))
        facts = [(_("Recording"), compensation.source), (_("Compensation"), compensation.id)]
        for name, value in (
            (_("Inclination of the fit"), validity.inclination_deg),
            (_("Roll"), validity.roll_deg),
            (_("Pitch"), validity.pitch_deg),
        ):
            if value is not None:
                within = f"{validity.within_deg:g}"
                facts.append(
                    (name, _("%(angle)s deg; holds within %(within)s deg of it", angle=f"{value:g}", within=within))
                )
        page.facts(facts)
        for name, curve in compensation.curves.items():
            one = samples[name]
            page.heading(_(CHANNELS.get(name, name)))
            page.facts(_facts(curve, one))
            page.figure(
                _fit_figure(curve, one),
                _("Left: errors (grey) and curve with twice its standard deviation. Right: what the curve leaves.")
                + _shaded(curve.coverage.has_gap),
            )
            if curve.form is CurveForm.FOURIER and curve.order > 0:
                page.figure(_harmonics_figure(curve), _("Size of each harmonic with twice its standard deviation."))
        return page.html()


def compare_page(source: str, compared: Mapping[str, tuple[Samples, CurveComparison]]) -> str:
    """The page of all methods on the same rows, as HTML. Raises InputError where matplotlib is not installed."""
    with plotting():
        page = Page(_("Rotor-angle compensation: the methods side by side"))
        page.facts([(_("Recording"), source)])
        page.paragraph(
            _(
                "What is left of the rows a method was fitted to hides the difference between methods, because noise is"
                " most of it. Held out: the error on whole turns that the fit did not use."
            )
        )
        for name, (samples, comparison) in compared.items():
            page.heading(_(CHANNELS.get(name, name)))
            _scores(page, samples, comparison)
            curves = {method: score.curve for method, score in comparison.scores.items()}
            if not curves:
                continue
            gap = _shaded(samples.coverage.has_gap)
            page.figure(_curves_figure(curves, samples), _("Errors (grey) and the curve of each method.") + gap)
            page.figure(_left_figure(curves, samples), _("What each method leaves, on one scale."))
            remarks = _remarks(curves)
            if remarks:
                page.bullets(remarks)
        return page.html()


def _shaded(has_gap: bool) -> str:
    return " " + _("Shaded: not covered.") if has_gap else ""


def _scores(page: Page, samples: Samples, comparison: CurveComparison) -> None:
    """The table of one channel, and which methods were refused."""
    before = f"{np.mean(np.abs(samples.error)):.4f}"
    headers = (
        _("method"), _("order"), _("mean |e|"), _("std"), _("largest"), _("held out"), _("better than sine")
    )  # fmt: skip
    page.table(
        headers,
        [_row(method, comparison) for method in comparison.scores],
        caption=_("%(rows)s rows, mean absolute error %(size)s'; arcminutes", rows=samples.n, size=before),
        words=(0,),
    )
    if comparison.refused:
        page.bullets([_about(_(NAMES[method]), why) for method, why in comparison.refused.items()])


def _facts(curve: ErrorCurve, samples: Samples) -> list[tuple[str, str]]:
    held = curve.held_out
    method = _(NAMES.get(curve.method, curve.method.value))
    before, left = samples.error, samples.error - curve(samples.theta_rad, samples.rate_radps)
    facts = [
        (_("Method"), _(ORDERS[curve.form], method=method, order=curve.order)),
        (_("Rows"), _("%(rows)s over %(turns)s turns", rows=samples.n, turns=f"{curve.coverage.turns:.1f}")),
        (
            _("Mean absolute error"),
            _(
                "%(before)s' before, %(after)s' after",
                before=f"{np.mean(np.abs(before)):.4f}",
                after=f"{np.mean(np.abs(left)):.4f}",
            ),
        ),
        (_("Noise of a row"), f"{curve.noise:.4f}'"),
    ]
    if held is not None:
        seen = _(
            "rms %(rms)s', largest %(worst)s' (turns: %(turns)s)",
            rms=f"{held.rms:.4f}",
            worst=f"{held.worst:.4f}",
            turns=held.turns,
        )
        facts.append((_("On turns held out"), seen))
    remarks = [in_words(remark, of="rotation") for remark in curve.remarks]
    facts += [(_("Remark") if i == 0 else "", remark) for i, remark in enumerate(remarks)]
    return facts


def _row(method: CurveMethod, comparison: CurveComparison) -> list[str]:
    score, better = comparison.scores[method], comparison.better_than_sine(method)
    held = score.curve.held_out
    return [
        _(NAMES[method]),
        str(score.curve.order),
        f"{score.mean_abs:.5f}",
        f"{score.std:.5f}",
        f"{score.largest:.4f}",
        "-" if held is None else f"{held.rms:.5f}",
        "-" if better is None else f"{100 * better:.1f} %",
    ]


def _remarks(curves: Mapping[CurveMethod, ErrorCurve]) -> list[str]:
    """Each remark once, with the methods it is about unless it is about all."""
    about: dict[str, list[str]] = {}
    for method, curve in curves.items():
        for remark in curve.remarks:
            about.setdefault(remark, []).append(_(NAMES[method]))
    whole = len(curves)
    return [_about("" if len(names) == whole else ", ".join(names), remark) for remark, names in about.items()]


def _about(names: str, remark: str) -> str:
    """A remark of the fit in the reader's language, with the methods that it is about before it."""
    said = in_words(remark, of="rotation")
    return Markup("{}: {}").format(names, said) if names else said


def _places(samples: Samples) -> tuple[slice, Array]:
    """Which rows are drawn, and where, deg."""
    thin = slice(None, None, -(-samples.n // MOST_POINTS))
    return thin, np.mod(np.degrees(samples.theta_rad[thin]), 360.0)


def _line(curve: ErrorCurve) -> tuple[Array, Array, Array]:
    """Angles (deg), curve and its standard deviation over the turn, at the middle of the recorded rates."""
    at = np.linspace(0.0, 360.0, 721)[:-1]
    rate = None if curve.rate is None else np.full(at.size, curve.rate.centre_radps)
    theta = np.radians(at)
    return at, curve(theta, rate), curve.std(theta, rate)


def _frame(axis: Axes, title: str, *, labelled: bool = True) -> None:
    label = _("arcmin") if labelled else ""
    axis.set(title=title, xlabel=_("rotor angle, deg"), ylabel=label, xlim=(0.0, 360.0))
    axis.set_xticks(range(0, 361, 90))


def _shade(axis: Axes, curve: ErrorCurve) -> None:
    if not curve.coverage.has_gap:
        return
    start = float(np.degrees(curve.coverage.gap_start_rad))
    end = start + float(np.degrees(curve.coverage.largest_gap_rad))
    for shift in (0.0, -360.0):
        axis.axvspan(max(start + shift, 0.0), max(min(end + shift, 360.0), 0.0), color=_GAP, alpha=0.15, lw=0)


def _fit_figure(curve: ErrorCurve, samples: Samples) -> Figure:
    figure, (axes,) = new_figure(1, 2)
    thin, at = _places(samples)
    where, values, std = _line(curve)
    colour = COLOURS.get(curve.method, "#2f7fd1")
    rate = None if samples.rate_radps is None else samples.rate_radps[thin]
    axes[0].plot(at, samples.error[thin], ".", ms=2, color=_GREY)
    axes[0].fill_between(where, values - 2 * std, values + 2 * std, color=colour, alpha=0.25, lw=0)
    axes[0].plot(where, values, color=colour)
    axes[1].plot(at, samples.error[thin] - curve(samples.theta_rad[thin], rate), ".", ms=2, color=colour)
    for axis, title in zip(axes, (_("error and curve"), _("what is left")), strict=True):
        _shade(axis, curve)
        _frame(axis, title)
    return figure


def _harmonics_figure(curve: ErrorCurve) -> Figure:
    figure, ((axis,),) = new_figure(1, 1, height=2.4)
    a, b = curve.parameters[1 : 2 * curve.order : 2], curve.parameters[2 : 2 * curve.order + 1 : 2]
    variance = np.diag(curve.covariance)
    size = np.hypot(a, b)
    toward = np.where(size > 0.0, size, 1.0)
    std = np.sqrt(
        np.square(a / toward) * variance[1 : a.size * 2 : 2] + np.square(b / toward) * variance[2::2][: a.size]
    )
    orders = np.arange(1, curve.order + 1)
    axis.bar(orders, size, 0.6, color=COLOURS.get(curve.method, "#2f7fd1"))
    axis.errorbar(orders, size, yerr=np.minimum(2 * std, size), fmt="none", ecolor="#010203", lw=1)
    axis.set_xticks(orders)
    axis.set(xlabel=_("harmonic"), ylabel=_("arcmin"))
    return figure


def _curves_figure(curves: Mapping[CurveMethod, ErrorCurve], samples: Samples) -> Figure:
    figure, ((axis,),) = new_figure(1, 1, height=3.4)
    thin, at = _places(samples)
    axis.plot(at, samples.error[thin], ".", ms=2, color=_GREY)
    for method, curve in curves.items():
        where, values = _line(curve)[:2]
        axis.plot(where, values, color=COLOURS[method], label=_(NAMES[method]))
    _shade(axis, next(iter(curves.values())))
    _frame(axis, "")
    # what runs away in a gap must not flatten the rest
    low, high = float(samples.error.min()), float(samples.error.max())
    axis.set_ylim(low - 0.3 * (high - low + 1e-9), high + 0.3 * (high - low + 1e-9))
    figure.legend(*axis.get_legend_handles_labels(), loc="outside upper center", ncols=len(curves))
    return figure


def _left_figure(curves: Mapping[CurveMethod, ErrorCurve], samples: Samples) -> Figure:
    figure, (axes,) = new_figure(1, len(curves), height=2.6)
    thin, at = _places(samples)
    rate = None if samples.rate_radps is None else samples.rate_radps[thin]
    left = {m: samples.error[thin] - curve(samples.theta_rad[thin], rate) for m, curve in curves.items()}
    most = 1.1 * max(float(np.abs(one).max()) for one in left.values()) or 1.0
    _panels(axes, left, at, most)
    return figure


def _panels(axes: Sequence[Axes], left: Mapping[CurveMethod, Array], at: Array, most: float) -> None:
    for number, (axis, (method, values)) in enumerate(zip(axes, left.items(), strict=True)):
        axis.plot(at, values, ".", ms=2, color=COLOURS[method])
        _frame(axis, _(NAMES[method]), labelled=number == 0)
        axis.set(xlabel="deg", ylim=(-most, most))
        axis.set_xticks(range(0, 361, 180))
