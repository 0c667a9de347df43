"""Pictures of a page as SVG, drawn here: what the pictures of a diagnosis need, in milliseconds.

matplotlib takes 0.35 s to import and as long again to lay out nine panels, which is more than the diagnosis of a pose
table. Letters and axes take the text colour of the page (`currentColor`), so that it is read on a light and on a dark
screen and prints well; they are letters of the page's own font.
"""

from highside.report.drawing.marks import Area, Bar, Level, Line, Points, Strip, Surface, Words
from highside.report.drawing.panel import Panel
from highside.report.drawing.picture import Picture

__all__ = ["Area", "Bar", "Level", "Line", "Panel", "Picture", "Points", "Strip", "Surface", "Words"]
