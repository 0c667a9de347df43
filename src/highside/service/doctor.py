"""Self-diagnosis: what would keep the service from its work on this machine, and what to do about each.

Each check is a function that yields findings; none changes anything but what it says it tries (the broker's queue is
tried with messages on a topic of its own, which are fetched again). A check that cannot be made says so.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import json
import os
import shutil
import sqlite3
import stat
import subprocess
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

import aiomqtt

from highside.config.links import PythonCanLink, SerialLink, SocketCanLink
from highside.config.rig import WitsSerial
from highside.config.settings import Settings
from highside.errors import HighsideError, Refused
from highside.recording.calibration_store import CalibrationStore, read_record
from highside.service.app import correction_of, state_dir
from highside.service.clock import clock_synced
from highside.service.publisher import broker_client, check_secrets

MIB = 1024 * 1024
EARLIEST_S = 1_767_225_600.0
"""The start of 2026: a clock that shows an earlier time was never set."""
EXPIRES_SOON_S = 30 * 86_400.0
QUIET_S = 1.0
"""The broker has handed out everything when nothing came for so long."""


class Level(StrEnum):
    """How bad."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"
    SKIP = "skip"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the answer."""

    check: str
    level: Level
    found: str
    remedy: str = ""

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


async def examine(settings: Settings, *, queue_messages: int = 1200) -> AsyncIterator[Finding]:
    """All checks, one after the other. `queue_messages` are used to try the broker's queue; 0: not tried."""
    directory = state_dir(settings)
    running = await asyncio.to_thread(_is_running, directory)
    for part in (
        _state_directory(directory, running),
        _disk(settings, directory),
        _outbox(directory),
        _secrets(settings),
        _clock(),
        _calibration(settings),
        _link(settings, running),
        _wits(settings, running),
        _site(settings),
    ):
        for finding in part:
            yield finding
    async for finding in _broker(settings, queue_messages):
        yield finding


# --- the machine ---------------------------------------------------------------------------------------------------


def _is_running(directory: Path) -> bool:
    """Whether a service holds the state directory."""
    try:
        with (directory / "lock").open("r") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                return True
    except OSError:
        pass
    return False


def _state_directory(directory: Path, running: bool) -> Iterator[Finding]:
    name = "state directory"
    if running:
        yield Finding("service", Level.OK, f"a service is running with {directory}")
    else:
        yield Finding("service", Level.SKIP, f"no service is running with {directory}")
    if not directory.exists():
        parent = next((p for p in directory.absolute().parents if p.exists()), Path("/"))
        if os.access(parent, os.W_OK | os.X_OK):
            yield Finding(name, Level.OK, f"{directory} does not exist yet; it can be made")
        else:
            yield Finding(name, Level.FAIL, f"{directory} does not exist and cannot be made by this user",
                          "make it, or give service.state_dir")  # fmt: skip
        return
    if not os.access(directory, os.W_OK | os.X_OK):
        yield Finding(name, Level.FAIL, f"{directory} cannot be written by this user",
                      "run as the user of the service, or change its owner")  # fmt: skip
        return
    foreign = [path.name for path in directory.iterdir() if not os.access(path, os.W_OK)]
    if foreign:
        yield Finding(name, Level.FAIL, f"{directory}: not writable: {', '.join(sorted(foreign)[:5])}",
                      "change their owner to the user of the service")  # fmt: skip
    else:
        yield Finding(name, Level.OK, f"{directory} can be written")


def _disk(settings: Settings, directory: Path) -> Iterator[Finding]:
    where = next((p for p in (directory.absolute(), *directory.absolute().parents) if p.exists()), Path("/"))
    usage = shutil.disk_usage(where)
    needed = settings.mqtt.outbox.max_bytes + (settings.recorder.total_max_bytes if settings.recorder.enabled else 0)
    used = sum(path.stat().st_size for path in directory.rglob("*") if path.is_file()) if directory.exists() else 0
    free, still_needed = usage.free / MIB, max(needed - used, 0) / MIB
    text = f"{free:,.0f} MiB free at {where}; outbox and recordings may still take {still_needed:,.0f} MiB"
    if usage.free < 64 * MIB:
        yield Finding("disk", Level.FAIL, text, "make room: below 64 MiB nothing is safe")
    elif free < still_needed:
        yield Finding("disk", Level.WARN, text, "make room, or lower recorder.total_max_bytes or mqtt.outbox.max_bytes")
    else:
        yield Finding("disk", Level.OK, text)
    inodes = os.statvfs(where)
    if inodes.f_files and inodes.f_favail < 1000:
        yield Finding("disk", Level.WARN, f"only {inodes.f_favail} files can still be made at {where}", "remove files")


