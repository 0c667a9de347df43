"""Walks each person's pages in a real browser: the technician's, those of who operates a rig, the engineer's.

    python tests/integration/people_walk.py [--browser chromium|firefox|both] [--shots DIR]

With the keyboard alone, but for the choice of a file, which is the system's. On every page at three widths: nothing is
wider than the screen, no control lies over another or cuts its words off, the Tab key reaches each, marks it and shows
it, axe finds nothing, nobody else is asked, the browser says no error; with the cable pulled at that width nothing that
is sent leaves the page. What the page is made of (headings, cards, tables, controls, in order, with the places of what
fills the width) is compared: Firefox's with Chromium's of the same run, and Chromium's with `pictures/pages.json`
(`test_people_walk`; `HIGHSIDE_RENEW_PICTURES=1` writes it). Points are not compared: fonts differ between machines, and
a picture that may differ in every letter shows no fault. Ends with 1 where it finds one.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import math
import re
import sys
import tempfile
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

import aiomqtt
import axe_playwright_python
from axe_walk import kept
from bench_page import chromium
from by_keys import ENTER, TAB, reach, tabbed
from firefox import FIREFOX, FirefoxPage, firefox
from playwright.async_api import Error as PlaywrightError
from playwright.async_api import Page
from signed_in import PASSWORD, make_users, serving
from test_records_page import record
from test_tools_page import NOISY, attitude, history_message, tool, watch_message

WIDTHS = (320, 820, 1400)
NEAR = 0.05
"""Of the width: how far the place of what fills it may be from that in another browser, or on another machine."""
KEPT = Path(__file__).parent / "pictures" / "pages.json"
AXE = (Path(axe_playwright_python.__file__).parent / "axe.min.js").read_text(encoding="utf-8")

SEEN = "{ visibilityProperty: true, opacityProperty: true }"
SKELETON = r"""(() => {
  const out = [], wide = innerWidth;
  const seen = document.querySelectorAll('main h1, main h2, main .card, main table, main pre, main textarea,'
    + ' main a[href], main button, main input:not([type=hidden]), main select, main summary, main .alarm, nav a');
  for (const one of seen) {
    if (!one.checkVisibility(SEEN)) continue;
    const box = one.getBoundingClientRect(), kind = one.localName + (one.matches('.card') ? '.card' : '');
    const said = one.matches('h1, h2, a, button, summary') ? one.textContent : one.getAttribute('name') ?? '';
    const words = said.trim().replace(/\s+/g, ' ');
    const fills = one.matches('h1, h2, .card, table, pre, textarea');
    out.push([kind, words, fills ? [box.left / wide, box.right / wide] : null]);
  }
  return out;
})()""".replace("SEEN", SEEN)
"""Kind, words, and of what fills the width where it begins and ends, as a part of it."""

COVERED = r"""(() => {
  const out = [], all = [...document.querySelectorAll('a[href], button, input:not([type=hidden]), select, textarea')]
    .filter((one) => one.checkVisibility({ visibilityProperty: true }) && !one.closest('.scene, .chart, .skip, svg'));
  const boxes = all.map((one) => [...one.getClientRects()]);
  for (let i = 0; i < all.length; i++) {
    const cut = all[i].matches('button') && all[i].scrollWidth > all[i].clientWidth + 1;
    if (cut) out.push('cut off: ' + all[i].textContent.trim());
    for (let k = i + 1; k < all.length; k++) {
      if (all[i].contains(all[k]) || all[k].contains(all[i])) continue;
      const over = boxes[i].some((a) => boxes[k].some((b) =>
        Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1
        && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 2));
      const [one, other] = [all[i], all[k]].map((at) => at.outerHTML.slice(0, 90));
      if (over) out.push(`over one another: ${one} and ${other}`);
    }
  }
  return out;
})()"""

SIGNED_OUT = (
    "location.pathname.endsWith('/sign-in') && document.querySelector('#name') && !document.querySelector('.person')"
    " && document.readyState === 'complete'"
)
"""The page that came of it: the one that is left is at the same path and has a field of that name, too."""

Skeleton = list[tuple[str, str, list[float] | None]]


class Face(Protocol):
    """A tab of either browser."""

    name: str
    hosts: set[str]
    errors: list[str]

    async def goto(self, address: str) -> None: ...
    async def size(self, width: int, height: int) -> None: ...
    async def evaluate(self, expression: str) -> Any: ...
    async def until(self, expression: str, within_s: float = 60.0) -> None: ...
    async def keys(self, text: str) -> None: ...
    async def choose(self, selector: str, file: Path) -> None: ...
    async def picture(self, path: Path) -> None: ...
    async def cable(self, *, pulled: bool) -> None: ...


class ChromiumFace:
    """A page of Playwright."""

    name = "chromium"

    def __init__(self, page: Page) -> None:
        self.page = page
        self.hosts: set[str] = set()
        self.errors: list[str] = []
        page.on("request", lambda asked: self.hosts.add(urlsplit(asked.url).hostname or ""))
        page.on("console", lambda said: self.errors.append(said.text) if said.type == "error" else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))

    async def goto(self, address: str) -> None:
        try:
            await self.page.goto(address)
        except PlaywrightError as error:
            # a page that was about to send its reader somewhere does so first
            if "interrupted by another navigation" not in str(error):
                raise
            await self.page.goto(address)

    async def size(self, width: int, height: int) -> None:
        await self.page.set_viewport_size({"width": width, "height": height})

    async def evaluate(self, expression: str) -> Any:
        try:
            return await self.page.evaluate(expression)
        except PlaywrightError as error:
            # the page went on while it was asked: what comes after it answers
            if "Execution context was destroyed" not in str(error):
                raise
            await self.page.wait_for_load_state()
            return await self.page.evaluate(expression)

    async def until(self, expression: str, within_s: float = 60.0) -> None:
        # asked for anew: the policy of our pages lets nobody evaluate a text within them, which waiting by itself does
        async with asyncio.timeout(within_s):
            while True:
                with contextlib.suppress(PlaywrightError):
                    if await self.page.evaluate(f"!!({expression})"):
                        return
                await asyncio.sleep(0.1)

    async def keys(self, text: str) -> None:
        for part in re.split(f"([{TAB}{ENTER}])", text):
            name = {TAB: "Tab", ENTER: "Enter"}.get(part)
            await (self.page.keyboard.type(part) if name is None else self.page.keyboard.press(name))

    async def choose(self, selector: str, file: Path) -> None:
        await self.page.set_input_files(selector, file)

    async def picture(self, path: Path) -> None:
        await self.page.screenshot(path=str(path), full_page=True)

    async def cable(self, *, pulled: bool) -> None:
        await self.page.context.set_offline(pulled)


class FirefoxFace(FirefoxPage):
    """The same of Firefox."""

    name = "firefox"

    async def choose(self, selector: str, file: Path) -> None:
        found = await self.command(
            "script.evaluate", expression=f"document.querySelector({selector!r})", target={"context": self._tab},
            awaitPromise=False,
        )  # fmt: skip
        at = {"sharedId": found["result"]["sharedId"]}
        await self.command("input.setFiles", context=self._tab, element=at, files=[str(file)])


@dataclass
class Walk:
    """One browser's: what was seen, and what is wrong."""

    face: Face
    shots: Path | None = None
    brief: bool = False
    """without axe, and without what a child process has to work for"""
    widths: tuple[int, ...] = WIDTHS
    looked: int = 0
    tabs: int = 0
    cut: int = 0
    faults: list[str] = field(default_factory=list)
    seen: dict[str, Skeleton] = field(default_factory=dict)

    async def look(self, name: str, ready: str = "document.querySelector('h1')") -> None:
        await self.face.until(ready)
        # a live page is faded in, at times only after all that it is made of stands there
        await self.face.until(f"document.querySelector('h1')?.checkVisibility({SEEN})")
        for width in self.widths:
            await self.face.size(width, 900)
            await asyncio.sleep(0.2)
            where = f"{name}, {width}"
            wide = await self.face.evaluate("document.scrollingElement.scrollWidth - window.innerWidth")
            found = [f"{wide} px wider than the screen"] if wide > 0 else []
            found += await self.face.evaluate(COVERED)
            if not self.brief:
                await self.face.evaluate(f"(() => {{ {AXE}; return 0; }})()")
                said = await self.face.evaluate("axe.run().then((all) => all.violations)")
                found += [f"{one['id']}: {node['html'][:140]}" for one in said for node in one["nodes"]]
            self.seen[where] = masked(await self.face.evaluate(SKELETON))
            reached, astray = await tabbed(self.face)
            found += astray
            self.tabs += reached
            self.faults += [f"{self.face.name}: {where}: {one}" for one in found]
            self.looked += 1
            if self.shots is not None:
                await self.face.picture(
                    self.shots / f"{self.face.name}-{where.replace(', ', '-').replace(' ', '-')}.png"
                )

    async def press(self, selector: str) -> None:
        """A button or a link."""
        await reach(self.face, selector)
        await self.face.keys(ENTER)

    async def pull_the_cable(self, name: str, selector: str) -> None:
        """At each width a form is sent without a link: it is told, the page and what is written in it stay."""
        for width in self.widths:
            await self.face.size(width, 900)
            before = await self.face.evaluate(WRITTEN)
            await reach(self.face, selector)
            # what was told at another width
            await self.face.evaluate("document.querySelectorAll('[data-told]').forEach((line) => line.remove())")
            await self.face.cable(pulled=True)
            await self.face.keys(ENTER)
            try:
                await self.face.until("document.querySelector('[data-told=lost]')", 30.0)
                if await self.face.evaluate(WRITTEN) != before:
                    self.faults.append(f"{self.face.name}: {name}, {width}: what was written is gone without a link")
                wide = await self.face.evaluate("document.scrollingElement.scrollWidth - window.innerWidth")
                self.faults += (
                    [f"{self.face.name}: {name}, {width}: {wide} px wider without a link"] if wide > 0 else []
                )
            except TimeoutError:
                self.faults.append(f"{self.face.name}: {name}, {width}: nothing is told without a link")
            await self.face.cable(pulled=False)
            self.cut += 1


