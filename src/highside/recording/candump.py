"""CAN frames as `candump -L` text, the form that every CAN tool on Linux reads and writes.

    (1436509052.249713) can0 044#2A366C2B        standard identifier: three hexadecimal digits
    (1436509052.249713) can0 18FF50E5#0102       extended identifier: eight
    (1436509052.249713) can0 123#R4              remote frame that requests four bytes
    (1436509052.249713) can0 20000088#00...      error frame: eight digits with the error flag 0x20000000
    (1436509052.249713) can0 123##1112233        CAN FD: `##`, a digit of flags, data
Newer versions add ` R` or ` T` (received or sent), which is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from highside.codec.frame import CanFrame
from highside.errors import InputError
from highside.reading import read_bytes

ERROR_FLAG = 0x20000000
_LINE = re.compile(
    rb"\((\d{1,12}\.\d{1,9})\) (\S{1,32}) ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    rb"(?:(R)[0-9A-Fa-f]?|#([0-9A-Fa-f])((?:[0-9A-Fa-f]{2}){0,64})|((?:[0-9A-Fa-f]{2}){0,8}))(?: [RT])?\s*"
)


def format_candump(frame: CanFrame, channel: str) -> str:
    """One line with its line feed; times to the microsecond, as candump writes them."""
    if frame.error:
        can_id = f"{frame.can_id & 0x1FFFFFFF | ERROR_FLAG:08X}"
    else:
        can_id = f"{frame.can_id:08X}" if frame.extended else f"{frame.can_id:03X}"
    if frame.remote:
        content = "#R"
    elif frame.fd:
        content = f"##0{frame.data.hex().upper()}"
    else:
        content = f"#{frame.data.hex().upper()}"
    return f"({frame.t_wall:017.6f}) {channel} {can_id}{content}\n"


def parse_candump(line: bytes) -> CanFrame | None:
    """A frame of one line, or None if the line is none. `t_mono` is the line's own time too: there is no other."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    t = float(match[1])
    can_id = int(match[3], 16)
    extended = len(match[3]) == 8
    error = extended and bool(can_id & ERROR_FLAG)
    if error:
        can_id &= 0x1FFFFFFF
    fd = match[5] is not None
    data = bytes.fromhex((match[6] if fd else match[7] or b"").decode("ascii"))
    return CanFrame(t, t, can_id, data, extended and not error, error, match[4] is not None, fd)


def looks_like_candump(start: bytes) -> bool:
    """Whether the first line of a file's first bytes is a candump line."""
    return _LINE.fullmatch(start.split(b"\n", 1)[0]) is not None


class CandumpReader:
    """Iterates the frames of a file (plain or gzipped).

    A last line without its line feed is torn: it may lack digits and is not used. `torn_bytes` and `bad_lines`
    (lines in between that are no candump lines) are known after the last frame. `channel` takes one interface only.
    """

    def __init__(self, path: Path, channel: str | None = None) -> None:
        self.path = path
        self.channel = channel
        self.torn_bytes = 0
        self.bad_lines = 0
        self._text = read_bytes(path)
        if not looks_like_candump(self._text):
            raise InputError("is not candump -L text", where=f"{path}: line 1")

    def __iter__(self) -> Iterator[CanFrame]:
        self.torn_bytes = self.bad_lines = 0
        *lines, tail = self._text.split(b"\n")
        self.torn_bytes = len(tail)
        wanted = None if self.channel is None else self.channel.encode()
        for line in lines:
            frame = parse_candump(line)
            if frame is None:
                self.bad_lines += bool(line.strip())
            elif wanted is None or line.split(b" ", 2)[1] == wanted:
                yield frame


def read_candump(path: Path, channel: str | None = None) -> CandumpReader:
    """Open a candump file; raises InputError if it is none."""
    return CandumpReader(path, channel)