def _outbox(directory: Path) -> Iterator[Finding]:
    path = directory / "outbox.sqlite"
    if not path.exists():
        yield Finding("outbox", Level.OK, "empty: no service has run here yet")
        return
    try:
        with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=2.0)) as db:
            state = db.execute("PRAGMA quick_check").fetchone()[0]
            queued, oldest = db.execute("SELECT count(*), min(created_s) FROM outbox").fetchone()
    except sqlite3.Error as error:
        yield Finding("outbox", Level.FAIL, f"{path}: {error}", "the service sets a damaged file aside at its start")
        return
    if state != "ok":
        yield Finding("outbox", Level.FAIL, f"{path}: {state}", "the service sets a damaged file aside at its start")
    elif queued:
        age = (time.time() - oldest) / 3600.0
        level = Level.WARN if age > 1.0 else Level.OK
        yield Finding("outbox", level, f"{queued:,} messages wait for the broker, the oldest {age:.1f} h",
                      "look at the broker below" if level is Level.WARN else "")  # fmt: skip
    else:
        yield Finding("outbox", Level.OK, "sound, nothing waits")


def _secrets(settings: Settings) -> Iterator[Finding]:
    try:
        check_secrets(settings.mqtt)
    except HighsideError as error:
        yield Finding("secrets", Level.FAIL, str(error), "mend the named file")
        return
    tls = settings.mqtt.tls
    secret = [path for path in (settings.mqtt.password_file, tls.key if tls else None) if path is not None]
    exposed = []
    for path in secret:
        with contextlib.suppress(OSError):
            if path.stat().st_mode & stat.S_IROTH:
                exposed.append(str(path))
    if exposed:
        yield Finding("secrets", Level.WARN, f"{', '.join(exposed)} can be read by everybody", "chmod o-r")
    elif (
        settings.mqtt.username is not None
        and settings.mqtt.tls is None
        and settings.mqtt.transport == "tcp"
        and (settings.mqtt.host not in ("127.0.0.1", "::1", "localhost"))
    ):
        yield Finding("secrets", Level.WARN, "the password goes over the network in the clear", "add [mqtt.tls]")
    else:
        yield Finding("secrets", Level.OK, "readable by this user" if secret else "none are needed")