WRITTEN = (
    "[location.href, ...[...document.querySelectorAll('main input, main textarea, main select')]"
    ".map((at) => at.value)].join('|')"
)
"""Where the page is, and what is written in it."""


def masked(skeleton: list[list[Any]]) -> Skeleton:
    """Without what changes between two runs: numbers, ids, names of sessions."""
    return [
        (kind, re.sub(r"\b(?=\w*\d)\w+", "0", words), None if place is None else [round(x, 3) for x in place])
        for kind, words, place in skeleton
    ]


def differences(one: dict[str, Skeleton], other: dict[str, Skeleton]) -> list[str]:
    """What another browser, or another run, shows otherwise."""
    out = [f"{where}: is missing" for where in sorted(set(one) ^ set(other))]
    for where in sorted(set(one) & set(other)):
        first, second = ([tuple(part[:2]) for part in seen[where]] for seen in (one, other))
        if first != second:
            out.append(
                f"{where}: {[part for part in first if part not in second]} / {[p for p in second if p not in first]}"
            )
            continue
        for (kind, words, place), (_, _, there) in zip(one[where], other[where], strict=True):
            if (
                place is not None
                and there is not None
                and max(abs(a - b) for a, b in zip(place, there, strict=True)) > NEAR
            ):
                out.append(f"{where}: {kind} {words[:40]} from {place} to {there}")
    return out


