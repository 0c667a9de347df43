"""Recording and pose table: numbers come back exactly, errors name the place."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.codec.frame import NAN, Frame
from highside.errors import InputError
from highside.recording.table import (
    PoseTable,
    Recording,
    from_frames,
    read_poses,
    read_recording,
    write_poses,
    write_recording,
)


@pytest.mark.parametrize("name", ["rec.csv", "rec.csv.gz"])
@settings(max_examples=60, deadline=None)
@given(values=st.lists(st.floats(allow_infinity=False), min_size=1, max_size=30))
def test_numbers_read_back_exactly(tmp_path_factory: pytest.TempPathFactory, name: str, values: list[float]) -> None:
    path = tmp_path_factory.mktemp("t") / name
    recording = Recording(
        {"t_s": np.arange(len(values), dtype=float), "ax_g": np.array(values), "seq": np.array(values)}
    )
    write_recording(path, recording)
    back = read_recording(path)
    assert back.order == ("t_s", "ax_g", "seq")
    for column in back.order:
        np.testing.assert_array_equal(back.columns[column], recording.columns[column])


def test_counting_columns_are_written_as_whole_numbers_and_gaps_as_empty_cells(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    write_recording(
        path, Recording({"t_s": np.array([0.0, 0.5]), "seq": np.array([7.0, NAN]), "temp_c": np.array([NAN, 20.0])})
    )
    assert path.read_text() == "t_s,seq,temp_c\n0.0,7,\n0.5,,20.0\n"


def test_unknown_columns_are_kept_text_or_not(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    text = 't_s,note,ax_g,volts\n0.0,"left, slow",0.5,1.0\n1.0,ok,0.25,2.0\n'
    path.write_text(text)
    recording = read_recording(path)
    assert recording.texts == {"note": ("left, slow", "ok")}
    again = recording.with_columns({"inc_deg": np.array([1.0, 2.0])})
    out = tmp_path / "o.csv"
    write_recording(out, again)
    assert out.read_text() == ('t_s,note,ax_g,volts,inc_deg\n0.0,"left, slow",0.5,1.0,1.0\n1.0,ok,0.25,2.0,2.0\n')
    assert recording.select(np.array([False, True])).as_csv() == "t_s,note,ax_g,volts\n1.0,ok,0.25,2.0\n"


def test_gzip_is_deterministic_and_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    recording = Recording({"t_s": np.arange(5.0)})
    first, second = tmp_path / "a.csv.gz", tmp_path / "b.csv.gz"
    write_recording(first, recording)
    time.sleep(1.1)
    write_recording(second, recording)
    assert first.read_bytes() == second.read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv.gz", "b.csv.gz"]
    with pytest.raises(InputError, match="cannot be written"):
        write_recording(tmp_path / "no" / "such.csv", recording)
    with pytest.raises(InputError, match="is a directory"):
        write_recording(tmp_path, recording)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "r.csv: is empty"),
        (b"\n\n", "r.csv: is empty"),
        (b"t_s,ax_g\n", "has a header but no frames"),
        (b"ax_g\n1\n", "lacks the column t_s; it has: ax_g"),
        (b"t_s,ax_g\n0,1\n1,x\n", "line 3: ax_g: is a text ('x'), multiples of g are expected"),
        (b"t_s,ax_g\n0,1\n1,inf\n", "line 3: ax_g: 'inf' is not a finite number"),
        (b"t_s,ax_g\n0,1_0\n", "line 2: ax_g: '1_0' is not a finite number"),
        (b"t_s,ax_g\n0,1\n1\n2,2,3\n", "line 3: has 1 cells where the header has 2"),
        (b"t_s,ax_g\n0,1\n\n2,2\n", "line 3: has 0 cells"),
        (b"t_s,ax_g\n0,1\n,1\n", "line 3: t_s: every row needs its time"),
        (b"t_s,ax_g\n0,1\nnan,1\n", "line 3: t_s: every row needs its time"),
        (b"t_s,t_s\n0,1\n", "line 1: t_s: the header names this column twice"),
        (b"t_s,\n0,1\n", "line 1: the header has a column without a name"),
        (b"t_s,ax_g\n0,\xff\n", "line 2: is not text"),
        (b"\x1f\x8b\x08\x00broken", "is a damaged gzip file"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_with_its_place(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_recording(path)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_directory_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv: no such file"):
        read_recording(tmp_path / "none.csv")
    with pytest.raises(InputError, match="is a directory"):
        read_recording(tmp_path)


def test_windows_line_ends_byte_order_mark_and_spaces_are_read(tmp_path: Path) -> None:
    path = tmp_path / "r.csv"
    path.write_bytes(b"\xef\xbb\xbft_s, ax_g\r\n0, 1\r\n1,2 \r\n\r\n")
    np.testing.assert_array_equal(read_recording(path).columns["ax_g"], [1.0, 2.0])


def test_commands_are_reported_what_they_lack() -> None:
    recording = Recording({"t_s": np.arange(3.0), "ax_g": np.array([1.0, NAN, 2.0]), "ay_g": np.full(3, NAN)})
    with pytest.raises(InputError, match="lacks the columns az_g, gx_dps"):
        recording.require("ax_g", "az_g", "gx_dps")
    with pytest.raises(InputError, match="ay_g: holds no number"):
        recording.require("ay_g")
    with pytest.raises(InputError, match="row 1: ax_g: is missing"):
        recording.complete("t_s", "ax_g")
    whole = recording.with_columns(dict.fromkeys(("ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps"), np.ones(3)))
    assert whole.accel().shape == whole.gyro().shape == (3, 3)
    with pytest.raises(ValueError, match="unequal length"):
        Recording({"t_s": np.arange(3.0), "ax_g": np.ones(2)})


def test_pose_tables_come_back(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    poses = PoseTable(
        {
            name: np.array([0.1, 0.2])
            for name in ("inc_ref_deg", "tf_ref_deg", "ax", "ay", "az", "std_ax", "std_ay", "std_az")
        }
        | {"n": np.array([100.0, 200.0])}
    )
    write_poses(path, poses)
    back = read_poses(path)
    assert back.n == 2
    assert path.read_text().splitlines()[1].endswith(",100")
    np.testing.assert_array_equal(back.accel(), np.tile([0.1, 0.2], (3, 1)))
    np.testing.assert_array_equal(back.reference_deg(), np.tile([0.1, 0.2], (2, 1)))
    assert back.std() is not None
    path.write_text("ax,ay\n1,2\n")
    with pytest.raises(InputError, match="lacks the columns inc_ref_deg, tf_ref_deg, az"):
        read_poses(path)


def test_frames_become_columns_and_what_no_frame_has_is_left_out() -> None:
    frames = [Frame(None, None, 0.0, NAN, 0.1, NAN, gz=2.0, extra=(1.0, NAN)), Frame(None, None, 0.0, NAN, 0.2, NAN)]
    recording = from_frames(frames, [0.0, 0.5], ("volts", "amps"))
    assert recording.order == ("t_s", "ay_g", "gz_dps", "volts")
    np.testing.assert_array_equal(recording.columns["gz_dps"], [2.0, NAN])


def test_a_large_recording_is_read_in_seconds(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    names = ("t_s", "ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps", "temp_c")
    n = 90_000
    recording = Recording({name: np.round(rng.standard_normal(n), 9) for name in names})
    path = tmp_path / "big.csv"
    write_recording(path, recording)
    start = time.perf_counter()
    back = read_recording(path)
    # a quarter of an hour at 400 Hz is four times this and expected in 2 s
    assert time.perf_counter() - start < 5.0
    assert all(np.array_equal(back.columns[name], recording.columns[name]) for name in names)
