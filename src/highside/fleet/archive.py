"""What the tools publish, kept as Parquet: a subscriber that acknowledges a message when it is on the disk.

The broker keeps what this client has not acknowledged (a session that outlives the connection, QoS 1, acknowledged by
hand), so that neither an end of this program nor of its network loses a message, as far as the broker's own queue
reaches. Delivery is at least once: a part that was written just before the end is delivered again, and `tool`, `seq`
tell the two apart:

    SELECT DISTINCT ON (tool, seq) * FROM 'archive/attitude/*/*.parquet'
"""

from __future__ import annotations

import queue
import time
import uuid
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from highside.errors import HighsideError, InputError
from highside.reading import parse_json, read_named
from highside.reading.files import CERTIFICATES_MAX
from highside.recording.files import make_directory, write_whole

__all__ = ["KINDS", "Archive", "Broker", "follow", "row_of", "table_of"]

KINDS = ("attitude", "survey")
NUMBERS = (
    "t", "t_mono", "t_device_s", "inc_deg", "inc_std_deg", "tf_deg", "tf_std_deg", "motor_toolface_deg", "azi_deg",
    "azi_std_deg", "g_total", "g_std", "temp_c", "duration_s",
)  # fmt: skip
FORMERLY = {"motor_toolface_deg": "toolface_deg"}
"""What a member was named before: a fleet may have tools of both."""
TEXTS = ("cal_id", "comp_id", "zone")
MESSAGE_MAX = 16 << 10
"""Bytes of a message: an attitude with all its members has 600"""
MOST_ROWS = 50_000
"""Rows of a part: at 100,000 messages a second half a second of them, 5 MB."""


@dataclass(frozen=True, slots=True)
class Broker:
    """Where to listen. `name` is the client's: the broker keeps for that name what came in its absence."""

    host: str = "127.0.0.1"
    port: int = 1883
    prefix: str = "highside"
    name: str = "highside-archive"
    username: str | None = None
    password: str | None = None
    ca: Path | None = None


def row_of(topic: str, payload: bytes) -> tuple[str, dict[str, Any]] | None:
    """Kind and row of a message; None for one that is not to be kept. Raises InputError for a damaged one."""
    tool, _, kind = topic.rpartition("/")
    if kind not in KINDS:
        return None
    said = parse_json(payload, where=topic, max_bytes=MESSAGE_MAX)
    # `true` is a whole number to Python, and none to a column
    if not isinstance(said, dict) or type(said.get("seq")) is not int or not 0 <= said["seq"] < 1 << 63:
        raise InputError("has no sequence number", where=topic)
    row: dict[str, Any] = {"tool": tool.rpartition("/")[2], "seq": said["seq"]}
    for name in NUMBERS:
        value = said.get(name, said.get(FORMERLY.get(name, "")))
        row[name] = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
    row |= {name: said[name] if isinstance(said.get(name), str) else None for name in TEXTS}
    flags = said.get("flags")
    row["flags"] = [flag for flag in flags if isinstance(flag, str)] if isinstance(flags, list) else []
    row["accepted"] = said.get("accepted") if isinstance(said.get("accepted"), bool) else None
    row["historical"] = bool(said.get("historical"))
    return kind, row


def table_of(rows: Iterable[dict[str, Any]]) -> Any:
    """Rows of one kind as an Arrow table: of what `row_of` made, there is one."""
    import pyarrow as pa

    fields = [("tool", pa.string()), ("seq", pa.int64()), *((name, pa.float64()) for name in NUMBERS)]
    fields += [*((name, pa.string()) for name in TEXTS), ("flags", pa.list_(pa.string()))]
    schema = pa.schema([*fields, ("accepted", pa.bool_()), ("historical", pa.bool_())])
    return pa.Table.from_pylist([*rows], schema=schema)


@dataclass
class Archive:
    """Rows that wait for their part, below a folder: `KIND/DATE/*.parquet`."""

    folder: Path
    rows: dict[str, dict[tuple[str, int], dict[str, Any]]] = field(default_factory=dict)
    kept: int = 0
    damaged: int = 0

    def take(self, topic: str, payload: bytes) -> None:
        """A message; a damaged one is counted."""
        try:
            found = row_of(topic, payload)
        except HighsideError:
            self.damaged += 1
            return
        if found is not None:
            kind, row = found
            self.rows.setdefault(kind, {})[row["tool"], row["seq"]] = row

    def flush(self) -> None:
        """Write what waits, whole or not at all. Raises OSError."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        for kind, rows in self.rows.items():
            if not rows:
                continue
            folder = self.folder / kind / time.strftime("%Y-%m-%d", time.gmtime())
            make_directory(folder)
            sink = pa.BufferOutputStream()
            pq.write_table(table_of(rows.values()), sink, compression="zstd")
            write_whole(folder / f"{uuid.uuid4().hex}.parquet", sink.getvalue().to_pybytes())
            self.kept += len(rows)
            rows.clear()


def follow(broker: Broker, archive: Archive, every_s: float, ended: Callable[[], bool]) -> None:
    """Keep what comes until `ended`, a part each `every_s` seconds. Raises InputError where no broker answers, OSError
    where nothing can be written: what was not kept stays with the broker."""
    came: queue.Queue[mqtt.MQTTMessage] = queue.Queue()
    client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id=broker.name, clean_session=False, manual_ack=True)
    if broker.username is not None:
        client.username_pw_set(broker.username, broker.password)
    if broker.ca is not None:
        read_named(broker.ca, "--ca", max_bytes=CERTIFICATES_MAX)
        try:
            client.tls_set(str(broker.ca))
        except (OSError, ValueError) as error:
            raise InputError(
                f"is no certificate that can be used ({error})", where=str(broker.ca), field="--ca",
                remedy="give a PEM file",
            ) from None  # fmt: skip
    client.on_message = lambda _client, _data, message: came.put(message)
    topics = [(f"{broker.prefix}/+/{kind}", 1) for kind in KINDS]
    client.on_connect = lambda connected, *_: connected.subscribe(topics)
    try:
        client.connect(broker.host, broker.port, keepalive=30)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be reached: {error}", where=f"{broker.host}:{broker.port}", field="--host") from None
    client.loop_start()
    try:
        while not ended():
            _part(client, came, archive, time.monotonic() + every_s, ended)
    finally:
        client.disconnect()
        client.loop_stop()


def _part(
    client: mqtt.Client,
    came: queue.Queue[mqtt.MQTTMessage],
    archive: Archive,
    until: float,
    ended: Callable[[], bool],
) -> None:
    taken: list[mqtt.MQTTMessage] = []
    while len(taken) < MOST_ROWS and (left := until - time.monotonic()) > 0 and not ended():
        try:
            taken.append(came.get(timeout=min(left, 0.2)))
        except queue.Empty:
            continue
        try:
            topic = taken[-1].topic
        except UnicodeDecodeError:
            archive.damaged += 1
        else:
            archive.take(topic, bytes(taken[-1].payload))
    archive.flush()
    for message in taken:
        client.ack(message.mid, message.qos)
