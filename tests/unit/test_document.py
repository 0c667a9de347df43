"""Documents: the templates are those of the installation that the process began with."""

from __future__ import annotations

import io
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import pytest
from jinja2 import PackageLoader

from highside.report import document
from highside.report.document import Page
from highside.report.plots import as_svg, new_figure, plotting


@pytest.fixture
def templates(tmp_path: Path) -> Iterator[Path]:
    """A copy of the templates, read by an environment of its own."""
    document._environment.cache_clear()
    loader = document._environment().loader
    assert isinstance(loader, PackageLoader)
    copy = tmp_path / "templates"
    shutil.copytree(loader._template_root, copy)
    loader._template_root = str(copy)
    yield copy
    document._environment.cache_clear()


def test_a_page_is_not_emptied_by_templates_that_are_being_replaced(templates: Path) -> None:
    before = Page("As it was").html()
    assert before.startswith("<!DOCTYPE html>")
    for path in templates.iterdir():
        path.write_text("")
        os.utime(path, (0, 0))
    assert Page("As it was").html() == before


def test_a_figure_is_laid_out_and_drawn_once() -> None:
    drawn = []
    with plotting():
        figures = [new_figure(1, 1)[0] for _ in range(2)]
        for figure in figures:
            figure.axes[0].plot([0.0, 5000.0], [1e-4, 3e-4], label="a")
            figure.axes[0].set(xlabel="time, s", ylabel="g")
            figure.axes[0].legend()
        left_to_matplotlib = io.StringIO()
        with matplotlib.rc_context({"svg.hashsalt": "1"}):
            figures[0].savefig(left_to_matplotlib, format="svg", dpi=150, metadata={"Date": None, "Creator": None})
        figures[1].axes[0].lines[0].draw = drawn.append  # type: ignore[method-assign]
        as_svg(figures[1], 1)
        del figures[1].axes[0].lines[0].draw
        made = as_svg(figures[1], 1)
    assert len(drawn) == 1
    # in the same places to the last digit
    numbers = [re.findall(r'[xy]="([-\d.]+)"', svg) for svg in (left_to_matplotlib.getvalue(), made)]
    assert numbers[0] == numbers[1] and len(numbers[0]) > 10