def _clock() -> Iterator[Finding]:
    now = time.time()
    shown = datetime.fromtimestamp(now, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    if now < EARLIEST_S:
        yield Finding("clock", Level.FAIL, f"shows {shown}: it was never set", "set it, and start a time service")
    elif not clock_synced():
        yield Finding("clock", Level.WARN, f"{shown}, not synchronised: messages say clock_synced = false",
                      "start chrony or systemd-timesyncd")  # fmt: skip
    else:
        yield Finding("clock", Level.OK, f"{shown}, synchronised")


# --- calibration and site ------------------------------------------------------------------------------------------


def _calibration(settings: Settings) -> Iterator[Finding]:
    calibration = settings.calibration
    if calibration.record is None and calibration.store is None:
        yield Finding("calibration", Level.WARN, "none: readings pass uncorrected, flagged `uncalibrated`",
                      "give calibration.record or calibration.store")  # fmt: skip
        return
    try:
        correction = correction_of(settings)
        record = (
            read_record(calibration.record)
            if calibration.record is not None
            else CalibrationStore(calibration.store or Path()).active(settings.tool.id)
        )
    except HighsideError as error:
        remedy = "calibrate again, or roll back" if isinstance(error, Refused) else "mend the path"
        yield Finding("calibration", Level.FAIL, str(error), remedy)
        return
    found = f"{correction.cal_id[:12]} of {datetime.fromtimestamp(record.created_s, UTC):%Y-%m-%d}"
    expires = record.expires_s
    if expires is not None and expires - time.time() < EXPIRES_SOON_S:
        days = (expires - time.time()) / 86_400.0
        yield Finding("calibration", Level.WARN, f"{found} expires in {days:.0f} days", "plan a calibration")
    else:
        yield Finding("calibration", Level.OK, f"{found}, valid for tool {settings.tool.id}")


def _site(settings: Settings) -> Iterator[Finding]:
    if settings.site.gravity_mps2 is None:
        yield Finding("site", Level.WARN, "gravity is unknown: Gtotal of surveys is judged with +-1.6 mg of doubt",
                      "give site.gravity_mps2")  # fmt: skip
    else:
        yield Finding("site", Level.OK, f"gravity {settings.site.gravity_mps2} m/s2")


# --- links ---------------------------------------------------------------------------------------------------------


def _link(settings: Settings, running: bool) -> Iterator[Finding]:
    link = settings.link
    if isinstance(link, SerialLink):
        yield from _serial("link", link.port, link.baud, running)
    elif isinstance(link, SocketCanLink):
        yield from _can(link.interface)
    elif isinstance(link, PythonCanLink):
        yield Finding("link", Level.SKIP, f"python-can {link.interface}: only the driver can tell", "highside detect")
    else:
        yield Finding("link", Level.OK, f"{link.kind}: needs no hardware")


def _serial(check: str, port: str, baud: int, running: bool) -> Iterator[Finding]:
    if "://" in port:
        yield Finding(check, Level.SKIP, f"{port}: a network line, tried when the service opens it")
        return
    path = Path(port)
    if not path.exists():
        yield Finding(check, Level.FAIL, f"{port} does not exist", "plug it in; `highside detect` lists the ports")
        return
    if not stat.S_ISCHR(path.stat().st_mode):
        yield Finding(check, Level.FAIL, f"{port} is no serial device", "`highside detect` lists the ports")
        return
    if not os.access(path, os.R_OK | os.W_OK):
        group = _group_of(path)
        yield Finding(check, Level.FAIL, f"{port} may not be opened by this user",
                      f"add the user to group {group}, or run as the user of the service")  # fmt: skip
        return
    if running:
        yield Finding(check, Level.OK, f"{port} exists; the running service holds it")
        return
    import serial

    try:
        serial.Serial(port, baud, timeout=0, exclusive=True).close()
    except (serial.SerialException, ValueError) as error:
        yield Finding(check, Level.FAIL, f"{port} cannot be opened: {error}", "end the program that holds it")
        return
    if port.startswith("/dev/tty") and "USB" in port:
        yield Finding(check, Level.WARN, f"{port} can be opened, but may get another name when plugged in again",
                      "use its name below /dev/serial/by-id")  # fmt: skip
    else:
        yield Finding(check, Level.OK, f"{port} can be opened at {baud} baud")


def _group_of(path: Path) -> str:
    try:
        return path.group()
    except KeyError:
        return str(path.stat().st_gid)


def _can(interface: str) -> Iterator[Finding]:
    try:
        answer = subprocess.run(
            ["ip", "-json", "-details", "-statistics", "link", "show", interface],
            capture_output=True, text=True, timeout=5.0, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        yield Finding("link", Level.SKIP, f"{interface}: `ip` cannot be run ({error})", "install iproute2")
        return
    if answer.returncode:
        yield Finding("link", Level.FAIL, f"{interface}: {answer.stderr.strip() or 'no such interface'}",
                      "plug the adapter in, load its driver")  # fmt: skip
        return
    yield from judge_can(interface, json.loads(answer.stdout)[0])


def judge_can(interface: str, told: dict[str, Any]) -> Iterator[Finding]:
    """What `ip -json -details link show` tells about a CAN interface."""
    if told.get("link_type") != "can":
        yield Finding("link", Level.FAIL, f"{interface} is no CAN interface ({told.get('link_type')})", "name another")
        return
    info = told.get("linkinfo", {})
    data = info.get("info_data", {})
    bitrate = data.get("bittiming", {}).get("bitrate")
    if "UP" not in told.get("flags", []):
        yield Finding("link", Level.FAIL, f"{interface} is down", f"ip link set {interface} up type can bitrate 500000")
        return
    state = data.get("state")
    if state == "BUS-OFF":
        yield Finding("link", Level.FAIL, f"{interface} is bus-off", "check wiring, termination and bit rate; "
                      f"ip link set {interface} type can restart-ms 100")  # fmt: skip
    elif state in ("ERROR-PASSIVE", "ERROR-WARNING"):
        yield Finding("link", Level.WARN, f"{interface} is {state.lower()}", "check termination and bit rate")
    elif info.get("info_kind") == "vcan":
        yield Finding("link", Level.OK, f"{interface} is up (virtual: no bit rate)")
    else:
        rate = f"{bitrate / 1000:g} kbit/s" if bitrate else "unknown bit rate"
        yield Finding("link", Level.OK, f"{interface} is up, {rate}, {state or 'state unknown'}")
    if data and not data.get("restart_ms") and info.get("info_kind") == "can":
        yield Finding("link", Level.WARN, f"{interface} stays off after a bus-off",
                      f"ip link set {interface} type can restart-ms 100")  # fmt: skip


def _wits(settings: Settings, running: bool) -> Iterator[Finding]:
    for table in settings.wits:
        if isinstance(table, WitsSerial):
            yield from _serial("wits", table.port, table.baud, running)
        else:
            yield Finding("wits", Level.SKIP, f"{table.kind} {table.host}:{table.port}: seen in health when running")


# --- the broker ----------------------------------------------------------------------------------------------------


async def _broker(settings: Settings, queue_messages: int) -> AsyncIterator[Finding]:
    mqtt = settings.mqtt
    where = f"{mqtt.host}:{mqtt.port}" if mqtt.transport == "tcp" else mqtt.host
    identifier = f"highside-{settings.tool.id}-doctor"
    topic = mqtt.topic(settings.tool.id, "doctor")
    try:
        began = time.monotonic()
        async with asyncio.timeout(mqtt.connect_timeout_s + 1.0):
            async with await broker_client(mqtt, identifier):
                pass
    except (aiomqtt.MqttError, OSError, TimeoutError, ValueError, HighsideError) as error:
        yield Finding("broker", Level.FAIL, f"{where}: {str(error) or 'no answer'}",
                      "start it, or mend the [mqtt] table; meanwhile messages are kept on disk")  # fmt: skip
        return
    yield Finding("broker", Level.OK, f"{where} answers, {1e3 * (time.monotonic() - began):.0f} ms")
    if not queue_messages:
        yield Finding("broker queue", Level.SKIP, "not tried")
        return
    try:
        async with asyncio.timeout(60.0):
            kept = await _queue_depth(settings, identifier, topic, queue_messages)
    except (aiomqtt.MqttError, OSError, TimeoutError) as error:
        yield Finding("broker queue", Level.WARN, f"could not be tried: {str(error) or 'no answer'}",
                      f"allow this client to publish and subscribe {topic}")  # fmt: skip
        return
    text = f"keeps {kept:,} of {queue_messages:,} messages for a subscriber that is away"
    if kept < queue_messages:
        yield Finding("broker queue", Level.WARN, text, "raise max_queued_messages; config/mosquitto.conf shows how")
    else:
        yield Finding("broker queue", Level.OK, text)


async def _queue_depth(settings: Settings, identifier: str, topic: str, count: int) -> int:
    """How many of `count` messages a subscriber gets that was away when they were published."""
    mqtt = settings.mqtt
    subscriber = f"{identifier}-sub"
    async with await broker_client(mqtt, subscriber, clean_session=False) as client:
        await client.subscribe(topic, qos=1)
    try:
        async with await broker_client(mqtt, identifier) as client:
            for start in range(0, count, 50):
                await asyncio.gather(
                    *(client.publish(topic, str(i), qos=1) for i in range(start, min(start + 50, count)))
                )
        return await _fetch(settings, subscriber, count)
    finally:
        # a clean session forgets the subscription and what is still queued for it
        with contextlib.suppress(aiomqtt.MqttError, OSError, TimeoutError):
            async with await broker_client(mqtt, subscriber, clean_session=True):
                pass


async def _fetch(settings: Settings, subscriber: str, count: int) -> int:
    seen: set[bytes] = set()
    async with await broker_client(settings.mqtt, subscriber, clean_session=False) as client:
        messages = aiter(client.messages)
        with contextlib.suppress(TimeoutError):
            while len(seen) < count:
                message = await asyncio.wait_for(anext(messages), QUIET_S)
                if isinstance(message.payload, bytes):
                    seen.add(message.payload)
    return len(seen)
