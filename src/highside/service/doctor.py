"""Self-diagnosis: what would keep the service from its work on this machine, and what to do about each.

Each check is a function that yields findings. None changes anything or says anything at the broker, but for the
broker's queue where that was requested (`doctor_broker`). A check that cannot be made says so. Beside a running service
its files are only looked at, and what it says of itself in the retained `health` is read.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import sqlite3
import stat
import subprocess
import time
from collections.abc import AsyncIterator, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from highside.calibration.record import RecordError, RecordReason
from highside.config.links import PythonCanLink, SerialLink, SocketCanLink
from highside.config.rig import WitsSerial
from highside.config.settings import Settings
from highside.errors import HighsideError, InputError
from highside.reading import MALFORMED, parse_json
from highside.recording.locks import lock as take_lock
from highside.service.broker_client import check_secrets
from highside.service.clock import clock_synced
from highside.service.doctor_broker import examine_broker
from highside.service.findings import CheckResult, Level
from highside.service.in_force import configured_calibration
from highside.service.known_time import known_now
from highside.service.outbox_inspect import inspect
from highside.service.places import state_dir

MIB = 1024 * 1024
EARLIEST_S = 1_767_225_600.0
"""The start of 2026: a clock that shows an earlier time was never set."""
EXPIRES_SOON_S = 30 * 86_400.0


async def examine(settings: Settings, *, queue_messages: int = 0) -> AsyncIterator[CheckResult]:
    """All checks, one after the other. `queue_messages` are used to try the broker's queue; 0: not tried."""
    directory = state_dir(settings)
    running = await asyncio.to_thread(_is_running, directory)
    for part in (
        _state_directory(directory, running),
        _disk(settings, directory),
        _outbox(directory, running),
        _secrets(settings),
        _clock(),
        _calibration(settings),
        _link(settings, running),
        _wits(settings, running),
        _site(settings),
    ):
        for finding in part:
            yield finding
    async for finding in examine_broker(settings, running=running, queue_messages=queue_messages):
        yield finding


# --- the machine ---------------------------------------------------------------------------------------------------


def _is_running(directory: Path) -> bool:
    """Whether a service holds the state directory."""
    try:
        with (directory / "lock").open("r") as lock:
            try:
                take_lock(lock.fileno(), shared=True)
            except OSError:
                return True
    except OSError:
        pass
    return False


def _state_directory(directory: Path, running: bool) -> Iterator[CheckResult]:
    name = "state directory"
    if running:
        yield CheckResult("service", Level.OK, f"a service is running with {directory}")
    else:
        yield CheckResult("service", Level.SKIP, f"no service is running with {directory}")
    if not directory.exists():
        parent = next((p for p in directory.absolute().parents if p.exists()), Path("/"))
        if os.access(parent, os.W_OK | os.X_OK):
            yield CheckResult(name, Level.OK, f"{directory} does not exist yet; it can be made")
        else:
            yield CheckResult(
                name,
                Level.FAIL,
                f"{directory} does not exist and cannot be made by this user",
                "make it, or give service.state_dir",
            )
        return
    if not os.access(directory, os.W_OK | os.X_OK):
        yield CheckResult(
            name,
            Level.FAIL,
            f"{directory} cannot be written by this user",
            "run as the user of the service, or change its owner",
        )
        return
    foreign = [path.name for path in directory.iterdir() if not os.access(path, os.W_OK)]
    if foreign:
        yield CheckResult(
            name,
            Level.FAIL,
            f"{directory}: not writable: {', '.join(sorted(foreign)[:5])}",
            "change their owner to the user of the service",
        )
    else:
        yield CheckResult(name, Level.OK, f"{directory} can be written")


