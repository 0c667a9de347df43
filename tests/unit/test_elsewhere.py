"""The desk and the bench without POSIX: what Windows lacks is hidden (`elsewhere.py`), each command does its job."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import elsewhere
import fake_msvcrt
import numpy as np
import pytest

from highside.errors import InputError
from highside.link.base import Chunk, LinkError, LinkReason
from highside.link.tcp_wire import TcpTransport, TcpWire
from highside.recording import files, locks

HERE = Path(__file__).parent
FURTHER = pytest.mark.further
"""a case of a kind of which others stay in every run"""


def run(jobs: Sequence[Sequence[str | Path]], cwd: Path) -> subprocess.CompletedProcess[str]:
    """Jobs of `highside` on such a system, one after the other in one process."""
    code = json.dumps([[str(word) for word in job] for job in jobs])
    return subprocess.run(
        [sys.executable, HERE / "elsewhere.py"], input=code, capture_output=True, text=True, cwd=cwd, timeout=550,
        env=os.environ | {"HIGHSIDE_DEBUG": "1", "XDG_DATA_HOME": str(cwd / "data")},
    )  # fmt: skip


def write(path: Path, **columns: np.ndarray) -> None:
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, "%.6f", ",", header=",".join(columns), comments="")


def config(name: str) -> Path:
    return HERE.parents[1] / "config" / name


def test_what_is_hidden_is_hidden_from_our_modules_alone(tmp_path: Path) -> None:
    # the harness must be able to fail: a module of ours that takes what Windows lacks does not load
    package = tmp_path / "highside"
    package.mkdir()
    (package / "__init__.py").write_text("")
    for n, line in enumerate(("import fcntl", "from os import geteuid", "import signal; signal.SIGHUP")):
        (package / f"m{n}.py").write_text(line)
        code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(HERE)!r}]; import elsewhere; elsewhere.hide()\n"
        done = subprocess.run([sys.executable, "-c", code + f"import highside.m{n}"], capture_output=True, text=True)
        assert done.returncode == 1, line
        assert "No module named 'fcntl'" in done.stderr or "geteuid" in done.stderr or "SIGHUP" in done.stderr
    assert os.geteuid is not None


def test_files_that_are_open_stay_where_they_are(tmp_path: Path) -> None:
    path = tmp_path / "open"
    with path.open("w"):
        assert elsewhere.is_open(path)
    assert not elsewhere.is_open(path)


@pytest.mark.slow
@pytest.mark.timeout(600)
@FURTHER
def test_the_desk_and_the_bench_do_their_jobs(tmp_path: Path) -> None:
    rng, rows = np.random.default_rng(1), 3000
    t, rotor = np.arange(rows) * 0.02, np.arange(rows) * 3.7 % 360.0
    write(
        tmp_path / "turns.csv",
        t_s=t,
        rotor_deg=rotor,
        d_roll_arcmin=9 * np.cos(np.radians(rotor)) + rng.normal(size=rows),
    )
    gyros = {f"g{axis}_dps": rng.normal(0.01, 0.01, rows) for axis in "xyz"}
    write(tmp_path / "still.csv", t_s=t, ax_g=0 * t, ay_g=0.5 + 0 * t, az_g=3**0.5 / 2 + 0 * t, **gyros)
    sets = ["store.directory=cals", "store.sessions=sessions", "plan.poses=6"]
    jobs: list[list[str | Path]] = [
        ["check", config("bench-simulated.toml")],
        ["check", config("highside.toml")],
        ["simulate", config("model-bench.toml"), "-o", "session.csv", "--poses", "poses.csv"],
        ["calibrate", "poses", "session.csv", "-o", "again.csv"],
        ["calibrate", "solve", "poses.csv", "--method", "joint", "--tool", "t", "--store", "store", "-o", "cal.json"],
        ["calibrate", "activate", "cal.json", "--store", "store"],
        ["calibrate", "apply", "cal.json", "session.csv", "-o", "corrected.csv"],
        ["diagnose", "poses.csv", "--model", config("model-known.toml"), "--out", "report"],
        ["import", "session.csv", "-o", "imported.csv", "--yes"],
        ["export", "session.csv", "--to", "parquet"],
        ["effects"],
        ["drift", "still.csv", "--method", "kinematic", "--latitude-deg", "52", "-o", "drift.csv"],
        ["rotation", "fit", "turns.csv", "-o", "comp.json"],
        ["keys", "new", "my.key", "--name", "me"],
        ["keys", "sign", "cal.json", "--key", "my.key"],
        ["calibrate", "bench", "--config", config("bench-simulated.toml"), "--auto", "--plain",
         *(word for one in sets for word in ("--set", one))],
        ["calibrate", "sessions", "--config", config("bench-simulated.toml"), "--set", "store.sessions=sessions"],
    ]  # fmt: skip
    groups = [
        "calibrate", "diagnose", "import", "export", "simulate", "check", "effects", "drift", "rotation", "reproduce",
        "reproduce balance", "calibrate bench", "detect", "predict", "confirm", "decode",
    ]  # fmt: skip
    done = run([*([*name.split(), "--help"] for name in groups), *jobs], tmp_path)
    assert done.returncode == 0, done.stderr[-3000:]
    print("\n".join(line for line in done.stderr.splitlines() if line.startswith("==")))
    assert done.stderr.count("== exit status 0") == len(groups) + len(jobs)
    assert "named" in json.loads((tmp_path / "report" / "diagnosis.json").read_text())["verdict"]
    assert len(list((tmp_path / "cals" / "records").glob("*.json"))) == 1
    assert list(tmp_path.rglob(".*.??????")) == [], "something was left beside a file that was replaced"


@pytest.mark.timeout(600)
def test_every_module_but_those_of_the_service_loads() -> None:
    code = (
        f"import sys, pkgutil, importlib; sys.path.insert(0, {str(HERE)!r}); import elsewhere; elsewhere.hide()\n"
        "import highside\n"
        "names = [found.name for found in pkgutil.walk_packages(highside.__path__, 'highside.')]\n"
        "for name in names:\n"
        "    if not name.startswith('highside.service'): importlib.import_module(name)\n"
        "print(len(names))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=550)
    assert done.returncode == 0, done.stderr[-2000:]
    assert int(done.stdout) > 300


@pytest.mark.parametrize("command", [["run", "--config", "x.toml"], ["demo", "--seconds", "1"]])
def test_the_service_says_that_it_is_for_linux(command: list[str], tmp_path: Path) -> None:
    done = run([command], tmp_path)
    assert done.returncode == 2, done.stderr
    assert "needs Linux" in done.stderr
    assert "Traceback" not in done.stderr


# --- locks and replacing ---------------------------------------------------------------------------------------------


@pytest.fixture
def no_flock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locks, "FLOCK", False)
    monkeypatch.setitem(sys.modules, "msvcrt", fake_msvcrt)


HOLD = """
import os, sys
sys.path.insert(0, {here!r})
import fake_msvcrt
sys.modules["msvcrt"] = fake_msvcrt
from highside.recording import locks
locks.FLOCK = {flock}
descriptor = os.open({path!r}, os.O_RDWR)
locks.lock(descriptor)
print("held", flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("flock", [True, False])
def test_a_lock_keeps_another_process_out_until_that_ends(
    flock: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(locks, "FLOCK", flock)
    monkeypatch.setitem(sys.modules, "msvcrt", fake_msvcrt)
    path = tmp_path / "file"
    path.write_text("what it holds")
    code = HOLD.format(here=str(HERE), path=str(path), flock=flock)
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with path.open("r+b") as file:
            with pytest.raises(BlockingIOError if flock else OSError):
                locks.lock(file.fileno())
            with pytest.raises(OSError, match=r"locked|unavailable"):
                locks.lock(file.fileno(), shared=True)
            # whoever only reads is not held up, and the place in the file is where it was
            assert file.read() == b"what it holds"
            threading.Timer(0.3, other.kill).start()
            began = time.monotonic()
            locks.lock(file.fileno(), wait=True)
            assert time.monotonic() - began > 0.2


def test_a_file_that_another_program_has_open_is_replaced_when_it_is_let_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file.json"
    path.write_text("old")
    monkeypatch.delattr(os, "O_DIRECTORY")
    real, replaced = Path.replace, []

    def replace(self: Path, target: Path) -> Path:
        replaced.append(target)
        if len(replaced) < 4:
            raise PermissionError(13, "Access is denied")
        return real(self, target)

    monkeypatch.setattr(Path, "replace", replace)
    files.write_whole(path, b"new")
    assert path.read_bytes() == b"new"
    assert len(replaced) == 4
    # and one that is never let go leaves the old file, and nothing beside it
    replaced[:] = []
    monkeypatch.setattr(files, "LET_GO_S", 0.1)
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(PermissionError(13, "Access is denied")))
    with pytest.raises(InputError, match=r"cannot be written"):
        files.write_whole(path, b"newer")
    assert path.read_bytes() == b"new"
    assert [found.name for found in tmp_path.iterdir()] == ["file.json"]


# --- the simulated line without pseudo-terminals ---------------------------------------------------------------------


async def test_a_line_over_tcp_carries_all_ends_with_the_plug_and_opens_again() -> None:
    wire = TcpWire()
    wire.write(b"nobody")
    assert wire.unheard == 6
    wire.plug()
    address, got = wire.address, []

    async def heard(count: int) -> bytes:
        async with asyncio.timeout(5):
            while sum(map(len, got)) < count:
                wire.flush()
                await asyncio.sleep(0.005)
        return b"".join(got)

    def take(batch: object) -> None:
        assert isinstance(batch, Chunk)
        got.append(batch.data)

    for _ in range(2):
        transport = TcpTransport(address)
        await transport.open(take)
        async with asyncio.timeout(5):
            while not wire.listened_to:
                await asyncio.sleep(0.005)
        sent = bytes(range(256)) * 800
        got.clear()
        wire.write(sent)
        assert await heard(len(sent)) == sent
        wire.unplug()
        error = await asyncio.wait_for(transport.wait_closed(), 5)
        assert error.reason is LinkReason.END_OF_FILE
        await transport.close()
        with pytest.raises(LinkError, match="nobody listens"):
            await TcpTransport(address).open(take)
        wire.plug()
        assert wire.address == address or wire.address.startswith("socket://127.0.0.1:")
        address = wire.address
    wire.remove()
