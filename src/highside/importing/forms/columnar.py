"""Parquet and Arrow tables, and MCAP files."""

from __future__ import annotations

from collections.abc import Iterable

from highside.importing.core.source import SourceColumn, SourceTable
from highside.importing.forms.topics import read_mcap_topics
from highside.reading.columnar import ReadColumn, arrow_columns, parquet_columns


def read_parquet(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The table of a Parquet file. Raises InputError."""
    return (_table(parquet_columns(data, where=where), "Parquet", where, stem),)


def read_arrow(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The table of an Arrow (Feather) file. Raises InputError."""
    return (_table(arrow_columns(data, where=where), "Arrow", where, stem),)


def read_mcap(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """One table a topic. Raises InputError."""
    return read_mcap_topics(data, where)


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
