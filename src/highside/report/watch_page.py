"""The page of a watch: what is said, the parameters over time with their bands, and what the hole has not shown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from highside.report.document import Page
from highside.report.plots import can_plot, new_figure, plotting
from highside.watch.parameters import CALIBRATION, INDEX
from highside.watch.result import AttitudeError, Deviation, NotObservable, Size, WatchClaim, WatchResult
from highside.watch.words import noise_words
from highside.words import _, said_later, told

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HEADLINES = {
    "holds": said_later("the calibration holds, as far as this hole can tell"),
    "learning": said_later("not enough was seen to say whether the calibration holds"),
    "departs": said_later("the tool departs from its calibration"),
}
VERDICTS = {"holds": said_later("holds"), "learning": said_later("learning"), "departs": said_later("departs")}
BADGES = {"holds": "good", "learning": "open", "departs": "bad"}
NO_FIGURES = said_later("without figures, since matplotlib is not installed (pip install 'highside[plot]')")
COLOURS = ("#2f7fd1", "#d9822b", "#3d9a50")
_RED = "#c23b3b"
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
    (said_later("offsets, mg"), ("b_x", "b_y", "b_z")),
    (said_later("scales, mg/g"), ("S_xx", "S_yy", "S_zz")),
    (said_later("misalignments, mg/g"), ("S_xz", "S_yz", "S_zx")),
)


def headline(found: WatchResult) -> str:
    """The verdict in a sentence."""
    return f"{_(VERDICTS[found.verdict])}: {_(HEADLINES[found.verdict])}"


def claim_words(claim: WatchClaim) -> str:
    """A departure in one line: class, size of its likeliest, since when, and what it does."""
    name, size = next(iter(claim.parameters.items()))
    factor, unit = _scaled(size)
    if name == "length":
        return _(
            "readings are %(size)s %(unit)s from gravity's length: %(what)s, since %(since)s s; %(error)s",
            size=f"{factor * size.value:+.3g} +- {1.96 * factor * size.std:.2g}",
            unit=unit,
            what=one_of([told(name, "watch") for name in claim.equivalence_class]),
            since=f"{claim.since_s:.0f}",
            error=error_words(claim.error),
        )
    # each with the size that it has if it is what happened
    others = {other: f"{other} {_size_words(one)}" for other, one in claim.parameters.items()}
    rest = [others.get(other, other) for other in claim.equivalence_class if other != name]
    alike = " " + _("(or %(names)s: not told apart)", names=", ".join(rest)) if rest else ""
    return _(
        "%(what)s since %(since)s s (%(low)s to %(high)s s; %(hours)s h); %(error)s",
        what=f"{name} {_size_words(size)}{alike}",
        since=f"{claim.since_s:.0f}",
        low=f"{claim.since_low_s:.0f}",
        high=f"{claim.since_high_s:.0f}",
        hours=f"{claim.since_s / 3600.0:.2f}",
        error=error_words(claim.error),
    )


def _scaled(size: Size) -> tuple[float, str]:
    return (1e3, f"m{size.unit}") if size.unit.startswith("g") else (1.0, size.unit)


def _size_words(size: Size) -> str:
    factor, unit = _scaled(size)
    return f"{factor * size.value:+.3g} +- {1.96 * factor * size.std:.2g} {unit}"


def one_of(names: Sequence[str]) -> str:
    """Several as alternatives: `a, b or c`."""
    return _(" or ").join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def error_words(error: AttitudeError | None) -> str:
    """An error of inclination and toolface, deg."""
    if error is None:
        return _("inclination and toolface are not to be used")
    inc = _("%(angle)s deg of inclination", angle=f"{error.inc_deg:+.3f}")
    if error.tf_deg is None:
        return inc
    return f"{inc}, " + _("%(angle)s deg of toolface", angle=f"{error.tf_deg:+.3f}")


def page_of(found: WatchResult, source: str, notes: Sequence[str] = (), tool: str | None = None) -> str:
    """The page as HTML; without figures where matplotlib is not installed."""
    page = Page(_("Watch: does the calibration hold?"))
    add_found(page, found, (_("Recording"), source), more=() if tool is None else [(_("Calibration of tool"), tool)])
    if notes:
        page.heading(_("Notes"))
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
    page.badge(_(VERDICTS[found.verdict]), BADGES[found.verdict], _(HEADLINES[found.verdict]))
    page.facts([source, *more, *_facts(found)])
    if found.claims:
        page.heading(_("What departs"))
        page.bullets([claim_words(claim) for claim in found.claims])
    if found.noise_changes:
        page.heading(_("What has become noisier or quieter"))
        page.bullets([told(noise_words(change), "watch") for change in found.noise_changes])
    page.heading(_("What to do"))
    page.bullets([told(line, "watch") for line in found.advice])
    page.heading(_("Over time"))
    if not found.trace.t_s.size:
        page.paragraph(_("Nothing was measured: the tool neither lay still nor turned long enough."), look="soft")
    elif can_plot():
        with plotting():
            if first is not None:
                page.figure(first(), caption)
            page.figure(
                _figure(found),
                _(
                    "Deviation from the calibration in force, with bands of two standard deviations; the last panel is"
                    " the evidence of the best hypothesis of a departure (twice the log-likelihood ratio) against its"
                    " threshold, and the inclination. A red line is the time at which a departure was first said, a"
                    " dashed one its likeliest onset."
                ),
            )
    else:
        page.paragraph(
            _("This page is %(without)s.", without=_(NO_FIGURES)),
            look="soft",
        )
    page.heading(_("Parameters"))
    page.table(
        [_("parameter"), _("deviation"), _("standard deviation"), _("before"), _("unit"), _("seen")],
        [_row(name, one) for name, one in list(found.parameters.items())],
        _("Deviation from the calibration, and what was known of it before the first measurement."),
        words=(0, 4, 5),
    )
    if found.not_observable:
        page.heading(_("Not observable so far"))
        page.bullets(_unseen(found.not_observable))


def _facts(found: WatchResult) -> list[tuple[str, str]]:
    counts = found.counts
    left = ", ".join(f"{count} x {told(reason, 'watch')}" for reason, count in counts.left_out.items())
    watched = _(
        "%(hours)s h: %(rests)s rests, %(windows)s windows of rotation",
        hours=f"{found.duration_s / 3600.0:.2f}",
        rests=counts.stills,
        windows=counts.turns,
    )
    inclination = (
        "" if found.inclination_deg is None else _("%(angle)s deg at the end", angle=f"{found.inclination_deg:.2f}")
    )
    rows = [
        (_("Calibration"), found.cal_id),
        (_("Watched"), watched),
        (_("Not used"), left),
        (_("Inclination"), inclination),
    ]
    if found.still_unseen is not None and found.stated is not None:
        unseen, stated = found.still_unseen, found.stated
        rows += [
            (
                _("Would not have been seen"),
                _(
                    "an error here of up to %(inc)s deg of inclination and %(tf)s deg of toolface times sin I (3"
                    " standard deviations of what the hole alone says); the record states %(stated_inc)s and"
                    " %(stated_tf)s deg (1 standard deviation)",
                    inc=f"{unseen.inc_deg:.3f}",
                    tf=f"{unseen.tf_sin_inc_deg:.3f}",
                    stated_inc=f"{stated.inc_deg:.4f}",
                    stated_tf=f"{stated.tf_sin_inc_deg:.4f}",
                ),
            )
        ]
    times = _("%(times)s times what is stated", times=f"{found.noise_ratio:.2f}")
    grown = _(", grown: thresholds stand wider") if found.noise_grown else ""
    rows.append((_("Noise"), f"{times}{grown}"))
    return rows


def _unseen(found: Sequence[NotObservable]) -> list[str]:
    """One line a reason, with all parameters that it keeps from sight."""
    names: dict[str, list[str]] = {}
    for one in found:
        names.setdefault(one.why, []).append(one.parameter)
    return [f"{', '.join(of)}: {told(why, 'watch')}" for why, of in names.items()]


def _row(name: str, one: Deviation) -> list[str]:
    factor, unit = READABLE.get(one.unit, (1.0, one.unit))
    return [
        name,
        f"{factor * one.value:+.3f}",
        f"{factor * one.std:.3f}",
        f"{factor * one.stated_std:.3f}",
        unit,
        _("yes") if one.observable else _("no"),
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
        axis.set_ylabel(_(label))
        axis.legend(loc="upper left", ncols=3)
    (last,) = axes[-1]
    last.plot(hours, trace.evidence[some], color=COLOURS[0], label="evidence")
    last.axhline(found.threshold, color=_RED, linestyle=":", label="threshold")
    last.set_yscale("symlog", linthresh=found.threshold)
    last.set_ylim(bottom=0.0)
    last.set_ylabel(_("evidence"))
    last.set_xlabel(_("hours"))
    beside = last.twinx()
    beside.plot(hours, trace.inclination_deg[some], color=COLOURS[1], label="inclination")
    beside.set_ylabel(_("inclination, deg"))
    beside.grid(visible=False)
    handles = [*last.get_legend_handles_labels()[0], *beside.get_legend_handles_labels()[0]]
    last.legend(handles, [_("evidence"), _("threshold"), _("inclination")], loc="upper left", ncols=3)
    for claim in found.claims:
        for (axis,) in axes:
            axis.axvline(claim.alarm_s / 3600.0, color=_RED, linewidth=1.0)
            axis.axvline(claim.since_s / 3600.0, color=_RED, linewidth=1.0, linestyle="--")
    return figure
