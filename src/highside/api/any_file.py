"""Recordings out of files of any kind, DataFrames and dicts of arrays."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

from highside.api.importing import inspect_import
from highside.api.recording import Recording
from highside.errors import InputError
from highside.reading import csv_header, decode_text, read_bytes
from highside.reading.columnar import MCAP_MAGIC, PARQUET_MAGIC
from highside.recording import table as tables
from highside.recording.frames import Columns, File, FrameT, take
from highside.recording.table import Table

__all__ = ["is_own", "read"]


def read(
    source: File | Columns | FrameT,
    *,
    mapping: Mapping[str, str] | None = None,
    units: Sequence[str] = (),
    axes: str | None = None,
    rate_hz: float | None = None,
    table: str | None = None,
    part: int | None = None,
    profile: str | None = None,
    accept: bool = False,
) -> Recording:
    """A Recording of N rows.

    `source`: a file, a DataFrame, or a dict of arrays (N,) by the names of their columns. Only `t_s` (s) is mandatory;
    names of columns carry their units (`ax_g`, `gx_dps`, `temp_c`, `inc_ref_deg`). Columns that are not known are kept.

    A file with a column `t_s` is one of ours (CSV, gzipped or not, Parquet and MCAP as `highside export` writes them).
    A file of another program is read by `import_recording` with the same arguments `mapping`, `units`, `axes`,
    `rate_hz`, `table`, `part`, `profile` and `accept`: what the file says clearly is used, what rests on values alone
    only with `accept`, what is open is refused; `inspect_import` shows it before. `notes` of the Recording say what
    was taken for what, and what is wrong with its rows is said as a warning too.

    Raises InputError that names file, line and column of what is wrong, or the argument that decides it.
    """
    given = (mapping, tuple(units), axes, rate_hz, table, part, profile, accept)
    wished = given != (None, (), None, None, None, None, None, False)
    if isinstance(source, str | os.PathLike):
        if wished or not is_own(Path(source)):
            looked = inspect_import(
                source,
                mapping=mapping,
                units=units,
                axes=axes,
                rate_hz=rate_hz,
                table=table,
                part=part,
                profile=profile,
            )
            made = looked.read(accept=accept)
            for line in looked.remarks:
                warnings.warn(f"{source}: {line}", stacklevel=2)
            return made
    elif wished:
        raise InputError(
            "say of a file of another program what it holds, and this is a table",
            field="mapping, units, axes, ...",
            remedy="give its columns the names and units of highside: t_s, ax_g, gx_dps, ...",
        )
    return Recording.of(take(source, tables.Recording).table)


def is_own(path: Path) -> bool:
    """Whether a file says that it is ours: it has a column `t_s`. Raises InputError for one that cannot be opened."""
    data = read_bytes(path)
    where = str(path)
    if not data.strip():
        return True
    try:
        if data.startswith((PARQUET_MAGIC, MCAP_MAGIC)):
            return "t_s" in Table.read(path).order
        header = decode_text(data, where=where, expected="CSV file").partition("\n")[0]
        return "t_s" in csv_header(header.removesuffix("\r"), where=where)
    except InputError:
        return False