def _disk(settings: Settings, directory: Path) -> Iterator[CheckResult]:
    where = next((p for p in (directory.absolute(), *directory.absolute().parents) if p.exists()), Path("/"))
    usage = shutil.disk_usage(where)
    needed = settings.mqtt.outbox.max_bytes + (settings.recorder.total_max_bytes if settings.recorder.enabled else 0)
    used = sum(path.stat().st_size for path in directory.rglob("*") if path.is_file()) if directory.exists() else 0
    free, still_needed = usage.free / MIB, max(needed - used, 0) / MIB
    text = f"{free:,.0f} MiB free at {where}; outbox and recordings may still take {still_needed:,.0f} MiB"
    if usage.free < 64 * MIB:
        yield CheckResult("disk", Level.FAIL, text, "make room: below 64 MiB nothing is safe")
    elif free < still_needed:
        yield CheckResult(
            "disk", Level.WARN, text, "make room, or lower recorder.total_max_bytes or mqtt.outbox.max_bytes"
        )
    else:
        yield CheckResult("disk", Level.OK, text)
    inodes = os.statvfs(where)
    if inodes.f_files and inodes.f_favail < 1000:
        yield CheckResult(
            "disk", Level.WARN, f"only {inodes.f_favail} files can still be made at {where}", "remove files"
        )


def _outbox(directory: Path, running: bool) -> Iterator[CheckResult]:
    path = directory / "outbox.sqlite"
    if not path.exists():
        yield CheckResult("outbox", Level.OK, "empty: no service has run here yet")
        return
    try:
        found = inspect(path)
        if not running:
            with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=2.0)) as db:
                state = db.execute("PRAGMA quick_check").fetchone()[0]
            if state != "ok":
                raise InputError(state, where=str(path), remedy="the service sets a damaged file aside at its start")
    except (sqlite3.Error, InputError) as error:
        remedy = error.remedy if isinstance(error, InputError) else None
        what = f"{path}: {error.what}" if isinstance(error, InputError) else f"{path}: {error}"
        yield CheckResult("outbox", Level.FAIL, what, remedy or "the service sets a damaged file aside at its start")
        return
    whose = "in use by the running service, " if running else "sound, "
    if not found.queued:
        yield CheckResult("outbox", Level.OK, f"{whose}nothing waits")
        return
    # an age that no clock can tell is not one to worry about
    hours = 0.0 if found.oldest_age_s is None else found.oldest_age_s / 3600.0
    old = "" if found.oldest_age_s is None else f", the oldest {hours:.1f} h"
    level = Level.WARN if hours > 1.0 else Level.OK
    yield CheckResult(
        "outbox",
        level,
        f"{whose}{found.queued:,} messages wait for the broker{old}",
        "look at the broker below" if level is Level.WARN else "",
    )


def _secrets(settings: Settings) -> Iterator[CheckResult]:
    try:
        check_secrets(settings.mqtt)
    except HighsideError as error:
        yield CheckResult("secrets", Level.FAIL, str(error), "fix the named file")
        return
    tls = settings.mqtt.tls
    secret = [path for path in (settings.mqtt.password_file, tls.key if tls else None) if path is not None]
    exposed = []
    for path in secret:
        with contextlib.suppress(OSError):
            if path.stat().st_mode & stat.S_IROTH:
                exposed.append(str(path))
    if exposed:
        yield CheckResult("secrets", Level.WARN, f"{', '.join(exposed)} can be read by everybody", "chmod o-r")
    elif (
        settings.mqtt.username is not None
        and settings.mqtt.tls is None
        and settings.mqtt.transport == "tcp"
        and (settings.mqtt.host not in ("127.0.0.1", "::1", "localhost"))
    ):
        yield CheckResult("secrets", Level.WARN, "the password goes over the network in the clear", "add [mqtt.tls]")
    else:
        yield CheckResult("secrets", Level.OK, "readable by this user" if secret else "none are needed")


