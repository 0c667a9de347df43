"""Draws docs/tools-page.png: a tool's page of `highside serve`, from a real broker, a real service and a real browser.

    python docs/tools_page_pictures.py [--seconds 90]

Needs mosquitto, chromium and the extra `web`.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "integration"))

from bench_page import HIGHSIDE, chromium
from broker import Mosquitto
from test_tools_page import listed, serve

TOOL = """
[tool]
id = "tool-7"
[link]
kind = "simulated"
[codec]
name = "tool"
[survey]
still_s = 5.0
[mqtt]
port = {port}
[service]
state_dir = "{state}"
"""


async def picture(target: Path, seconds: float) -> None:
    """Let a simulated tool run for so long and take the picture. Raises AssertionError where a part is missing."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        broker = Mosquitto(folder / "broker")
        broker.start()
        (folder / "state").mkdir()
        config = folder / "tool.toml"
        config.write_text(TOOL.format(port=broker.port, state=folder / "state"))
        service = await asyncio.create_subprocess_exec(
            HIGHSIDE, "run", "--config", config, stderr=asyncio.subprocess.DEVNULL
        )
        try:
            async with serve("--set", f"mqtt.port={broker.port}") as (address, _), chromium() as browser:
                await listed(address, 1)
                await asyncio.sleep(seconds)
                page = await browser.new_page(viewport={"width": 1400, "height": 900})
                await page.goto(f"{address}tool/tool-7")
                await page.locator("section.space canvas").wait_for()
                # the whole page in the window: a change of size for the picture would empty the tool in space
                height = await page.evaluate("document.scrollingElement.scrollHeight")
                await page.set_viewport_size({"width": 1400, "height": height})
                await asyncio.sleep(6.0)
                await page.screenshot(path=target)
        finally:
            service.terminate()
            await service.wait()
            broker.stop()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=90.0)
    asyncio.run(picture(Path(__file__).with_name("tools-page.png"), parser.parse_args().seconds))
