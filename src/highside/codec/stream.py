"""Finding frames in a byte stream that holds other things as well: the part that binary serial codecs share.

The scanner looks for the sync bytes. What starts with them is a *candidate*: its header says how long it is (or is
refused at once), and a complete candidate passes its check or does not. After a good frame the scan goes on behind it,
after a refused one a single byte behind its start, so that no good frame inside a false one is lost. Bytes of refused
candidates are counted bad (as far as no good frame claims them), all others junk or text. Nothing is kept but a
candidate that is not complete, so the memory is bounded by the longest frame, and how the stream is cut into chunks
makes no difference.
"""

from __future__ import annotations

from enum import Enum

from highside.codec.frame import Counts, Frame

MORE = 0
"""`_length`: the header is not complete"""
REFUSED = -1
"""`_length`: no frame of ours begins like this"""


class Packet(Enum):
    """What a complete candidate was: the answer of `_accept`, by which its frame and its bytes are counted."""

    READING = "reading"
    """good, and with it one reading is whole (handed out, or held until its time is known: `Counts.frames_held`)"""
    PART = "part"
    """good, but a reading takes more packets than this one: nothing was handed out"""
    IGNORED = "ignored"
    """good, but nothing of it is used (a status, a quaternion beside the accelerations)"""
    DAMAGED = "damaged"
    """it failed its check, or no reading of ours looks like this; good frames are looked for inside it"""


READING, PART, IGNORED, DAMAGED = Packet
"""the same, for who answers thousands of times a second: a look into an enumeration costs 0.1 us"""


class SyncStream:
    """Base of the codecs for binary frames with sync bytes. A subclass sets the constants and the three hooks."""

    name: str
    extra_columns: tuple[str, ...] = ()
    seq_modulus: int | None = None
    sync: bytes
    header_bytes: int
    max_frame_bytes: int

    def __init__(self) -> None:
        self.counts = Counts()
        self._tail = b""
        self._bad_until = 0

    # hooks

    def _length(self, buffer: bytes, start: int, available: int) -> int:
        """Length in bytes of the candidate at `start`, or MORE, or REFUSED."""
        raise AssertionError("a subclass says how long its frames are")

    def _accept(self, buffer: bytes, start: int, stop: int, t_mono: float, out: list[Frame]) -> Packet:
        """Check the complete candidate and say what it is; a reading that is whole with it goes to `out`."""
        raise AssertionError("a subclass decodes its frames")

    def _pass_by(self, chunk: bytes, out: list[Frame]) -> None:
        """Bytes between frames go by (counted already, unless they are text)."""

    def _is_text(self, chunk: bytes) -> int:
        """How many bytes of `chunk` are readable text that this codec expects between its frames."""
        return 0

    # the verbs of a codec

    def receive(self, data: bytes, t_mono: float = 0.0) -> list[Frame]:
        self.counts.bytes_in += len(data)
        return self._scan(data, t_mono, final=False)

    def flush(self) -> list[Frame]:
        return self._scan(b"", 0.0, final=True)

    def reset(self) -> None:
        self.counts.bytes_junk += len(self._tail)
        self.counts.bytes_pending = 0
        self._tail = b""
        self._bad_until = 0

    def _scan(self, data: bytes, t_mono: float, *, final: bool) -> list[Frame]:
        counts = self.counts
        buffer = self._tail + data if self._tail else bytes(data)
        end = len(buffer)
        sync = self.sync
        out: list[Frame] = []
        pos = 0
        while True:
            start = buffer.find(sync, pos)
            if start < 0:
                start = end if final else end - _begun(buffer, pos, sync)
                complete = False
            else:
                complete = True
            if start > pos:
                self._skip(buffer, pos, start, out)
                pos = start
            if not complete:
                break
            length = self._length(buffer, start, end - start)
            if length > 0 and end - start >= length:
                packet = self._accept(buffer, start, start + length, t_mono, out)
                if packet is READING:
                    counts.frames_good += 1
                    counts.bytes_framed += length
                    pos = start + length
                    continue
                if packet is PART or packet is IGNORED:
                    if packet is PART:
                        counts.frames_part += 1
                        counts.bytes_framed += length
                    else:
                        counts.frames_ignored += 1
                        counts.bytes_ignored += length
                    pos = start + length
                    continue
            elif length != REFUSED:
                if not final:
                    break
                # the input ends inside the candidate: it is no frame, but a good one may lie in what it claimed
                self._skip(buffer, start, start + 1, out)
                pos = start + 1
                continue
            counts.frames_bad += 1
            self._bad_until = max(self._bad_until, start + (length if length > 0 else self.header_bytes))
            self._skip(buffer, start, start + 1, out)
            pos = start + 1
        self._tail = buffer[pos:]
        self._bad_until = max(0, self._bad_until - pos)
        counts.bytes_pending = end - pos
        return out

    def _skip(self, buffer: bytes, start: int, stop: int, out: list[Frame]) -> None:
        """Count the bytes of [start, stop), which belong to no frame."""
        chunk = buffer[start:stop]
        counts = self.counts
        bad = min(stop, self._bad_until) - start
        if bad > 0:
            counts.bytes_bad += bad
        else:
            bad = 0
        if stop - start > bad:
            rest = chunk[bad:] if bad else chunk
            text = self._is_text(rest)
            counts.bytes_text += text
            counts.bytes_junk += len(rest) - text
        self._pass_by(chunk, out)


def _begun(buffer: bytes, pos: int, sync: bytes) -> int:
    """How many bytes at the end of `buffer[pos:]` may be the beginning of `sync`."""
    for size in range(min(len(sync) - 1, len(buffer) - pos), 0, -1):
        if buffer.endswith(sync[:size]):
            return size
    return 0
