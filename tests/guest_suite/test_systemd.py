"""The unit as it is shipped, under a real systemd, with a real broker: the whole life of the service.

The installation that the unit expects is put together in the guest's memory: `/opt/highside` is a virtual environment
around this checkout, and the interpreter (which may live in a home directory that no other user may enter) is mounted
at a place that all may read. The unit itself is not changed; a drop-in shortens the watchdog, so that tests need not
wait for half a minute, and tells the moved interpreter where its own library lies.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import stat
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
UNIT = "highside.service"
PREFIX = Path("/opt/highside")
PYTHON = Path("/opt/highside-python")
PACKAGES = Path("/opt/highside-packages")
SOURCE = Path("/opt/highside-source")
STATE = Path("/var/lib/private/highside")
CONFIG = Path("/etc/highside/highside.toml")
WATCHDOG_S = 6.0
DIRECTORY = (-1, -1)
"""stands for size and time of a directory"""
USER, PASSWORD = "tool", "a pass:word = of its own"

CONFIGURATION = """\
[tool]
id = "bench1"

[link]
kind = "simulated"

[codec]
name = "tool"

[mqtt]
host = "127.0.0.1"
username = "tool"

[pipeline]
output_rate_hz = {rate}

[service]
health_interval_s = 0.5
"""


def run(*command: str, check: bool = True) -> str:
    """Output of a command."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not check or done.returncode == 0, f"{command}: {done.returncode}: {done.stderr}{done.stdout}"
    return done.stdout


def show(name: str) -> str:
    """A property of the unit."""
    return run("systemctl", "show", "--property", name, "--value", UNIT).strip()


def until(what: Callable[[], bool], timeout_s: float, say: str) -> float:
    """Wait for something; returns the seconds it took."""
    begin = time.monotonic()
    while not what():
        assert time.monotonic() - begin < timeout_s, f"{say}: not within {timeout_s} s\n{journal()}"
        time.sleep(0.1)
    return time.monotonic() - begin


def journal(lines: int = 40) -> str:
    """The unit's last words."""
    return run("journalctl", "--no-pager", "-n", str(lines), "-u", UNIT, check=False)


