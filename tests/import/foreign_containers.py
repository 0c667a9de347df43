"""Files that are no text, as the libraries of their own programs write them."""

from __future__ import annotations

import io
import json
import struct
import tempfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.parquet as pq
import scipy.io
from foreign_session import Session
from foreign_texts import AXES, frame
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

IMU = "sensor_msgs/msg/Imu"


def excel_xlsx(s: Session) -> bytes:
    """A workbook with a sheet of remarks before the sheet with the data; times as Excel's own dates (to the ms)."""
    out = io.BytesIO()
    table = frame(s, "Accel {} (m/s²)", "Gyro {} (rad/s)", Time=pd.to_datetime(s.ns))
    with pd.ExcelWriter(out, engine="openpyxl") as book:
        pd.DataFrame({"remark": ["made by hand"]}).to_excel(book, sheet_name="notes", index=False)
        table.to_excel(book, sheet_name="data", index=False)
    return out.getvalue()


def pandas_parquet(s: Session) -> bytes:
    """`DataFrame.to_parquet` with a DatetimeIndex: the index is a column `time`, units only in the names."""
    table = frame(s, "imu.acc.{} [m/s2]", "imu.gyr.{} [rad/s]", time=pd.to_datetime(s.ns)).set_index("time")
    out = io.BytesIO()
    pq.write_table(pa.Table.from_pandas(table), out)
    return out.getvalue()


def arrow_feather(s: Session) -> bytes:
    """Feather, as Arrow's own libraries write it: seconds and g, units in the names, 32-bit floats."""
    names = ["t [s]", *(f"acc_{a} [g]" for a in AXES), *(f"gyr_{a} [dps]" for a in AXES)]
    columns = [pa.array(s.t_s), *(pa.array(v.astype(np.float32)) for v in (*s.accel_g, *s.rate_dps))]
    out = io.BytesIO()
    feather.write_feather(pa.table(dict(zip(names, columns, strict=True))), out)
    return out.getvalue()


def numpy_archive(s: Session) -> bytes:
    """`numpy.savez`: arrays (N, 3) `acc` and `gyr` without units, and the rate as a number."""
    out = io.BytesIO()
    np.savez_compressed(out, acc=s.accel_mps2.T, gyr=s.rate_rads.T, fs=50.0)
    return out.getvalue()


def matlab_structure(s: Session) -> bytes:
    """MATLAB's `save` (version 5) of a structure."""
    out = io.BytesIO()
    scipy.io.savemat(out, {"imu": {"time_s": s.t_s, "acc_mps2": s.accel_mps2.T, "gyr_rads": s.rate_rads.T}})
    return out.getvalue()


def hdf5_units(s: Session) -> bytes:
    """h5py with the attribute `units`, groups for each sensor."""
    out = io.BytesIO()
    with h5py.File(out, "w") as file:
        for name, values, unit in (
            ("time", s.t_s, "s"),
            ("imu/acc", s.accel_g.T, "g"),
            ("imu/gyro", s.rate_dps.T, "deg/s"),
        ):
            file.create_dataset(name, data=values, compression="gzip").attrs["units"] = unit
    return out.getvalue()


def px4_ulog(s: Session) -> bytes:
    """PX4's logger, topic `sensor_combined` (ULog, message definitions of PX4)."""

    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<Hc", len(content), kind) + content

    form = b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1000) + message(b"F", form)
    out += message(b"A", struct.pack("<BH", 0, 7) + b"sensor_combined")
    for k in range(s.n):
        stamp = 1000 + round(s.t_s[k] * 1e6)
        out += message(b"D", struct.pack("<HQ6f", 7, stamp, *s.rate_rads[:, k], *s.accel_mps2[:, k]))
    return out


