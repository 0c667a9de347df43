"""Messages of robots and autopilots: PX4 ULog (pyulog), ROS 1 bags and `sensor_msgs/Imu` (rosbags).

The types define what their fields are and in which units: m/s2 and rad/s. Values are held against that all the same.
"""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from highside.errors import InputError
from highside.importing.core.source import SourceColumn, SourceTable, number_column
from highside.importing.forms.missing import damaged, not_installed
from highside.reading.expansion import bounded_unpacking
from highside.reading.files import allowed_bytes
from highside.reading.table import MAX_COLUMNS

ULOG = b"ULog\x01\x12\x35"
ROSBAG = b"#ROSBAG V2.0"
IMU = "sensor_msgs/msg/Imu"
_AXES = "xyz"
_DEEPEST = 16
"""types within types"""
_ULOG_TRIADS = {
    "sensor_combined": (("accelerometer_m_s2[{}]", "a"), ("gyro_rad[{}]", "g")),
    "sensor_accel": (("{}", "a"),),
    "sensor_gyro": (("{}", "g"),),
    "vehicle_acceleration": (("xyz[{}]", "a"),),
    "vehicle_angular_velocity": (("xyz[{}]", "g"),),
}
"""topic of PX4 to the fields of its triads"""
_UNITS = {"a": "m/s2", "g": "rad/s"}
_OURS = {"a": "a{}_g", "g": "g{}_dps"}


class _Bounded(io.BytesIO):
    """Bytes that end a reader which goes back again and again, as pyulog does where the last message is cut.

    Of a whole file each byte is read once; a reader that looks for the next message moves on by a byte with two reads.
    """

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self._reads = 4 * len(data) + 1000

    def read(self, size: int | None = -1, /) -> bytes:
        """As of any file. Raises EOFError where a whole file would long have been read."""
        self._reads -= 1
        if self._reads < 0:
            raise EOFError("cut within a message")
        return super().read(size)


def _bounded_ulog(library: Any, where: str) -> Any:
    """The library's reader, which makes a field of each member of each array of each type within a type."""

    class Described(library._MessageAddLogged):  # type: ignore[misc]
        def _parse_nested_type(self, prefix_str: str, type_name: str, message_formats: Any) -> None:
            here = sum(max(1, size) for _, size, _ in message_formats[type_name].fields)
            if len(self.field_data) + here > MAX_COLUMNS or prefix_str.count(".") > _DEEPEST:
                what = f"a topic of more than {MAX_COLUMNS} fields, or of types more than {_DEEPEST} deep"
                raise InputError(what, where=where, field=self.message_name[:40], remedy="give the right file")
            super()._parse_nested_type(prefix_str, type_name, message_formats)

    class Bounded(library):  # type: ignore[misc]
        _MessageAddLogged = Described

    return Bounded


def read_ulog(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """One table a topic of a PX4 log. Raises InputError."""
    try:
        from pyulog import ULog
    except ImportError:
        raise not_installed("pyulog", where) from None
    try:
        # the library prints what it thinks of a file
        with contextlib.redirect_stdout(io.StringIO()):
            log = _bounded_ulog(ULog, where)(_Bounded(data))
        if log.file_corruption:
            raise InputError("is a damaged ULog file", where=where, remedy="give the whole file")
        found = [(topic.name, int(topic.multi_id), dict(topic.data)) for topic in log.data_list]
        dropped = len(log.dropouts)
    except (InputError, MemoryError):
        raise
    except Exception as error:
        raise damaged("ULog", error, where) from None
    remarks = (f"the logger itself dropped data {dropped} times",) if dropped else ()
    tables = tuple(_topic(name, multi, arrays, where, remarks) for name, multi, arrays in found if arrays)
    if not tables:
        raise InputError("holds no topic with data", where=where)
    return tables


def _topic(name: str, multi: int, arrays: dict[str, Any], where: str, remarks: tuple[str, ...]) -> SourceTable:
    units, hints = {"timestamp": "us"}, {"t_s": "timestamp"}
    for pattern, kind in _ULOG_TRIADS.get(name, ()):
        for k, axis in enumerate(_AXES):
            field = pattern.format(k if "[" in pattern else axis)
            if field in arrays:
                units[field] = _UNITS[kind]
                hints[_OURS[kind].format(axis)] = field
    if "temperature" in arrays:
        units["temperature"] = "C"
    columns = tuple(
        number_column(field, np.asarray(values), units.get(field))
        for field, values in arrays.items()
        if np.asarray(values).dtype.kind in "iuf"
    )
    title = f"{name}/{multi}" if multi else name
    return SourceTable(columns, f"PX4 ULog, topic {title}", where, title, remarks=remarks, hints=hints)


class _Held:
    """A path to bytes that are there already. A file would give the library as much memory as a damaged header asks
    for, up to 4 GiB at a time; bytes give what they have."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def open(self, _mode: str) -> io.BytesIO:
        return io.BytesIO(self._data)


def read_rosbag(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """One table a topic of `sensor_msgs/Imu` in a ROS 1 bag. Raises InputError."""
    try:
        from rosbags.rosbag1 import Reader
    except ImportError:
        raise not_installed("rosbags", where) from None
    topics: dict[str, list[Any]] = {}
    others: set[str] = set()
    size = 0
    try:
        store = ros_store("ros1")
        reader: Any = Reader(Path(__file__))
        reader.path = _Held(data)
        with reader as bag:
            for place, chunk in list(bag.chunks.items()):
                unpack = bounded_unpacking(chunk.decompressor, len(data), where)
                bag.chunks[place] = chunk._replace(decompressor=unpack)
            for connection, _, raw in bag.messages():
                size += len(raw)
                if size > allowed_bytes():
                    raise InputError("expands to more than a file may have", where=where, remedy="split the bag")
                if connection.msgtype == IMU:
                    topics.setdefault(connection.topic, []).append(store.deserialize_ros1(raw, IMU))
                else:
                    others.add(f"{connection.topic} ({connection.msgtype})")
    except (InputError, MemoryError):
        raise
    except Exception as error:
        raise damaged("ROS bag", error, where) from None
    return _imu_tables(topics, others, "ROS 1 bag", where)


def ros_store(encoding: str) -> Any:
    """The types of ROS 1 or 2 that are known without a definition."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)


def _imu_tables(topics: dict[str, list[Any]], others: set[str], form: str, where: str) -> tuple[SourceTable, ...]:
    if not topics:
        listed = ", ".join(sorted(others)[:8]) or "nothing"
        raise InputError(f"holds no sensor_msgs/Imu; it has {listed}", where=where, remedy="export it as CSV")
    return tuple(imu_table(topic, found, form, where) for topic, found in topics.items())


def imu_table(topic: str, found: list[Any], form: str, where: str) -> SourceTable:
    """The table of a topic of `sensor_msgs/Imu`; `found` are its messages."""
    ns = np.array([m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for m in found], dtype=np.int64)
    columns = [SourceColumn("header.stamp", ns.astype(np.float64), integers=ns, instant=True)]
    hints = {"t_s": "header.stamp"}
    for field, kind in (("linear_acceleration", "a"), ("angular_velocity", "g")):
        for axis in _AXES:
            name = f"{field}.{axis}"
            values = np.array([getattr(getattr(m, field), axis) for m in found], dtype=np.float64)
            columns.append(number_column(name, values, _UNITS[kind]))
            hints[_OURS[kind].format(axis)] = name
    return SourceTable(tuple(columns), f"{form}, topic {topic}", where, topic, hints=hints)
