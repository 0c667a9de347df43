"""Decoding speed of every codec, in CPU time, beside the most that a line or a bus can carry.

    python -m tests.bench.codec_speed [--json]

Ceilings: 921,600 baud carry 3,840 frames/s of 24 bytes; classic CAN at 1 Mbit/s 9,009 frames/s.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from highside.codec import can_dbc, tool, tool_can, vn100
from highside.codec.delimited import DelimitedCodec, DelimitedCodecConfig
from highside.codec.frame import ByteCodec


def layout_of(fields: dict[str, dict[str, float]], **settings: object) -> DelimitedCodecConfig:
    return DelimitedCodecConfig.model_validate({"name": "delimited", "fields": fields} | settings)


ROOT = Path(__file__).resolve().parent.parent.parent
READ_BYTES = 4096
N = 20_000


def cpu_us(work: Callable[[], int], repeats: int = 7) -> float:
    """Best CPU time of one item in us; `work` returns how many it did."""
    best = float("inf")
    for _ in range(repeats):
        start = time.process_time()
        items = work()
        best = min(best, (time.process_time() - start) / items)
    return best * 1e6


def through(make: Callable[[], ByteCodec], data: bytes, size: int = READ_BYTES) -> Callable[[], int]:
    """Decode a stream in reads of `size` bytes."""

    def work() -> int:
        codec = make()
        return sum(len(codec.receive(data[at : at + size], 1.0)) for at in range(0, len(data), size))

    return work


def measurements() -> Iterator[tuple[str, float, int]]:
    """(what, us per frame, ceiling in frames/s)."""
    a, w = (0.1, 0.2, 0.97), (1.0, 2.0, 3.0)
    base = b"".join(tool.encode(i, i / 3840, a) for i in range(N))
    full = b"".join(tool.encode(i, i / 3840, a, gyro_dps=w, temp_c=20, rotor_deg=9) for i in range(N))
    yield "tool, base frame (24 bytes)", cpu_us(through(tool.ToolCodec, base)), 3840
    yield "tool, base frame, one read a frame", cpu_us(through(tool.ToolCodec, base, 24)), 3840
    yield "tool, all contents (46 bytes)", cpu_us(through(tool.ToolCodec, full)), 2003
    sensor = b"".join(vn100.encode(tuple(float(k) for k in range(29)), i * 10) for i in range(N // 4))
    yield "vn100 with time lines", cpu_us(through(vn100.Vn100Codec, sensor)), 800
    layout = layout_of({"ax_g": {"column": 1}, "ay_g": {"column": 2}, "az_g": {"column": 3}})
    lines = b"\n" + b"".join(b"%d,0.123456,-0.23456,0.98765\n" % i for i in range(N))
    yield "delimited, three numbers", cpu_us(through(lambda: DelimitedCodec(layout), lines)), 2880
    own = can_dbc.compile_dbc((ROOT / "config" / "highside.dbc").read_text())
    parts = [part for i in range(N // 4) for part in tool_can.encode(i, i * 1e-3, a, gyro_dps=w)]
    yield "dbc, the tool's own messages, per CAN frame", cpu_us(lambda: _can(tool_can.ToolCanCodec(own), parts)), 9009
    car = can_dbc.compile_dbc((ROOT / "config" / "comma2k19.dbc").read_text())
    fields = {
        "gz_dps": can_dbc.SignalSource("KINEMATICS", "YAW_RATE"),
        "ay_g": can_dbc.SignalSource("KINEMATICS", "ACCEL_Y"),
    }
    mine = [part._replace(can_id=0x24) for part in parts]
    yield "dbc, two signals of a message", cpu_us(lambda: _can(can_dbc.SignalCodec(car, fields), mine)), 9009
    yield "dbc, messages of others", cpu_us(lambda: _can(can_dbc.SignalCodec(car, fields), parts)), 9009


def _can(codec: tool_can.ToolCanCodec | can_dbc.SignalCodec, parts: list[tool_can.CanFrame]) -> int:
    for at in range(0, len(parts), 64):
        codec.receive_can(parts[at : at + 64])
    return len(parts)


def main() -> None:
    rows = [
        {"what": what, "us_per_frame": round(us, 2), "frames_per_s": round(1e6 / us), "ceiling_frames_per_s": ceiling}
        for what, us, ceiling in measurements()
    ]
    if "--json" in sys.argv:
        print(json.dumps(rows))
        return
    print(f"{'what':46}{'us/frame':>10}{'frames/s':>11}{'the line carries':>18}{'of a core':>11}")
    for row in rows:
        share = 100 * row["ceiling_frames_per_s"] / row["frames_per_s"]
        print(
            f"{row['what']:46}{row['us_per_frame']:>10}{row['frames_per_s']:>11}{row['ceiling_frames_per_s']:>18}{share:>10.1f}%"
        )


if __name__ == "__main__":
    main()
