"""The misfit of a recording step by step (`misfit_steps`) in a picture: bars that subtract in plain sight."""

from __future__ import annotations

import numpy as np

from highside.report.diagnosis_figures import AFTER, BEFORE, SHADE
from highside.report.drawing import Bar, Level, Line, Picture, Words
from highside.report.misfit_steps import Steps
from highside.words import _

ROOM = 1.32
"""of the longest bar: for the words beside it"""
NONE = 1e-4
"""Share of the first bar below which what is left is rounding. Words of this page."""


def waterfall(steps: Steps, titles: dict[str, str]) -> Picture:
    """Bars from the simulation as given down to what is left, with the floor of the noise as a line."""
    names = [_("simulation as given"), *(titles.get(name, name) for name in steps.names), _("what is left")]
    picture = Picture(1, 1, height=0.55 + 0.42 * len(names))
    panel = picture.panels[0][0]
    left = steps.left if steps.names else steps.levels[0]
    # a unit of several words stands along the axis alone: beside the bars there is no room for it
    unit = "" if " " in steps.unit else f" {steps.unit}"
    panel.add(Bar(0, 0.0, steps.levels[0], BEFORE), Words(steps.levels[0], 0.0, f"{steps.levels[0]:.3g}{unit}"))
    for k in range(len(steps.names)):
        low, high = steps.levels[k + 1], steps.levels[k]
        panel.add(
            Bar(k + 1, low, high, SHADE),
            Line(np.array([high, high]), np.array([k - 0.31, k + 1.31]), SHADE, width=0.8),
            # the share in units of the noise stands in the sentence above: another weighting, another figure
            Words(high, k + 1.0, f"\N{MINUS SIGN}{high - low:.3g}{unit}"),
        )
    last = len(names) - 1
    within = " " + _("(within the noise)") if left <= steps.floor else ""
    shown = left if left > NONE * steps.levels[0] else 0.0
    panel.add(
        Bar(last, 0.0, left, AFTER),
        Words(max(left, steps.floor), float(last), f"{shown:.3g}{unit}{within}"),
        Level(steps.floor, AFTER, width=1.0, dashed=True, upright=True),
    )
    panel.y_names = names
    panel.x_limits = (0.0, ROOM * max(*steps.levels, steps.floor))
    panel.x_label = _("systematic misfit, rms, %(unit)s; dashed: what noise alone would leave at most", unit=steps.unit)
    return picture
