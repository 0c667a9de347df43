"""Recognising what is spoken by its bytes alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from highside.codec import tool
from highside.link.detect import score_bytes


def frames(count: int) -> bytes:
    return b"".join(tool.encode(n, n / 100.0, (0.1, 0.2, 0.97), temp_c=20.0) for n in range(count))


def test_the_tools_own_frames_are_recognised_even_when_cut_anywhere() -> None:
    data = frames(50)
    for cut in range(26):
        best = score_bytes(data[cut : len(data) - cut])[0]
        assert (best.codec, best.valid) == ("tool", True)
        assert best.frames >= 47
        assert best.share > 0.9


def test_real_vn100_bytes_are_recognised_between_their_text(shared_data: Path) -> None:
    data = (shared_data / "serial_vn100" / "F00379_first60pct.bin").read_bytes()
    for start in (0, 100_001, 400_003):
        best = score_bytes(data[start : start + 8192])[0]
        assert (best.codec, best.valid) == ("vn100", True)
        assert "bytes of text" in best.detail


def test_real_delimited_text_is_recognised_with_its_columns(shared_data: Path) -> None:
    data = (shared_data / "serial_multi_imu" / "2023-08-09_Multi-IMU_commaDelim.txt").read_bytes()
    best = score_bytes(data[1000:9000])[0]
    assert (best.codec, best.valid) == ("delimited", True)
    assert "between commas" in best.detail


def test_nmea_sentences_count_only_with_a_good_checksum() -> None:
    good = b"$GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03,61.7,M,55.2,M,,*76\r\n" * 10
    best = score_bytes(good)[0]
    assert best.valid
    assert "$GPGGA" in best.detail
    assert not score_bytes(good.replace(b"*76", b"*77"))[0].detail.startswith("NMEA")


@pytest.mark.parametrize("seed", range(20))
def test_noise_of_a_wrong_baud_rate_is_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = rng.bytes(8192)
    # frames with bits lost by sampling at another rate
    mangled = bytes(np.frombuffer(frames(300), np.uint8)[::2] | rng.integers(0, 2, 1) * 128)
    for junk in (data, mangled, b"", b"\x00" * 5000, b"\xff" * 5000, b"\n" * 500):
        assert not score_bytes(junk)[0].valid


def test_readable_text_without_numbers_is_no_codec() -> None:
    assert not score_bytes(b"booting, please wait\r\nready\r\n" * 50)[0].valid


@pytest.mark.parametrize(("options", "named"), [(("--port", ""), "--port"), (("--baud", "0"), "--baud")])
def test_a_port_or_rate_that_cannot_be_is_refused_in_one_line(options: tuple[str, str], named: str) -> None:
    done = subprocess.run(
        [str(Path(sys.executable).with_name("highside")), "detect", *options],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert named in done.stderr and done.stderr.count("\n") == 1
