"""Files as Excel, MATLAB, HDF5, PX4, ROS and VectorNav write them: each gives back what was written, or is refused."""

from __future__ import annotations

import io
import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

import highside
from highside.errors import InputError
from highside.importing.core.proposal import Sure
from highside.importing.core.units import STANDARD_GRAVITY
from highside.importing.core.wishes import Wishes
from highside.importing.files import open_foreign, recording_of

N, RATE_HZ = 120, 50.0
START_NS = 1_752_345_678_000_000_000
ACCEL, RATES = ("ax_g", "ay_g", "az_g"), ("gx_dps", "gy_dps", "gz_dps")
IMU = "sensor_msgs/msg/Imu"


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times in s (N,), accelerations in m/s2 (3, N) and rates in rad/s (3, N) of a tool that tilts to and fro."""
    t = np.arange(N) / RATE_HZ
    tilt = 0.5 + 0.4 * np.sin(1.7 * t)
    accel = STANDARD_GRAVITY * np.vstack([np.sin(tilt), 0.1 * np.ones(N), np.cos(tilt)]) / np.sqrt(1.01)
    rate = np.vstack([np.zeros(N), -0.68 * np.cos(1.7 * t), np.zeros(N)])
    return t, accel + np.random.default_rng(0).normal(0, 1e-3, (3, N)), rate


def written_excel(path: Path) -> None:
    t, accel, rate = motion()
    frame = pd.DataFrame({"When": pd.to_datetime(START_NS + np.rint(t * 1e9).astype(np.int64))})
    for k, axis in enumerate("XYZ"):
        frame[f"Accel {axis} (m/s²)"] = accel[k]
        frame[f"Gyro {axis} (rad/s)"] = rate[k]
    with pd.ExcelWriter(path, engine="openpyxl") as book:
        pd.DataFrame({"remark": ["made by hand"]}).to_excel(book, sheet_name="notes", index=False)
        frame.rename(columns={"When": "Time"}).to_excel(book, sheet_name="data", index=False)


def written_mat5(path: Path) -> None:
    t, accel, rate = motion()
    scipy.io.savemat(
        path, {"imu": {"time_s": t, "acc_mps2": accel.T, "gyr_rads": rate.T}, "note": "x"}, do_compression=True
    )


def written_mat73(path: Path) -> None:
    t, accel, rate = motion()
    with h5py.File(path, "w", userblock_size=512) as file:
        file["time_s"] = t[None, :]
        file["acc_mps2"], file["gyr_rads"] = accel, rate  # MATLAB stores (N, 3) so
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def written_hdf5(path: Path) -> None:
    t, accel, rate = motion()
    with h5py.File(path, "w") as file:
        for name, values, unit in (("time", t, "s"), ("imu/acc", accel.T, "m/s^2"), ("imu/gyro", rate.T, "rad/s")):
            file.create_dataset(name, data=values, compression="gzip").attrs["units"] = unit


def written_ulog(path: Path) -> None:
    t, accel, rate = motion()

    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<Hc", len(content), kind) + content

    form = b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000) + message(b"F", form)
    out += message(b"A", struct.pack("<BH", 0, 7) + b"sensor_combined")
    for k in range(N):
        row = struct.pack("<HQ6f", 7, 1000 + round(t[k] * 1e6), *rate[:, k], *accel[:, k])
        out += message(b"D", row)
    path.write_bytes(out)


def _messages(encoding: str) -> list[tuple[int, bytes]]:
    t, accel, rate = motion()
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    types = store.types
    found = []
    for k in range(N):
        ns = START_NS + round(t[k] * 1e9)
        stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        extra = {"seq": k} if encoding == "ros1" else {}
        vector = types["geometry_msgs/msg/Vector3"]
        none = np.zeros(9)
        imu = types[IMU](
            types["std_msgs/msg/Header"](stamp=stamp, frame_id="imu", **extra),
            types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), none, vector(*rate[:, k]), none,
            vector(*accel[:, k]), none,
        )  # fmt: skip
        raw = store.serialize_ros1(imu, IMU) if encoding == "ros1" else store.serialize_cdr(imu, IMU)
        found.append((ns, bytes(raw)))
    return found


def written_bag(path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with BagWriter(path) as bag:
        connection = bag.add_connection("/imu/data", IMU, typestore=store)
        for ns, raw in _messages("ros1"):
            bag.write(connection, ns, raw)


def written_mcap(path: Path) -> None:
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(name=IMU, encoding="ros2msg", data=b"")
        channel = writer.register_channel(schema_id=schema, topic="/imu/data", message_encoding="cdr")
        for ns, raw in _messages("cdr"):
            writer.add_message(channel_id=channel, log_time=ns + 5_000_000, publish_time=ns, data=raw)
        writer.finish()  # type: ignore[no-untyped-call]


TURNED = {0: np.ones(3), 1: np.array([-1.0, -1.0, 1.0])}
"""how two sensors lie: the second half a turn about its z axis"""


def written_dataflash(path: Path) -> None:
    t, accel, rate = motion()

    def described(number: int, length: int, name: bytes, letters: bytes, labels: bytes) -> bytes:
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, length, name, letters, labels)

    out = described(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    out += described(129, 13, b"BARO", b"Qc", b"TimeUS,Temp")
    out += described(130, 38, b"IMU", b"QBffffffc", b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T")
    for k in range(N):
        for sensor in (0, 1):
            sign = TURNED[sensor]
            stamp = 1000 + round(t[k] * 1e6)
            out += b"\xa3\x95\x82" + struct.pack(
                "<QB6fh", stamp, sensor, *(sign * rate[:, k]), *(sign * accel[:, k]), 2512
            )
    path.write_bytes(out)


def test_a_log_of_ardupilot_has_a_table_for_each_sensor(tmp_path: Path) -> None:
    written_dataflash(tmp_path / "1.bin")
    t, accel, rate = motion()
    with pytest.raises(InputError, match=r"IMU\[0\], IMU\[1\]"):
        highside.import_recording(tmp_path / "1.bin")
    for sensor, turned in TURNED.items():
        sign = turned[:, None]
        found = highside.import_recording(tmp_path / "1.bin", table=f"IMU[{sensor}]")
        np.testing.assert_allclose(found.t_s - found.t_s[0], t, rtol=0, atol=1e-6)
        np.testing.assert_allclose(found.accel(), sign * accel / STANDARD_GRAVITY, rtol=0, atol=1e-6)
        np.testing.assert_allclose(found.gyro(), sign * np.degrees(rate), rtol=0, atol=1e-4)
        np.testing.assert_allclose(found["temp_c"], 25.12)
    whole = (tmp_path / "1.bin").read_bytes()
    (tmp_path / "2.bin").write_bytes(whole[:4000] + b"noise" + whole[4000:-7])
    proposal = open_foreign(tmp_path / "2.bin", Wishes(table="IMU[0]"))
    assert "belong to no message" in proposal.table.remarks[0]
    (tmp_path / "3.bin").write_bytes(whole[:100])
    with pytest.raises(InputError, match="holds no message of a known type"):
        highside.import_recording(tmp_path / "3.bin")


def test_a_log_of_ardupilot_as_text(tmp_path: Path) -> None:
    t, accel, rate = motion()
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
             "FMT, 130, 40, IMU, QffffffcB, TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T,I",
             "MSG, 100, hello, world"]  # fmt: skip
    for k in range(N):
        numbers = [repr(float(v)) for v in (*rate[:, k], *accel[:, k])]
        lines.append(", ".join(["IMU", str(1000 + round(t[k] * 1e6)), *numbers, "25.1", "0"]))
    (tmp_path / "x.log").write_text("\n".join(lines) + "\n")
    found = highside.import_recording(tmp_path / "x.log")
    np.testing.assert_allclose(found.accel(), accel / STANDARD_GRAVITY, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.t_s - found.t_s[0], t, rtol=0, atol=1e-6)
    (tmp_path / "y.log").write_text("\n".join(lines).replace("IMU, 21000,", "IMU, zero,") + "\n")
    with pytest.raises(InputError, match=r"line 5: IMU: holds a text among numbers"):
        highside.import_recording(tmp_path / "y.log")


WRITTEN: dict[str, Callable[[Path], None]] = {
    "x.xlsx": written_excel,
    "5.mat": written_mat5,
    "73.mat": written_mat73,
    "x.h5": written_hdf5,
    "x.ulg": written_ulog,
    "x.bag": written_bag,
    "x.mcap": written_mcap,
}


@pytest.mark.parametrize("name", WRITTEN)
def test_each_form_comes_back_without_a_question(tmp_path: Path, name: str) -> None:
    WRITTEN[name](tmp_path / name)
    t, accel, rate = motion()
    proposal = open_foreign(tmp_path / name, Wishes())
    assert [guess.sure for guess in proposal.guesses] == [Sure.CERTAIN] * 7, proposal.doubts
    found = highside.import_recording(tmp_path / name)
    coarse = 1e-6 if name == "x.ulg" else 1e-9
    np.testing.assert_allclose(found.t_s - found.t_s[0], t, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.accel(), accel / STANDARD_GRAVITY, rtol=0, atol=coarse)
    np.testing.assert_allclose(found.gyro(), np.degrees(rate), rtol=0, atol=50 * coarse)


def read_or_refused(path: Path) -> highside.Recording | str:
    """The Recording, or what the user reads; any other error is a failure, and so is a library's own warning."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return highside.import_recording(path, accept=True)
    except InputError as error:
        return str(error)


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.97])
def test_a_torn_file_is_read_as_far_as_it_is_whole_or_refused(tmp_path: Path, name: str, share: float) -> None:
    WRITTEN[name](tmp_path / name)
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(len(data) * share)])
    _, accel, _ = motion()
    found = read_or_refused(tmp_path / name)
    if isinstance(found, str):
        assert found.startswith(str(tmp_path))
        assert "\n" not in found
        return
    assert name == "x.ulg", "only a log that has no end by its nature is read in part"
    np.testing.assert_allclose(found.accel(), accel[:, : found.n] / STANDARD_GRAVITY, rtol=0, atol=1e-6)


