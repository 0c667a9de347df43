"""Columns of Parquet, Arrow and MCAP files from bytes, within the limits of all files.

The libraries are the formats' own (extra `export`), imported when such a file is met.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.errors import InputError
from highside.reading.arrow_size import FILE_MARK_BYTES, unpacked_bytes
from highside.reading.documents import parse_json
from highside.reading.expansion import refuse_expansion
from highside.reading.files import allowed_bytes
from highside.reading.mcap_size import unpacked_chunks
from highside.reading.parquet_size import group_bytes, row_groups
from highside.reading.table import MAX_COLUMNS

PARQUET_MAGIC = b"PAR1"
ARROW_MAGIC = b"ARROW1"
MCAP_MAGIC = b"\x89MCAP0\r\n"
_CELL_BYTES = 8
_SHOWN = 120
_WHOLE_MOST = 1 << 63


@dataclass(frozen=True, slots=True)
class ReadColumn:
    """One column: `numbers` (N,) with NaN where missing, or texts; `integers` where all are whole and there, and then
    `instant` marks nanoseconds since 1970. `unit`: what the file says of it."""

    name: str
    numbers: NDArray[np.float64] | None
    texts: tuple[str, ...] | None = None
    integers: NDArray[np.int64] | None = None
    unit: str | None = None
    instant: bool = False


@dataclass(frozen=True, slots=True)
class McapMessage:
    """A message of an MCAP file, its content as bytes."""

    topic: str
    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes
    log_time_ns: int
    data: bytes


def parquet_columns(data: bytes, *, where: str) -> list[ReadColumn]:
    """The columns of a Parquet file. Raises InputError for what is damaged or too large."""
    pq = _library("pyarrow.parquet", where)

    def read() -> list[ReadColumn]:
        meta = pq.read_metadata(io.BytesIO(data))
        _fits(meta.num_rows, meta.num_columns, len(data), where)
        groups, pages = row_groups(lambda at, size: data[at : at + size], len(data)), 0
        refuse_expansion(sum(group.stated_bytes for group in groups), len(data), where=where)
        for group in groups:
            pages += group_bytes(group, lambda at, size: data[at : at + size])
            refuse_expansion(pages, len(data), where=where)
        leaves = [meta.schema.column(k) for k in range(meta.num_columns)]
        # a text that stands once in the file stands once in the memory
        texts = [leaf.path for leaf in leaves if leaf.physical_type == "BYTE_ARRAY" and leaf.max_repetition_level == 0]
        table = pq.ParquetFile(io.BytesIO(data), read_dictionary=texts).read()
        return _table(_checked(table, len(data), where), where)

    return _guarded(read, "Parquet", where)


def arrow_columns(data: bytes, *, where: str) -> list[ReadColumn]:
    """The columns of an Arrow (Feather) file. Raises InputError for what is damaged or too large."""
    pa = _library("pyarrow", where)

    def read() -> list[ReadColumn]:
        buffer = pa.py_buffer(data)
        refuse_expansion(unpacked_bytes(buffer), len(data), where=where)
        # the stream between the file's marks: the messages that were just looked at, and no others
        table = pa.ipc.open_stream(buffer.slice(FILE_MARK_BYTES)).read_all()
        return _table(_checked(table, len(data), where), where)

    return _guarded(read, "Arrow", where)


def _checked(table: Any, size: int, where: str) -> Any:
    """A table whose values are what its types say, and whose texts are not too long all together."""
    import pyarrow as pa
    import pyarrow.compute as pc

    _fits(table.num_rows, table.num_columns, size, where)
    table.validate(full=True)
    texts = 0
    for column in table.columns:
        if pa.types.is_dictionary(column.type) and _is_text(column.type.value_type):
            for chunk in column.chunks:
                lengths = pc.binary_length(chunk.dictionary).take(chunk.indices)
                texts += pc.sum(pc.cast(lengths, pa.int64())).as_py() or 0
    refuse_expansion(texts, size, where=where)
    return table


def _is_text(kind: Any) -> bool:
    from pyarrow import types

    return bool(types.is_string(kind) or types.is_large_string(kind))


def mcap_messages(data: bytes, *, where: str) -> Iterator[McapMessage]:
    """The messages of an MCAP file in the order of their time. Raises InputError for what is damaged."""
    reader = _library("mcap.reader", where)
    limit = allowed_bytes()
    try:
        unpacked, chunks = unpacked_chunks(data)
        refuse_expansion(unpacked, len(data), where=where)
        opened = reader.SeekingReader(io.BytesIO(data), validate_crcs=True, record_size_limit=limit)
        summary = opened.get_summary()
        if summary is not None and not chunks.issuperset(index.chunk_start_offset for index in summary.chunk_indexes):
            raise ValueError("its index names a chunk that is not there")
        size = 0
        for schema, channel, message in opened.iter_messages():
            size += len(message.data)
            refuse_expansion(size, len(data), where=where)
            yield McapMessage(
                channel.topic,
                channel.message_encoding,
                schema.name if schema else "",
                schema.encoding if schema else "",
                schema.data if schema else b"",
                message.log_time,
                message.data,
            )
    except InputError:
        raise
    except Exception as error:
        raise _damaged("MCAP", error, where) from None


def mcap_json_columns(data: bytes, *, where: str, topic: str | None = None) -> list[ReadColumn]:
    """The fields of the JSON messages of an MCAP file (of one topic, if it is given) as columns.

    Raises InputError for a message that is no flat object, and where no message is JSON.
    """
    names: dict[str, None] = {}
    rows: list[dict[str, Any]] = []
    for message in mcap_messages(data, where=where):
        if message.encoding != "json" or (topic is not None and message.topic != topic):
            continue
        value = parse_json(message.data, where=f"{where}: message {len(rows) + 1}")
        if not isinstance(value, dict):
            raise InputError("is no object with fields", where=f"{where}: message {len(rows) + 1}")
        flat = dict(flattened(value))
        names.update(dict.fromkeys(flat))
        if len(names) > MAX_COLUMNS:
            raise InputError(f"has more than {MAX_COLUMNS} fields", where=where, remedy="give the right file")
        rows.append(flat)
    if not rows:
        raise InputError("holds no message in JSON", where=where)
    return [column_of(name, [row.get(name) for row in rows], where) for name in names]


def flattened(value: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Fields of fields as `outer.inner`, members of short lists as `name[0]`."""
    for key, inner in value.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(inner, dict):
            yield from flattened(inner, name)
        elif isinstance(inner, list):
            yield from ((f"{name}[{k}]", one) for k, one in enumerate(inner[:9]) if not isinstance(one, dict | list))
        else:
            yield name, inner


