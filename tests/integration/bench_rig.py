"""A bench whose cable can be pulled: the real driver and page over a simulated bench, hands at the table.

As a program (FOLDER with `bench.toml` in it) it prints the page's link; each line of its input is a word: `unplug
STATE` waits for the session to be in that state and pulls the plug then, `plug` puts it back. It says `unplugged` then.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

from bench_page import FILE, BenchProcess

HERE = Path(__file__).parent


@dataclass
class Rig(BenchProcess):
    """The page, and the plug."""

    async def unplug_in(self, state: str, timeout_s: float = 90.0) -> None:
        """Pull the plug as soon as the session is in that state."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(f"unplug {state}\n".encode())
        await self.process.stdin.drain()
        said = await asyncio.wait_for(self.process.stdout.readline(), timeout_s)
        assert said.strip() == b"unplugged", said

    async def plug(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(b"plug\n")
        await self.process.stdin.drain()


@contextlib.asynccontextmanager
async def bench_rig(folder: Path, *, plan: str, speed: float = 4.0) -> AsyncIterator[Rig]:
    (folder / "bench.toml").write_text(FILE.format(speed=speed, plan=plan))
    process = await asyncio.create_subprocess_exec(
        sys.executable, HERE / "bench_rig.py", folder,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None
    try:
        link = (await asyncio.wait_for(process.stdout.readline(), 120.0)).decode().strip()
        assert link.startswith("http"), "the page did not start"
        yield Rig(process, folder, link)
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


async def _serve(folder: Path) -> None:
    from highside.bench.driver import BenchDriver
    from highside.bench.simulated_operator import SimulatedOperator
    from highside.config.bench import load_bench
    from highside.web.server import BenchPage

    settings = load_bench(folder / "bench.toml")
    driver = BenchDriver.begin(settings, operator="A. Operator")
    assert driver.bench is not None
    page = BenchPage(driver, settings.web, operator="A. Operator")
    await page.start()
    print(page.link, flush=True)
    hands = SimulatedOperator(driver.bench)

    async def work() -> None:
        while True:
            # what he would command is the test's
            hands.look(driver.snapshot())
            await asyncio.sleep(0.05)

    tasks = [asyncio.create_task(driver.run(stay=True)), asyncio.create_task(work())]
    while line := (await asyncio.to_thread(sys.stdin.readline)).split():
        if line[0] == "unplug":
            while driver.snapshot().state.value != line[1]:
                await asyncio.sleep(0.02)
            driver.bench.unplug()
            print("unplugged", flush=True)
        else:
            driver.bench.plug()
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    await page.stop()


if __name__ == "__main__":
    asyncio.run(_serve(Path(sys.argv[1])))
