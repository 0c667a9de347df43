"""Fault scenarios at their own numbers: `make faults`, or one of them alone.

    python tests/faults/run.py                               all, at their numbers; the table goes into docs/faults.md
    python tests/faults/run.py --scenario 4 --number 1000    one of them
    python tests/faults/run.py --short                       small numbers
    python tests/faults/run.py --keep DIR                    what held stays in DIR: called again it goes on from there

Scenarios that need the whole daemon are in scenarios.py and storm.py; for the others the tests of the project are run,
with the number in the environment where there is one. Some run beside one another where they do not disturb each other:
those that judge times are alone in their lane.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parent)]

import scenarios  # noqa: E402
import storm  # noqa: E402
from rig import ROOT, Row  # noqa: E402

TABLE = ROOT / "docs" / "faults.md"
BEGIN, END = "<!-- make faults: begin -->", "<!-- make faults: end -->"
HEAD = (
    "| # | scenario | number asked | number run | measured | held | took | command |\n|---|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class Live:
    """A function of scenarios.py or storm.py."""

    key: str
    function: Callable[..., Row]
    long: int
    short: int
    lane: int = 0

    def run(self, number: int | None, *, short: bool) -> Row:
        chosen = number if number is not None else (self.short if short else self.long)
        with tempfile.TemporaryDirectory(prefix="faults-") as folder:
            row = self.function(chosen, Path(folder), strict=not short)
        row.command = f"python tests/faults/run.py --scenario {self.key} --number {chosen}"
        return row


@dataclass(frozen=True)
class Tests:
    """Tests of the project; `number` goes into the environment as `variable`."""

    key: str
    name: str
    asked: str
    nodes: str
    variable: str = ""
    long: int = 0
    short: int = 0
    lane: int = 1

    def run(self, number: int | None, *, short: bool) -> Row:
        chosen = number if number is not None else (self.short if short else self.long)
        env = dict(os.environ)
        prefix = ""
        if self.variable:
            env[self.variable] = str(chosen)
            prefix = f"{self.variable}={chosen} "
        command = [sys.executable, "-m", "pytest", "-q", "-s", "-p", "no:cacheprovider", "-p", "no:warnings"]
        command += ["-o", "timeout=3600"]
        done = subprocess.run(
            [*command, *self.nodes.split()], cwd=ROOT, env=env, capture_output=True, text=True, check=False
        )
        lines = [line.strip(" .") for line in done.stdout.splitlines() if line.strip(" .=")]
        figures = [line for line in lines[:-1] if self._is_figure(line)][-3:]
        summary = lines[-1].strip("= ") if lines else "no output"
        if done.returncode != 0:
            missed = (line.split(" - ")[0] for line in lines if line.startswith("FAILED "))
            figures = (
                list(dict.fromkeys(line.removeprefix("FAILED ").rpartition("::")[2] for line in missed)) + figures[-1:]
            )
            print(done.stdout[-20_000:], file=sys.stderr)
        measured = "; ".join([*figures, summary]).replace("|", "/")
        run = f"{chosen:,}" if self.variable else "as asked"
        held = done.returncode == 0 and whole(summary)
        return Row(self.key, self.name, self.asked, run, measured, held, f"{prefix}pytest {self.nodes}")

    @staticmethod
    def _is_figure(line: str) -> bool:
        """What a test printed of itself, and not what pytest says."""
        return (
            any(c.isdigit() for c in line)
            and " " in line
            and not line.startswith(("/", "tests/", "SKIPPED", "FAILED", "E  ", "real recordings: "))
        )


def whole(summary: str) -> bool:
    """Whether pytest's last line says that something passed and nothing was skipped: what was skipped held nothing."""
    return " passed" in summary and " skipped" not in summary


