"""The main pages in Firefox: the walk of `firefox_walk`, its two halves side by side."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest
from firefox import FIREFOX
from firefox_walk import WIDTHS, a_session, the_served_pages

ENDS = (WIDTHS[0], WIDTHS[-1])
"""The width between them is looked at by the walk by itself."""


@pytest.mark.slow
async def test_a_session_and_the_served_pages_in_firefox(tmp_path: Path) -> None:
    """Absent: skipped, but a failure under CI."""
    if FIREFOX is None:
        if os.environ.get("CI") == "true":
            pytest.fail("firefox-esr is not installed, and CI must not skip this test")
        pytest.skip("needs the browser firefox-esr")
    for name in ("session", "served"):
        (tmp_path / name).mkdir()
    async with asyncio.TaskGroup() as both:
        both.create_task(a_session(tmp_path / "session", FIREFOX, None, ENDS))
        both.create_task(the_served_pages(tmp_path / "served", FIREFOX, None, ENDS))
