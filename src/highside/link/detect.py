"""Which port speaks, at which baud rate, in which language: found by listening, scored by frames that pass checks.

At the wrong baud rate a line gives bytes, but no frame with a good CRC and no lines of readable text; so every rate is
listened to for a moment, the bytes are given to every codec that needs no set-up, and what is left is looked at as
text: NMEA 0183 sentences (their checksum decides) or delimited lines (equal numbers of columns). Nothing is sent.
"""

from __future__ import annotations

import re
import select
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

from highside.codec.frame import CanFrame
from highside.codec.registry import CodecTable, detectable
from highside.link.base import LinkError
from highside.link.serial import SerialSettings, open_port
from highside.link.socketcan import SocketCanSettings, interface_problem, open_socket, parse
from highside.printable import one_line

BAUDS = (115200, 921600, 460800, 230400, 57600, 38400, 19200, 9600)
ENOUGH_BYTES = 8192
MIN_FRAMES = 3
MIN_SHARE = 0.2
"""of the bytes must lie in frames with a good CRC; there may be text in between"""
MIN_TEXT_SHARE = 0.8
"""of the bytes must lie in lines of one form; text alone proves less than a checksum"""
ARPHRD_CAN = "280"
SILENT_BAUDS = 2
"""a line that gave no byte at so many rates is silent at all: a wrong rate gives wrong bytes, not none"""

_NMEA = re.compile(rb"[$!]([\x20-\x29\x2b-\x7e]{4,120})\*([0-9A-Fa-f]{2})")
_CELL = re.compile(rb"\s*[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?\s*")


@dataclass(frozen=True, slots=True)
class CodecScore:
    """How well a codec fits some bytes: good frames (or lines), and the share of the bytes that they make up."""

    codec: str
    frames: int
    share: float
    detail: str = ""

    @property
    def valid(self) -> bool:
        needed = MIN_TEXT_SHARE if self.codec == "delimited" else MIN_SHARE
        return self.frames >= MIN_FRAMES and self.share >= needed


@dataclass(frozen=True, slots=True)
class PortFinding:
    """What was found on a port. `codec` is None where nothing fits; `note` says what was found instead."""

    port: str
    kind: str
    """ "serial" or "socketcan": the link's `kind`"""
    baud: int | None = None
    codec: str | None = None
    frames: int = 0
    bytes: int = 0
    share: float = 0.0
    note: str = ""

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


def score_bytes(data: bytes) -> list[CodecScore]:
    """All codecs that need no set-up, the best first."""
    scores = []
    for name, table in detectable("bytes").items():
        codec: Any = table.model_validate({"name": name}).build()
        try:
            codec.receive(data)
            codec.flush()
        except Exception as error:
            # another package's decoder: what it fails on is not its language, and the others are still to be tried
            scores.append(CodecScore(name, 0, 0.0, f"failed: {type(error).__name__}: {one_line(str(error))}"))
            continue
        counts = codec.counts
        # a frame cut off at the end is no fault of the codec
        share = counts.bytes_framed / max(len(data), 1)
        text = f", {counts.bytes_text} bytes of text between" if counts.bytes_text else ""
        scores.append(CodecScore(name, counts.frames_good, share, f"{counts.frames_bad} bad{text}"))
    scores.append(_score_text(data))
    return sorted(scores, key=lambda score: (score.valid, score.share, score.frames), reverse=True)


def _score_text(data: bytes) -> CodecScore:
    """Delimited lines or NMEA sentences; the first and the last line may be cut off and do not count."""
    lines = [line.rstrip(b"\r") for line in data.split(b"\n")[1:-1]]
    whole = max(sum(len(line) + 1 for line in lines), 1)
    sentences = [
        match for line in lines if (match := _NMEA.fullmatch(line)) and reduce(xor, match[1]) == int(match[2], 16)
    ]
    if len(sentences) >= MIN_FRAMES:
        kinds = Counter(match[1].split(b",")[0].decode("ascii") for match in sentences)
        detail = "NMEA sentences " + ", ".join(f"${kind}" for kind, _ in kinds.most_common(4))
        return CodecScore("delimited", len(sentences), sum(len(match[0]) + 2 for match in sentences) / whole, detail)
    best = CodecScore("delimited", 0, 0.0)
    for delimiter in (b",", b";", b"\t", b" "):
        cut = [line.split(delimiter) for line in lines]
        # a reading has several cells, most of them numbers
        cut = [cells for cells in cut if sum(bool(_CELL.fullmatch(cell)) for cell in cells) >= max(2, 0.6 * len(cells))]
        columns = Counter(len(cells) for cells in cut).most_common(1)
        if not columns:
            continue
        (width, frames) = columns[0]
        share = sum(len(delimiter.join(cells)) + 1 for cells in cut if len(cells) == width) / whole
        if share > best.share:
            name = {b",": "commas", b";": "semicolons", b"\t": "tabs", b" ": "blanks"}[delimiter]
            best = CodecScore("delimited", frames, min(share, 1.0), f"lines of {width} columns between {name}")
    return best