class Broker:
    """A real mosquitto that wants a password, with a subscriber that keeps all it gets."""

    def __init__(self, directory: Path) -> None:
        self.received = directory / "received"
        self._config = directory / "mosquitto.conf"
        passwords = directory / "passwords"
        run("mosquitto_passwd", "-b", "-c", str(passwords), USER, PASSWORD)
        self._config.write_text(
            f"user root\nlistener 1883 127.0.0.1\nallow_anonymous false\npassword_file {passwords}\n"
            # what it has acknowledged it delivers, also after a restart of its own
            f"persistence true\npersistence_location {directory}/\nmax_queued_messages 0\n"
        )
        self._broker: subprocess.Popen[bytes] | None = None
        self._subscriber: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        self._broker = subprocess.Popen(
            ["mosquitto", "-c", str(self._config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(0.5)
        out = self.received.open("ab")
        self._subscriber = subprocess.Popen(
            ["mosquitto_sub", "-c", "-i", "watcher", "-q", "1", "-u", USER, "-P", PASSWORD, "-t", "#", "-F", "%t %p"],
            stdout=out,
        )
        out.close()

    def stop(self) -> None:
        for process in (self._subscriber, self._broker):
            if process is not None:
                process.terminate()
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    # told to end before it is connected, mosquitto_sub goes on trying; the broker holds what it has not
                    # acknowledged, so nothing is lost
                    process.kill()
                    process.wait(10)
        self._broker = self._subscriber = None

    def messages(self, topic: str) -> list[dict[str, object]]:
        """Payloads received so far on a topic below the tool's."""
        found = []
        for line in self.received.read_text().splitlines(keepends=True):
            name, _, payload = line.partition(" ")
            if name == f"highside/bench1/{topic}" and line.endswith("\n"):
                found.append(json.loads(payload))
        return found


@dataclass(frozen=True, slots=True)
class Guest:
    """What the tests share."""

    broker: Broker
    before: dict[str, tuple[int, int]]
    """every file written in the guest before the service first ran"""


def written_files() -> dict[str, tuple[int, int]]:
    """All that has been written in this guest, wherever: the upper layer of its root and its memory file systems."""
    found = {}
    for top in (Path("/run/guest/written"), Path("/run"), Path("/dev/shm")):
        for directory, names, files in os.walk(top):
            if top == Path("/run") and directory == "/run":
                names.remove("guest")
            for name in (*names, *files):
                path = Path(directory) / name
                try:
                    state = path.lstat()
                except FileNotFoundError:
                    continue
                # a directory's times change with its content, which is listed itself
                found[str(path)] = DIRECTORY if stat.S_ISDIR(state.st_mode) else (state.st_size, state.st_mtime_ns)
    return found


def install() -> None:
    """Put the installation together, as the comments of the unit describe it."""
    base = Path(sys.base_prefix)
    interpreter = Path(sys.executable).resolve()
    site = next(Path(place) for place in sys.path if place.endswith("site-packages"))
    for source, place in ((base, PYTHON), (site, PACKAGES), (ROOT / "src", SOURCE)):
        place.mkdir()
        run("mount", "--bind", str(source), str(place))
    packages = PREFIX / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    packages.mkdir(parents=True)
    (packages / "highside.pth").write_text(f"{SOURCE}\n{PACKAGES}\n")
    (PREFIX / "pyvenv.cfg").write_text(f"home = {PYTHON / 'bin'}\ninclude-system-site-packages = false\n")
    (PREFIX / "bin").mkdir()
    (PREFIX / "bin" / "python").symlink_to(PYTHON / interpreter.relative_to(base.resolve()))
    command = PREFIX / "bin" / "highside"
    command.write_text(f"#!{PREFIX}/bin/python\nfrom highside.cli.main import main\nmain()\n")
    command.chmod(0o755)

    CONFIG.parent.mkdir(exist_ok=True)
    (CONFIG.parent / "highside.dbc").write_bytes((ROOT / "config" / "highside.dbc").read_bytes())
    configure(rate=10)
    password = CONFIG.parent / "mqtt-password"
    password.write_text(PASSWORD + "\n")
    password.chmod(0o600)
    unit = Path("/etc/systemd/system") / UNIT
    unit.write_bytes((ROOT / "systemd" / UNIT).read_bytes())
    drop_in = Path(f"/etc/systemd/system/{UNIT}.d/test.conf")
    drop_in.parent.mkdir()
    # an interpreter with a shared library would look for it where it can no longer be reached
    library = f"Environment=LD_LIBRARY_PATH={PYTHON}/lib\n" if any((base / "lib").glob("libpython3.*.so.*")) else ""
    drop_in.write_text(f"[Service]\nWatchdogSec={WATCHDOG_S:g}\nTimeoutAbortSec=3\nRestartSec=0.5\n{library}")
    if not notify_reload():
        (drop_in.parent / "reload.conf").write_bytes((ROOT / "systemd" / "systemd-252.conf").read_bytes())
    run("systemctl", "daemon-reload")


def notify_reload() -> bool:
    """Whether this systemd knows Type=notify-reload."""
    return int(run("systemctl", "--version").split()[1]) >= 253


def synchronise_clock() -> None:
    """Tell this guest's kernel that its clock follows a reference, as an NTP daemon does (adjtimex(2))."""
    set_status_and_errors, pll = 0x0010 | 0x0008 | 0x0004, 1
    timex = struct.pack("@i4xllllI", set_status_and_errors, 0, 0, 1000, 1000, pll).ljust(256, b"\0")
    buffer = ctypes.create_string_buffer(timex, 256)
    assert ctypes.CDLL(None).adjtimex(buffer) >= 0


def configure(rate: int) -> None:
    """Write the service's configuration."""
    CONFIG.write_text(CONFIGURATION.format(rate=rate))


@pytest.fixture(scope="module")
def guest(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guest]:
    """The service installed and started once, the broker running."""
    os.umask(0o022)
    broker = Broker(tmp_path_factory.mktemp("broker"))
    install()
    synchronise_clock()
    broker.start()
    before = written_files()
    begin = time.monotonic()
    done = subprocess.run(["systemctl", "start", UNIT], capture_output=True, text=True, timeout=90, check=False)
    assert done.returncode == 0, f"{done.stderr}\n{journal()}"
    print(f"ready {time.monotonic() - begin:.1f} s after `systemctl start`")
    yield Guest(broker, before)
    run("systemctl", "stop", UNIT, check=False)
    broker.stop()


def restarts() -> int:
    """How often systemd has restarted the service."""
    return int(show("NRestarts"))


def attitudes_flow(broker: Broker) -> None:
    """Wait until new attitudes arrive at the subscriber."""
    before = len(broker.messages("attitude"))
    until(lambda: len(broker.messages("attitude")) > before + 3, 30, "attitudes at the subscriber")


def after_restart(count: int) -> Callable[[], bool]:
    """Whether the service has been restarted `count` times and is ready again."""
    return lambda: restarts() == count and show("ActiveState") == "active"


def test_the_unit_becomes_ready_and_says_how_it_is(guest: Guest) -> None:
    assert show("ActiveState") == "active"
    assert show("SubState") == "running"
    assert restarts() == 0
    until(lambda: show("StatusText") != "", 10, "a status text")
    print(show("StatusText"))


def test_it_publishes_with_the_password_from_its_credential(guest: Guest) -> None:
    # the broker refuses whoever does not know the password, and only root may read the file it comes from
    attitudes_flow(guest.broker)
    last = guest.broker.messages("attitude")[-1]
    assert {"seq", "inc_deg", "inc_std_deg", "tf_deg", "tf_std_deg", "cal_id"} <= last.keys()
    # the service may read the state of the clock, though it may not set it
    assert last["clock_synced"] is True
    pid = show("MainPID")
    status = Path(f"/proc/{pid}/status").read_text()
    assert "Uid:\t0\t" not in status
    assert "CapEff:\t0000000000000000" in status
    assert "Seccomp:\t2" in status
    assert "NoNewPrivs:\t1" in status


def test_its_exposure_is_at_most_two(guest: Guest) -> None:
    verdict = run("systemd-analyze", "security", "--no-pager", UNIT).splitlines()[-1]
    print(verdict)
    assert float(verdict.split(":")[1].split()[0]) <= 2.0


def test_reload_takes_a_good_configuration_and_refuses_a_bad_one(guest: Guest) -> None:
    pid = show("MainPID")
    assert show("Type") == ("notify-reload" if notify_reload() else "notify")
    configure(rate=20)
    run("systemctl", "reload", UNIT)
    until(lambda: guest.broker.messages("health")[-1]["reload"]["count"] == 1, 15, "the reload")  # type: ignore[index]
    # RELOADING was answered by READY: the unit is no longer in between
    until(lambda: show("ActiveState") == "active", 15, "the end of the reload")
    configure(rate=-1)
    run("systemctl", "reload", UNIT)
    until(lambda: "reload refused" in show("StatusText"), 15, "the refusal in the status line")
    until(lambda: show("ActiveState") == "active", 15, "the end of the refused reload")
    until(
        lambda: "output_rate_hz" in str(guest.broker.messages("health")[-1]["reload"]["refused"]),  # type: ignore[index]
        15,
        "the refusal, with the field's name",
    )
    configure(rate=10)
    run("systemctl", "reload", UNIT)
    until(lambda: guest.broker.messages("health")[-1]["reload"]["count"] == 2, 15, "the second reload")  # type: ignore[index]
    assert show("ActiveState") == "active"
    assert show("MainPID") == pid
    assert restarts() == 0


def test_a_reload_moves_the_tool_to_a_can_bus_and_back(guest: Guest) -> None:
    # the unit's restrictions leave CAN open; the process stays the same
    pid = show("MainPID")
    serial = CONFIG.read_text()
    on_can = serial.replace('kind = "simulated"', 'kind = "simulated"\ninterface = "vcan0"')
    CONFIG.write_text(on_can.replace('[codec]\nname = "tool"', '[codec]\nname = "dbc"\ndbc = "highside.dbc"'))
    run("systemctl", "reload", UNIT)
    until(lambda: int(str(link_health(guest)["can_frames"])) > 50, 30, "frames from the bus")
    attitudes_flow(guest.broker)
    CONFIG.write_text(serial)
    run("systemctl", "reload", UNIT)
    until(lambda: link_health(guest)["can_frames"] == 0 and link_health(guest)["state"] == "up", 30, "the serial line")
    attitudes_flow(guest.broker)
    assert show("MainPID") == pid


def link_health(guest: Guest) -> dict[str, object]:
    """The table `link` of the last health message."""
    return guest.broker.messages("health")[-1]["link"]  # type: ignore[return-value]


def test_a_dead_broker_is_no_reason_to_restart(guest: Guest) -> None:
    count, pid = restarts(), show("MainPID")
    guest.broker.stop()
    time.sleep(WATCHDOG_S + 4.0)
    assert show("ActiveState") == "active"
    guest.broker.start()
    attitudes_flow(guest.broker)
    assert restarts() == count
    assert show("MainPID") == pid
    sequence = [int(str(message["seq"])) for message in guest.broker.messages("attitude")]
    assert sorted(set(sequence)) == list(range(min(sequence), max(sequence) + 1)), "messages were lost in the outage"


def test_a_killed_service_is_restarted(guest: Guest) -> None:
    count = restarts()
    run("systemctl", "kill", "--signal", "KILL", "--kill-whom", "main", UNIT)
    took = until(after_restart(count + 1), 60, "the restart after SIGKILL")
    print(f"ready again {took:.1f} s after SIGKILL")
    attitudes_flow(guest.broker)


def test_the_watchdog_ends_a_stopped_process(guest: Guest) -> None:
    count = restarts()
    run("systemctl", "kill", "--signal", "STOP", "--kill-whom", "main", UNIT)
    begin = time.monotonic()
    until(after_restart(count + 1), 60, "the restart by the watchdog")
    assert time.monotonic() - begin > 0.5 * WATCHDOG_S
    assert "watchdog" in journal().lower()
    attitudes_flow(guest.broker)


class HeldThreads:
    """Stops single threads of a process, as a debugger does, while the others run on."""

    SEIZE, INTERRUPT, DETACH, ALL_THREADS = 0x4206, 0x4207, 17, 0x40000000

    def __init__(self, pid: int, threads: list[int]) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self._libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
        self._libc.ptrace.restype = ctypes.c_long
        self.pid, self._threads = pid, threads
        for thread in threads:
            self._call(self.SEIZE, thread)
            self._call(self.INTERRUPT, thread)

    def _call(self, request: int, thread: int) -> None:
        if self._libc.ptrace(request, thread, None, None) != 0:
            raise OSError(ctypes.get_errno(), f"ptrace {request:#x} of {thread}")

    def reap(self) -> None:
        """Take note of threads that have ended: their process cannot end before."""
        for thread in self._threads:
            with contextlib.suppress(ChildProcessError):
                os.waitpid(thread, os.WNOHANG | self.ALL_THREADS)

    def release(self) -> None:
        self.reap()
        for thread in self._threads:
            with contextlib.suppress(OSError):
                self._call(self.DETACH, thread)


def test_the_watchdog_ends_a_pipeline_that_no_longer_moves(guest: Guest) -> None:
    # the process lives and its event loop turns (health goes on), but the threads behind it stand: nothing is kept
    count, pid = restarts(), int(show("MainPID"))
    for _ in range(5):
        workers = [int(task.name) for task in Path(f"/proc/{pid}/task").iterdir() if int(task.name) != pid]
        held = HeldThreads(pid, workers)
        heard = len(guest.broker.messages("health"))
        time.sleep(2.0)
        if len(guest.broker.messages("health")) > heard + 1:
            break
        # a thread was stopped in the moment in which it held the interpreter, and the loop with it: once more
        held.release()
        time.sleep(0.5)
    else:
        pytest.fail("the event loop never ran on without its threads")
    begin = time.monotonic()

    def restarted() -> bool:
        held.reap()
        return restarts() > count and show("ActiveState") == "active"

    until(restarted, 60, "the restart by the watchdog")
    print(f"{len(workers)} threads stopped; back after {time.monotonic() - begin:.1f} s")
    said = journal(400)
    assert "the outbox has committed nothing" in said, said
    attitudes_flow(guest.broker)


def test_it_writes_nothing_outside_its_state_directory(guest: Guest) -> None:
    running = written_files()
    begin = time.monotonic()
    run("systemctl", "stop", UNIT)
    print(f"stopped in {time.monotonic() - begin:.1f} s, result {show('Result')}")
    assert time.monotonic() - begin < 10.0
    assert show("Result") == "success"
    root = "/run/guest/written"
    others = (
        # the state directory, and its public name
        f"{root}/var/lib/private/", f"{root}/var/lib/highside",
        # systemd itself, its journal, the broker, this test
        "/run/systemd/", "/run/credentials/", "/run/log/", f"{root}/var/log/journal/", f"{root}/var/lib/systemd/",
        f"{root}/tmp/pytest-of-root/", f"{root}{CONFIG}",
    )  # fmt: skip
    directories = {"/run/credentials", f"{root}/var/lib/private", f"{root}/var/tmp"}
    strange = []
    for seen in (running, written_files()):
        for path, state in seen.items():
            # the directories that systemd makes for PrivateTmp stay empty
            private_tmp = "/tmp/systemd-private-" in path and state == DIRECTORY
            if guest.before.get(path) != state and not path.startswith(others) and path not in directories:
                strange += [] if private_tmp else [path]
    assert strange == []
    assert any(path.startswith(f"{root}{STATE}/recordings/") for path in running)
