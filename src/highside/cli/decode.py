"""`highside decode`: a recording of the wire becomes a Recording that the other commands read.

The time of a row is the device's own. A wire whose frames carry no time at all is given the times of arrival, in
seconds from the start of the file, where the recording has them (segments, candump); raw bytes have none. Where only
some frames lack the device's time (the line with it was damaged), their rows are omitted and counted: a time is never
made up, and two clocks are never mixed.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.say import echo, echo_json, report_omitted

if TYPE_CHECKING:
    from highside.codec.frame import ByteCodec, CanCodec, Counts, Frame
    from highside.codec.registry import CodecTable
    from highside.recording.table import Recording

_CHUNK_BYTES = 1 << 16
_FRAMES_AT_ONCE = 4096


@dataclass(slots=True)
class _Decoded:
    """All frames of a file, the times at which they came (empty for raw bytes), what could not be read."""

    kind: str
    frames: list[Frame] = field(default_factory=list)
    arrivals: list[float] = field(default_factory=list)
    unreadable: str | None = None
    torn_bytes: int = 0
    bad_lines: int = 0


def decode(
    file: Annotated[Path, typer.Argument(help="Raw bytes, highside's segments or candump -L text; plain or .gz.")],
    codec: Annotated[str, typer.Option("--codec", help="tool, vn100, delimited, dbc or an installed one.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The Recording to write; .gz zips it.")],
    config: Annotated[Path | None, typer.Option("--config", help="TOML file with a [codec] table.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the counts as one JSON object.")] = False,
) -> None:
    """Turn a recording of the wire into a Recording (CSV); the counts go to stderr."""
    from highside.codec.registry import faults
    from highside.config.codecs import codec_from_file, codec_from_name
    from highside.errors import Refused
    from highside.recording.table import from_frames, write_recording

    settings = codec_from_name(codec) if config is None else codec_from_file(config, codec)
    report_omitted("codec", faults())
    decoder = settings.build()
    decoded = _decoded(file, decoder, settings)
    frames, times, source = _timed(decoded)
    summary = {
        "file": str(file),
        "kind": decoded.kind,
        "codec": codec,
        "rows": len(frames),
        "frames_without_time": len(decoded.frames) - len(frames),
        "time": source,
        **decoder.counts.as_dict(),
        "balanced": decoder.counts.balanced(),
        "torn_bytes": decoded.torn_bytes,
        "bad_lines": decoded.bad_lines,
    }
    if frames:
        write_recording(output, from_frames(frames, times, decoder.extra_columns))
    if as_json:
        echo_json(json.dumps(summary))
    echo(_for_people(file, decoded, decoder.counts, len(frames), source), err=True)
    if not decoded.frames:
        raise Refused(f"{file}: codec {codec!r} found no frame in it; nothing was written")
    if not frames:
        raise Refused(
            f"{file}: its frames carry no time, and raw bytes have no times of arrival; nothing was written"
            " (record the wire with highside, or with candump -L)"
        )


def decode_recording(file: Path, codec: str | None, config: Path | None) -> Recording:
    """The Recording that `decode` would write. Raises InputError or Refused as it does."""
    from highside.config.codecs import codec_from_file, codec_from_name
    from highside.errors import InputError, Refused
    from highside.recording.table import from_frames

    if codec is None:
        raise InputError("is missing", field="--codec", remedy="name the codec of the wire recording")
    settings = codec_from_name(codec) if config is None else codec_from_file(config, codec)
    decoder = settings.build()
    decoded = _decoded(file, decoder, settings)
    frames, times, _ = _timed(decoded)
    if not frames:
        raise Refused(f"{file}: codec {codec!r} found no frame with a time in it; see `highside decode`")
    recording = from_frames(frames, times, decoder.extra_columns)
    recording.source = str(file)
    return recording


def _decoded(file: Path, decoder: ByteCodec | CanCodec, settings: CodecTable) -> _Decoded:
    """All frames of a file. Raises InputError, too, where a decoder of another package fails on what it is given."""
    from highside.errors import HighsideError, InputError
    from highside.printable import one_line

    try:
        return _decode_can(file, decoder) if settings.carries == "can" else _decode_bytes(file, decoder)
    except (HighsideError, OSError, MemoryError):
        raise
    except Exception as error:
        cause = one_line(f"{type(error).__name__}: {error}")[:300]
        raise InputError(
            f"the decoder of codec {settings.name!r} failed on it ({cause})",
            where=str(file),
            remedy="give this line and the file to the maker of the codec",
        ) from error


def _decode_bytes(path: Path, codec: ByteCodec | CanCodec) -> _Decoded:
    from highside.errors import InputError
    from highside.reading import read_bytes
    from highside.recording.wire import WireKind, detect_kind, read_segments

    kind = detect_kind(path)
    decoded = _Decoded(kind.value)
    receive = codec.receive  # type: ignore[union-attr]
    if kind is WireKind.CANDUMP:
        raise InputError(
            f"holds CAN frames, but codec {codec.name!r} reads a byte stream", where=str(path), remedy="use --codec dbc"
        )
    if kind is WireKind.RAW:
        data = read_bytes(path)
        for start in range(0, len(data), _CHUNK_BYTES):
            decoded.frames += receive(data[start : start + _CHUNK_BYTES])
        decoded.frames += codec.flush()
        return decoded
    reader = read_segments(path)
    first: float | None = None
    for t_mono, _, data in reader:
        first = t_mono if first is None else first
        decoded.frames += receive(data, t_mono)
    decoded.frames += codec.flush()
    decoded.arrivals = [frame.t_mono - (first or 0.0) for frame in decoded.frames]
    decoded.torn_bytes = reader.torn_bytes
    return decoded


def _decode_can(path: Path, codec: ByteCodec | CanCodec) -> _Decoded:
    from highside.errors import InputError
    from highside.recording.candump import read_candump
    from highside.recording.wire import WireKind, detect_kind

    kind = detect_kind(path)
    if kind is not WireKind.CANDUMP:
        raise InputError(
            f"holds {'a byte stream' if kind is WireKind.SEGMENTS else 'no CAN frames'}, but codec {codec.name!r}"
            " reads CAN frames",
            where=str(path),
            remedy="give candump -L text",
        )
    reader = read_candump(path)
    decoded = _Decoded(kind.value)
    receive = codec.receive_can  # type: ignore[union-attr]
    wire = list(reader)
    for start in range(0, len(wire), _FRAMES_AT_ONCE):
        decoded.frames += receive(wire[start : start + _FRAMES_AT_ONCE])
    decoded.frames += codec.flush()
    begin = wire[0].t_mono if wire else 0.0
    decoded.arrivals = [frame.t_mono - begin for frame in decoded.frames]
    decoded.torn_bytes, decoded.bad_lines = reader.torn_bytes, reader.bad_lines
    return decoded


def _timed(decoded: _Decoded) -> tuple[list[Frame], list[float], str]:
    """The frames that have a time, their times, and whose times they are."""
    timed = [(frame, frame.t_s) for frame in decoded.frames if frame.t_s is not None]
    if timed:
        return [frame for frame, _ in timed], [t_s for _, t_s in timed], "device"
    if decoded.arrivals:
        return decoded.frames, decoded.arrivals, "arrival"
    return [], [], "none"


def _for_people(path: Path, decoded: _Decoded, counts: Counts, rows: int, source: str) -> str:
    balance = "they add up" if counts.balanced() else "THEY DO NOT ADD UP"
    parts = f" and {counts.frames_part} packets that are parts of them" if counts.frames_part else ""
    lines = [
        f"{path} ({decoded.kind}): {counts.frames_good} good frames{parts}, {counts.frames_bad} bad,"
        f" {counts.frames_ignored} for others; {rows} rows with the time of {source}",
        f"  {counts.bytes_in} bytes = {counts.bytes_framed} in frames + {counts.bytes_bad} bad + {counts.bytes_text}"
        f" text + {counts.bytes_ignored} for others + {counts.bytes_junk} junk ({balance})",
    ]
    missing = len(decoded.frames) - rows
    if missing and rows:
        lines.append(f"  {missing} frames without the device's time were omitted")
    if decoded.torn_bytes:
        lines.append(f"  {decoded.torn_bytes} bytes at the end of the file are torn and were not read")
    if decoded.bad_lines:
        lines.append(f"  {decoded.bad_lines} lines of the file are no candump lines")
    return "\n".join(lines)