def serial_ports() -> list[str]:
    """The serial ports of this machine, each by its by-id link where it has one."""
    from serial.tools import list_ports

    links: dict[str, str] = {}
    by_id = Path("/dev/serial/by-id")
    if by_id.is_dir():
        links = {str(link.resolve()): str(link) for link in sorted(by_id.iterdir())}
    return sorted({links.get(str(Path(port.device).resolve()), port.device) for port in list_ports.comports()})


def can_interfaces() -> list[str]:
    """The CAN interfaces of this machine, up or not."""
    found = []
    for directory in sorted(Path("/sys/class/net").glob("*")):
        try:
            if (directory / "type").read_text().strip() == ARPHRD_CAN:
                found.append(directory.name)
        except OSError:
            continue
    return found


def probe_serial(port: str, bauds: Sequence[int] = BAUDS, listen_s: float = 1.0) -> PortFinding:
    """Listen on a port at each rate until one gives valid frames; blocking. Never raises for a port's sake."""
    try:
        line = open_port(SerialSettings(port=port, baud=bauds[0]))
    except LinkError as error:
        return PortFinding(port, "serial", note=error.message)
    best = PortFinding(port, "serial")
    received = silent = 0
    try:
        for baud in bauds:
            line.baudrate = baud
            line.reset_input_buffer()
            data = _listen(line, listen_s)
            received += len(data)
            silent = 0 if data else silent + 1
            score = score_bytes(data)[0]
            if score.valid:  # no other rate can give valid frames too
                best = PortFinding(
                    port, "serial", baud, score.codec, score.frames, len(data), round(score.share, 4), score.detail
                )
                break
            if received == 0 and silent >= SILENT_BAUDS:
                break
    except (OSError, ValueError, TypeError) as fault:
        return PortFinding(port, "serial", note=f"cannot be read: {' '.join(str(fault).split())}")
    finally:
        line.close()
    if best.codec is None:
        note = f"{received} bytes, no valid frame at any rate" if received else "open, but silent"
        return PortFinding(port, "serial", bytes=received, note=note)
    return best


def _listen(line: object, listen_s: float) -> bytes:
    data = bytearray()
    end = time.monotonic() + listen_s
    while len(data) < ENOUGH_BYTES and time.monotonic() < end:
        data += line.read(max(1, line.in_waiting))  # type: ignore[attr-defined]
    return bytes(data)


def probe_can(interface: str, tables: Sequence[CodecTable], listen_s: float = 1.0) -> PortFinding:
    """Listen on a CAN interface, and try these codecs on what is received; blocking."""
    try:
        problem = interface_problem(interface)
        if problem is not None:
            raise problem
        raw = open_socket(SocketCanSettings(interface=interface))
    except LinkError as error:
        return PortFinding(interface, "socketcan", note=error.message)
    frames: list[CanFrame] = []
    end = time.monotonic() + listen_s
    try:
        while (left := end - time.monotonic()) > 0.0 and len(frames) < ENOUGH_BYTES:
            if select.select([raw], [], [], left)[0]:
                frame = parse(raw.recv(72), time.monotonic(), time.time())
                if frame is not None and not frame.error:
                    frames.append(frame)
    except OSError as fault:
        return PortFinding(interface, "socketcan", note=f"cannot be read: {fault.strerror}")
    finally:
        raw.close()
    size = sum(len(frame.data) for frame in frames)
    ids = Counter(frame.can_id for frame in frames)
    ids_text = ", ".join(f"0x{can_id:03x}" for can_id, _ in ids.most_common(5))
    fits = []
    for table in tables:
        codec: Any = table.build()
        readings = len(codec.receive_can(frames))
        if readings >= MIN_FRAMES:
            share = round(codec.counts.bytes_framed / size, 4)
            note = "the tool's own messages" if table.speaks_as_the_tool else ""
            fits.append(PortFinding(interface, "socketcan", None, table.name, readings, size, share, note))
    if fits:
        return max(fits, key=lambda found: found.share)
    note = (
        f"{len(frames)} frames of {len(ids)} identifiers ({ids_text}): needs the maker's DBC file"
        if frames
        else "up, but silent"
    )
    return PortFinding(interface, "socketcan", bytes=size, note=note)
