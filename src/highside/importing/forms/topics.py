"""Topics of containers (MCAP, bags of ROS 2): messages in JSON, protobuf or as ROS writes them, a table for each topic.

`sensor_msgs/Imu` is read by its definition (`messages`); of any other message each number is a column, named by its
path. The time of a message that carries none is the one at which it was written.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from highside.errors import InputError
from highside.importing.core.source import SourceColumn, SourceTable
from highside.importing.core.units import Quantity
from highside.importing.core.words import meaning
from highside.importing.forms.messages import IMU, imu_table, ros_store
from highside.importing.forms.missing import damaged, not_installed
from highside.reading import parse_json
from highside.reading.columnar import McapMessage, column_of, flattened, mcap_messages
from highside.reading.table import MAX_COLUMNS

SQLITE = b"SQLite format 3\0"
WRITTEN_AT = "log_time"
"""column: when the message was written, ns since 1970"""
_LONGEST = 9
"""numbers of one list that are taken apart"""

_FIXED = re.compile(rb"\[\s*([0-9]+)\s*\]")
_DIGITS = 12
_LONGEST_FIXED = 1000
"""members of an array of a fixed length: one of 1,000 texts takes 1 s (rosbags 0.10), a covariance has 36"""
_WHOLE = re.compile("-?[0-9]{1,19}")
"""as whole numbers of 64 bits are written"""

Decoder = Callable[[bytes], dict[str, Any]]


def read_mcap_topics(data: bytes, where: str) -> tuple[SourceTable, ...]:
    """The tables of an MCAP file. Raises InputError where no topic can be read, with what there is."""
    return _tables(mcap_messages(data, where=where), "MCAP", where)


def read_db3(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The tables of a bag of ROS 2 in SQLite (`.db3`). Raises InputError."""
    try:
        from rosbags.rosbag2 import Reader
    except ImportError:
        raise not_installed("rosbags", where) from None

    def messages(path: Path) -> Iterator[McapMessage]:
        with Reader(path) as bag:
            for connection, time_ns, raw in bag.messages():
                definition = connection.msgdef.data.encode()
                yield McapMessage(connection.topic, "cdr", connection.msgtype, "ros2msg", definition, time_ns, raw)

    # the library opens files by name alone
    with TemporaryDirectory() as folder:
        path = Path(folder) / "x.db3"
        path.write_bytes(data)
        try:
            return _tables(messages(path), "ROS 2 bag", where)
        except (InputError, MemoryError):
            raise
        except Exception as error:
            raise damaged("ROS 2 bag", error, where) from None


def bag_within(path: Path) -> Path:
    """The one storage file of a folder that `ros2 bag record` wrote; the path itself where it is no such folder.

    Raises InputError for a bag of several files.
    """
    try:
        if not (path.is_dir() and (path / "metadata.yaml").is_file()):
            return path
        found = sorted(file for file in path.iterdir() if file.suffix in (".db3", ".mcap"))
    except OSError:
        return path  # whoever opens it says why not
    if len(found) != 1:
        raise InputError(
            f"is a bag of {len(found)} files", where=str(path), remedy="give one of them, or make one bag of them"
        )
    return found[0]


def _tables(messages: Iterable[McapMessage], form: str, where: str) -> tuple[SourceTable, ...]:
    decoders: dict[str, Decoder | None] = {}
    rows: dict[str, list[Any]] = {}
    kinds: dict[str, str] = {}
    others: dict[str, None] = {}
    for message in messages:
        topic = message.topic
        if topic not in decoders:
            decoders[topic] = _decoder(message, where)
            kinds[topic] = "sensor_msgs/Imu" if _is_imu(message) else {"json": "JSON"}.get(
                message.encoding, message.schema_name or message.encoding
            )  # fmt: skip
        decode = decoders[topic]
        if decode is None:
            others[f"{topic} ({message.schema_name or message.encoding})"] = None
            continue
        try:
            value = decode(message.data)
        except (InputError, MemoryError):
            raise
        except Exception as error:
            raise damaged(form, error, where) from None
        rows.setdefault(topic, []).append(value if _is_imu(message) else value | {WRITTEN_AT: message.log_time_ns})
    if not rows:
        listed = ", ".join(list(others)[:8])
        what = f"holds no message that can be read; it has {listed}" if listed else "holds no message"
        raise InputError(what, where=where, remedy="JSON, protobuf and messages of ROS are read; else export it as CSV")
    return tuple(
        imu_table(topic, found, f"{form}, sensor_msgs/Imu", where)
        if kinds[topic] == "sensor_msgs/Imu"
        else _table(topic, found, f"{form}, {kinds[topic]}", where)
        for topic, found in rows.items()
    )


def _ros_name(message: McapMessage) -> str:
    return message.schema_name.replace("/msg/", "/").replace("/", "/msg/")


def _is_imu(message: McapMessage) -> bool:
    return message.encoding in ("cdr", "ros1") and _ros_name(message) == IMU


