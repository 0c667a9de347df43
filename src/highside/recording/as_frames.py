"""A table as a DataFrame of pandas, polars or Arrow. The libraries are loaded when they are needed."""

from __future__ import annotations

import importlib
from typing import Any, cast

from highside.errors import InputError
from highside.recording.columns import NamedColumns

__all__ = ["arrow_stream", "as_arrow", "as_pandas", "as_polars", "library", "pyarrow"]


def as_pandas(table: NamedColumns) -> Any:
    """A `pandas.DataFrame`. Raises InputError where pandas is not installed."""
    pandas = library("pandas", "pip install pandas")
    return pandas.DataFrame({name: _cells_of(table, name) for name in table.order})


def as_polars(table: NamedColumns) -> Any:
    """A `polars.DataFrame`. Raises InputError where polars is not installed."""
    polars = library("polars", "pip install polars")
    return polars.DataFrame({name: _cells_of(table, name) for name in table.order}, nan_to_null=True)


def as_arrow(table: NamedColumns) -> Any:
    """A `pyarrow.Table`. Raises InputError where pyarrow is not installed."""
    arrow = pyarrow()
    return arrow.table({name: arrow.array(_cells_of(table, name), from_pandas=True) for name in table.order})


def arrow_stream(table: NamedColumns, requested_schema: object | None) -> object:
    """The capsule of `__arrow_c_stream__`."""
    return cast("object", as_arrow(table).__arrow_c_stream__(requested_schema))


def _cells_of(table: NamedColumns, name: str) -> Any:
    return table.columns[name] if name in table.columns else list(table.texts[name])


def pyarrow() -> Any:
    """The library. Raises InputError where it is not installed."""
    return library("pyarrow", "pip install 'highside[export]'")


def library(name: str, remedy: str) -> Any:
    """A library of that name. Raises InputError with the remedy where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(f"this needs {name}, which is not installed", remedy=remedy) from None
