"""Wire recordings: segments that survive a kill, candump text."""

from __future__ import annotations

import gzip
import random
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.codec.frame import CanFrame
from highside.errors import InputError
from highside.recording.candump import format_candump, parse_candump, read_candump
from highside.recording.wire import (
    Record,
    WireKind,
    detect_kind,
    encode_header,
    encode_record,
    read_segments,
)
from tests.segments import SegmentWriter

META = {"tool": "t1", "codec": "tool"}


def some_records(n: int = 20) -> list[Record]:
    rng = random.Random(4)
    return [Record(100 + i * 0.01, 1.7e9 + i * 0.01, rng.randbytes(rng.randrange(0, 200))) for i in range(n)]


def test_records_come_back_with_their_times_plain_and_zipped(tmp_path: Path) -> None:
    path = tmp_path / "a.hsw"
    writer = SegmentWriter(path, META)
    grown = sum(writer.append(r.data, t_wall=r.t_wall, t_mono=r.t_mono) for r in some_records())
    writer.sync()
    writer.close()
    assert path.stat().st_size == grown + len(encode_header(META))
    zipped = tmp_path / "a.hsw.gz"
    zipped.write_bytes(gzip.compress(path.read_bytes()))
    for file in (path, zipped):
        reader = read_segments(file)
        assert reader.meta == META
        assert list(reader) == some_records()
        assert list(reader) == some_records()
        assert reader.torn_bytes == 0
        assert detect_kind(file) is WireKind.SEGMENTS
    with pytest.raises(FileExistsError):
        SegmentWriter(path, META)


def test_a_file_torn_at_any_byte_is_read_to_its_last_complete_record(tmp_path: Path) -> None:
    path = tmp_path / "a.hsw"
    head = encode_header(META)
    records = some_records(4)
    pieces = [encode_record(r) for r in records]
    whole = head + b"".join(pieces)
    for size in range(len(whole) + 1):
        path.write_bytes(whole[:size])
        if size < len(head):
            with pytest.raises(InputError):
                read_segments(path)
            continue
        complete, at = 0, len(head)
        while complete < len(pieces) and at + len(pieces[complete]) <= size:
            at += len(pieces[complete])
            complete += 1
        reader = read_segments(path)
        assert list(reader) == records[:complete]
        assert reader.torn_bytes == size - at


def test_a_damaged_record_ends_the_reading_and_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.hsw"
    pieces = [encode_record(r) for r in some_records(5)]
    data = bytearray(encode_header(META) + b"".join(pieces))
    at = len(encode_header(META)) + len(pieces[0])
    for byte in range(at, at + len(pieces[1])):
        damaged = bytearray(data)
        damaged[byte] ^= 0x40
        path.write_bytes(damaged)
        reader = read_segments(path)
        assert list(reader) == some_records(1)[:1]
        assert reader.torn_bytes == sum(map(len, pieces[1:]))


def test_a_torn_gzip_file_gives_what_it_holds(tmp_path: Path) -> None:
    path = tmp_path / "a.hsw.gz"
    whole = gzip.compress(encode_header(META) + b"".join(encode_record(r) for r in some_records(200)))
    path.write_bytes(whole[: len(whole) // 2])
    found = list(read_segments(path))
    assert 50 < len(found) < 200
    assert found == some_records(200)[: len(found)]


def test_what_a_killed_process_wrote_is_readable(tmp_path: Path, project_root: Path) -> None:
    path = tmp_path / "a.hsw"
    code = (
        "import sys; from pathlib import Path; from tests.segments import SegmentWriter\n"
        "w = SegmentWriter(Path(sys.argv[1]), {}); i = 0\n"
        "while True:\n"
        "    w.append(b'%08d' % i * 9, t_wall=i, t_mono=i); i += 1\n"
        "    if i == 1000: print('on', flush=True)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, cwd=project_root)
    assert process.stdout is not None
    assert process.stdout.readline() == b"on\n"
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    reader = read_segments(path)
    found = list(reader)
    assert len(found) >= 1000
    assert [r.data for r in found] == [b"%08d" % i * 9 for i in range(len(found))]
    assert reader.torn_bytes < len(encode_record(found[0]))


def test_a_write_that_fails_leaves_the_file_readable_and_later_records_findable(tmp_path: Path) -> None:
    path = tmp_path / "a.hsw"
    writer = SegmentWriter(path, META)
    writer.append(b"before", t_wall=1, t_mono=1)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    old = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 50, before[1]))
    try:
        with pytest.raises(OSError):
            writer.append(bytes(1000), t_wall=2, t_mono=2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, old)
    writer.append(b"after", t_wall=3, t_mono=3)
    writer.close()
    reader = read_segments(path)
    assert [r.data for r in reader] == [b"before", b"after"]
    assert reader.torn_bytes == 0


def test_too_long_a_record_and_a_foreign_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError):
        encode_record((0.0, 0.0, bytes((1 << 24) + 1)))
    path = tmp_path / "x"
    path.write_bytes(b"something else")
    with pytest.raises(InputError, match="is not a wire recording"):
        read_segments(path)
    assert detect_kind(path) is WireKind.RAW
    with pytest.raises(InputError, match="no such file"):
        detect_kind(tmp_path / "none")
    path.write_bytes(b"")
    assert detect_kind(path) is WireKind.RAW