def _decoder(message: McapMessage, where: str) -> Decoder | None:
    """What turns the bytes of a topic's messages into values by name; for an Imu into the message itself. None for
    what cannot be read."""
    if message.encoding == "json":
        return lambda data: _object(data, message.topic, where)
    if message.encoding == "protobuf":
        return _protobuf(message, where)
    if message.encoding in ("cdr", "ros1"):
        return _ros(message, where)
    return None


def _object(data: bytes, topic: str, where: str) -> dict[str, Any]:
    value = parse_json(data, where=f"{where}: {topic}")
    if not isinstance(value, dict):
        raise InputError("holds a message that is no object with fields", where=where, field=topic)
    return {name: _stamped(inner) for name, inner in value.items()}


def _stamped(value: Any) -> Any:
    """`{"sec": 1, "nsec": 5}` of Foxglove's messages as whole nanoseconds."""
    if not isinstance(value, dict):
        return value
    rest = value.keys() - {"sec"}
    if "sec" in value and rest in ({"nsec"}, {"nanosec"}) and all(type(part) is int for part in value.values()):
        return value["sec"] * 1_000_000_000 + value[rest.pop()]
    return {name: _stamped(inner) for name, inner in value.items()}


def _protobuf(message: McapMessage, where: str) -> Decoder | None:
    """By the `FileDescriptorSet` that the schema is (MCAP, well-known encodings)."""
    try:
        from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
    except ImportError:
        raise not_installed("protobuf", where) from None
    pool = descriptor_pool.DescriptorPool()
    try:
        for file in descriptor_pb2.FileDescriptorSet.FromString(message.schema).file:
            pool.Add(file)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(message.schema_name))
    except Exception as error:
        raise damaged("MCAP", error, where) from None

    def decode(data: bytes) -> dict[str, Any]:
        found: dict[str, Any] = json_format.MessageToDict(
            kind.FromString(data), preserving_proto_field_name=True, always_print_fields_with_no_presence=True
        )
        return found

    return decode


def _ros(message: McapMessage, where: str) -> Decoder | None:
    name, imu = _ros_name(message), _is_imu(message)
    try:
        store = ros_store(message.encoding)
        if name not in store.types and message.schema_encoding in ("ros2msg", "ros1msg") and message.schema:
            from rosbags.typesys import get_types_from_msg

            _refuse_long_arrays(message, where)
            store.register({
                kind: fields
                for kind, fields in get_types_from_msg(message.schema.decode(), name).items()
                if kind not in store.types
            })  # fmt: skip
    except ImportError:
        raise not_installed("rosbags", where) from None
    except InputError:
        raise
    except Exception as error:
        raise damaged("MCAP", error, where) from None
    if name not in store.types:
        return None
    read = store.deserialize_cdr if message.encoding == "cdr" else store.deserialize_ros1
    return (lambda data: read(data, name)) if imu else (lambda data: _fields(read(data, name)))


def _refuse_long_arrays(message: McapMessage, where: str) -> None:
    """The library writes a piece of program for each member of an array of a fixed length."""
    longest = max((int(size[:_DIGITS]) for size in _FIXED.findall(message.schema)), default=0)
    if longest > _LONGEST_FIXED:
        raise InputError(
            f"is described with arrays of {longest}, more than {_LONGEST_FIXED}", where=where, field=message.topic,
            remedy="record it without that topic, or export it as CSV",
        )  # fmt: skip


def _fields(value: Any) -> dict[str, Any]:
    """A message of ROS as values by name; its stamps as whole nanoseconds."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(value):
        inner = getattr(value, field.name)
        if hasattr(inner, "sec") and hasattr(inner, "nanosec"):
            found[field.name] = inner.sec * 1_000_000_000 + inner.nanosec
        elif dataclasses.is_dataclass(inner):
            found[field.name] = _fields(inner)
        elif isinstance(inner, np.ndarray):
            found[field.name] = inner[:_LONGEST].tolist()
        elif isinstance(inner, int | float | str):
            found[field.name] = inner
    return found


def _table(topic: str, rows: list[dict[str, Any]], form: str, where: str) -> SourceTable:
    """One row a message."""
    flat = [dict(flattened(row)) for row in rows]
    names = dict.fromkeys(name for row in flat for name in row)
    if len(names) > MAX_COLUMNS:
        raise InputError(f"has more than {MAX_COLUMNS} fields", where=where, field=topic, remedy="give the right file")
    columns = [
        SourceColumn(c.name, c.numbers, c.texts, c.integers, instant=name == WRITTEN_AT)
        for name in names
        for c in [column_of(name, [_number(row.get(name)) for row in flat], where)]
    ]
    times = [c.name for c in columns if meaning(c.name, None, frozenset()).quantity is Quantity.TIME]
    if times != [WRITTEN_AT]:
        # the time at which it was measured goes before that at which it was written
        columns = [column for column in columns if column.name != WRITTEN_AT]
    return SourceTable(tuple(columns), f"{form}, topic {topic}", where, topic)


def _number(value: Any) -> Any:
    """Whole numbers of 64 bits are texts in protobuf's JSON."""
    if isinstance(value, str) and _WHOLE.fullmatch(value):
        return int(value)
    return value
