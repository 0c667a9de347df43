"""How results show themselves: a card of rows and words, and plots for the screen and for paper.

`card` is what a notebook shows of a result. A `plot.Plot` says what is drawn, without a library; `screen` makes of it a
page to zoom and hover in (Bokeh, extra `notebook`), `paper` a figure to print (matplotlib, extra `plot`). Nothing that
is shown asks the network for anything. Knows numpy and templates, and nothing of what the numbers mean.
"""

from highside.shown.card import card
from highside.shown.panel import PlotLine, PlotPanel
from highside.shown.plot import Plot

__all__ = ["Plot", "PlotLine", "PlotPanel", "card"]
