"""A power cut at any moment: what was promised to be on the disk is there, and nothing is half there.

Each test does what the product does on a disk that logs its writes, marks the log where something was promised (a call
returned, a message was counted as committed), and looks at the disk as a power cut would have left it: at every mark
for what was promised, at flushes drawn at random between them for anything half-written.
"""

from __future__ import annotations

import contextlib
import json
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from power_loss import LAST, Cut, LoggedDisk

from highside.bench.journal_file import JournalFile
from highside.bench.session.entries import Noted
from highside.bench.session.journal import read_journal
from highside.bench.setup import header_of
from highside.calibration.record import CalibrationRecord, Environment, SolveRequest, build_record, solve_poses
from highside.config.bench import load_bench
from highside.config.recorder import RecorderSettings
from highside.errors import InputError
from highside.link.base import Chunk
from highside.physics.gravity import gravity_direction
from highside.recording.calibration_store import CalibrationStore, load_active
from highside.recording.files import write_whole
from highside.recording.wire import read_segments
from highside.service.recorder import Recorder
from highside.service.rig.surveys import SurveyLog
from highside.service.rig.toolface import ToolfaceLog

ROOT = Path(__file__).resolve().parents[2]
HIGHSIDE = Path(sys.executable).with_name("highside")
NOW = 1_795_000_000.0

BETWEEN = 6
"""flushes looked at beside the marks, drawn with a fixed seed"""


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[LoggedDisk]:
    images = Path("/dev/shm") / tmp_path.name
    images.mkdir()
    made = LoggedDisk(images, tmp_path / "disk")
    yield made
    for path in images.iterdir():
        path.unlink()
    images.rmdir()


def check(disk: LoggedDisk, tmp_path: Path, look: Callable[[Cut, Path], None]) -> None:
    """Cut the power at every mark and at some flushes between them."""
    disk.unmount()
    cuts = [cut for cut in disk.cuts() if cut.mark is not None and cut.mark != LAST]
    marks = [cut for cut in cuts if cut.is_mark]
    others = [cut for cut in cuts if not cut.is_mark]
    chosen = marks + random.Random(1).sample(others, min(BETWEEN, len(others)))
    looked = 0
    with disk.after(chosen, tmp_path / "after") as states:
        for cut, place in states:
            look(cut, place)
            looked += 1
    assert looked == len(chosen) >= 3


def number_of(cut: Cut) -> int:
    """The number in the name of the last mark; 0 before the first."""
    word = (cut.mark or "").rpartition("-")[2]
    return int(word) if word.isdigit() else 0


def until(what: Callable[[], bool], timeout_s: float, say: str) -> None:
    """Wait for something."""
    end = time.monotonic() + timeout_s
    while not what():
        assert time.monotonic() < end, f"{say}: not within {timeout_s} s"
        time.sleep(0.05)


def test_the_disk_forgets_what_was_not_synced(disk: LoggedDisk, tmp_path: Path) -> None:
    """The instrument itself: without fsync a file is not there, with it it is."""
    (disk.place / "not-synced").write_bytes(b"x" * 5000)
    disk.mark("done-1")
    lost: list[bool] = []

    def look(cut: Cut, place: Path) -> None:
        if cut.is_mark and cut.mark == "done-1":
            lost.append(not (place / "not-synced").exists())

    write_whole(disk.place / "synced", b"y" * 5000)
    disk.mark("done-2")
    check(disk, tmp_path, look)
    assert lost == [True]


def test_a_file_written_whole_is_the_old_or_the_new_one(disk: LoggedDisk, tmp_path: Path) -> None:
    path = disk.place / "file"
    for number in range(1, 9):
        write_whole(path, f"{number:08d}".encode() * 1000)
        disk.mark(f"done-{number}")

    def look(cut: Cut, place: Path) -> None:
        done = number_of(cut)
        if not (place / "file").exists():
            assert done == 0
            return
        data = (place / "file").read_bytes()
        assert data == data[:8] * 1000
        assert int(data[:8]) >= done
        assert not cut.is_mark or int(data[:8]) == done

    check(disk, tmp_path, look)


def test_the_calibration_in_force_stays_in_force(disk: LoggedDisk, tmp_path: Path) -> None:
    records = [_record(seed) for seed in range(4)]
    store = CalibrationStore(disk.place / "store")
    for number, record in enumerate(records, 1):
        store.activate(record, now_s=record.created_s)
        disk.mark(f"active-{number}")

    def look(cut: Cut, place: Path) -> None:
        done, kept = number_of(cut), CalibrationStore(place / "store")
        if done == 0 and not (place / "store").exists():
            return
        found = kept.active_id("tool")
        expected = [record.id for record in records[max(done - 1, 0) : done if cut.is_mark else done + 1]]
        assert found in expected or (done == 0 and found is None)
        for name in kept.ids():
            kept.get(name)  # whole, or a RecordError
        if found is not None:
            load_active(place / "store", tool_id="tool")

    check(disk, tmp_path, look)


