"""Many short sessions through four ways of doing them in one run: a loop, a process pool, joblib, `highside fleet`.

Half of the workers' lives are taken: while the fleet works, worker processes are ended by SIGKILL at random, and the
whole command is ended so and begun anew. What is asked: is every result there, once, and equal to the loop's; what does
a session cost, processor time of all processes taken together, as a ratio to the loop.

    python -m studies.fleet_scale --sessions 1000 --workers 2 --repeats 5 --kills 10 --ends 2
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import numpy as np
import psutil

import highside
from highside.fleet.catalogue import catalogue_of
from highside.fleet.jobs import Order, row_of
from highside.fleet.parts import PartStore
from highside.fleet.run import run
from highside.recording.table import Table

MODEL: dict[str, Any] = {
    "sensor": {"bias_g": [1e-3, -8e-4, 1e-3]},
    "motion": {"kind": "poses", "inclinations_deg": [3, 45, 88], "toolfaces_deg": [0, 90, 180, 270], "hold_s": 2},
    "effects": {"included": ["reading_noise"], "reading_noise": {"density_ug": 50}},
}
KNOWN = "[sensor]\nnoise_g = 5e-5\n"
ORDERS = {"diagnose": Order("diagnose", KNOWN), "solve": Order("solve", method="joint")}
CHUNK = 25
"""sessions that the pool and joblib give out at a time: about as many as a task of the fleet has"""
OF_THE_RUN = ("seconds", "cpu_s", "key")
"""columns of a result that are no answer"""


def sessions(folder: Path, count: int, job: str) -> list[Path]:
    """So many tools, each at rest at twelve attitudes; every fourth has an effect that the model lacks."""
    folder.mkdir(parents=True)
    found = []
    for i in range(count):
        model = dict(MODEL)
        if i % 4 == 0:
            model["effects"] = {
                **MODEL["effects"],
                "included": ["reading_noise", "quadratic"],
                "quadratic": {"k2_x": 2e-3},
            }
        found.append(folder / f"tool{i:04d}.csv")
        recording = highside.simulate(model, seed=i).recording
        if job == "solve":
            _poses(recording).write(found[-1])
        else:
            recording.write(found[-1])
    return found


def _poses(recording: Table) -> Table:
    """The means of the stops."""
    columns = recording.columns
    pose = columns["pose"]
    names = {"inc_ref_deg": "inc_ref_deg", "tf_ref_deg": "tf_ref_deg", "ax_g": "ax", "ay_g": "ay", "az_g": "az"}
    return Table({to: np.array([columns[of][pose == k].mean() for k in np.unique(pose)]) for of, to in names.items()})


def answer(job: str, path: Path) -> dict[str, Any]:
    """What a session says, without what differs from run to run."""
    return plain(row_of(ORDERS[job], path))


def plain(row: dict[str, Any]) -> dict[str, Any]:
    kept = {name: value for name, value in row.items() if name not in OF_THE_RUN}
    if kept.pop("record", ""):
        # its id is that of its content, the time of making it included
        record = json.loads(row["record"])
        kept["record"] = {name: record[name] for name in ("request", "result", "pose_table", "raw")}
        kept.pop("record_id")
    return kept


def in_loop(job: str, paths: Sequence[Path]) -> list[dict[str, Any]]:
    return [answer(job, path) for path in paths]


def in_pool(job: str, paths: Sequence[Path], workers: int) -> list[dict[str, Any]]:
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        found = pool.map(partial(answer, job), paths, CHUNK)
        # their processor time counts when they have ended
        pool.close()
        pool.join()
    return found


def in_joblib(job: str, paths: Sequence[Path], workers: int) -> list[dict[str, Any]]:
    from joblib import Parallel, delayed
    from joblib.externals.loky import get_reusable_executor

    found = list(Parallel(n_jobs=workers, batch_size=CHUNK)(delayed(answer)(job, path) for path in paths))
    get_reusable_executor().shutdown(wait=True)
    return found


def in_fleet(job: str, paths: Sequence[Path], workers: int, store: PartStore) -> list[dict[str, Any]]:
    entries = catalogue_of(str(paths[0].parent))
    finished = run(entries, ORDERS[job], store, workers=workers)
    # the process of which all others were copies lives on; its processor time and theirs count when it has ended
    forkserver._forkserver._stop()
    rows = store.read()
    return [plain(rows[finished.keys[str(path)]]) for path in paths]


@dataclass
class Cost:
    """Processor seconds of this process and of those it waited for, and seconds."""

    cpu_s: float = 0.0
    wall_s: float = 0.0


@contextmanager
def measured() -> Iterator[Cost]:
    cost, began, used = Cost(), time.perf_counter(), _used()
    yield cost
    cost.wall_s, cost.cpu_s = time.perf_counter() - began, _used() - used


def _used() -> float:
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in both)


def _workers_of(pid: int) -> list[psutil.Process]:
    """The cluster's processes below one of ours: all are copies of one."""
    found = []
    for child in psutil.Process(pid).children():
        try:
            if "forkserver" in " ".join(child.cmdline()):
                found += child.children()
        except psutil.Error:
            continue
    return found


