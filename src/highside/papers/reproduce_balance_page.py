"""The page of `highside reproduce balance`: the one instrument, tables and figures beside what it predicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from highside.arrays import Array
from highside.calibration.balance import TRIPLES
from highside.papers import balance_triples, published_instrument
from highside.papers.balance_prediction import Ensemble, interval
from highside.papers.balance_session import COLUMNS, INCLINATIONS_DEG, STATIONS_DEG
from highside.papers.balance_statements import statements
from highside.papers.published_instrument import TITLES
from highside.papers.reproduce_balance import LARGE_DEG, OMITTED, SMALL_DEG, Reproduction, smooth
from highside.report.document import Page
from highside.report.plots import new_figure, plotting

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PREDICTED, PUBLISHED = "#2f7fd1", "#d9822b"
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
    "table1": "The instrument was found from these cells: agreement here is no prediction.",
    "table2": "Conventional rows are those of table 1. Cells marked lost are not in the source.",
    "table3": (
        "Conventional rows are those of table 1. The text does not say which poses its 'first-quadrant balance' takes: "
        "predicted is any of the four triples. At 90 deg balance is refused."
    ),
    "table6": "At 90 deg balance is refused; the published zeros are the degeneracy explained below.",
}
_HOW = (
    "Bands and intervals hold 95 % of what table 1 allows: sizes, signs and other explanations, noise, and chance in "
    "the session itself."
)


def page_of(found: Reproduction) -> str:
    """The whole page as HTML. Raises InputError where matplotlib is not installed."""
    with plotting():
        return _page_of(found)


def _page_of(found: Reproduction) -> str:
    instrument = found.instrument
    page = Page("Balance correction: what the paper's first table predicts of the others")
    page.paragraph(
        "A triaxial accelerometer was turned once around at eleven inclinations, 73 stations with four unfiltered "
        "readings each, and corrected by the conventional three-pose matrix (table 1) or by balance matrices of each "
        "inclination (tables 2 to 6). Errors are mean and peak-to-peak over the revolution against the bench, in "
        "degrees. The instrument is found from table 1 alone; it then predicts all other tables and figures, which "
        "took no part in finding it."
    )
    count = instrument.predictions.overall
    kind = "good" if count.verdict == "predicted" else "open"
    page.badge(f"{count.covered} of {count.of}", kind, published_instrument.coverage_in_words(instrument))
    page.table(
        ["", *(TITLES[c] for c in COLUMNS)],
        published_instrument.verdicts(instrument),
        "Held-out cells within their intervals. A column counts as predicted unless so few cells, or "
        "fewer, are covered by chance with less than 5 % probability; cells of a table share what they depend on, so "
        "this is a guide.",
        words=range(5),
    )
    page.bullets(published_instrument.outside_in_words(instrument))
    page.heading("The mean toolface of single triples")
    page.bullets(balance_triples.in_words(instrument.triples, instrument.found.noise_g))
    page.figure(
        _closures(found),
        "Mean T of each triple less that of the average: published (points), as the table's "
        "own means of I say it must be (crosses), and predicted from table 1 (bars).",
    )
    published_instrument.add_to(page, instrument)
    page.heading("Tables")
    page.paragraph(
        f"Published, and in brackets what table 1 predicts; * is outside of its interval. {_HOW}", look="soft"
    )
    for name, title in _TITLES.items():
        page.table(*_table(found.tables[name]), caption=f"{title} (deg). {_NOTES.get(name, '')}".strip())
    page.figure(_table6(found), "Table 6, which the fit did not use: published (orange) and predicted (blue, band).")
    page.heading("Figures")
    _figures(page, found)
    page.heading("What is left, in percent of the conventional error")
    page.table(*_ratio_table(found.ratios), caption="Published, and in brackets what table 1 predicts.")
    page.heading("Where the paper's model and the measurements part")
    rows = [[s.topic, s.paper_says, s.published, s.predicted, s.reason] for s in statements(found)]
    page.table(["", "The paper says", "Its own tables", "Predicted from table 1", "Why"], rows, words=range(5))
    page.heading("Against the bench and against the truth")
    page.paragraph(
        "Root mean square over each turn, middle of the instruments that table 1 allows. Only a simulation knows where "
        "gravity truly was. The balance matrix agrees with the bench because it absorbs the bench's own errors; the "
        "joint estimator tells sensor and bench apart."
    )
    for angle, name in (("inc", "Inclination"), ("tf", "Toolface")):
        page.table(*_truth_table(found.truth, angle), caption=f"{name}, deg rms; single readings, noise included")
    page.bullets(found.refused)
    return page.html()


def _figures(page: Page, found: Reproduction) -> None:
    ensemble = found.instrument.ensemble
    page.paragraph(f"The paper's figures as predicted; points are what its tables give of them. {_HOW}", look="soft")
    page.figure(
        _turns(found, "conventional", "table1"),
        "Figure 1. Conventional correction: error over a turn at each "
        "inclination (mean of the four readings of a station), and the published means and peak-to-peaks of "
        "table 1, which it was found from.",
    )
    beside = {name: _beside(found.tables[name]) for name in ("table2", "table3", "table4", "table5")}
    page.figure(
        _compared(ensemble, SMALL_DEG),
        "Figure 2. Small inclinations: conventional (dashed) and balance 1-2-3 (solid, with band); below, table 2.",
    )
    page.figure(beside["table2"], "Table 2 of figure 2.")
    large = tuple(i for i in LARGE_DEG if i != 90.0)
    page.figure(
        _compared(ensemble, large),
        "Figure 3. Large inclinations: conventional (dashed) "
        "and balance 1-2-3 (solid, with band); below, table 3. Balance at 90 deg is refused.",
    )
    page.figure(beside["table3"], "Table 3 of figure 3.")
    for number, inc_deg in ((4, 1.206), (5, 0.612)):
        page.figure(_triples(ensemble, inc_deg), _triples_caption(found, number, inc_deg))
        page.figure(beside[f"table{number}"], f"Table {number} of figure {number}.")
    page.figure(
        _turns(found, "average", "table6"),
        "Figure 6. Average of the four triples: error over a turn at each "
        "inclination that balance can be used at, and the published figures of table 6.",
    )
    page.figure(
        _bars(found),
        "Figure 7. Peak-to-peak after the average balance as a share of that before, and of the "
        "toolface specification (5 deg below 3 deg of inclination, else 3 deg): predicted with intervals, and "
        "published.",
    )


# --- tables


def _cell(printed: float | None, row: Mapping[str, Any], column: str, digits: int = 4) -> str:
    words = "lost" if printed is None else f"{printed:.{digits}f}"
    if row["predicted"] is None:
        return f"{words} (refused)"
    mark = "*" if row["covered"][column] is False else ""
    return f"{words}{mark} ({row['low'][column]:.{digits}f} to {row['high'][column]:.{digits}f})"


def _table(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    headers = ["correction", "I", *(TITLES[c] for c in COLUMNS)]
    body = [
        [row["correction"], f"{row['inc_ref_deg']:.3f}", *(_cell(row["published"][c], row, c) for c in COLUMNS)]
        for row in rows
    ]
    return headers, body


def _ratio_table(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    body = []
    for row in rows:
        cells = [f"{row['inc_ref_deg']:.3f}"]
        for c in COLUMNS:
            part = row[c]
            mark = "" if part["covered"] else "*"
            cells.append(f"{part['published']:.1f}{mark} ({part['low']:.1f} to {part['high']:.1f})")
        body.append(cells)
    return ["I", *(TITLES[c] for c in COLUMNS)], body


def _truth_table(truth: Sequence[Mapping[str, Any]], angle: str) -> tuple[list[str], list[list[str]]]:
    methods = ("conventional", "average", "joint")
    keys = [f"{m}_{angle}_rms_{ref}_deg" for m in methods for ref in ("bench", "truth")]
    headers = ["I"] + [f"{m}, {ref}" for m in methods for ref in ("bench", "truth")]
    body = []
    for row in truth:
        cells = ["refused" if row[key] is None else f"{row[key]:.4f}" for key in keys]
        body.append([f"{row['inc_ref_deg']:.3f}", *cells])
    return headers, body


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


def _turns(found: Reproduction, method: str, table: str) -> Figure:
    """Errors over a turn, and beside them mean and peak-to-peak of each: published and predicted."""
    ensemble = found.instrument.ensemble
    figure, grid = new_figure(2, 3, height=3.0, width=13.0)
    for column, inclinations in enumerate((_NEAR, _FAR)):
        usable = [i for i in inclinations if method == "conventional" or i != 90.0]
        for inc_deg, colour in zip(usable, _colours(len(usable)), strict=True):
            for row, errors in enumerate(ensemble.turn(method, inc_deg)):
                low, middle, high = interval(errors)
                grid[row][column].fill_between(STATIONS_DEG, low, high, color=colour, alpha=0.14, linewidth=0)
                grid[row][column].plot(STATIONS_DEG, middle, color=colour, label=f"{inc_deg:g} deg")
        for row, what in enumerate(("inclination", "toolface")):
            _turn_axes(grid[row][column], what)
        grid[0][column].legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), handlelength=1.2)
    rows = [r for r in found.tables[table] if r["predicted"] is not None]
    for row, (angle, scale) in enumerate((("d_inc", "linear"), ("d_tf", "symlog"))):
        axes = grid[row][2]
        for shift, kind, mark in ((-0.12, "mean", "o"), (0.12, "pp", "s")):
            _against(axes, rows, f"{angle}_{kind}_deg", shift, mark, "mean" if kind == "mean" else "peak-to-peak")
        if scale == "symlog":
            axes.set_yscale("symlog", linthresh=0.05)
        axes.set_ylabel("deg")
        axes.set_title("published (points), predicted (bars)")
        if row == 0:
            axes.legend(loc="best")
    return figure


def _against(axes: Axes, rows: Sequence[Mapping[str, Any]], column: str, shift: float, mark: str, label: str) -> None:
    """Published points and predicted bars of one column over the rows."""
    at = np.arange(len(rows)) + shift
    middle, low, high = (np.array([r[k][column] for r in rows]) for k in ("predicted", "low", "high"))
    axes.errorbar(at, middle, [middle - low, high - middle], fmt="none", ecolor=PREDICTED, elinewidth=4, alpha=0.5)
    printed = np.array([np.nan if r["published"][column] is None else r["published"][column] for r in rows])
    axes.plot(at, printed, mark, color=PUBLISHED, markersize=4, label=label)
    axes.set_xticks(np.arange(len(rows)), [f"{r['inc_ref_deg']:g}" for r in rows], rotation=60)


def _beside(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Means and peak-to-peaks of a table's balance rows: published points, predicted bars."""
    figure, grid = new_figure(1, 2, height=2.4)
    own = [r for r in rows if r["held_out"] and r["predicted"] is not None]
    triples = len({r["inc_ref_deg"] for r in own}) == 1
    for axes, angle, title in zip(grid[0], ("d_inc", "d_tf"), ("inclination", "toolface"), strict=True):
        for shift, kind, mark in ((-0.12, "mean", "o"), (0.12, "pp", "s")):
            _against(axes, own, f"{angle}_{kind}_deg", shift, mark, "mean" if kind == "mean" else "peak-to-peak")
        if triples:
            axes.set_xticks(range(len(own)), [r["correction"] for r in own])
        axes.set(ylabel="deg", title=f"{title}: published (points), predicted (bars)")
    grid[0][0].legend(loc="best")
    return figure