def test_a_session_loses_no_pose(disk: LoggedDisk, tmp_path: Path) -> None:
    settings = load_bench(ROOT / "config" / "bench-simulated.toml")
    header = header_of(settings, "tool_20261121T120000Z", NOW, "operator")
    journal = JournalFile.create(disk.place / "sessions", header)
    disk.mark("written-0")
    for number in range(1, 11):
        journal.write(Noted("pose", f"{number} {'x' * 700}"), NOW + number)
        disk.mark(f"written-{number}")
    journal.close()

    def look(cut: Cut, place: Path) -> None:
        path = place / "sessions" / journal.path.name
        if cut.mark == "mounted" and not (path.exists() and path.stat().st_size):
            return
        read = read_journal(path.read_bytes(), where=str(path))
        assert len(read.entries) >= number_of(cut)
        reopened, again = JournalFile.reopen(path)
        reopened.close()
        assert len(again.entries) == len(read.entries)

    check(disk, tmp_path, look)


def test_a_toolface_offset_that_was_confirmed_stays(disk: LoggedDisk, tmp_path: Path) -> None:
    log = ToolfaceLog(disk.place / "state")
    for number in range(1, 9):
        log.set(float(number), "driller", NOW + number)
        disk.mark(f"set-{number}")

    def look(cut: Cut, place: Path) -> None:
        current = ToolfaceLog(place / "state").current()
        value = 0 if current is None else round(current.offset_deg)
        assert value in ((number_of(cut),) if cut.is_mark else (number_of(cut), number_of(cut) + 1))

    check(disk, tmp_path, look)


def test_a_survey_that_was_kept_stays(disk: LoggedDisk, tmp_path: Path) -> None:
    log = SurveyLog(disk.place / "surveys.jsonl")
    log.start()
    for number in range(1, 9):
        log.keep({"number": number, "text": "x" * 900})
        until(lambda number=number: log.kept == number, 10.0, "the survey is kept")
        disk.mark(f"kept-{number}")
    log.stop(5.0)

    def look(cut: Cut, place: Path) -> None:
        found = [survey["number"] for survey in SurveyLog(place / "surveys.jsonl").recent(100)]
        assert found == list(range(1, len(found) + 1))
        assert len(found) >= number_of(cut)

    check(disk, tmp_path, look)


def test_a_recording_ends_at_most_one_interval_before_the_cut(disk: LoggedDisk, tmp_path: Path) -> None:
    interval_s, slack_s, rate_hz = 0.2, 0.8, 50.0
    settings = RecorderSettings(fsync_interval_s=interval_s, segment_max_bytes=16_384, total_max_bytes=1 << 20)
    recorder = Recorder(settings, disk.place / "recordings", "bench")
    recorder.start()
    handed: list[float] = []
    begin = time.monotonic()
    while time.monotonic() - begin < 6.0:
        number = len(handed)
        recorder.on_batch(Chunk(float(number), NOW + number, number.to_bytes(4, "little") * 32))
        handed.append(time.monotonic())
        if number % 50 == 49:
            due = sum(at < handed[-1] - interval_s - slack_s for at in handed)
            disk.mark(f"due-{due}")
        time.sleep(1.0 / rate_hz)
    assert recorder.stop()
    disk.mark(f"due-{len(handed)}")

    def look(cut: Cut, place: Path) -> None:
        found: list[int] = []
        for path in sorted((place / "recordings").glob("*.hsw")):
            try:
                found += [int.from_bytes(record.data[:4], "little") for record in read_segments(path)]
            except InputError:
                # cut off before its header was synced: the newest file, with nothing in it
                assert path == max((place / "recordings").glob("*.hsw"))
        assert found == list(range(len(found)))
        assert len(found) >= number_of(cut)

    check(disk, tmp_path, look)


def _record(seed: int) -> CalibrationRecord:
    rng = np.random.default_rng(seed)
    inc, tf = np.repeat([5.0, 45.0], 8), np.tile(np.arange(0.0, 360.0, 45.0), 2)
    a = gravity_direction(np.deg2rad(inc), np.deg2rad(tf)) + 1e-5 * rng.standard_normal((3, inc.size))
    columns = {"inc_ref_deg": inc.tolist(), "tf_ref_deg": tf.tolist()}
    columns |= {name: row.tolist() for name, row in zip(("ax", "ay", "az"), a, strict=True)}
    request = SolveRequest("conventional")
    return build_record(
        tool_id="tool", serial=None, request=request, result=solve_poses(columns, request).result,
        pose_columns=columns, raw_sha256="0" * 64, raw_name="poses.csv", environment=Environment(), now_s=NOW,
    )  # fmt: skip


# --- the whole daemon ------------------------------------------------------------------------------------------

CONFIGURATION = """\
[tool]
id = "tool"
[link]
kind = "simulated"
[codec]
name = "tool"
[pipeline]
output_rate_hz = 50
[mqtt]
port = 18840
reconnect_max_s = 0.5
[service]
state_dir = "{state}"
"""
COMMIT_S = 0.05
"""mqtt.outbox.commit_interval_s by default: what a power cut may take of what was not published yet"""
SLOW_S = 1.0
"""allowance for a disk that logs every write in a guest that emulates its processor, on top of the interval"""
PATIENCE_S = 100.0
"""For what must come, but is promised no time here: a broker that listens, attitudes after a start. Outside of a guest
a start has been seen to take 22 s on a machine with a load of 13."""
HEARD = b"heard"
"""The word of a retained message by which a subscriber shows that it is subscribed."""