def column_of(name: str, values: list[Any], where: str) -> ReadColumn:
    """A column of values that are numbers, texts or None. Raises InputError where numbers and texts are mixed."""
    present = [value for value in values if value is not None]
    if any(isinstance(value, str) for value in present):
        if not all(isinstance(value, str) for value in present):
            raise InputError("is a number in one row and a text in another", where=where, field=name)
        return ReadColumn(name, None, tuple("" if value is None else value for value in values))
    try:
        numbers = np.array([np.nan if value is None else float(value) for value in values])
    except (OverflowError, TypeError):
        raise InputError("holds what is no number of 64 bits", where=where, field=name) from None
    whole = (
        bool(present)
        and len(present) == len(values)
        and all(type(value) is int and -_WHOLE_MOST <= value < _WHOLE_MOST for value in present)
    )
    return ReadColumn(name, numbers, integers=np.array(values, dtype=np.int64) if whole else None)


def _table(table: Any, where: str) -> list[ReadColumn]:
    names = [str(name) for name in table.column_names]
    double = next((name for name in names if names.count(name) > 1), None)
    if double is not None:
        raise InputError("names this column twice", where=where, field=double)
    return [
        column
        for name, field in zip(names, table.schema, strict=True)
        if (column := column_of_arrow(name, field, table.column(name))) is not None
    ]