async def signs_in(walk: Walk, at: str, name: str) -> None:
    """By the keyboard."""
    await walk.face.goto(f"{at}sign-in")
    if await walk.face.evaluate("!!document.querySelector('form.person button')"):
        await walk.press("form.person button")
        await walk.face.until(SIGNED_OUT)
    await reach(walk.face, "#name")
    await walk.face.keys(name)
    await reach(walk.face, "#password")
    await walk.face.keys(f"{PASSWORD} of {name}{ENTER}")
    await walk.face.until("document.querySelector('.person')")


async def technician(walk: Walk, at: str, port: int, folder: Path) -> None:
    """Begins sessions, finds those that are over."""
    await walk.face.goto(f"{at}sign-in")
    await walk.look("technician: sign in", "document.querySelector('#name')")
    await reach(walk.face, "#name")
    await walk.face.keys("F. Force")
    await reach(walk.face, "#password")
    await walk.face.keys(f"{PASSWORD} of F. Force")
    await walk.pull_the_cable("technician: sign in", "main form button")
    await signs_in(walk, at, "F. Force")
    await walk.face.goto(f"{at}bench")
    await walk.look("technician: bench", "document.querySelector('[aria-label=\"six.toml\"]')")
    await walk.pull_the_cable("technician: bench", "[aria-label='six.toml'] form.form button")
    await walk.face.goto(f"{at}sessions")
    await walk.look("technician: sessions")
    await walk.press("tbody a")
    await walk.look("technician: session", "location.pathname.length > 12")