@pytest.mark.timeout(60)
def test_a_log_that_is_cut_within_an_unknown_message_is_not_read_for_ever(tmp_path: Path) -> None:
    (tmp_path / "x.ulg").write_bytes(b"ULog\x01\x12\x35\x01 and nothing")
    found = read_or_refused(tmp_path / "x.ulg")
    assert isinstance(found, str)
    assert "is a damaged ULog file (cut within a message)" in found


def test_a_name_within_an_archive_that_is_no_text_is_said_to_be_damage(tmp_path: Path) -> None:
    WRITTEN["x.xlsx"](tmp_path / "x.xlsx")
    data = bytearray((tmp_path / "x.xlsx").read_bytes())
    entry = data.rindex(b"PK\x01\x02")
    data[entry + 9] |= 0x08  # its name is UTF-8
    data[entry + 46] = 0xFF
    (tmp_path / "x.xlsx").write_bytes(data)
    found = read_or_refused(tmp_path / "x.xlsx")
    assert isinstance(found, str)
    assert "is a damaged archive" in found


@pytest.mark.parametrize("name", WRITTEN)
def test_changed_bytes_never_end_in_another_error(tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    WRITTEN[name](tmp_path / name)
    data = bytearray((tmp_path / name).read_bytes())
    rng = np.random.default_rng(4)
    for _ in range(6):
        changed = bytearray(data)
        for place in rng.integers(0, len(data), 20):
            changed[place] = int(rng.integers(0, 256))
        (tmp_path / "changed").write_bytes(changed)
        found = read_or_refused(tmp_path / "changed")
        assert not isinstance(found, str) or "\n" not in found
    assert capfd.readouterr() == ("", ""), "a library printed"


def line(text: str) -> str:
    total = 0
    for byte in text.encode():
        total ^= byte
    return f"${text}*{total:02X}"


def test_vectornav_lines(tmp_path: Path) -> None:
    _, accel, rate = motion()
    cells = [[1.0, 2.0, 3.0, 0.1, 0.2, 0.3, *accel[:, k], *rate[:, k]] for k in range(N)]
    lines = [line("VNYMR," + ",".join(f"{value:+010.5f}" for value in row)) for row in cells]
    lines[10] = lines[10].replace("+", "-", 1)  # its sum is wrong now
    lines.insert(5, "$GPZDA,093434.00,09,08,2023,00,00*6D")
    (tmp_path / "vn.txt").write_text("\r\n".join(lines) + "\r\n")
    with pytest.raises(InputError, match="no column is a time; rate_hz=HZ"):
        highside.import_recording(tmp_path / "vn.txt")
    proposal = open_foreign(tmp_path / "vn.txt", Wishes(rate_hz=RATE_HZ))
    assert proposal.table.remarks == ("1 lines fail their sum, omitted: line 12", "1 other lines passed over")
    found = recording_of(proposal).recording
    assert found.n == N - 1
    np.testing.assert_allclose(found.accel()[:, 20:], accel[:, 21:] / STANDARD_GRAVITY, rtol=0, atol=1e-5)


def test_several_tables_need_a_name(tmp_path: Path) -> None:
    t, accel, _ = motion()
    frame = pd.DataFrame({"time_s": t} | {f"acc_{a}_mps2": accel[k] for k, a in enumerate("xyz")})
    with pd.ExcelWriter(tmp_path / "x.xlsx", engine="openpyxl") as book:
        frame.to_excel(book, sheet_name="one", index=False)
        frame.iloc[:50].to_excel(book, sheet_name="two", index=False)
    with pytest.raises(InputError, match="2 of its tables hold accelerations: one, two; table="):
        highside.import_recording(tmp_path / "x.xlsx")
    assert highside.import_recording(tmp_path / "x.xlsx", table="two").n == 50


def test_a_text_in_a_sheet_is_named_by_its_row(tmp_path: Path) -> None:
    t, accel, _ = motion()
    frame = pd.DataFrame({"time_s": t} | {f"acc_{a}_mps2": accel[k] for k, a in enumerate("xyz")})
    frame = frame.astype({"acc_y_mps2": object})
    frame.loc[7, "acc_y_mps2"] = "9,81"
    frame.to_excel(tmp_path / "x.xlsx", index=False)
    with pytest.raises(InputError, match=r"row 9: acc_y_mps2: '9,81' is no number"):
        highside.import_recording(tmp_path / "x.xlsx")


def test_a_packed_matlab_file_of_zeros_is_refused(tmp_path: Path) -> None:
    packed = io.BytesIO()
    scipy.io.savemat(packed, {"t": np.zeros(4_000_000)}, do_compression=True)
    (tmp_path / "x.mat").write_bytes(packed.getvalue())
    with pytest.raises(InputError, match="more than any recording does"):
        highside.import_recording(tmp_path / "x.mat")