def _table6(found: Reproduction) -> Figure:
    figure, axes = new_figure(2, 2, height=2.6)
    rows = [r for r in reversed(found.tables["table6"]) if r["predicted"] is not None]
    at = np.arange(len(rows))
    for column, axis in zip(COLUMNS, np.ravel(np.array(axes, dtype=object)), strict=True):
        low, middle, high = (np.array([r[k][column] for r in rows]) for k in ("low", "predicted", "high"))
        axis.fill_between(at, low, high, color=PREDICTED, alpha=0.25, linewidth=0)
        axis.plot(at, middle, "-", color=PREDICTED, label="predicted")
        axis.plot(at, [r["published"][column] for r in rows], "o", color=PUBLISHED, markersize=4, label="published")
        axis.set_xticks(at, [f"{r['inc_ref_deg']:g}" for r in rows], rotation=60)
        axis.set(ylabel="deg", title=TITLES[column])
        if column.endswith("tf_pp_deg"):
            axis.set_yscale("log")
        if column == COLUMNS[0]:
            axis.legend()
    return figure


def _closures(found: Reproduction) -> Figure:
    figure, grid = new_figure(1, 2, height=3.0)
    ensemble = found.instrument.ensemble
    for axes, inc_deg in zip(grid[0], (1.206, 0.612), strict=True):
        own = [m for m in found.instrument.triples.means if m.inc_ref_deg == inc_deg]
        at = np.arange(len(own))
        average = ensemble.of(["average"], inc_deg)[:, 2]
        low, middle, high = interval(np.stack([ensemble.of([m.triple], inc_deg)[:, 2] - average for m in own], axis=1))
        axes.errorbar(at, middle, [middle - low, high - middle], fmt="none", ecolor=PREDICTED, elinewidth=5, alpha=0.5)
        axes.plot(at, [m.published for m in own], "o", color=PUBLISHED, label="published")
        axes.plot(
            at, [m.from_inclination for m in own], "x", color=QUADRANT_SHADE, markersize=8, label="from its mean I"
        )
        axes.axhline(0.0, color=QUADRANT_SHADE, linewidth=0.8)
        axes.set_xticks(at, [m.triple for m in own])
        axes.set(ylabel="deg", title=f"{inc_deg:g} deg")
    grid[0][0].legend()
    return figure


