"""The page of a watch: what is said, the parameters over time with their bands, and what the hole has not shown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from highside.report.document import Page
from highside.report.plots import can_plot, new_figure, plotting
from highside.watch.parameters import CALIBRATION, INDEX
from highside.watch.result import AttitudeError, Deviation, NotObservable, WatchClaim, WatchResult
from highside.watch.words import noise_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEADLINES = {
    "holds": "the calibration holds, as far as this hole can tell",
    "learning": "not enough was seen to say whether the calibration holds",
    "departs": "the tool departs from its calibration",
}
BADGES = {"holds": "good", "learning": "open", "departs": "bad"}
COLOURS = ("#2f7fd1", "#d9822b", "#3d9a50")
_RED = "#c23b3b"
NO_FIGURES = "without figures, since matplotlib is not installed (pip install 'highside[plot]')"
MOST_POINTS = 2000
READABLE: Mapping[str, tuple[float, str]] = {
    "g": (1e3, "mg"),
    "g/g": (1e3, "mg/g"),
    "g/degC": (1e6, "µg/degC"),
    "g/g^2": (1e3, "mg/g^2"),
    "g/g per km or h": (1e6, "µg/g per km or h"),
    "m": (1e3, "mm"),
    "rad": (1e3, "mrad"),
}
"""unit of a parameter: in which it is shown, three decimals, and by what factor"""
PANELS = (
    ("offsets, mg", ("b_x", "b_y", "b_z")),
    ("scales, mg/g", ("S_xx", "S_yy", "S_zz")),
    ("misalignments, mg/g", ("S_xz", "S_yz", "S_zx")),
)


def headline(found: WatchResult) -> str:
    """The verdict in a sentence."""
    return f"{found.verdict}: {HEADLINES[found.verdict]}"


def claim_words(claim: WatchClaim) -> str:
    """A departure in one line: class, size of its likeliest, since when, and what it does."""
    ((name, size),) = claim.parameters.items()
    factor, unit = (1e3, f"m{size.unit}") if size.unit.startswith("g") else (1.0, size.unit)
    if name == "length":
        return (
            f"readings are {factor * size.value:+.3g} +- {1.96 * factor * size.std:.2g} {unit} from gravity's length:"
            f" {one_of(claim.equivalence_class)}, since {claim.since_s:.0f} s;"
            f" {error_words(claim.error)}"
        )
    rest = [other for other in claim.equivalence_class if other != name]
    alike = f" (or {', '.join(rest)}: not told apart)" if rest else ""
    return (
        f"{name} {factor * size.value:+.3g} +- {1.96 * factor * size.std:.2g} {unit}{alike} since {claim.since_s:.0f} s"
        f" ({claim.since_low_s:.0f} to {claim.since_high_s:.0f} s; {claim.since_s / 3600.0:.2f} h);"
        f" {error_words(claim.error)}"
    )


def one_of(names: Sequence[str]) -> str:
    """Several as alternatives: `a, b or c`."""
    return " or ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def error_words(error: AttitudeError | None) -> str:
    """An error of inclination and toolface, deg."""
    if error is None:
        return "inclination and toolface are not to be used"
    tf = "" if error.tf_deg is None else f", {error.tf_deg:+.3f} deg of toolface"
    return f"{error.inc_deg:+.3f} deg of inclination{tf}"


def page_of(found: WatchResult, source: str, notes: Sequence[str] = (), tool: str | None = None) -> str:
    """The page as HTML; without figures where matplotlib is not installed."""
    page = Page("Watch: does the calibration hold?")
    add_found(page, found, ("Recording", source), more=() if tool is None else [("Calibration of tool", tool)])
    if notes:
        page.heading("Notes")
        page.bullets(list(notes))
    return page.html()


def add_found(
    page: Page,
    found: WatchResult,
    source: tuple[str, str],
    *,
    more: Sequence[tuple[str, str]] = (),
    first: Callable[[], Figure] | None = None,
    caption: str = "",
) -> None:
    """Verdict, claims, advice, parameters over time and what has not been seen, on any page. `source`: what was looked
    at, by kind and name; `more` facts beside; `first`: draws a figure that comes before, with its `caption`."""
    page.badge(found.verdict, BADGES[found.verdict], HEADLINES[found.verdict])
    page.facts([source, *more, *_facts(found)])
    if found.claims:
        page.heading("What departs")
        page.bullets([claim_words(claim) for claim in found.claims])
    if found.noise_changes:
        page.heading("What has become noisier or quieter")
        page.bullets([noise_words(change) for change in found.noise_changes])
    page.heading("What to do")
    page.bullets(list(found.advice))
    page.heading("Over time")
    if not found.trace.t_s.size:
        page.paragraph("Nothing was measured: the tool neither lay still nor turned long enough.", look="soft")
    elif can_plot():
        with plotting():
            if first is not None:
                page.figure(first(), caption)
            page.figure(
                _figure(found),
                "Deviation from the calibration in force, with bands of two standard deviations; the last panel is the"
                " evidence of the best hypothesis of a departure (twice the log-likelihood ratio) against its"
                " threshold, and the inclination. A red line is the time at which a departure was first said, a"
                " dashed one its likeliest onset.",
            )
    else:
        page.paragraph(f"This page is {NO_FIGURES}.", look="soft")
    page.heading("Parameters")
    page.table(
        ["parameter", "deviation", "standard deviation", "before", "unit", "seen"],
        [_row(name, one) for name, one in list(found.parameters.items())],
        "Deviation from the calibration, and what was known of it before the first measurement.",
        words=(0, 4, 5),
    )
    if found.not_observable:
        page.heading("Not observable so far")
        page.bullets(_unseen(found.not_observable))


def _facts(found: WatchResult) -> list[tuple[str, str]]:
    counts = found.counts
    left = ", ".join(f"{count} x {reason}" for reason, count in counts.left_out.items())
    rows = [
        ("Calibration", found.cal_id),
        ("Watched", f"{found.duration_s / 3600.0:.2f} h: {counts.stills} rests, {counts.turns} windows of rotation"),
        ("Not used", left),
        ("Inclination", "" if found.inclination_deg is None else f"{found.inclination_deg:.2f} deg at the end"),
    ]
    if found.still_unseen is not None and found.stated is not None:
        unseen, stated = found.still_unseen, found.stated
        rows += [
            (
                "Would not have been seen",
                f"an error here of up to {unseen.inc_deg:.3f} deg of inclination and {unseen.tf_sin_inc_deg:.3f} deg of"
                f" toolface times sin I (3 standard deviations of what the hole alone says); the record states"
                f" {stated.inc_deg:.4f} and {stated.tf_sin_inc_deg:.4f} deg (1 standard deviation)",
            )
        ]
    grown = ", grown: thresholds stand wider" if found.noise_grown else ""
    rows.append(("Noise", f"{found.noise_ratio:.2f} times what is stated{grown}"))
    return rows


def _unseen(found: Sequence[NotObservable]) -> list[str]:
    """One line a reason, with all parameters that it keeps from sight."""
    names: dict[str, list[str]] = {}
    for one in found:
        names.setdefault(one.why, []).append(one.parameter)
    return [f"{', '.join(of)}: {why}" for why, of in names.items()]


def _row(name: str, one: Deviation) -> list[str]:
    factor, unit = READABLE.get(one.unit, (1.0, one.unit))
    return [
        name,
        f"{factor * one.value:+.3f}",
        f"{factor * one.std:.3f}",
        f"{factor * one.stated_std:.3f}",
        unit,
        "yes" if one.observable else "no",
    ]


def _figure(found: WatchResult) -> Figure:
    trace = found.trace
    some = slice(None, None, max(1, trace.t_s.size // MOST_POINTS))
    hours = trace.t_s[some] / 3600.0
    figure, axes = new_figure(len(PANELS) + 1, 1, height=2.1)
    for (label, names), (axis,) in zip(PANELS, axes, strict=False):
        for name, colour in zip(names, COLOURS, strict=True):
            k = INDEX[name]
            assert k < CALIBRATION
            value, std = 1e3 * trace.value[some, k], 1e3 * trace.std[some, k]
            axis.plot(hours, value, color=colour, label=name)
            axis.fill_between(hours, value - 2.0 * std, value + 2.0 * std, color=colour, alpha=0.15, linewidth=0)
        axis.set_ylabel(label)
        axis.legend(loc="upper left", ncols=3)
    (last,) = axes[-1]
    last.plot(hours, trace.evidence[some], color=COLOURS[0], label="evidence")
    last.axhline(found.threshold, color=_RED, linestyle=":", label="threshold")
    last.set_yscale("symlog", linthresh=found.threshold)
    last.set_ylim(bottom=0.0)
    last.set_ylabel("evidence")
    last.set_xlabel("hours")
    beside = last.twinx()
    beside.plot(hours, trace.inclination_deg[some], color=COLOURS[1], label="inclination")
    beside.set_ylabel("inclination, deg")
    beside.grid(visible=False)
    handles = [*last.get_legend_handles_labels()[0], *beside.get_legend_handles_labels()[0]]
    last.legend(handles, ["evidence", "threshold", "inclination"], loc="upper left", ncols=3)
    for claim in found.claims:
        for (axis,) in axes:
            axis.axvline(claim.alarm_s / 3600.0, color=_RED, linewidth=1.0)
            axis.axvline(claim.since_s / 3600.0, color=_RED, linewidth=1.0, linestyle="--")
    return figure