@contextmanager
def killing(times: int, done: Callable[[], int], total: int, rng: random.Random) -> Iterator[list[int]]:
    """Ends a worker by SIGKILL whenever a further share of the results is there; yields how often it was done."""
    killed: list[int] = []
    ended = threading.Event()

    def watch() -> None:
        while len(killed) < times and not ended.wait(0.3):
            if done() < (len(killed) + rng.random()) * total / (times + 1):
                continue
            if workers := _workers_of(os.getpid()):
                victim = rng.choice(workers)
                os.kill(victim.pid, signal.SIGKILL)
                killed.append(victim.pid)
                # its nanny starts another
                ended.wait(1.0)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield killed
    finally:
        ended.set()
        thread.join()


class PeakMemory:
    """The largest resident set of any worker, MiB, looked at twice a second."""

    def __init__(self) -> None:
        self.mib = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> PeakMemory:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._ended.wait(0.5):
            for worker in _workers_of(os.getpid()):
                try:
                    self.mib = max(self.mib, worker.memory_info().rss / 2**20)
                except psutil.Error:
                    continue


def command_ended(job: str, folder: Path, out: Path, workers: int, ends: int, total: int) -> tuple[int, int]:
    """The command itself, ended by SIGKILL `ends` times; its last run's results computed and found there."""
    own = [sys.executable, "-c", "from highside.cli.main import main; main()", "fleet", job, str(folder)]
    own += ["--out", str(out), "--workers", str(workers), "--json"]
    if job == "diagnose":
        model = folder.parent / "model.toml"
        model.write_text(KNOWN)
        own += ["--model", str(model)]
    for turn in range(ends):
        process = subprocess.Popen(own, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        goal = (turn + 1) * total // (ends + 1)
        while _rows(out) < goal and process.poll() is None:
            time.sleep(0.05)
        process.kill()
        process.wait()
    said = json.loads(subprocess.run(own, capture_output=True, text=True, check=True).stdout)
    return int(said["computed"]), int(said["there_already"])


def _rows(out: Path) -> int:
    """Rows of all parts; a key that stands in two counts twice."""
    import pyarrow.parquet as pq

    paths = (out / "parts").glob("[!.]*.parquet") if (out / "parts").is_dir() else ()
    return sum(pq.read_metadata(path).num_rows for path in paths)


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--job", choices=[*ORDERS], default="diagnose")
    asked.add_argument("--sessions", type=int, default=1000)
    asked.add_argument("--workers", type=int, default=2)
    asked.add_argument("--repeats", type=int, default=5)
    asked.add_argument("--kills", type=int, default=10)
    asked.add_argument("--ends", type=int, default=2)
    asked.add_argument("--seed", type=int, default=1)
    given = asked.parse_args()
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    folder = Path(tempfile.mkdtemp(prefix="highside-fleet-scale-"))
    try:
        _compare(folder, given)
    finally:
        shutil.rmtree(folder)


def _compare(folder: Path, given: argparse.Namespace) -> None:
    job, n, workers = given.job, given.sessions, given.workers
    paths = sessions(folder / "sessions", n, job)
    in_loop(job, paths[:2])
    expected: list[dict[str, Any]] = []
    ways: dict[str, Callable[[Path], list[dict[str, Any]]]] = {
        "loop": lambda _: in_loop(job, paths),
        "multiprocessing pool": lambda _: in_pool(job, paths, workers),
        "joblib (loky)": lambda _: in_joblib(job, paths, workers),
        "fleet": lambda out: in_fleet(job, paths, workers, PartStore(out)),
    }
    shares: dict[str, list[float]] = {name: [] for name in ways}
    loop = Cost()
    for turn in range(given.repeats):
        for name, way in ways.items():
            with PeakMemory() as peak, measured() as cost:
                found = way(folder / f"{name}-{turn}")
            if name == "loop":
                loop, expected = cost, expected or found
            shares[name].append(cost.cpu_s / loop.cpu_s)
            _show(f"{turn + 1}. {name}", cost, loop, found, expected, f"; at most {peak.mib:.0f} MiB a worker")
    assert not any(row["error"] for row in expected), expected[0]["error"]
    print(f"{job}: {n} sessions, {workers} workers; verdicts: {dict(Counter(row['verdict'] for row in expected))}")
    for name, ratios in shares.items():
        said = ", ".join(f"{ratio:.2f}" for ratio in ratios)
        print(f"{name}, CPU of the loop of its turn: {said}; median {np.median(ratios):.2f}", flush=True)
    if given.kills:
        out = folder / "killed"
        with killing(given.kills, lambda: _rows(out), n, random.Random(given.seed)) as killed, measured() as cost:
            found = in_fleet(job, paths, workers, PartStore(out))
        told = f"; {len(killed)} workers killed, {_rows(out)} rows of {len(PartStore(out).read([]))} results"
        _show("fleet, workers killed", cost, loop, found, expected, told)
    if given.ends:
        computed, there = command_ended(job, folder / "sessions", folder / "ended", workers, given.ends, n)
        print(
            f"command killed {given.ends} times: the last run computed {computed} and found {there} there; "
            f"{_rows(folder / 'ended')} rows of {n} sessions"
        )


def _show(
    name: str, cost: Cost, loop: Cost, found: Sequence[object], expected: Sequence[object], more: str = ""
) -> None:
    n = len(expected)
    print(
        f"{name}: {1e3 * cost.cpu_s / n:.1f} ms CPU a session, {cost.cpu_s / loop.cpu_s:.2f} of the loop; "
        f"{cost.wall_s:.0f} s, {cost.wall_s / loop.wall_s:.2f} of the loop; "
        f"{sum(a == b for a, b in zip(found, expected, strict=True))} of {n} equal{more}",
        flush=True,
    )


if __name__ == "__main__":
    main()
