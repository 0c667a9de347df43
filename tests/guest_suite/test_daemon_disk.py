"""The daemon on a disk that answers with I/O errors and on one that becomes read-only while it runs."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "faults"), str(ROOT / "tests" / "integration")]

from broker import Mosquitto  # noqa: E402
from daemon import Subscriber, running, wait_for  # noqa: E402
from rig import Tool, configuration  # noqa: E402
from scenarios import health_of  # noqa: E402

from highside.service.demo import factory_record  # noqa: E402

MIB = 1 << 20
ALARM_S = 5.0
"""within which a disk that refuses is an alarm"""
SMALL_FILES = "[recorder]\nsegment_max_bytes = 4096\n"
"""a file that is open may be written to after the file system became read-only: the next one is opened within 2 s"""


def command(*words: object) -> str:
    """A command that must succeed; its output."""
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(map(str, words))}: {done.stderr}{done.stdout}"
    return done.stdout.strip()


class Disk:
    """A disk whose device can be replaced by one that fails every read and write (device mapper, target `error`).

    Without a journal, and told to go on after errors: the disk is whole again as soon as the device is.
    """

    NAME = "unwell"
    SECTORS = 32 * MIB // 512

    def __init__(self, folder: Path) -> None:
        self.place = folder / "disk"
        self.place.mkdir()
        self._image = Path("/dev/shm/unwell.disk")
        with self._image.open("wb") as file:
            file.truncate(self.SECTORS * 512)
        command("modprobe", "-a", "loop", "dm-mod")
        self._loop = command("losetup", "--find", "--show", self._image)
        command("dmsetup", "create", self.NAME, "--noudevsync", "--noudevrules", "--table", self._table(good=True))
        command("dmsetup", "mknodes")
        device = f"/dev/mapper/{self.NAME}"
        command("mkfs.ext4", "-q", "-O", "^has_journal", "-E", "lazy_itable_init=0", device)
        command("mount", "-o", "errors=continue,noatime", device, self.place)

    def _table(self, *, good: bool) -> str:
        return f"0 {self.SECTORS} linear {self._loop} 0" if good else f"0 {self.SECTORS} error"

    def _load(self, *, good: bool) -> None:
        command("dmsetup", "load", self.NAME, "--table", self._table(good=good))
        command("dmsetup", "suspend", "--noflush", "--nolockfs", "--noudevsync", self.NAME)
        command("dmsetup", "resume", "--noudevsync", "--noudevrules", self.NAME)

    def fail(self) -> None:
        self._load(good=False)

    def mend(self) -> None:
        self._load(good=True)

    def read_only(self) -> None:
        """As the kernel does when it no longer trusts a disk: files that are open for writing are no hindrance."""
        Path("/proc/sysrq-trigger").write_text("u")

    def writable(self) -> None:
        command("mount", "-o", "remount,rw", self.place)

    def close(self) -> None:
        command("umount", "--lazy", self.place)
        subprocess.run(["dmsetup", "remove", "--noudevsync", "--force", self.NAME], capture_output=True, check=False)
        subprocess.run(["losetup", "--detach", self._loop], capture_output=True, check=False)
        self._image.unlink()


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    made = Disk(tmp_path)
    yield made
    made.close()


@pytest.mark.parametrize(
    ("harm", "heal"), [(Disk.fail, Disk.mend), (Disk.read_only, Disk.writable)], ids=["I/O error", "read-only"]
)
def test_acquisition_goes_on_the_alarm_comes_and_goes_and_nothing_kept_is_harmed(
    tmp_path: Path, disk: Disk, harm: Callable[[Disk], None], heal: Callable[[Disk], None]
) -> None:
    record = factory_record()
    path, calibration = disk.place / "highside.toml", disk.place / "calibration.json"
    tool = Tool(tmp_path / "tty", 100.0)
    with Mosquitto(tmp_path / "broker") as broker:
        calibration.write_text(record.to_json())
        text = configuration(disk.place, tool, broker.port, rate_hz=10).replace('id = "t"', f'id = "{record.tool_id}"')
        path.write_text(text + f'[calibration]\nrecord = "{calibration}"\n' + SMALL_FILES)
        kept = (path.read_bytes(), calibration.read_bytes())
        # the log is not on the disk that fails
        elsewhere = tmp_path / "highside.toml"
        elsewhere.symlink_to(path)
        subscriber = Subscriber(broker.port)
        with running(elsewhere) as daemon:
            tool.start()
            tool.connect(timeout_s=60.0)  # a start under load took 20 s in a guest
            before = wait_for(
                lambda: (h := health_of(subscriber)) and h["monitor"]["good"] > 50 and h, 60, "data", daemon
            )
            assert before["calibration"]["cal_id"] == record.id
            command("sync")
            harm(disk)
            begun = time.monotonic()
            health = wait_for(
                lambda: (h := health_of(subscriber)) and "recorder_storage" in h["alarms"] and h, 30, "alarm", daemon
            )
            alarm_s = time.monotonic() - begun
            more = wait_for(
                lambda: (h := health_of(subscriber)) and h["monitor"]["good"] > health["monitor"]["good"] + 100 and h,
                20, "frames on the failed disk", daemon,
            )  # fmt: skip
            assert more["pipeline"]["attitudes"] > health["pipeline"]["attitudes"]
            assert more["calibration"]["cal_id"] == record.id
            heal(disk)
            wait_for(
                lambda: (h := health_of(subscriber)) and not {"recorder_storage", "outbox_storage"} & set(h["alarms"]),
                30, "the end of the alarm", daemon,
            )  # fmt: skip
            tool.drain()
            last = wait_for(
                lambda: (h := health_of(subscriber)) and h["monitor"]["good"] == tool.frames and h, 20, "all", daemon
            )
            assert last["monitor"]["gap"] == 0
            assert all(last["balance"].values())
            assert last["recorder"]["balanced"]
            made = last["pipeline"]["attitudes"]
            numbers = wait_for(
                lambda: len(n := {p["seq"] for p in subscriber.payloads("attitude")}) >= made and n, 20, "all", daemon
            )
            assert daemon.terminate(20) == 0, daemon.log
            assert "Traceback" not in daemon.log
        subscriber.close()
    tool.stop()
    print(f"alarm after {alarm_s:.1f} s, {made} attitudes, recorder {last['recorder']}")
    assert alarm_s < ALARM_S
    assert set(range(made)) <= numbers
    assert (path.read_bytes(), calibration.read_bytes()) == kept