def _compared(ensemble: Ensemble, inclinations: Sequence[float]) -> Figure:
    figure, grid = new_figure(1, 2, height=3.2)
    for inc_deg, colour in zip(inclinations, _colours(len(inclinations)), strict=True):
        for method, dashes in (("conventional", "--"), ("1-2-3", "-")):
            for column, errors in enumerate(ensemble.turn(method, inc_deg)):
                low, middle, high = interval(errors)
                axes = grid[0][column]
                if dashes == "-":
                    axes.fill_between(STATIONS_DEG, low, high, color=colour, alpha=0.2, linewidth=0)
                label = f"{inc_deg:g} deg" if dashes == "-" else None
                axes.plot(STATIONS_DEG, middle, dashes, color=colour, label=label)
    for column, what in enumerate(("inclination", "toolface")):
        _turn_axes(grid[0][column], what)
    grid[0][1].legend(ncols=len(inclinations), loc="lower center", bbox_to_anchor=(0.5, 1.0), handlelength=1.2)
    return figure


def _triples(ensemble: Ensemble, inc_deg: float) -> Figure:
    figure, grid = new_figure(2, 4, height=2.5)
    for column, name in enumerate(TRIPLES):
        for row, errors in enumerate(ensemble.turn(name, inc_deg)):
            axes = grid[row][column]
            axes.axvspan(
                90 * (OMITTED[name] - 1),
                90 * OMITTED[name],
                color=QUADRANT_SHADE,
                alpha=0.25,
                linewidth=0,
            )
            _band(axes, errors)
            _turn_axes(axes, ("inclination", "toolface")[row])
            axes.set_xticks(range(0, 361, 90))
            if column:
                axes.set_ylabel("")
        grid[0][column].set_title(f"{name}, without quadrant {OMITTED[name]}")
    for line_of_axes in grid:
        limits = [axes.get_ylim() for axes in line_of_axes]
        for axes in line_of_axes:
            axes.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
    return figure


