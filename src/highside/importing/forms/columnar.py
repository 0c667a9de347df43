"""Parquet and Arrow tables, and MCAP files whose messages are JSON: ours, and those of others."""

from __future__ import annotations

from collections.abc import Iterable

from highside.errors import InputError
from highside.importing.core.source import SourceColumn, SourceTable
from highside.importing.forms.messages import imu_of_mcap
from highside.reading.columnar import ReadColumn, arrow_columns, mcap_json_columns, mcap_messages, parquet_columns


def read_parquet(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The table of a Parquet file. Raises InputError."""
    return (_table(parquet_columns(data, where=where), "Parquet", where, stem),)


def read_arrow(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The table of an Arrow (Feather) file. Raises InputError."""
    return (_table(arrow_columns(data, where=where), "Arrow", where, stem),)


def read_mcap(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """One table a topic: those in JSON, else those of `sensor_msgs/Imu`. Raises InputError."""
    topics: dict[str, str] = {}
    for message in mcap_messages(data, where=where):
        topics.setdefault(message.topic, message.encoding)
    if not topics:
        raise InputError("holds no message", where=where)
    json_topics = [topic for topic, encoding in topics.items() if encoding == "json"]
    if not json_topics:
        return imu_of_mcap(mcap_messages(data, where=where), where)
    return tuple(
        _table(mcap_json_columns(data, where=where, topic=topic), "MCAP, JSON", where, topic) for topic in json_topics
    )


def _table(columns: Iterable[ReadColumn], form: str, where: str, name: str) -> SourceTable:
    made = tuple(
        SourceColumn(
            column.name if column.name != "__index_level_0__" else "index",
            column.numbers,
            column.texts,
            column.integers,
            column.unit,
            column.instant,
        )
        for column in columns
    )
    return SourceTable(made, form, where, name)