def test_an_empty_recording_says_that_the_service_was_ended_before_any_data(tmp_path: Path) -> None:
    """What a SIGKILL between the making of a file and its first data leaves."""
    path = tmp_path / "a.hsw"
    path.write_bytes(b"")
    assert detect_kind(path) is WireKind.SEGMENTS
    with pytest.raises(InputError, match="is empty: the service was ended before any data came"):
        read_segments(path)


ids = st.integers(0, 0x7FF)
payload = st.binary(max_size=8)
can_frames = (
    st.builds(lambda i, d: (i, d, {}), ids, payload)
    | st.builds(lambda i, d: (i, d, {"extended": True}), st.integers(0, 0x1FFFFFFF), payload)
    | st.builds(lambda i: (i, b"", {"remote": True}), ids)
    | st.builds(lambda i, d: (i, d, {"fd": True}), ids, st.binary(max_size=64))
    | st.builds(lambda i, d: (i, d, {"error": True}), st.integers(0, 0x1FFFFFFF), st.binary(min_size=8, max_size=8))
)


@settings(max_examples=200, deadline=None)
@given(content=can_frames, t_us=st.integers(0, 4_000_000_000_000_000))
def test_every_kind_of_can_frame_survives_candump_text(content: tuple[int, bytes, dict[str, bool]], t_us: int) -> None:
    can_id, data, kind = content
    frame = CanFrame(0.0, t_us / 1e6, can_id, data, **kind)
    line = format_candump(frame, "can0")
    assert line.endswith("\n")
    back = parse_candump(line.encode())
    assert back is not None
    assert back[2:] == frame[2:]
    assert back.t_wall == pytest.approx(frame.t_wall, abs=1e-6)


@pytest.mark.parametrize(
    ("line", "frame"),
    [
        (b"(1436509052.249713) vcan0 044#2A366C2B R\r\n", CanFrame(0, 0, 0x044, bytes.fromhex("2A366C2B"))),
        (b"(1436509052.249713) vcan0 00000044#R8", CanFrame(0, 0, 0x044, b"", True, False, True)),
        (b"(1.5) slcan0 123##3AABB", CanFrame(0, 0, 0x123, b"\xaa\xbb", fd=True)),
        (b"(1.5) can0 20000004#0000000000000000", CanFrame(0, 0, 4, bytes(8), error=True)),
    ],
)
def test_lines_of_other_programs_are_read(line: bytes, frame: CanFrame) -> None:
    back = parse_candump(line)
    assert back is not None
    assert back[2:] == frame[2:]


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=60) | st.text("()0123.#cAR \n", max_size=40).map(str.encode))
def test_other_lines_are_none(line: bytes) -> None:
    frame = parse_candump(line)
    assert frame is None or b"#" in line


def test_a_torn_last_line_is_not_believed_and_bad_lines_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "c.log"
    path.write_bytes(b"(1.0) can0 123#0102\n\0\0\0\n(2.0) can1 123#03\n\n(3.0) can0 123#04")
    reader = read_candump(path)
    assert [f.data for f in reader] == [b"\1\2", b"\3"]
    assert (reader.bad_lines, reader.torn_bytes) == (1, len(b"(3.0) can0 123#04"))
    assert [f.data for f in read_candump(path, "can1")] == [b"\3"]
    assert detect_kind(path) is WireKind.CANDUMP
    path.write_bytes(b"hello\n")
    with pytest.raises(InputError, match="line 1: is not candump"):
        read_candump(path)
