"""`highside decode` on real recordings, each compared with an independent reading of the same bytes."""

from __future__ import annotations

import contextlib
import csv
import gzip
import io
import json
import random
import re
import subprocess
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from highside.cli.main import main
from highside.codec import tool, tool_can
from highside.codec.frame import CanFrame
from highside.config.codecs import CODEC_NAMES, codec_from_file, codec_from_name
from highside.recording.candump import format_candump, read_candump
from highside.recording.table import read_recording
from tests.segments import SegmentWriter


def decode(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command as a user does."""
    command = [sys.executable, "-c", "from highside.cli.main import main; main()", "decode", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def refused(status: int, *arguments: object) -> str:
    """Run a command that must fail with this status (in this process: many of them); returns its last line."""
    said = io.StringIO()
    with (
        contextlib.redirect_stderr(said),
        mock.patch.object(sys, "argv", ["highside", "decode", *map(str, arguments)]),
        pytest.raises(SystemExit) as left,
    ):
        main()
    assert left.value.code == status, said.getvalue()
    assert "internal error" not in said.getvalue()
    return said.getvalue().strip().splitlines()[-1]


@pytest.fixture(scope="module")
def vn100_bytes(shared_data: Path) -> bytes:
    return (shared_data / "serial_vn100" / "F00379_first60pct.bin").read_bytes()


@pytest.fixture(scope="module")
def vn100_expected(shared_data: Path) -> list[dict[str, str]]:
    with gzip.open(shared_data / "serial_vn100" / "F00379_first60pct_decoded.csv.gz", "rt", newline="") as file:
        return list(csv.DictReader(file))


def assert_equals_golden(path: Path, expected: list[dict[str, str]]) -> None:
    """Every frame of the independent decode and no other, equal to the last printed digit."""
    recording = read_recording(path)
    assert recording.n == len(expected) == 5343
    for name in expected[0]:
        digits = 15 if name == "t_s" else 9
        ours = [f"{value:.{digits}g}" for value in recording.columns[name]]
        theirs = [f"{float(row[name]):.{digits}g}" for row in expected]
        assert ours == theirs, name
    for ours_name, theirs_name, unit in (
        [(f"a{k}_g", f"Acc{k.upper()}", 1 / 9.80665) for k in "xyz"]
        + [(f"g{k}_dps", f"Gyro{k.upper()}", 180 / np.pi) for k in "xyz"]
        + [("temp_c", "Temp", 1.0)]
    ):
        # nine digits name one float32
        exact = np.array([np.float32(row[theirs_name]) for row in expected], dtype=np.float64)
        np.testing.assert_allclose(recording.columns[ours_name], exact * unit, rtol=1e-15)


@pytest.mark.parametrize("zipped", [False, True])
def test_vn100_recording_gives_every_frame_and_every_byte_is_accounted_for(
    shared_data: Path, tmp_path: Path, vn100_expected: list[dict[str, str]], zipped: bool
) -> None:
    raw = shared_data / "serial_vn100" / "F00379_first60pct.bin"
    source, out = raw, tmp_path / "rec.csv"
    if zipped:
        source, out = tmp_path / "raw.bin.gz", tmp_path / "rec.csv.gz"
        source.write_bytes(gzip.compress(raw.read_bytes()))
    result = decode(source, "--codec", "vn100", "-o", out, "--json")
    assert result.returncode == 0, result.stderr
    assert_equals_golden(out, vn100_expected)
    counts = json.loads(result.stdout)
    assert (counts["frames_good"], counts["frames_bad"], counts["frames_without_time"]) == (5343, 2, 0)
    assert counts["bytes_framed"] == 5343 * 124
    parts = [counts[f"bytes_{part}"] for part in ("framed", "bad", "text", "junk", "ignored")]
    assert sum(parts) == counts["bytes_in"] == raw.stat().st_size
    assert counts["bytes_pending"] == 0
    assert counts["balanced"] is True
    assert counts["time"] == "device"
    assert "5343 good frames, 2 bad" in result.stderr


def test_vn100_frames_are_the_same_in_any_chunks(vn100_bytes: bytes) -> None:
    rng = random.Random(21)
    whole = codec_from_name("vn100").build()
    expected = whole.receive(vn100_bytes) + whole.flush()  # type: ignore[union-attr]
    for largest in (1, 100, 4096):
        codec = codec_from_name("vn100").build()
        found, at = [], 0
        while at < len(vn100_bytes):
            size = rng.randint(1, largest)
            found += codec.receive(vn100_bytes[at : at + size])  # type: ignore[union-attr]
            at += size
        assert found + codec.flush() == expected
        assert codec.counts == whole.counts


def test_vn100_second_recording_agrees_with_a_search_by_regular_expression(shared_data: Path, tmp_path: Path) -> None:
    raw = shared_data / "serial_vn100" / "F00294.bin"
    result = decode(raw, "--codec", "vn100", "-o", tmp_path / "rec.csv", "--json")
    assert result.returncode == 0
    # header, any 118 bytes, time line: what a person would look for
    times = re.findall(rb"\xfa\x14\x3e\x00\x3a\x00[\x00-\xff]{118}[\r\n]+M,(\d+)\r?\n", raw.read_bytes(), re.DOTALL)
    assert read_recording(tmp_path / "rec.csv").t_s.tolist() == [int(t) / 1000 for t in times]
    counts = json.loads(result.stdout)
    assert counts["frames_good"] == counts["rows"] + counts["frames_without_time"]


def test_segments_and_their_torn_end_decode_like_the_raw_bytes(
    tmp_path: Path, vn100_bytes: bytes, vn100_expected: list[dict[str, str]]
) -> None:
    rng = random.Random(22)
    path = tmp_path / "live.hsw"
    writer = SegmentWriter(path, {"codec": "vn100"})
    at = 0
    while at < len(vn100_bytes):
        size = rng.randint(1, 4096)
        writer.append(vn100_bytes[at : at + size], t_wall=1.7e9 + at, t_mono=50.0 + at)
        at += size
    writer.append(bytes(100), t_wall=0, t_mono=0)
    writer.close()
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size - 7)
    result = decode(path, "--codec", "vn100", "-o", tmp_path / "rec.csv", "--json")
    assert result.returncode == 0
    assert_equals_golden(tmp_path / "rec.csv", vn100_expected)
    counts = json.loads(result.stdout)
    assert (counts["kind"], counts["bytes_in"]) == ("segments", len(vn100_bytes))
    assert counts["torn_bytes"] == 20 + 100 + 4 - 7
    assert "torn" in result.stderr


def test_each_of_the_five_sensors_is_taken_out_of_the_interleaved_text(
    shared_data: Path, project_root: Path, tmp_path: Path
) -> None:
    mapping = (project_root / "config" / "multi_imu-mapping.toml").read_text()
    totals = []
    for raw in sorted((shared_data / "serial_multi_imu").glob("*.txt")):
        data = raw.read_bytes()
        # independent: any line of twelve whole numbers
        rows = [[int(c) for c in m] for m in re.findall(rb"(?m)^" + rb",".join([rb"(-?\d+)"] * 12) + rb"\r$", data)]
        for sensor in "12345":
            config = tmp_path / f"{sensor}.toml"
            config.write_text(mapping.replace('equals = "3"', f'equals = "{sensor}"'))
            codec = codec_from_file(config, "delimited").build()
            frames = codec.receive(data) + codec.flush()  # type: ignore[union-attr]
            mine = [row for row in rows if row[0] == int(sensor)]
            assert codec.counts.frames_good == len(mine)
            assert codec.counts.frames_ignored == len(rows) - len(mine)
            assert codec.counts.frames_bad == 0
            assert codec.counts.balanced()
            assert codec.counts.bytes_in == len(data)
            assert [f.t_s for f in frames] == pytest.approx([r[1] + r[2] / r[3] for r in mine], abs=1e-9)
            for place in range(3):
                assert [f[3 + place] for f in frames] == pytest.approx([r[4 + place] * 1e-4 for r in mine])
            assert [f.extra for f in frames] == [tuple(map(float, r[7:])) for r in mine]
            totals.append(len(mine))
    assert totals[:5] == [20] * 5
    assert sum(totals[5:]) == 7482


def test_multi_imu_by_the_command(shared_data: Path, project_root: Path, tmp_path: Path) -> None:
    raw = shared_data / "serial_multi_imu" / "2023-08-15_Multi-IMU_static60s.txt"
    config = project_root / "config" / "multi_imu-mapping.toml"
    result = decode(raw, "--codec", "delimited", "--config", config, "-o", tmp_path / "rec.csv")
    assert result.returncode == 0, result.stderr
    assert result.stdout == ""
    recording = read_recording(tmp_path / "rec.csv")
    assert recording.n == 1501
    assert 0.9 < -recording.columns["az_g"].mean() < 1.0
    assert not recording.has("gx_dps")


def test_every_0x024_of_30_s_of_a_cars_bus_equals_an_independent_decode(
    shared_data: Path, project_root: Path, tmp_path: Path
) -> None:
    raw = shared_data / "can_comma2k19" / "candump_first30s.log.gz"
    config = project_root / "config" / "comma2k19-mapping.toml"
    result = decode(raw, "--codec", "dbc", "--config", config, "-o", tmp_path / "rec.csv", "--json")
    assert result.returncode == 0, result.stderr
    # independent: the bits picked out of the text by position in the hexadecimal digits
    times, yaw, lateral = [], [], []
    begin = None
    for line in gzip.decompress(raw.read_bytes()).decode().splitlines():
        stamp, _, content = line.split()
        t = float(stamp.strip("()"))
        begin = t if begin is None else begin
        can_id, _, text = content.partition("#")
        if can_id == "024":
            bits = "".join(f"{int(digit, 16):04b}" for digit in text)
            times.append(t - begin)
            yaw.append(int(bits[6:16], 2) * 0.244 - 125)
            lateral.append(int(bits[38:48], 2) * 0.03589 - 18.375)
    recording = read_recording(tmp_path / "rec.csv")
    assert recording.n == len(yaw) == 2487
    assert recording.columns["gz_dps"].tolist() == yaw
    assert recording.columns["lateral_mps2"].tolist() == lateral
    np.testing.assert_allclose(recording.columns["ay_g"], np.array(lateral) / 9.80665, rtol=1e-12)
    np.testing.assert_allclose(recording.t_s, times, atol=1e-6)
    assert not recording.has("ax_g")
    assert not recording.has("az_g")
    counts = json.loads(result.stdout)
    assert counts["frames_good"] + counts["frames_ignored"] == len(list(read_candump(raw)))
    assert (counts["frames_bad"], counts["balanced"], counts["time"]) == (0, True, "arrival")


def test_the_tools_own_frames_over_both_wires_give_the_same_recording(tmp_path: Path) -> None:
    rng = random.Random(23)
    serial = b""
    wire: list[CanFrame] = []
    for i in range(300):
        accel = [round(rng.uniform(-1, 1) / 4e-8) * 4e-8 for _ in range(3)]
        gyro = [round(rng.uniform(-9, 9) / 2e-6) * 2e-6 for _ in range(3)]
        serial += tool.encode(i, i * 0.01, accel, gyro_dps=gyro, temp_c=i * 0.05)
        wire += tool_can.encode(i, i * 0.01, accel, gyro_dps=gyro, temp_c=i * 0.05, t_wall=1.7e9 + i * 0.01)
    (tmp_path / "a.bin").write_bytes(b"noise" + serial + serial[:11])
    (tmp_path / "a.log").write_text("".join(format_candump(f, "can0") for f in wire))
    results = []
    for name, codec in (("a.bin", "tool"), ("a.log", "dbc")):
        result = decode(tmp_path / name, "--codec", codec, "-o", tmp_path / f"{name}.csv")
        assert result.returncode == 0, result.stderr
        results.append(read_recording(tmp_path / f"{name}.csv"))
    assert results[0].order == results[1].order
    assert results[0].order == (
        "t_s", "ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps", "temp_c", "seq"
    )  # fmt: skip
    for name in results[0].order:
        np.testing.assert_allclose(results[0].columns[name], results[1].columns[name], atol=1e-9)
    np.testing.assert_array_equal(results[0].columns["seq"], np.arange(300.0))


def test_axes_of_the_configuration_are_applied(shared_data: Path, project_root: Path, tmp_path: Path) -> None:
    raw = shared_data / "serial_vn100" / "F00294.bin"
    config = project_root / "config" / "vn100-mapping.toml"
    plain, mapped = tmp_path / "plain.csv", tmp_path / "mapped.csv"
    assert decode(raw, "--codec", "vn100", "-o", plain).returncode == 0
    assert decode(raw, "--codec", "vn100", "--config", config, "-o", mapped).returncode == 0
    before, after = read_recording(plain), read_recording(mapped)
    np.testing.assert_array_equal(after.accel(), before.accel() * np.array([[1.0], [-1.0], [-1.0]]))
    np.testing.assert_array_equal(after.columns["AccZ"], before.columns["AccZ"])


def test_wrong_input_ends_with_one_line_and_status_2(tmp_path: Path, project_root: Path, shared_data: Path) -> None:
    raw = shared_data / "serial_vn100" / "F00294.bin"
    bus = shared_data / "can_comma2k19" / "candump_first30s.log.gz"
    out = tmp_path / "rec.csv"
    bad = tmp_path / "bad.toml"
    assert "nofile: no such file" in refused(2, tmp_path / "nofile", "--codec", "tool", "-o", out)
    line = refused(2, raw, "--codec", "vn1000", "-o", out)
    assert "'vn1000'" in line
    assert all(name in line for name in CODEC_NAMES)
    assert "--config" in refused(2, raw, "--codec", "delimited", "-o", out)
    assert "CAN frames" in refused(2, raw, "--codec", "dbc", "-o", out)
    assert "use --codec dbc" in refused(2, bus, "--codec", "vn100", "-o", out)
    config = project_root / "config" / "multi_imu-mapping.toml"
    assert "codec.name: is 'delimited', but --codec says 'vn100'" in refused(
        2, raw, "--codec", "vn100", "--config", config, "-o", out
    )
    assert "cannot be written" in refused(2, raw, "--codec", "vn100", "-o", tmp_path / "no" / "rec.csv")
    for text, says in {
        "[codec": "is not valid TOML",
        "[link]\n": "has no [codec] table",
        '[codec]\nname = "morse"\n': "codec.name: no codec 'morse'; allowed: dbc, delimited",
        '[codec]\naxes = "xxz"\n': "no axis map",
        '[codec]\naxes = "-xyz"\n': "mirror",
        "[codec]\nbaud = 1\n": "codec.baud: is not a known field",
        "[codec]\ntime_line = 7\n": "codec.time_line",
    }.items():
        bad.write_text(text)
        line = refused(2, raw, "--codec", "vn100", "--config", bad, "-o", out)
        assert says in line, line
        assert "bad.toml" in line
    for text, says in {
        '[codec]\ndbc = "none.dbc"\n': "none.dbc: no such file",
        '[codec.fields]\ngz_dps = { signal = "A.B" }\n': "codec.fields.gz_dps: no message 'A'",
        '[codec.fields]\npose = { signal = "A.B" }\n': "'pose' is no quantity",
    }.items():
        bad.write_text(text)
        assert says in refused(2, bus, "--codec", "dbc", "--config", bad, "-o", out)
    for text, says in {
        "[codec]\n": "codec.fields: is missing",
        "[codec]\ncolumns = 3\n[codec.fields]\nax_g = { column = 3 }\n": "column 3 is beyond the 3 columns",
        "[codec.fields]\nax_g = { column = -1 }\n": "codec.fields.ax_g.column",
    }.items():
        bad.write_text(text)
        assert says in refused(2, raw, "--codec", "delimited", "--config", bad, "-o", out)
    assert not out.exists()
    # and once through a process of its own
    result = decode(tmp_path / "nofile", "--codec", "tool", "-o", out)
    assert (result.returncode, result.stdout) == (2, "")
    assert len(result.stderr.splitlines()) == 1


def test_a_file_without_frames_is_bad_news_and_writes_nothing(tmp_path: Path, shared_data: Path) -> None:
    out = tmp_path / "rec.csv"
    raw = shared_data / "serial_vn100" / "F00294.bin"
    assert "found no frame" in refused(1, raw, "--codec", "tool", "-o", out)
    empty = tmp_path / "empty"
    empty.write_bytes(b"")
    assert "found no frame" in refused(1, empty, "--codec", "tool", "-o", out)
    bare = tmp_path / "bare.toml"
    bare.write_text("[codec]\ntime_line = false\n")
    assert "carry no time" in refused(1, raw, "--codec", "vn100", "--config", bare, "-o", out)
    assert not out.exists()
