"""The page of `highside reproduce balance`: figures 1 to 7, tables 1 to 6 beside the published ones, and words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from highside.calibration.balance import TRIPLES
from highside.report.page import Page, new_figure, plotting
from highside.report.published_instrument import Comparison, add_to
from highside.report.reproduce_balance import (
    BENCH,
    COLUMNS,
    INCLINATIONS_DEG,
    INSTRUMENT,
    LARGE_DEG,
    LEFT_OUT,
    NOISE_G,
    SMALL_DEG,
    Experiment,
    against_truth,
    headline_ratios,
    left_out_quadrants,
    smooth_error_deg,
    specification_shares,
    statements,
    tables,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OURS, THEIRS = "#2f7fd1", "#d9822b"
BEFORE = "#9aa3ab"
QUADRANT_SHADE = "#808890"
_NEAR = [i for i in INCLINATIONS_DEG if i <= 5.004]
_FAR = [i for i in INCLINATIONS_DEG if i > 5.004]

_TITLES = {
    "table1": "Table 1. Conventional correction, three poses",
    "table2": "Table 2. Small inclinations: conventional and balance 1-2-3",
    "table3": "Table 3. Large inclinations: conventional and balance of three quadrants",
    "table4": "Table 4. The four triples at 1.206 deg",
    "table5": "Table 5. The four triples at 0.612 deg",
    "table6": "Table 6. Average of the four triples",
}
_NOTES = {
    "table2": "Cells marked lost are not in the source; those of the conventional correction are in table 1.",
    "table3": (
        "The text does not say which poses its 'first-quadrant balance' takes; the four triples stand beside the same "
        "published row. At 90 deg balance is refused."
    ),
    "table6": "At 90 deg balance is refused; the published zeros are the degeneracy explained above.",
}


def page_of(experiment: Experiment, comparison: Comparison | None = None) -> str:
    """The whole page as HTML, with the diagnosis of the published instrument where it is given.

    Raises InputError where matplotlib is not installed.
    """
    with plotting():
        return _page_of(experiment, comparison)


def _page_of(experiment: Experiment, comparison: Comparison | None) -> str:
    made = tables(experiment)
    page = Page("Balance correction: the paper's tables beside a simulated instrument")
    page.paragraph(
        "A triaxial accelerometer is turned once around at eleven inclinations, 73 stations with four unfiltered "
        "readings each, and corrected by the conventional three-pose matrix or by a balance matrix of each "
        "inclination. Errors are mean and peak-to-peak over the revolution against the bench, in degrees. The "
        "instrument and the bench are simulated; the sizes of their imperfections were fitted to the published "
        "tables 1 and 6 and are listed at the end. They are one explanation of those tables, not the only one."
    )
    page.heading("Where the paper's model and the measurements part")
    rows = [[s.topic, s.paper_says, s.published, s.ours, s.reason] for s in statements(experiment, made)]
    page.table(["", "The paper says", "Its own tables", "This simulation", "Why"], rows, words=range(5))
    page.heading("Figures")
    page.figure(_turns(experiment, "conventional"), "Figure 1. Conventional correction: error over a turn at each "
                "inclination (mean of the four readings of a station).")  # fmt: skip
    page.figure(_compared(experiment, SMALL_DEG), "Figure 2. Small inclinations: conventional (dashed) and balance "
                "1-2-3 (solid).")  # fmt: skip
    page.figure(_compared(experiment, tuple(i for i in LARGE_DEG if i != 90.0)), "Figure 3. Large inclinations: "
                "conventional (dashed) and balance 1-2-3 (solid). Balance at 90 deg is refused.")  # fmt: skip
    for number, inc_deg in ((4, 1.206), (5, 0.612)):
        page.figure(_triples(experiment, inc_deg), _triples_caption(experiment, number, inc_deg))
    page.figure(_turns(experiment, "average"), "Figure 6. Average of the four triples: error over a turn at each "
                "inclination that balance can be used at.")  # fmt: skip
    page.figure(_bars(made), "Figure 7. Peak-to-peak before (conventional) and after (average balance), and toolface "
                "after as a share of the instrument's specification band (5 deg below 3 deg of inclination, else "
                "3 deg).")  # fmt: skip
    page.heading("Tables")
    for name, title in _TITLES.items():
        page.table(*_table(made[name]), caption=f"{title} (deg). {_NOTES.get(name, '')}".strip())
    page.heading("What is left, in percent of the conventional error")
    page.table(*_ratio_table(made))
    page.heading("Against the bench and against the truth")
    page.paragraph(
        "Root mean square over each turn. Only a simulation knows where gravity truly was. The balance matrix agrees "
        "with the bench because it takes up the bench's own errors; the joint estimator tells sensor and bench apart."
    )
    for angle, name in (("inc", "Inclination"), ("tf", "Toolface")):
        page.table(*_truth_table(experiment, angle), caption=f"{name}, deg rms; single readings, noise included")
    if comparison is not None:
        add_to(page, comparison)
    page.heading("The simulated instrument and bench")
    page.table(["effect", "parameter", "value"], _effects(), words=(1,))
    page.paragraph(f"Noise of one reading: {NOISE_G * 1e6:.0f} ug. Angles in rad, sensor terms in g.", soft=True)
    page.bullets([r.text for r in experiment.balance["average"].remarks])
    return page.html()


# --- tables


def _number(value: float | None, digits: int = 4) -> str:
    return "lost" if value is None else f"{value:.{digits}f}"


def _table(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    names = ("mean I", "p-p I", "mean T", "p-p T")
    headers = ["correction", "I"] + [f"{name}, {who}" for name in names for who in ("ours", "published")]
    body = []
    for row in rows:
        cells = [str(row["correction"]), f"{row['inc_ref_deg']:.3f}"]
        for column in COLUMNS:
            ours = row["ours"]
            cells += ["refused" if ours is None else _number(ours[column]), _number(row["published"][column])]
        body.append(cells)
    return headers, body


def _ratio_table(made: Mapping[str, list[dict[str, Any]]]) -> tuple[list[str], list[list[str]]]:
    names = ("mean I", "p-p I", "mean T", "p-p T")
    headers = ["I"] + [f"{name}, {who}" for name in names for who in ("ours", "published")]
    body = [
        [f"{row['inc_ref_deg']:.3f}"] + [f"{row[who][c]:.1f}" for c in COLUMNS for who in ("ours", "published")]
        for row in headline_ratios(made)
    ]
    return headers, body


def _truth_table(experiment: Experiment, angle: str) -> tuple[list[str], list[list[str]]]:
    methods = ("conventional", "average", "joint")
    keys = [f"{m}_{angle}_rms_{ref}_deg" for m in methods for ref in ("bench", "truth")]
    headers = ["I"] + [f"{m}, {ref}" for m in methods for ref in ("bench", "truth")]
    body = []
    for row in against_truth(experiment):
        cells = ["refused" if row[key] is None else f"{row[key]:.4f}" for key in keys]
        body.append([f"{row['inc_ref_deg']:.3f}", *cells])
    return headers, body


def _effects() -> list[list[str]]:
    return [
        [effect, name, f"{value:.3g}"]
        for source in (INSTRUMENT, BENCH)
        for effect, values in source.items()
        for name, value in values.items()
    ]


# --- figures


def _colours(count: int) -> list[Any]:
    from matplotlib import colormaps

    # the ends of the map are too dark for one of the page's two backgrounds
    return list(colormaps["turbo"](np.linspace(0.14, 0.86, count)))


def _turn_axes(axes: Axes, what: str) -> None:
    axes.set_xlim(0, 360)
    axes.set_xticks(range(0, 361, 45))
    axes.set_xlabel("toolface, deg")
    axes.set_ylabel(f"error of {what}, deg")


def _turns(experiment: Experiment, method: str) -> Figure:
    figure, grid = new_figure(2, 2, height=3.0)
    for column, inclinations in enumerate((_NEAR, _FAR)):
        usable = [i for i in inclinations if experiment.matrix(method, i) is not None]
        for inc_deg, colour in zip(usable, _colours(len(usable)), strict=True):
            matrix = experiment.matrix(method, inc_deg)
            assert matrix is not None
            turn = experiment.turns[inc_deg]
            for row, errors in enumerate(turn.errors_deg(*matrix)):
                grid[row][column].plot(
                    np.degrees(turn.tf_ref_rad), errors.mean(axis=1), color=colour, label=f"{inc_deg:g} deg"
                )
        for row, what in enumerate(("inclination", "toolface")):
            _turn_axes(grid[row][column], what)
        grid[0][column].legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), handlelength=1.2)
    return figure


def _compared(experiment: Experiment, inclinations: Sequence[float]) -> Figure:
    figure, grid = new_figure(1, 2, height=3.2)
    for inc_deg, colour in zip(inclinations, _colours(len(inclinations)), strict=True):
        turn = experiment.turns[inc_deg]
        for method, dashes in (("conventional", "--"), ("1-2-3", "-")):
            matrix = experiment.matrix(method, inc_deg)
            assert matrix is not None
            for column, errors in enumerate(turn.errors_deg(*matrix)):
                grid[0][column].plot(
                    np.degrees(turn.tf_ref_rad),
                    errors.mean(axis=1),
                    dashes,
                    color=colour,
                    label=f"{inc_deg:g} deg" if dashes == "-" else None,
                )
    for column, what in enumerate(("inclination", "toolface")):
        _turn_axes(grid[0][column], what)
    grid[0][1].legend(ncols=len(inclinations), loc="lower center", bbox_to_anchor=(0.5, 1.0), handlelength=1.2)
    return figure


def _triples(experiment: Experiment, inc_deg: float) -> Figure:
    figure, grid = new_figure(2, 4, height=2.5)
    turn = experiment.turns[inc_deg]
    where = np.degrees(turn.tf_ref_rad)
    for column, name in enumerate(TRIPLES):
        matrix = experiment.matrix(name, inc_deg)
        assert matrix is not None
        smooth = smooth_error_deg(turn, *matrix)
        for row, (errors, line) in enumerate(zip(turn.errors_deg(*matrix), smooth, strict=True)):
            axes = grid[row][column]
            axes.axvspan(90 * (LEFT_OUT[name] - 1), 90 * LEFT_OUT[name], color=QUADRANT_SHADE, alpha=0.25, linewidth=0)
            axes.plot(where, errors.mean(axis=1), color=OURS, linewidth=0.8, alpha=0.7)
            axes.plot(where, line, color=THEIRS, linewidth=2.0)
            _turn_axes(axes, ("inclination", "toolface")[row])
            axes.set_xticks(range(0, 361, 90))
            if column:
                axes.set_ylabel("")
        grid[0][column].set_title(f"{name}, without quadrant {LEFT_OUT[name]}")
    for line_of_axes in grid:
        limits = [axes.get_ylim() for axes in line_of_axes]
        for axes in line_of_axes:
            axes.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
    return figure


def _triples_caption(experiment: Experiment, number: int, inc_deg: float) -> str:
    found = left_out_quadrants(experiment, inc_deg)
    right = [row["triple"] for row in found if row["largest_in"] == row["left_out"]]
    others = [
        f"{row['triple']} (largest in quadrant {row['largest_in']})"
        for row in found
        if row["largest_in"] != row["left_out"]
    ]
    said = f"The toolface error is largest in the quadrant left out (shaded) for {', '.join(right) or 'none'}"
    said += f"; not for {', '.join(others)}." if others else "."
    return (
        f"Figure {number}. The four triples at {inc_deg:g} deg: mean of each station (thin), first two harmonics "
        f"(thick). {said} Three poses are met exactly; what the four do not agree on falls on the fourth."
    )


def _bars(made: Mapping[str, list[dict[str, Any]]]) -> Figure:
    figure, grid = new_figure(1, 3, width=10.5, height=3.6)
    rows = [row for row in made["table6"] if row["ours"] is not None]
    place = np.arange(len(rows), dtype=float)
    before = {row["inc_ref_deg"]: row for row in made["table1"]}
    for axes, column, title in (
        (grid[0][0], "d_inc_pp_deg", "inclination, peak-to-peak"),
        (grid[0][1], "d_tf_pp_deg", "toolface, peak-to-peak"),
    ):
        for shift, who, colour in ((-0.2, "ours", OURS), (0.2, "published", THEIRS)):
            first = [before[row["inc_ref_deg"]][who][column] for row in rows]
            then = [row[who][column] for row in rows]
            axes.bar(place + shift, first, 0.38, color=colour, alpha=0.35, label=f"{who}, before")
            axes.bar(place + shift, then, 0.38, color=colour, label=f"{who}, after")
        axes.set_yscale("log")
        axes.set_ylabel("deg")
        axes.set_title(title, pad=38)
    shares = [row for row in specification_shares(made) if row["ours_after"] is not None]
    axes = grid[0][2]
    for shift, who, colour in ((-0.2, "ours", OURS), (0.2, "published", THEIRS)):
        axes.bar(place + shift, [row[f"{who}_after"] for row in shares], 0.38, color=colour, label=f"{who}, after")
    axes.set_ylabel("% of the band")
    axes.set_title("toolface after, share of the specification", pad=38)
    for axes in grid[0]:
        axes.set_xticks(place, [f"{row['inc_ref_deg']:g}" for row in rows], rotation=60)
        axes.set_xlabel("inclination, deg")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, handlelength=1.0)
    return figure
