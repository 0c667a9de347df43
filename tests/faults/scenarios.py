"""The fault scenarios that need the whole daemon and a number: each takes its number and returns a row of the table.

The daemon is a process of its own, the line a real pty, the broker a real mosquitto. `run.py` calls them, alone or all,
at the full number or a small one; `test_scenarios.py` calls the small ones.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import sqlite3
import time
from pathlib import Path
from typing import Any

import psutil
from rig import Checks, Gate, Row, Tool, books, closed, configuration, open_port, quantile

from broker import Mosquitto  # isort: skip
from daemon import Subscriber, running, wait_for  # isort: skip

from highside.service.messages import attitude_payload
from highside.service.outbox import Outbox
from highside.service.outputs import AttitudeOutput

STILL = AttitudeOutput(
    0.0, 0.0, 12.5, 0.01, 271.5, 0.2, 271.5, 0.0, 1.0001, 1e-4, "identity", "", ("uncalibrated",), 10, 0.1, 25.0
)
SEEN_S, BACK_S, AWAY_CPU = 0.05, 1.0, 0.02
"""an unplug is seen, data is back after the return, share of one core while away: what is asked of a service that is
always on"""
SETTLED = 3
"""unplugs after which the descriptors are counted: the files of the outbox and of the recordings are open by then"""
LATE_S = 1.0
"""live data beside a backlog"""


def health_of(subscriber: Subscriber) -> dict[str, Any]:
    """The newest one, without reading all the others."""
    for topic, payload, kept, _ in reversed(subscriber.drain()):
        if topic.endswith("/health") and not kept:
            return json.loads(payload)
    return {}


def came_after(subscriber: Subscriber, moment: float) -> bool:
    """Whether an attitude came after a moment (monotonic)."""
    for topic, _, kept, at in reversed(subscriber.drain()):
        if at <= moment:
            return False
        if topic.endswith("/attitude") and not kept:
            return True
    return False


class Arrivals:
    """Looks at each message of a subscriber once."""

    def __init__(self, subscriber: Subscriber) -> None:
        self._subscriber, self._at = subscriber, 0

    def new(self) -> list[tuple[dict[str, Any], float]]:
        """Attitudes that came since the last call, each with the time of its arrival (monotonic)."""
        messages = self._subscriber.drain()
        fresh, self._at = messages[self._at :], len(messages)
        return [(json.loads(data), at) for topic, data, kept, at in fresh if topic.endswith("/attitude") and not kept]


def unplugs(number: int, folder: Path, *, strict: bool) -> Row:
    """4: seen within 50 ms, below 2 % of a core while away, descriptors flat, data within a second of the return."""
    checks, seen, back = Checks(), [], []
    tool, path = Tool(folder / "tty", 200.0), folder / "highside.toml"
    with Mosquitto(folder / "broker") as broker:
        path.write_text(configuration(folder, tool, broker.port))
        subscriber = Subscriber(broker.port)
        arrivals = Arrivals(subscriber)
        with running(path) as daemon:
            tool.start()
            tool.connect()
            wait_for(arrivals.new, 20, "attitudes", daemon)
            process = psutil.Process(daemon.process.pid)
            descriptors = 0
            for cycle in range(number):
                if cycle == SETTLED:
                    descriptors = process.num_fds()
                port = open_port(daemon.process.pid)
                assert port is not None
                pulled = tool.disconnect()
                while not closed(port):
                    assert time.monotonic() < pulled + 10.0, "the unplug was not seen within 10 s"
                    time.sleep(0.0005)
                seen.append(time.monotonic() - pulled)
                time.sleep(0.02)
                arrivals.new()
                plugged = tool.connect()
                came = wait_for(arrivals.new, 20, "attitudes after the return", daemon)
                back.append(came[0][1] - plugged)
            more = process.num_fds() - descriptors
            tool.disconnect()
            time.sleep(1.0)
            before, away_s = process.cpu_times(), 20.0 if strict else 4.0
            time.sleep(away_s)
            after = process.cpu_times()
            share = (after.user + after.system - before.user - before.system) / away_s
            tool.connect()
            time.sleep(0.5)
            tool.drain()
            sent = tool.frames + tool.unheard
            health = wait_for(
                lambda: (h := health_of(subscriber))["monitor"]["expected"] == sent and h, 20, "the last frame", daemon
            )
            # a reader throws away what a port held when it was opened: that is gap as well
            at_opening = tool.frames - health["monitor"]["good"]
            checks.ask(at_opening <= number and all(health["balance"].values()), f"{at_opening} frames lost")
            checks.ask(daemon.terminate() == 0, "orderly end")
        subscriber.close()
    tool.stop()
    checks.say(
        f"seen after {1e3 * quantile(seen, 0.5):.1f} ms (p99 {1e3 * quantile(seen, 0.99):.1f}, at most"
        f" {1e3 * max(seen):.1f}); {tool.frames:,} frames,"
        f" {at_opening} of them lost while the port was opened; data back after {quantile(back, 0.5):.2f} s"
        f" (p99 {quantile(back, 0.99):.2f}, at most {max(back):.2f}); {share:.1%} of a core while away;"
        f" descriptors {more:+d}"
    )
    # a busy machine may hold either process up: the short form judges the middle, the long one all but one in a hundred
    q = 0.99 if strict else 0.5
    checks.ask(quantile(seen, q) < SEEN_S, f"seen within {SEEN_S} s")
    checks.ask(quantile(back, q) < BACK_S, f"back within {BACK_S} s")
    checks.ask(share < (AWAY_CPU if strict else 5 * AWAY_CPU), f"below {AWAY_CPU:.0%} of a core while away")
    checks.ask(more <= 0, "descriptors flat")
    return checks.into(Row("4", "unplugged and plugged in again", "1,000 times", f"{number:,}"))


def delivered(checks: Checks, attitudes: list[dict[str, Any]], made: int) -> int:
    """All numbers from 0 are there, none with two contents; returns how many came more than once (QoS 1 may)."""
    contents: dict[int, str] = {}
    twice = differ = 0
    for message in attitudes:
        message = {name: value for name, value in message.items() if name != "historical"}
        said = json.dumps(message, sort_keys=True)
        before = contents.setdefault(message["seq"], said)
        twice += before is not said
        differ += before != said
    lost = set(range(made)) - contents.keys()
    checks.ask(not lost, f"{len(lost)} lost, the first {sorted(lost)[:3]}")
    checks.ask(not contents.keys() - set(range(made)), "numbers beyond what was made")
    checks.ask(not differ, f"{differ} numbers with two contents")
    return twice


def rising(checks: Checks, attitudes: list[dict[str, Any]]) -> None:
    """Live and historical messages each keep their order; repetitions of QoS 1 are passed over."""
    for historical in (False, True):
        seen: set[int] = set()
        order = []
        for message in attitudes:
            if message["seq"] not in seen and bool(message.get("historical")) == historical:
                order.append(message["seq"])
            seen.add(message["seq"])
        wrong = [(a, b) for a, b in itertools.pairwise(order) if b < a]
        kind = "historical" if historical else "live"
        checks.ask(not wrong, f"order of the {kind} ones: {len(wrong)} steps back, {wrong[:3]}")


def broker_away(seconds: int, folder: Path, *, strict: bool) -> Row:
    """11: the broker is killed and stays away; nothing is lost, order kept, live data first when it is back."""
    checks = Checks()
    tool, path = Tool(folder / "tty", 100.0), folder / "highside.toml"
    with Gate(folder / "broker") as broker:
        subscriber = Subscriber(broker.port)
        path.write_text(configuration(folder, tool, broker.gate, rate_hz=20))
        with running(path) as daemon:
            tool.start()
            tool.connect()
            wait_for(lambda: subscriber.payloads("attitude"), 30, "attitudes", daemon)
            process = psutil.Process(daemon.process.pid)
            rss = process.memory_info().rss
            wait_for(lambda: health_of(subscriber)["outbox"]["queued"] < 3, 20, "an empty outbox", daemon)
            broker.take_away()
            away = time.monotonic()
            time.sleep(seconds)
            grown = (process.memory_info().rss - rss) / 2**20
            away_s = time.monotonic() - away
            broker.bring_back(subscriber)
            returned = time.monotonic()
            wait_for(lambda: came_after(subscriber, returned), 30, "attitudes after the return", daemon)
            back_s = time.monotonic() - returned
            time.sleep(2.0)
            tool.drain()
            health = wait_for(
                lambda: (
                    (h := health_of(subscriber))["monitor"]["good"] == tool.frames and not h["outbox"]["queued"] and h
                ),
                120,
                "the backlog",
                daemon,
            )
            wait_for(
                lambda: len({p["seq"] for p in subscriber.payloads("attitude")}) >= health["pipeline"]["attitudes"],
                30, "all of them at the subscriber", daemon,
            )  # fmt: skip
            books(checks, health, tool)
            attitudes = subscriber.payloads("attitude")
            twice = delivered(checks, attitudes, health["pipeline"]["attitudes"])
            lost = health["pipeline"]["attitudes"] - len({message["seq"] for message in attitudes})
            rising(checks, attitudes)
            checks.ask(daemon.terminate() == 0, "orderly end")
        subscriber.close()
    tool.stop()
    outbox = health["outbox"]
    checks.ask(not outbox["dropped"], f"dropped {outbox['dropped']}")
    checks.ask(grown < 5.0 or not strict, f"memory grew by {grown:.1f} MiB")
    checks.say(
        f"away {away_s:.0f} s; {health['pipeline']['attitudes']:,} attitudes made, {lost} lost,"
        f" {twice} sent twice; {outbox['committed']:,} went through the disk; first back after {back_s:.1f} s; memory"
        f" {grown:+.1f} MiB"
    )
    return checks.into(Row("11", "broker killed and away", "600 s", f"{seconds} s"))


def fill(path: Path, rows: int) -> None:
    """An outbox with so many attitudes that nobody took."""
    path.parent.mkdir(parents=True)
    outbox = Outbox(path, max_rows=2 * rows + 100, max_age_s=1e6, max_bytes=1 << 30, max_memory_rows=40_000)
    outbox.start()
    topic, now, mono = "highside/t/attitude", time.time(), time.monotonic()
    for number in range(rows):
        payload = attitude_payload(outbox.next_seq(topic), now, mono, True, STILL)
        outbox.put(topic, payload, created_s=now)
        if number % 10_000 == 9_999:
            while outbox.stats.committed < number - 10_000:
                time.sleep(0.01)
    while outbox.stats.committed < rows:
        time.sleep(0.01)
    outbox.stop(60.0)
    with contextlib.closing(sqlite3.connect(path)) as db:
        assert db.execute("SELECT count(*) FROM outbox").fetchone() == (rows,)


BACKLOG_PER_S = 2_500


def backlog(rows: int, folder: Path, *, strict: bool) -> Row:
    """14: a backlog drains while live data is less than a second late."""
    checks = Checks()
    begun = time.monotonic()
    fill(folder / "state" / "outbox.sqlite", rows)
    filled_s = time.monotonic() - begun
    time.sleep(6.0)  # older than `historical_after_s`
    tool, path = Tool(folder / "tty", 200.0), folder / "highside.toml"
    with Mosquitto(folder / "broker") as broker:
        path.write_text(configuration(folder, tool, broker.port, rate_hz=20, mqtt=f"backlog_per_s = {BACKLOG_PER_S}\n"))
        subscriber = Subscriber(broker.port)
        arrivals = Arrivals(subscriber)
        old: list[int] = []
        live: list[int] = []
        late: list[float] = []
        rss = 0
        with running(path) as daemon:
            tool.start()
            tool.connect()
            process = psutil.Process(daemon.process.pid)
            begun, apart = time.monotonic(), time.time() - time.monotonic()
            while len(old) < rows:
                checks_due = time.monotonic() - begun > 30.0 + rows / 500.0
                assert not checks_due, f"{len(old):,} of {rows:,} came"
                for message, at in arrivals.new():
                    if message["seq"] < rows:
                        old.append(message["seq"])
                    else:
                        live.append(message["seq"])
                        late.append(at + apart - message["t"])
                subscriber.all.clear()
                arrivals = Arrivals(subscriber)
                rss = max(rss, process.memory_info().rss)
                time.sleep(0.05)
            took_s = time.monotonic() - begun
            tool.drain()
            time.sleep(1.0)
            live += [message["seq"] for message, _ in arrivals.new() if message["seq"] >= rows]
            checks.ask(daemon.terminate() == 0, "orderly end")
        subscriber.close()
    tool.stop()
    checks.ask(list(dict.fromkeys(old)) == list(range(rows)), "every row of the backlog, in order")
    checks.ask(list(dict.fromkeys(live)) == list(range(live[0], live[0] + len(set(live)))), "live ones, in order")
    checks.ask(quantile(late, 0.999 if strict else 0.5) < LATE_S, f"live data below {LATE_S} s")
    checks.say(
        f"{rows:,} rows put on the disk in {filled_s:.0f} s, delivered in {took_s:.0f} s ({rows / took_s:,.0f}/s, cap"
        f" {BACKLOG_PER_S:,}/s), all in order; {len(live):,} live ones meanwhile, late by {quantile(late, 0.5):.3f} s"
        f" (p99.9 {quantile(late, 0.999):.2f}, at most {max(late):.2f}); memory at most {rss / 2**20:.0f} MiB"
    )
    return checks.into(Row("14", "backlog drains beside live data", "1,000,000 rows", f"{rows:,}"))
