"""A Recording for other programs: MCAP (Foxglove), Parquet (pandas, DuckDB and others) or plain CSV.

The libraries are the formats' own: `mcap` of the format's authors, `pyarrow` of the Apache Arrow project (extra
`export`). Values go over unchanged; a missing one is null. The file is written beside and renamed when it is whole.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from highside.errors import InputError
from highside.recording.export_format import ExportFormat
from highside.recording.files import write_whole
from highside.recording.table import Recording, Table

TOPIC = "/frame"
ROWS_AT_ONCE = 4096

Progress = Callable[[int, int], None]
"""rows done, rows in all"""

_UNITS = {
    "s": "second",
    "g": "standard gravity",
    "dps": "degree per second",
    "deg": "degree",
    "c": "degree Celsius",
    "mg": "milli-g",
}


def export(recording: Table, target: Path, to: ExportFormat, progress: Progress = lambda done, total: None) -> None:
    """Write the table. Raises InputError if the extra is not installed, if the place cannot be written, and for rows
    without times as MCAP."""
    if to is ExportFormat.CSV:
        recording.write(target)
    elif to is ExportFormat.PARQUET:
        write_whole(target, _parquet(recording, progress))
    elif isinstance(recording, Recording):
        write_whole(target, _mcap(recording, progress))
    else:
        what = "MCAP holds messages by time, and poses have none"
        raise InputError(what, where=str(target), remedy="write .csv or .parquet")
    progress(recording.n, recording.n)


def unit_of(column: str) -> str | None:
    """The unit that a column's name ends in; None for a number without one."""
    return _UNITS.get(column.rsplit("_", 1)[-1])


def _parquet(recording: Table, progress: Progress) -> bytes:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise _not_installed("parquet") from None
    fields, arrays = [], []
    for name in recording.order:
        unit = unit_of(name)
        metadata = {"unit": unit} if unit else None
        if name in recording.columns:
            array = pa.array(recording.columns[name], from_pandas=True)  # NaN becomes null
        else:
            array = pa.array(recording.texts[name])
        fields.append(pa.field(name, array.type, metadata=metadata))
        arrays.append(array)
    schema = pa.schema(fields, metadata={"producer": "highside", "source": Path(recording.source or "").name})
    table = pa.Table.from_arrays(arrays, schema=schema)
    out = io.BytesIO()
    with pq.ParquetWriter(out, schema, compression="zstd") as writer:
        step = 65_536
        for start in range(0, recording.n, step):
            writer.write_table(table.slice(start, step))
            progress(min(start + step, recording.n), recording.n)
    return out.getvalue()


def _mcap(recording: Recording, progress: Progress) -> bytes:
    try:
        from mcap.writer import Writer
    except ImportError:
        raise _not_installed("mcap") from None
    t_s = recording.t_s
    if float(t_s.min()) < 0.0 or float(t_s.max()) > 1.8e10:
        raise InputError(
            "MCAP knows times from 0 to the year 2554 alone",
            where=recording.source,
            field="t_s",
            remedy="export to parquet or csv, or shift the column",
        )
    # to the nanosecond: whole seconds apart, so that no digit is lost in a product with 1e9
    whole = np.floor(t_s)
    nanoseconds = whole.astype(np.int64) * 1_000_000_000 + np.rint((t_s - whole) * 1e9).astype(np.int64)
    properties: dict[str, dict[str, object]] = {}
    for name in recording.order:
        kind = "number" if name in recording.columns else "string"
        properties[name] = {"type": [kind, "null"]} | ({"description": unit} if (unit := unit_of(name)) else {})
    out = io.BytesIO()
    writer = Writer(out)
    writer.start(profile="", library="highside")
    schema = writer.register_schema(
        name="highside.Frame",
        encoding="jsonschema",
        data=json.dumps({"title": "highside.Frame", "type": "object", "properties": properties}).encode(),
    )
    channel = writer.register_channel(schema_id=schema, topic=TOPIC, message_encoding="json")
    writer.add_metadata("source", {"file": Path(recording.source or "").name})
    columns = [
        recording.columns[name].tolist() if name in recording.columns else list(recording.texts[name])
        for name in recording.order
    ]
    for row, (stamp, values) in enumerate(zip(nanoseconds.tolist(), zip(*columns, strict=True), strict=True)):
        message = {
            name: (None if value != value else value) for name, value in zip(recording.order, values, strict=True)
        }
        writer.add_message(
            channel_id=channel, log_time=stamp, publish_time=stamp, sequence=row, data=json.dumps(message).encode()
        )
        if row % ROWS_AT_ONCE == 0:
            progress(row, recording.n)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def _not_installed(what: str) -> InputError:
    return InputError(f"{what} needs the export libraries", remedy="pip install 'highside[export]'")
