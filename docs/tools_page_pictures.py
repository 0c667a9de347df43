"""Draws docs/tools-page.png: a tool's page of `highside serve`, from a real broker, a real service and a real browser;
the tool is calibrated, and its calibration is watched.

    python docs/tools_page_pictures.py [--seconds 240]

Needs mosquitto, chromium and the extra `web`.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "integration")]

from bench_page import HIGHSIDE, chromium  # noqa: E402
from broker import Mosquitto  # noqa: E402
from test_tools_page import listed, serve  # noqa: E402

import highside  # noqa: E402
from highside.link.device import DeviceSettings, SimulatedDevice  # noqa: E402
from highside.link.tcp_wire import local_wire  # noqa: E402
from highside.physics.motion import Leg, Motion  # noqa: E402
from highside.recording.calibration_store import CalibrationStore  # noqa: E402
from tests.unit.watch_frames import poses_of_a_good_tool  # noqa: E402

TOOL = """
[tool]
id = "tool-7"
[link]
kind = "serial"
port = "{tool}"
[codec]
name = "tool"
[calibration]
store = "{store}"
[survey]
still_s = 5.0
[mqtt]
port = {port}
[service]
state_dir = "{state}"
"""
STANDS = tuple(leg for inclination in (30.0, 60.0, 5.0) for leg in (Leg(35.0), Leg(4.0, inclination, turn_deg=130.0)))
"""Rests as long as the watch asks for, between turns to another attitude."""


async def picture(target: Path, seconds: float) -> None:
    """Let a simulated tool run for so long and take the picture. Raises AssertionError where a part is missing."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        broker = Mosquitto(folder / "broker")
        broker.start()
        (folder / "state").mkdir()
        calibration = highside.calibrate(poses_of_a_good_tool(1), "joint", tool="tool-7", temp_c=25.0)
        CalibrationStore(folder / "store").activate(calibration.record, now_s=time.time() - 3600.0)
        tool = SimulatedDevice(
            DeviceSettings(motion=Motion(STANDS, inclination_deg=5.0, toolface_deg=30.0)), local_wire()
        )
        tool.plug()
        tool.start()
        config = folder / "tool.toml"
        config.write_text(
            TOOL.format(port=broker.port, state=folder / "state", store=folder / "store", tool=tool.address)
        )
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
            tool.stop()
            broker.stop()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=240.0)
    asyncio.run(picture(Path(__file__).with_name("tools-page.png"), parser.parse_args().seconds))