def _clock() -> Iterator[CheckResult]:
    now = time.time()
    shown = datetime.fromtimestamp(now, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    if now < EARLIEST_S:
        yield CheckResult("clock", Level.FAIL, f"shows {shown}: it was never set", "set it, and start a time service")
    elif not clock_synced():
        yield CheckResult(
            "clock",
            Level.WARN,
            f"{shown}, not synchronised: messages say clock_synced = false",
            "start chrony or systemd-timesyncd",
        )
    else:
        yield CheckResult("clock", Level.OK, f"{shown}, synchronised")


# --- calibration and site ------------------------------------------------------------------------------------------


def _calibration(settings: Settings) -> Iterator[CheckResult]:
    calibration = settings.calibration
    if calibration.record is None and calibration.store is None:
        yield CheckResult(
            "calibration",
            Level.WARN,
            "none: readings pass uncorrected, flagged `uncalibrated`",
            "give calibration.record or calibration.store",
        )
        return
    try:
        present = known_now(settings)
        record = configured_calibration(settings, present).record
    except RecordError as error:
        if error.reason is RecordReason.NONE_ACTIVE:
            yield CheckResult(
                "calibration",
                Level.WARN,
                f"{error.text}: readings pass uncorrected",
                "run `highside calibrate bench` and put its record in force",
            )
            return
        yield CheckResult("calibration", Level.FAIL, str(error), "calibrate again, or roll back")
        return
    except HighsideError as error:
        table = "calibration.record" if calibration.record is not None else "calibration.store"
        yield CheckResult("calibration", Level.FAIL, f"{table}: {error}", f"fix {table}, or calibrate into it")
        return
    if record is None:
        return
    found = f"{record.id[:12]} of {datetime.fromtimestamp(record.created_s, UTC):%Y-%m-%d}"
    expires = record.expires_s
    if expires is not None and not present.known:
        until = f"{datetime.fromtimestamp(expires, UTC):%Y-%m-%d}"
        yield CheckResult(
            "calibration",
            Level.WARN,
            f"{found}: whether it has expired ({until}) cannot be determined",
            "synchronise the clock: until then it is used, flagged `calibration_age_unknown`",
        )
    elif expires is not None and expires - present.wall_s < EXPIRES_SOON_S:
        days = (expires - present.wall_s) / 86_400.0
        yield CheckResult("calibration", Level.WARN, f"{found} expires in {days:.0f} days", "plan a calibration")
    else:
        yield CheckResult("calibration", Level.OK, f"{found}, valid for tool {settings.tool.id}")


def _site(settings: Settings) -> Iterator[CheckResult]:
    local = settings.site.local_gravity()
    if local is None:
        yield CheckResult(
            "site",
            Level.WARN,
            "gravity is unknown: Gtotal of surveys is judged with +-1.6 mg of doubt",
            "give site.gravity_mps2, or site.latitude_deg and site.height_m",
        )
    else:
        yield CheckResult("site", Level.OK, f"gravity {local[0]:.6g} +- {local[1]:.1g} m/s2")


# --- links ---------------------------------------------------------------------------------------------------------


def _link(settings: Settings, running: bool) -> Iterator[CheckResult]:
    link = settings.link
    if isinstance(link, SerialLink):
        yield from _serial("link", link.port, link.baud, running)
    elif isinstance(link, SocketCanLink):
        yield from _can(link.interface)
    elif isinstance(link, PythonCanLink):
        yield CheckResult(
            "link", Level.SKIP, f"python-can {link.interface}: only the driver can tell", "highside detect"
        )
    else:
        yield CheckResult("link", Level.OK, f"{link.kind}: needs no hardware")


def _serial(check: str, port: str, baud: int, running: bool) -> Iterator[CheckResult]:
    if "://" in port:
        yield CheckResult(check, Level.SKIP, f"{port}: a network line, tried when the service opens it")
        return
    path = Path(port)
    if not path.exists():
        yield CheckResult(check, Level.FAIL, f"{port} does not exist", "plug it in; `highside detect` lists the ports")
        return
    if not stat.S_ISCHR(path.stat().st_mode):
        yield CheckResult(check, Level.FAIL, f"{port} is no serial device", "`highside detect` lists the ports")
        return
    if not os.access(path, os.R_OK | os.W_OK):
        group = _group_of(path)
        yield CheckResult(
            check,
            Level.FAIL,
            f"{port} may not be opened by this user",
            f"add the user to group {group}, or run as the user of the service",
        )
        return
    if running:
        yield CheckResult(check, Level.OK, f"{port} exists; the running service holds it")
        return
    import serial

    try:
        serial.Serial(port, baud, timeout=0, exclusive=True).close()
    except (serial.SerialException, ValueError) as error:
        yield CheckResult(check, Level.FAIL, f"{port} cannot be opened: {error}", "end the program that holds it")
        return
    if port.startswith("/dev/tty") and "USB" in port:
        yield CheckResult(
            check,
            Level.WARN,
            f"{port} can be opened, but may get another name when plugged in again",
            "use its name below /dev/serial/by-id",
        )
    else:
        yield CheckResult(check, Level.OK, f"{port} can be opened at {baud} baud")


def _group_of(path: Path) -> str:
    try:
        return path.group()
    except KeyError:
        return str(path.stat().st_gid)


def _can(interface: str) -> Iterator[CheckResult]:
    try:
        answer = subprocess.run(
            ["ip", "-json", "-details", "-statistics", "link", "show", interface],
            capture_output=True,
            text=True,
            timeout=5.0,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        yield CheckResult("link", Level.SKIP, f"{interface}: `ip` cannot be run ({error})", "install iproute2")
        return
    if answer.returncode:
        yield CheckResult(
            "link",
            Level.FAIL,
            f"{interface}: {answer.stderr.strip() or 'no such interface'}",
            "plug the adapter in, load its driver",
        )
        return
    try:
        details = parse_json(answer.stdout)[0]
    except (*MALFORMED, HighsideError) as error:
        yield CheckResult(
            "link", Level.SKIP, f"{interface}: `ip` answers otherwise than expected ({error})", "update iproute2"
        )
        return
    yield from judge_can(interface, details)


def judge_can(interface: str, details: dict[str, Any]) -> Iterator[CheckResult]:
    """What `ip -json -details link show` tells about a CAN interface."""
    if details.get("link_type") != "can":
        yield CheckResult(
            "link", Level.FAIL, f"{interface} is no CAN interface ({details.get('link_type')})", "name another"
        )
        return
    info = details.get("linkinfo", {})
    data = info.get("info_data", {})
    bitrate = data.get("bittiming", {}).get("bitrate")
    if "UP" not in details.get("flags", []):
        yield CheckResult(
            "link", Level.FAIL, f"{interface} is down", f"ip link set {interface} up type can bitrate 500000"
        )
        return
    state = data.get("state")
    if state == "BUS-OFF":
        yield CheckResult(
            "link",
            Level.FAIL,
            f"{interface} is bus-off",
            f"check wiring, termination and bit rate; ip link set {interface} type can restart-ms 100",
        )
    elif state in ("ERROR-PASSIVE", "ERROR-WARNING"):
        yield CheckResult("link", Level.WARN, f"{interface} is {state.lower()}", "check termination and bit rate")
    elif info.get("info_kind") == "vcan":
        yield CheckResult("link", Level.OK, f"{interface} is up (virtual: no bit rate)")
    else:
        rate = f"{bitrate / 1000:g} kbit/s" if bitrate else "unknown bit rate"
        yield CheckResult("link", Level.OK, f"{interface} is up, {rate}, {state or 'state unknown'}")
    if data and not data.get("restart_ms") and info.get("info_kind") == "can":
        yield CheckResult(
            "link",
            Level.WARN,
            f"{interface} stays off after a bus-off",
            f"ip link set {interface} type can restart-ms 100",
        )


def _wits(settings: Settings, running: bool) -> Iterator[CheckResult]:
    for table in settings.wits:
        if isinstance(table, WitsSerial):
            yield from _serial("wits", table.port, table.baud, running)
        else:
            yield CheckResult(
                "wits", Level.SKIP, f"{table.kind} {table.host}:{table.port}: seen in health when running"
            )