class _Rig:
    """A broker that comes and goes, and what a subscriber got: lines of (time, topic, payload)."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.config = folder / "mosquitto.conf"
        self.config.write_text("listener 18840 127.0.0.1\nallow_anonymous true\npersistence false\nuser root\n")
        self._number = 0

    @contextlib.contextmanager
    def broker(self) -> Iterator[Callable[[], dict[int, tuple[float, bytes]]]]:
        """Yields what gives all attitudes received so far, by `seq`."""
        self._number += 1
        received = self.folder / f"received-{self._number}"
        running = [subprocess.Popen(["mosquitto", "-c", str(self.config)], stderr=subprocess.DEVNULL)]
        try:
            word = ["mosquitto_pub", "-p", "18840", "-q", "1", "-r", "-t", "heard", "-m", HEARD.decode()]
            until(
                lambda: subprocess.run(word, stderr=subprocess.DEVNULL, check=False).returncode == 0,
                PATIENCE_S, "the broker listens",
            )  # fmt: skip
            topics = ["-t", "highside/tool/attitude", "-t", "heard"]
            with received.open("wb") as out:
                arguments = ["mosquitto_sub", "-p", "18840", "-q", "1", *topics, "-F", "%U %p"]
                running.append(subprocess.Popen(arguments, stdout=out))
            # what the daemon publishes before that would be heard by nobody, and counted as lost
            until(lambda: HEARD in received.read_bytes(), PATIENCE_S, "the subscriber is subscribed")
            yield lambda: self.attitudes(received)
        finally:
            broker, *subscribers = running
            for process in subscribers:
                # not asked to end: mosquitto_sub disconnects in its signal handler and may block itself in it for ever
                process.kill()
                process.wait(PATIENCE_S)
            broker.terminate()
            broker.wait(PATIENCE_S)

    def attitudes(self, received: Path) -> dict[int, tuple[float, bytes]]:
        found = {}
        for line in received.read_bytes().splitlines(keepends=True):
            stamp, _, payload = line.partition(b" ")
            if line.endswith(b"\n") and payload.strip() != HEARD:
                message = json.loads(payload)
                # `historical` is said at the time of sending and is no part of what the message tells
                message.pop("historical", None)
                found[message["seq"]] = (float(stamp), json.dumps(message, sort_keys=True).encode())
        return found

    @contextlib.contextmanager
    def daemon(self, state: Path) -> Iterator[None]:
        config = self.folder / "highside.toml"
        config.write_text(CONFIGURATION.format(state=state))
        with (self.folder / "daemon.log").open("ab") as log:
            process = subprocess.Popen([str(HIGHSIDE), "run", "--config", str(config)], stdout=log, stderr=log)
            try:
                yield
            finally:
                assert process.poll() is None, (self.folder / "daemon.log").read_text()
                process.terminate()
                assert process.wait(PATIENCE_S) == 0


@pytest.mark.timeout(1500)
def test_after_a_power_cut_the_daemon_repeats_no_number_and_loses_one_interval(
    disk: LoggedDisk, tmp_path: Path
) -> None:
    """Published before the cut and published after it are together all that was made, and no number says two things."""
    rig = _Rig(tmp_path)
    marks: dict[str, tuple[float, dict[int, tuple[float, bytes]]]] = {}

    def mark(received: dict[int, tuple[float, bytes]]) -> None:
        name = f"t-{len(marks) + 1}"
        now = time.time()
        disk.mark(name)
        marks[name] = (now, received)

    with rig.daemon(disk.place / "state"):
        with rig.broker() as received:
            until(lambda: len(received()) > 50, PATIENCE_S, "attitudes come")
            for _ in range(3):
                time.sleep(1.0)
                mark(received())
        before = received()
        for _ in range(3):  # without a broker
            time.sleep(1.0)
            mark(before)
        with rig.broker() as received:
            until(lambda: len(before.keys() | received().keys()) > max(before) + 150, PATIENCE_S, "the backlog comes")
            made = before | received()
    disk.unmount()

    looked = 0
    cuts = [cut for cut in disk.cuts() if cut.is_mark and cut.mark in marks]
    with disk.after(cuts, tmp_path / "after") as states:
        for cut, place in states:
            at, published = marks[str(cut.mark)]
            with rig.broker() as received, rig.daemon(place / "state"):
                due = {seq for seq in made if json.loads(made[seq][1])["t"] < at - COMMIT_S - SLOW_S}
                until(
                    lambda due=due, p=published: due <= p.keys() | received().keys(),
                    PATIENCE_S,
                    f"{cut}: all that is due",
                )
                until(lambda p=published: max(received(), default=0) > max(p), PATIENCE_S, "live attitudes again")
                again = received()
            for seq in again.keys() & published.keys():
                assert again[seq][1] == published[seq][1], f"{cut}: number {seq} says two things"
            looked += 1
    assert looked == 6