def column_of_arrow(name: str, field: Any, array: Any) -> ReadColumn | None:
    """A column of an Arrow table; None for kinds that are neither numbers, times nor texts."""
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = field.type
    unit = (field.metadata or {}).get(b"unit", b"").decode("utf-8", "replace") or None
    if pa.types.is_timestamp(kind) and array.null_count == 0:
        ns = _whole(array.cast(pa.timestamp("ns", tz=kind.tz)).cast(pa.int64()), np.int64)
        return ReadColumn(name, ns.astype(np.float64), integers=ns, unit=unit, instant=True)
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
        numbers = _whole(array.cast(pa.float64(), safe=False), np.float64)
        whole = pa.types.is_integer(kind) and array.null_count == 0 and kind != pa.uint64()
        return ReadColumn(
            name, numbers, integers=_whole(array.cast(pa.int64()), np.int64) if whole else None, unit=unit
        )
    if pa.types.is_dictionary(kind) and _is_text(kind.value_type):
        return ReadColumn(name, None, tuple(_texts_of(array)), unit=unit)
    if pa.types.is_dictionary(kind):
        array = pc.cast(array, kind.value_type)
        kind = kind.value_type
    if _is_text(kind):
        return ReadColumn(name, None, tuple("" if text is None else text for text in array.to_pylist()), unit=unit)
    return None


def _texts_of(array: Any) -> Iterator[str]:
    """The texts of a dictionary's column: each of them once, however often it stands there."""
    for chunk in array.chunks:
        words = chunk.dictionary.to_pylist()
        for place in chunk.indices.to_pylist():
            yield "" if place is None else words[place] or ""


def _whole(array: Any, dtype: type) -> NDArray[Any]:
    """A column of numbers of 8 bytes as one array, NaN for null. pyarrow's own way loads pandas, which takes 1 s."""
    parts: list[NDArray[Any]] = []
    for part in getattr(array, "chunks", [array]):
        valid, content = part.buffers()
        if len(part) == 0:
            continue
        numbers: NDArray[Any] = np.frombuffer(content, dtype, len(part), part.offset * _CELL_BYTES)
        if part.null_count:
            there = np.unpackbits(np.frombuffer(valid, np.uint8), bitorder="little")[part.offset :][: len(part)]
            numbers = np.where(there, numbers, np.nan)
        parts.append(numbers)
    return np.concatenate(parts) if parts else np.zeros(0, dtype)


def _guarded(read: Callable[[], list[ReadColumn]], kind: str, where: str) -> list[ReadColumn]:
    try:
        return read()
    except InputError:
        raise
    except Exception as error:
        raise _damaged(kind, error, where) from None


def _damaged(kind: str, error: Exception, where: str) -> InputError:
    # a length within the file may be damaged, too, and is asked for before anything of it is read
    if isinstance(error, MemoryError):
        return InputError(
            f"needs more memory than there is, or is a damaged {kind} file", where=where, remedy="give the right file"
        )
    reason = " ".join(str(error).split())[:_SHOWN] or type(error).__name__
    return InputError(f"is a damaged {kind} file ({reason})", where=where, remedy="give the right file")


def _fits(rows: int, columns: int, size: int, where: str) -> None:
    if columns > MAX_COLUMNS:
        raise InputError(f"has more than {MAX_COLUMNS} columns", where=where, remedy="give the right file")
    refuse_expansion(rows * columns * _CELL_BYTES, size, where=where)


def _library(name: str, where: str) -> Any:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        raise InputError(
            f"needs {package}, which is not installed", where=where, remedy="pip install 'highside[export]'"
        ) from None