async def operator(walk: Walk, at: str, port: int, folder: Path) -> None:
    """Looks at tools, and orders what may be ordered of them."""
    await signs_in(walk, at, "O. Operate")
    await walk.face.goto(at)
    await walk.look("operator: no tool")
    async with tool(port, "tool-7") as client:
        await client.publish("highside/tool-7/watch", watch_message())
        await client.publish("highside/tool-7/watch/history", history_message())
        await client.publish("highside/tool-7/health", b'{"alarms": ["link_down"], "link": {"state": "down"}}')
        await client.publish("highside/tool-7/attitude", attitude(0, flags=["uncorrected"]))
        await walk.face.until("document.querySelector('li.card')")
        await walk.look("operator: tools")
        await walk.face.goto(f"{at}tool/tool-7")
        await walk.look("operator: tool", "document.querySelector('.chart canvas')")
        await walk.face.goto(f"{at}command/tool-7")
        await walk.look("operator: commands")
        await walk.pull_the_cable("operator: commands", "main form button")
    # the broker keeps no word of it for the next walk
    async with aiomqtt.Client("127.0.0.1", port) as client:
        await client.publish("highside/tool-7/status", b"", retain=True)
    await walk.face.goto(f"{at}acts")
    await walk.look("operator: acts")


async def engineer(walk: Walk, at: str, port: int, folder: Path) -> None:
    """Compares calibrations, certifies, puts in force, diagnoses a recording, changes the configuration."""
    first, second = record(1).id, record(2).id
    await signs_in(walk, at, "F. Force")
    for name, path in {
        "calibrations": "calibrations", "calibration": f"calibrations/{second}",
        "comparison": f"calibrations/compare?before={first}&after={second}", "no such": "calibrations/nothing",
    }.items():  # fmt: skip
        await walk.face.goto(f"{at}{path}")
        await walk.look(f"engineer: {name}")
    for name, path, button in (
        ("put in force", f"calibrations/{first}/force", "main form button"),
        ("take back", f"calibrations/{second}/back", "main form button"),
        ("certificate", f"calibrations/{second}/certificate", "button[value=pdf]"),
        ("configuration", "settings", "button[value=check]"),
    ):
        await walk.face.goto(f"{at}{path}")
        await walk.look(f"engineer: {name}")
        await walk.pull_the_cable(f"engineer: {name}", button)
    await reach(walk.face, "#text")
    await walk.face.keys("nonsense = 1 #")
    await walk.press("button[value=check]")
    await walk.look("engineer: configuration refused", "document.querySelector('main > .alarm')")
    await walk.face.goto(f"{at}diagnosis")
    await walk.look("engineer: diagnosis")
    if walk.brief:
        return
    file = folder / "recording.csv"
    for name, text in (("open", "a,b,c,d\n" + "0.1,0.2,0.3,1.0\n" * 200), ("looked at", poses_of_a_bench())):
        await asyncio.to_thread(file.write_text, text)
        await walk.face.choose("#recording", file)
        await walk.press("form[action='/diagnosis/file'] button")
        await walk.look(f"engineer: file {name}", "document.querySelector('[data-stage=looked]')")
        if name == "looked at":
            await walk.press("main button:not(.quiet)")
            ended = "document.querySelector('[data-stage=done]')"
            await walk.face.until(ended, 120.0)
            await walk.look("engineer: diagnosis ended", ended)
        await walk.press("main button.quiet")
        await walk.face.until("document.querySelector('#recording')")