def fuzz(number: int, _folder: Path, *, strict: bool) -> Row:
    """26: damaged inputs for every parser."""
    command = [sys.executable, str(ROOT / "tests" / "faults" / "fuzz.py"), "--inputs", str(number)]
    seconds = os.environ.get("HIGHSIDE_FUZZ_S", "120") if strict else "1"
    command += ["--seconds", seconds]
    if strict:
        command += ["--seed", "26", "--books", str(ROOT / "tests" / "faults" / "fuzzed.json")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    rows = [line.split("|")[1:-1] for line in done.stdout.splitlines()[2:] if line.startswith("|")]
    counts = [int(cells[1].replace(",", "")) for cells in rows]
    escaped = sum(int(cells[4].replace(",", "")) for cells in rows)
    full = sum(count >= number for count in counts)
    row = Row("26", "damaged files and commands", "1,000,000 a parser")
    row.run = f"{sum(counts):,} in all; {full} of {len(counts)} parsers at {number:,}, the least {min(counts):,}"
    row.measured = f"{escaped} escaped"
    if strict:
        row.measured += "; what the books hold" if float(seconds) == 0.0 else f"; at most {seconds} s a parser"
    row.complete = full == len(counts)
    row.held = done.returncode == 0 and bool(rows) and (row.complete or not strict)
    return row


INTEGRATION = "tests/integration"
ALL: tuple[Live | Tests, ...] = (
    Tests("1", "golden replay in any chunks", "identical payloads", f"{INTEGRATION}/test_run.py -k golden"),
    Tests("2", "soak, 3,840 serial and 9,000 CAN frames/s", "0 lost, p99.9 of the loop's lag < 20 ms",
          f"{INTEGRATION}/test_soak.py", "HIGHSIDE_SOAK_S", 120, 10, lane=0),
    Tests("3", "bit flips, inserted and removed bytes", "1,000,000 a codec", "tests/unit/test_codec_fuzz.py",
          "HIGHSIDE_FUZZ_INPUTS", 1_000_000, 20_000, lane=2),
    Live("4", scenarios.unplugs, 1000, 20),
    Tests("5, 6, 10", "other node, open but silent, second opener", "as written",
          f"{INTEGRATION}/test_link_serial.py {INTEGRATION}/test_places.py"),
    Tests("7, 16", "CAN down and up, deleted and made anew; I/O errors, read-only on the daemon",
          "1,000 times each; alarm <= 5 s", "tests/guest/test_guests.py -k can_suite", "HIGHSIDE_CAN_CYCLES",
          1000, 20, lane=2),
    Tests("8, 9", "loss, gaps, wraps counted exactly", "exact",
          "tests/unit/test_monitor.py tests/unit/test_codec_tool.py"),
    Live("11", scenarios.broker_away, 600, 6, lane=1),
    Tests("11, 12, 13", "resets, outage, black hole, empty broker", "0 lost, back <= 2 s",
          f"{INTEGRATION}/test_mqtt_faults.py"),
    Live("14", scenarios.backlog, 1_000_000, 6_000),
    Tests("15", "SIGKILL at random points", "200 times", f"{INTEGRATION}/test_run.py -k random_points",
          "HIGHSIDE_KILLS", 200, 10),
    Tests("15", "SIGKILL of the sender, outbox whole", "200 times", f"{INTEGRATION}/test_mqtt_sigkill.py",
          "HIGHSIDE_KILLS", 200, 30),
    Tests("16", "power cut", "what was promised is there",
          "tests/guest/test_guests.py -k power", lane=2),
    Tests("17", "clock steps, 1970", "an hour, a day, a month", f"{INTEGRATION}/test_clock_steps.py"),
    Tests("18", "bad reloads while frames flow", "20 kinds", f"{INTEGRATION}/test_reload.py"),
    Tests("19", "SIGTERM under load", "< 10 s", f"{INTEGRATION}/test_run.py -k sigterm"),
    Tests("20, 27", "watchdog, confinement, under systemd", "exposure <= 2.0",
          "tests/guest/test_guests.py -k systemd", lane=2),
    Tests("21-23", "calibration faults", "as written",
          "tests/session/test_faults.py tests/session/test_sigkill.py tests/unit/test_record.py"),
    Tests("24", "slow viewers of the page", "100 for 60 s", f"{INTEGRATION}/test_page_guard.py -k hundred",
          "HIGHSIDE_VIEWERS_S", 60, 10),
    Tests("25", "WITS peer absent or slow", "as written", f"{INTEGRATION}/test_rig.py -k away"),
    Live("26", fuzz, 1_000_000, 500, lane=2),
    Tests("28", "the broker's limits with a subscriber offline", "as written",
          f"{INTEGRATION}/test_mqtt_mosquitto_config.py"),
    Live("storm", storm.storm, 300, 30),
)  # fmt: skip


def one(job: Live | Tests, number: int | None, *, short: bool) -> Row:
    """Run it; whatever it raises is a row that did not hold."""
    begun = time.monotonic()
    try:
        row = job.run(number, short=short)
    except Exception as error:
        asked = job.asked if isinstance(job, Tests) else str(job.long)
        name = job.name if isinstance(job, Tests) else job.function.__name__
        said = " ".join(str(error).split())[:300].replace("|", "/")
        row = Row(job.key, name, asked, "not finished", f"{type(error).__name__}: {said}")
    row.seconds, row.date = time.monotonic() - begun, time.strftime("%Y-%m-%d")
    if os.sched_getscheduler(0) in (os.SCHED_RR, os.SCHED_FIFO):
        row.date += ", real-time priority"
    return row


class Kept:
    """Rows that held, each in a file of a folder, so that a run that was interrupted goes on; without one, none."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def row(self, name: str, run: Callable[[], Row]) -> Row:
        """That of an earlier run, or this one's."""
        place = None if self._folder is None else self._folder / f"{name}.json"
        if place is not None and place.exists():
            return Row(**json.loads(place.read_text()))
        row = run()
        if place is not None and row.held and row.complete:
            beside = place.with_suffix(".new")
            beside.write_text(row.json())
            beside.replace(place)
        return row


def all_of(jobs: list[Live | Tests], number: int | None, *, short: bool, kept: Kept) -> list[Row]:
    """The lanes beside each other, in processes of their own; lane 2, which computes, when the others are done."""
    rows: dict[int, Row] = {}

    def in_a_process(job: Live | Tests, count: int) -> Row:
        command = [sys.executable, __file__, "--index", str(ALL.index(job)), "--json", "--number", str(count)]
        done = subprocess.run(command + ["--short"] * short, stdout=subprocess.PIPE, text=True, check=False)
        return Row(**json.loads(done.stdout.splitlines()[-1]))

    def lane(which: int) -> None:
        for place, job in enumerate(jobs):
            if job.lane != which:
                continue
            count = number if number is not None else (job.short if short else job.long)
            name = f"{ALL.index(job):02}-{count}"
            rows[place] = kept.row(name, lambda job=job, count=count: in_a_process(job, count))  # type: ignore[misc]
            print(rows[place].markdown(), flush=True)

    print(HEAD, flush=True)
    beside = [threading.Thread(target=lane, args=(which,)) for which in (0, 1)]
    for thread in beside:
        thread.start()
    for thread in beside:
        thread.join()
    lane(2)
    return [rows[place] for place in sorted(rows)]


def write(rows: list[Row]) -> None:
    """Between the marks; rows of scenarios that were not run stay as they are."""
    text = TABLE.read_text()
    before, rest = text.split(BEGIN)
    old, after = rest.split(END)
    lines = {tuple(line.split(" | ")[:2]): line for line in old.splitlines() if line.startswith("| ")}
    lines.pop(tuple(HEAD.splitlines()[0].split(" | ")[:2]), None)
    for row in rows:
        line = row.markdown()
        cells = line.split(" | ")
        cells[3] = f"{cells[3]} ({row.date or time.strftime('%Y-%m-%d')})"
        lines[tuple(cells[:2])] = " | ".join(cells)
    order = {job.key: place for place, job in reversed(list(enumerate(ALL)))}
    body = sorted(lines.values(), key=lambda line: order.get(line.split(" | ")[0].strip("| "), 99))
    TABLE.write_text("\n".join([before + BEGIN, HEAD, *body, END + after]))


def main() -> int:
    arguments = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    arguments.add_argument("--scenario", action="append", help="only this one; may be given several times")
    arguments.add_argument("--number", type=int, help="how often, how many or how long, instead of its own number")
    arguments.add_argument("--short", action="store_true", help="small numbers, bounds for a busy machine")
    arguments.add_argument("--write", action="store_true", help=f"put the rows into {TABLE.relative_to(ROOT)}")
    arguments.add_argument("--keep", type=Path, help="folder of what has held: called again, it goes on from there")
    arguments.add_argument("--index", type=int, help=argparse.SUPPRESS)
    arguments.add_argument("--json", action="store_true", help=argparse.SUPPRESS)
    asked = arguments.parse_args()
    if asked.index is not None:
        print(one(ALL[asked.index], asked.number, short=asked.short).json())
        return 0
    jobs = [job for job in ALL if not asked.scenario or job.key in asked.scenario]
    if unknown := set(asked.scenario or ()) - {job.key for job in ALL}:
        arguments.error(f"no scenario {', '.join(sorted(unknown))}; there are: {', '.join(job.key for job in ALL)}")
    if asked.number is not None and asked.number < 1:
        arguments.error("--number is at least 1")
    if asked.keep is not None:
        try:
            asked.keep.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            arguments.error(f"--keep {asked.keep}: cannot be made a folder ({error.strerror}); name another place")
    rows = all_of(jobs, asked.number, short=asked.short, kept=Kept(asked.keep))
    if asked.write:
        write(rows)
    return 0 if all(row.held for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
