"""SIGKILL of a sending process at 30 random points: the outbox stays whole and loses one commit interval at most.

A third of the runs have no broker, so that rows wait in the file. What was put longer than a commit interval before the
kill must all arrive in the end, and a number must never be seen with two contents.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections import defaultdict
from pathlib import Path

import pytest
from broker import Mosquitto, Subscriber, free_port

from highside.service.outbox_file import log_path, moved_generation
from highside.service.outbox_log import read_log
from highside.service.sequence import BLOCK

KILLS = int(os.environ.get("HIGHSIDE_KILLS", "30"))
RATE_HZ = 300.0
COMMIT_INTERVAL_S = 0.05
SLACK_S = 0.25
"""For the commit in progress: an fsync on a busy machine, and the thread's turn."""
TOPIC = "highside/victim/attitude"


class Nursery:
    """The forking helper; reads what the present child says in a thread, so that its pipe never fills."""

    def __init__(self, path: Path) -> None:
        program = Path(__file__).with_name("outbox_child.py")
        self._process = subprocess.Popen(
            [sys.executable, str(program), str(path), str(RATE_HZ), str(COMMIT_INTERVAL_S)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self.lines: list[bytes] = []
        self._news = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._news:
                self.lines.append(line)
                self._news.notify_all()

    def run(self, run: int, port: int) -> None:
        assert self._process.stdin is not None
        self.lines.clear()
        self._process.stdin.write(b"%d %d\n" % (run, port))
        self._process.stdin.flush()

    def wait_for(self, word: bytes, timeout_s: float = 60.0) -> bytes:
        with self._news:
            found = self._news.wait_for(lambda: [ln for ln in self.lines if ln.startswith(word)], timeout_s)
        assert found, (word, self.lines[-5:])
        return found[0]

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(10.0)


def waiting(path: Path) -> dict[int, int]:
    """seq -> run of the rows that wait, in SQLite and in the log before it; the file is checked on the way."""
    if not path.exists():
        return {}
    generation, late = read_log(log_path(path))
    with contextlib.closing(sqlite3.connect(path)) as db:
        assert db.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
        if not db.execute("SELECT 1 FROM sqlite_master WHERE name = 'outbox'").fetchone():
            return {}  # killed before its first transaction
        rows = dict(db.execute("SELECT seq, payload FROM outbox").fetchall())
        if generation > moved_generation(db):
            rows |= {row.seq: row.payload for row in late.values()}
    return {seq: json.loads(payload)["run"] for seq, payload in rows.items()}


@pytest.mark.slow
@pytest.mark.timeout(3600 if KILLS > 30 else 300)
@pytest.mark.timing
async def test_a_kill_costs_one_commit_interval_at_most_and_no_number_is_used_twice(tmp_path: Path) -> None:
    rng = random.Random(20261121)
    path = tmp_path / "outbox.sqlite"
    nowhere = free_port()
    owner: dict[int, int] = {}
    put_s: dict[int, float] = {}
    killed_s: list[float] = []
    left_in_file = 0
    with Mosquitto(tmp_path / "broker") as mosquitto:
        watcher = Subscriber(mosquitto.port, "highside/victim")
        async with watcher.running():
            nursery = await asyncio.to_thread(Nursery, path)
            for run in range(KILLS):
                nursery.run(run, nowhere if run % 3 == 1 else mosquitto.port)
                pid = int((await asyncio.to_thread(nursery.wait_for, b"ready")).split()[1])
                await asyncio.sleep(rng.uniform(0.005, 0.5))
                killed_s.append(time.monotonic())
                os.kill(pid, signal.SIGKILL)
                await asyncio.to_thread(nursery.wait_for, b"gone")
                puts = [line.split() for line in nursery.lines if line[:1].isdigit()]
                for seq, t in ((int(seq), float(t)) for seq, t in puts):
                    if seq in owner:
                        # only one that was killed before its number was reserved, so that nobody has ever seen it
                        unseen_s = killed_s[owner[seq]] - put_s[seq]
                        assert unseen_s <= COMMIT_INTERVAL_S + SLACK_S, "a number of an earlier run was used again"
                    owner[seq], put_s[seq] = run, t
                rows = waiting(path)
                left_in_file += len(rows)
                # the last message may have been stored before the child could tell of it
                unknown = {seq for seq in rows if seq not in owner}
                assert len(unknown) <= run + 1
                assert all(owner[seq] == of for seq, of in rows.items() if seq in owner)
            nursery.run(-1, mosquitto.port)
            done = await asyncio.to_thread(nursery.wait_for, b"drained")
            assert done.split()[1] == b"0"
            # put a commit interval, and the commit in progress, before the kill
            safe = {seq for seq, t in put_s.items() if t < killed_s[owner[seq]] - COMMIT_INTERVAL_S - SLACK_S}
            await watcher.wait_for(lambda: {m["seq"] for _, m in watcher.messages} >= safe, 20.0)
            nursery.close()
    contents = defaultdict(set)
    for _, message in watcher.messages:
        contents[message["seq"]].add(message["run"])
    lost = sorted(owner.keys() - contents.keys())
    oldest_lost_s = max((killed_s[owner[seq]] - put_s[seq] for seq in lost), default=0.0)
    print(
        f"{KILLS} kills, {len(owner)} put, {len(contents)} delivered, {left_in_file} found waiting in the file,"
        f" {len(lost)} lost, the oldest of them put {oldest_lost_s * 1e3:.0f} ms before the kill"
    )
    assert len(contents) > 500
    assert left_in_file > 100
    assert {seq: runs for seq, runs in contents.items() if len(runs) > 1} == {}
    assert {seq for seq, runs in contents.items() if seq in owner and runs != {owner[seq]}} == set()
    assert oldest_lost_s <= COMMIT_INTERVAL_S + SLACK_S
    # the numbers left out at a start are those reserved, and no more
    numbers = sorted(owner)
    assert max(b - a for a, b in itertools.pairwise(numbers)) <= 2 * BLOCK