def _band(axes: Axes, errors: Array) -> None:
    """The band of the stations, and three single instruments without their noise."""
    low, _, high = interval(errors)
    axes.fill_between(STATIONS_DEG, low, high, color=PREDICTED, alpha=0.2, linewidth=0)
    for one in smooth(errors[:3]):
        axes.plot(STATIONS_DEG, one, color=PREDICTED, linewidth=1.2)


def _triples_caption(found: Reproduction, number: int, inc_deg: float) -> str:
    rows = found.omitted[f"{inc_deg:g}"]
    listed = ", ".join(f"{row['triple']} {row['probability_largest_there']:.0%}" for row in rows)
    return (
        f"Figure {number}. The four triples at {inc_deg:g} deg: band of the stations' means, and three of the "
        "instruments that table 1 allows, noise taken out. The paper finds the toolface error largest in the "
        f"quadrant omitted (shaded); predicted is that for {listed} (one in four by chance). Three poses are met "
        "exactly; what the four do not agree on falls on the fourth."
    )


def _bars(found: Reproduction) -> Figure:
    figure, grid = new_figure(1, 3, width=10.5, height=3.6)
    parts = [
        (
            "inclination, peak-to-peak",
            "% of the error before",
            [(r["inc_ref_deg"], r["d_inc_pp_deg"]) for r in found.ratios],
        ),
        (
            "toolface, peak-to-peak",
            "% of the error before",
            [(r["inc_ref_deg"], r["d_tf_pp_deg"]) for r in found.ratios],
        ),
        (
            "toolface after",
            "% of the specification",
            [(r["inc_ref_deg"], r["after"]) for r in found.shares if "after" in r],
        ),
    ]
    for axes, (title, unit, rows) in zip(grid[0], parts, strict=True):
        at = np.arange(len(rows), dtype=float)
        middle, low, high, printed = (
            np.array([part[k] for _, part in rows]) for k in ("predicted", "low", "high", "published")
        )
        axes.bar(at, middle, 0.6, color=PREDICTED, alpha=0.35, label="predicted")
        axes.errorbar(
            at, middle, [middle - low, high - middle], fmt="none", ecolor=PREDICTED, elinewidth=1.5, capsize=3
        )
        axes.plot(at, printed, "o", color=PUBLISHED, label="published")
        axes.set(ylabel=unit, ylim=(0, None))
        axes.set_title(title, pad=26)
        axes.set_xticks(at, [f"{inc:g}" for inc, _ in rows], rotation=60)
        axes.set_xlabel("inclination, deg")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, handlelength=1.0)
    return figure