def poses_of_a_bench() -> str:
    """A recording of 40 poses of four rows, of a tool with an offset."""
    lines = ["t_s,ax_g,ay_g,az_g,inc_ref_deg,tf_ref_deg,pose"]
    for k in range(160):
        inc, tf, noise = 15.0 + 37.0 * (k // 4) % 150, 83.0 * (k // 4) % 360, 2e-5 * ((7 * k) % 11 - 5)
        i, t = math.radians(inc), math.radians(tf)
        read = (math.sin(i) * math.cos(t) + 2e-3, math.sin(i) * math.sin(t), math.cos(i))
        axes = ",".join(f"{value + noise * (-1) ** n:.6f}" for n, value in enumerate(read))
        lines.append(f"{10.0 * (k // 4) + 0.5 * (k % 4)},{axes},{inc},{tf},{k // 4}")
    return "\n".join(lines) + "\n"


PEOPLE: tuple[Callable[[Walk, str, int, Path], Any], ...] = (technician, operator, engineer)


@contextlib.asynccontextmanager
async def faces(folder: Path, which: str) -> AsyncIterator[list[Face]]:
    async with contextlib.AsyncExitStack() as stack:
        out: list[Face] = []
        if which != "firefox":
            browser = await stack.enter_async_context(chromium())
            out.append(ChromiumFace(await (await browser.new_context()).new_page()))
        if which != "chromium":
            assert FIREFOX is not None, "no Firefox was found"
            (folder / "profile").mkdir()
            page = await stack.enter_async_context(firefox(folder / "profile", FIREFOX))
            page.__class__ = FirefoxFace
            out.append(page)  # type: ignore[arg-type]
        yield out


async def walked(which: str, shots: Path | None = None, *, brief: bool = False) -> list[Walk]:
    """All people, in each browser, one after the other."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        async with kept(folder) as (options, port), faces(folder, which) as found:
            users = make_users(folder)
            walks = [Walk(face, shots, brief) for face in found]
            for walk in walks:
                # a server of its own: what one has seen of tools, the next has not
                async with serving(folder, *options, users=users) as served:
                    for person in PEOPLE:
                        try:
                            await person(walk, served.address, port, folder)
                        except (TimeoutError, AssertionError, PlaywrightError) as error:
                            at = await walk.face.evaluate("location.pathname")
                            walk.faults.append(f"{walk.face.name}: {person.__name__} stops at {at}: {error!r:.300}")
                quiet = [text for text in walk.face.errors if not any(word in text for word in (*NOISY, *EXPECTED))]
                walk.faults += [f"{walk.face.name}: the browser says {text[:200]}" for text in quiet]
                others = walk.face.hosts - {"127.0.0.1", ""}
                walk.faults += [f"{walk.face.name}: asked {host}" for host in sorted(others)]
    return walks


EXPECTED = ("ERR_INTERNET_DISCONNECTED", "404", "409")
"""What a browser says of a cable that is pulled, of a page that is not there and of a text that is refused."""


def main() -> int:
    """Walk; the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--browser", choices=("chromium", "firefox", "both"), default="both")
    parser.add_argument("--shots", type=Path, help="a directory for pictures")
    asked = parser.parse_args()
    walks = asyncio.run(walked(asked.browser, asked.shots))
    faults = [fault for walk in walks for fault in walk.faults]
    if len(walks) == 2:
        faults += [f"firefox beside chromium: {one}" for one in differences(walks[0].seen, walks[1].seen)]
    for walk in walks:
        print(
            f"{walk.face.name}: {walk.looked} pages looked at, {walk.tabs} controls reached by the Tab key, "
            f"the cable pulled {walk.cut} times"
        )
    print(f"{len(faults)} faults", *(f"  {one}" for one in faults), sep="\n")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    sys.exit(main())
