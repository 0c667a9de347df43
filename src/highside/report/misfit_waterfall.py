"""The misfit of a recording step by step (`misfit_steps`) in a picture: bars that subtract in plain sight."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from highside.report.diagnosis_figures import AFTER, BEFORE, SHADE
from highside.report.misfit_steps import Steps
from highside.report.plots import new_figure
from highside.words import _

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def waterfall(steps: Steps, titles: dict[str, str]) -> Figure:
    """Bars from the simulation as given down to what is left, with the floor of the noise as a line."""
    names = [_("simulation as given"), *(titles.get(name, name) for name in steps.names), _("what is left")]
    figure, axes = new_figure(1, 1, height=0.55 + 0.42 * len(names))
    axis = axes[0][0]
    rows = np.arange(len(names))
    left = steps.left if steps.names else steps.levels[0]
    axis.barh(0, steps.levels[0], color=BEFORE, height=0.62)
    _label(axis, 0, steps.levels[0], f"{steps.levels[0]:.3g} {steps.unit}")
    for k in range(len(steps.names)):
        low, high = steps.levels[k + 1], steps.levels[k]
        axis.barh(k + 1, high - low, left=low, color=SHADE, height=0.62)
        axis.plot([high, high], [k - 0.31, k + 1.31], color=SHADE, linewidth=0.8)
        # the share in units of the noise stands in the sentence above: another weighting, another figure
        _label(axis, k + 1, high, f"\N{MINUS SIGN}{high - low:.3g} {steps.unit}")
    last = len(names) - 1
    axis.barh(last, left, color=AFTER, height=0.62)
    within = " " + _("(within the noise)") if left <= steps.floor else ""
    _label(axis, last, max(left, steps.floor), f"{left:.3g} {steps.unit}{within}")
    axis.axvline(steps.floor, color=AFTER, linestyle="--", linewidth=1.0)
    axis.set_yticks(rows, names)
    axis.invert_yaxis()
    axis.grid(visible=False, axis="y")
    axis.set_xlim(0, 1.32 * max(*steps.levels, steps.floor))
    axis.set(
        xlabel=_("systematic misfit, rms, %(unit)s; dashed: what noise alone would leave at most", unit=steps.unit)
    )
    return figure


def _label(axis: Axes, row: int, at: float, words: str) -> None:
    axis.annotate(words, (at, row), xytext=(5, 0), textcoords="offset points", va="center", fontsize=8)