def ardupilot_bin(s: Session) -> bytes:
    """ArduPilot's dataflash log: descriptions of the messages, then `IMU` in us, rad/s and m/s2."""

    def described(number: int, length: int, name: bytes, letters: bytes, labels: bytes) -> bytes:
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, length, name, letters, labels)

    out = described(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    out += described(130, 38, b"IMU", b"QBffffffc", b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T")
    for k in range(s.n):
        cells = (1000 + round(s.t_s[k] * 1e6), 0, *s.rate_rads[:, k], *s.accel_mps2[:, k], round(100 * s.temp_c[k]))
        out += b"\xa3\x95\x82" + struct.pack("<QB6fh", *cells)
    return out


def ardupilot_text(s: Session) -> bytes:
    """The text that Mission Planner and `mavlogdump` make of it."""
    out = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
           "FMT, 130, 40, IMU, QffffffcB, TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T,I"]  # fmt: skip
    for k in range(s.n):
        numbers = [f"{value:.7f}" for value in (*s.rate_rads[:, k], *s.accel_mps2[:, k])]
        out.append(", ".join(["IMU", str(1000 + round(s.t_s[k] * 1e6)), *numbers, f"{s.temp_c[k]}", "0"]))
    return ("\n".join(out) + "\n").encode()


def ros_messages(s: Session, *, ros1: bool) -> list[tuple[int, bytes]]:
    """(ns since 1970, serialised `sensor_msgs/Imu`) of each row."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types = store.types
    vector, none = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    found = []
    for k in range(s.n):
        ns = int(s.ns[k])
        stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        extra: dict[str, Any] = {"seq": k} if ros1 else {}
        imu = types[IMU](
            types["std_msgs/msg/Header"](stamp=stamp, frame_id="imu", **extra),
            types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), none, vector(*s.rate_rads[:, k]), none,
            vector(*s.accel_mps2[:, k]), none,
        )  # fmt: skip
        found.append((ns, bytes(store.serialize_ros1(imu, IMU) if ros1 else store.serialize_cdr(imu, IMU))))
    return found


def ros1_bag(s: Session) -> bytes:
    """`rosbag record /imu/data`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.bag"
        with BagWriter(path) as bag:
            connection = bag.add_connection("/imu/data", IMU, typestore=get_typestore(Stores.ROS1_NOETIC))
            for ns, raw in ros_messages(s, ros1=True):
                bag.write(connection, ns, raw)
        return path.read_bytes()


def ros2_mcap(s: Session) -> bytes:
    """`ros2 bag record -s mcap /imu/data`: messages in CDR, written 5 ms after their own stamp."""
    out = io.BytesIO()
    writer = McapWriter(out)
    writer.start(profile="ros2", library="rosbag2")
    schema = writer.register_schema(name=IMU, encoding="ros2msg", data=b"")
    channel = writer.register_channel(schema_id=schema, topic="/imu/data", message_encoding="cdr")
    for ns, raw in ros_messages(s, ros1=False):
        writer.add_message(channel_id=channel, log_time=ns + 5_000_000, publish_time=ns, data=raw)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def foxglove_json(s: Session) -> bytes:
    """MCAP with messages in JSON, as Foxglove's libraries for browsers write them: stamps of `sec` and `nsec`."""
    out = io.BytesIO()
    writer = McapWriter(out)
    writer.start(profile="", library="foxglove")
    schema = writer.register_schema(name="Imu", encoding="jsonschema", data=b"{}")
    channel = writer.register_channel(schema_id=schema, topic="/imu", message_encoding="json")
    for k in range(s.n):
        ns = int(s.ns[k])
        value = {
            "timestamp": {"sec": ns // 10**9, "nsec": ns % 10**9},
            "linear_acceleration": dict(zip(AXES, s.accel_mps2[:, k].tolist(), strict=True)),
            "angular_velocity": dict(zip(AXES, s.rate_rads[:, k].tolist(), strict=True)),
        }
        writer.add_message(channel, log_time=ns + 2_000_000, publish_time=ns, data=json.dumps(value).encode())
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def _imu_of_protobuf() -> tuple[bytes, Any]:
    """(schema, class) of a message with a stamp and two vectors, as `protoc` would make them."""
    file = descriptor_pb2.FileDescriptorProto(name="imu.proto", package="own", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    vector = file.message_type.add(name="Vector3")
    for number, axis in enumerate(AXES, 1):
        vector.field.add(name=axis, number=number, type=1, label=1)
    imu = file.message_type.add(name="Imu")
    names = {"timestamp": ".google.protobuf.Timestamp", "linear_acceleration": ".own.Vector3"}
    for number, (name, kind) in enumerate((names | {"angular_velocity": ".own.Vector3"}).items(), 1):
        imu.field.add(name=name, number=number, type=11, label=1, type_name=kind)
    stamp = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamp)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(stamp)
    pool.Add(file)
    schema = descriptor_pb2.FileDescriptorSet(file=[stamp, file]).SerializeToString()
    return schema, message_factory.GetMessageClass(pool.FindMessageTypeByName("own.Imu"))


def protobuf_mcap(s: Session) -> bytes:
    """MCAP with messages in protobuf, which carry their own description."""
    description, kind = _imu_of_protobuf()
    out = io.BytesIO()
    writer = McapWriter(out)
    writer.start(profile="", library="own")
    schema = writer.register_schema(name="own.Imu", encoding="protobuf", data=description)
    channel = writer.register_channel(schema_id=schema, topic="/imu", message_encoding="protobuf")
    for k in range(s.n):
        ns, message = int(s.ns[k]), kind()
        message.timestamp.seconds, message.timestamp.nanos = ns // 10**9, ns % 10**9
        for vector, values in (("linear_acceleration", s.accel_mps2), ("angular_velocity", s.rate_rads)):
            for axis, value in zip(AXES, values[:, k], strict=True):
                setattr(getattr(message, vector), axis, float(value))
        writer.add_message(channel, log_time=ns + 2_000_000, publish_time=ns, data=message.SerializeToString())
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def ros2_db3(s: Session) -> bytes:
    """`ros2 bag record /imu/data /encoder` with the storage `sqlite3`; the encoder as `std_msgs/Float64` in deg."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        with Ros2Writer(path, version=9) as bag:
            imu = bag.add_connection("/imu/data", IMU, typestore=store)
            encoder = bag.add_connection("/encoder", "std_msgs/msg/Float64", typestore=store)
            angle = store.types["std_msgs/msg/Float64"]
            for (ns, raw), tf_deg in zip(ros_messages(s, ros1=False), s.tf_deg, strict=True):
                bag.write(imu, ns, raw)
                bag.write(encoder, ns, bytes(store.serialize_cdr(angle(float(tf_deg)), "std_msgs/msg/Float64")))
        (file,) = path.glob("*.db3")
        return file.read_bytes()


def labview_tdms(s: Session) -> bytes:
    """The beginning of LabVIEW's TDMS, whose raw data need its own library."""
    return b"TDSm\x0e\x00\x00\x00\x69\x12\x00\x00" + struct.pack("<QQ", 24 * s.n, 0) + s.accel_g.tobytes()


def old_excel(s: Session) -> bytes:
    """The beginning of a workbook of Excel 97 (`.xls`), a compound file of OLE 2."""
    return b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(504) + s.accel_g.tobytes()
