"""Documents: the templates are those of the installation that the process began with."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from jinja2 import PackageLoader

from highside.report import document
from highside.report.document import Page


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
