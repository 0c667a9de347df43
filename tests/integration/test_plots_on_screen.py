"""Plots in a browser: they draw without a network, zoom and tell values, and a page can do without them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_page import chromium

from highside.report.document import Page as ReportPage
from highside.report.plots import new_figure, plotting
from highside.shown import Plot, PlotLine, PlotPanel

T = np.linspace(0.0, 100.0, 20_000)
SIGNAL = np.sin(T)
SIGNAL[12_345] = 7.0
PLOT = Plot(
    "of <b>outside</b>",
    (
        PlotPanel(T, (PlotLine("ax", SIGNAL), PlotLine("</script><b>", np.cos(T), np.full(T.size, 0.1))), "time, s"),
        PlotPanel(T, (PlotLine("temp", 0.1 * T),), "time, s", "C"),
        PlotPanel(np.arange(2.0), (PlotLine("share", np.array([1.0, 0.4]), np.array([0.1, 0.1]), "points"),),
                  names=("base_tilt", "sag")),
    ),
)  # fmt: skip
PANELS = "Bokeh.documents[0].roots()[0].children.map(child => child[0])"
"""the figures of the first plot of a page"""
RANGE = f"[{PANELS}[{{0}}].x_range.start, {PANELS}[{{0}}].x_range.end]"
DRAWN = "window.Bokeh && Bokeh.documents.length > 0 && Bokeh.documents[0].is_idle"


@pytest.fixture
async def opened(tmp_path: Path) -> AsyncIterator[Any]:
    """Opens a text as a page, offline; what it asked for and what went wrong stands in `page.asked`, `page.wrong`."""
    async with chromium() as browser:

        async def show(html: str, **how: Any) -> Any:
            file = tmp_path / "page.html"
            file.write_text(html, encoding="utf-8")
            context = await browser.new_context(offline=True, viewport={"width": 900, "height": 900}, **how)
            page = await context.new_page()
            page.asked, page.wrong = [], []
            page.on("request", lambda request: page.asked.append(request.url))
            page.on("pageerror", lambda error: page.wrong.append(str(error)))
            await page.goto(file.as_uri())
            return page

        yield show


async def test_a_plot_draws_zooms_and_tells_values_without_a_network(opened: Any) -> None:
    page = await opened(PLOT.html())
    await page.wait_for_function(DRAWN)
    assert all(not url.startswith("http") for url in page.asked), page.asked
    assert page.wrong == []
    for step in range(20):  # the first moves tell Bokeh where the pointer is
        await page.mouse.move(300 + step, 130)
    tooltip = page.locator(".bk-tooltip-content").first
    await tooltip.wait_for(timeout=20_000)
    words = await tooltip.inner_text()
    assert "time, s" in words
    assert "</script><b>" in words
    assert await page.locator("b").count() == 0, "a name from outside became markup"
    # a box drawn in the first panel zooms in, and the second goes along
    before = await page.evaluate(RANGE.format(0))
    await page.mouse.move(300, 90)
    await page.mouse.down()
    await page.mouse.move(400, 160, steps=5)
    await page.mouse.up()
    await page.wait_for_function(f"{RANGE.format(0)}[0] > {before[0]}")
    low, high = await page.evaluate(RANGE.format(0))
    assert before[0] < low < high < before[1]
    assert high - low < 0.3 * (before[1] - before[0])
    assert await page.evaluate(RANGE.format(1)) == [low, high]


async def test_of_a_long_recording_no_peak_is_lost(opened: Any) -> None:
    page = await opened(PLOT.html())
    await page.wait_for_function(DRAWN)
    rows = f"{PANELS}[0].renderers.find(drawn => drawn.data_source).data_source.data"
    largest, count = await page.evaluate(f"[Math.max(...{rows}.y0), {rows}.y0.length]")
    assert largest == 7.0
    assert 1000 < count <= 4002


async def test_a_report_holds_its_plot_and_can_do_without_it(opened: Any) -> None:
    report = ReportPage("A report")
    with plotting():
        figure, axes = new_figure(1, 1)
        axes[0][0].plot([1, 2])
        report.figure(figure, "still")
    report.chart(PLOT, "to zoom")
    page = await opened(report.html())
    await page.wait_for_function(DRAWN)
    assert page.wrong == []
    assert all(not url.startswith("http") for url in page.asked), page.asked
    assert await page.locator("figure.moves").bounding_box() is not None
    await page.emulate_media(media="print")
    assert await page.locator("figure.moves").bounding_box() is None, "paper holds what can be read on it"
    plain = await opened(report.html(), java_script_enabled=False)
    assert await plain.locator("figure svg").first.is_visible()


def test_a_page_carries_its_script_once_and_stays_small() -> None:
    report = ReportPage("A report")
    alone = len(report.html())
    report.chart(PLOT, "first")
    one = len(report.html())
    report.chart(PLOT, "second")
    assert report.html().count('id="drawing-library"') == 1
    assert 300_000 < one - alone < 900_000
    assert len(report.html()) - one < 350_000
