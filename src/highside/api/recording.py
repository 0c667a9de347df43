"""Recordings: read from files, taken from DataFrames and dicts of arrays."""

from __future__ import annotations

from highside.recording.frames import Columns, File, FrameT, take
from highside.recording.table import Recording

__all__ = ["read"]


def read(source: File | Columns | FrameT) -> Recording:
    """A Recording of N rows.

    `source`: a file (CSV, optionally gzipped), a DataFrame, or a dict of arrays (N,) by the names of their columns.
    Only `t_s` (s) is mandatory; names of columns carry their units (`ax_g`, `gx_dps`, `temp_c`, `inc_ref_deg`). Columns
    that are not known are kept. Raises InputError that names file, line and column of what is wrong.
    """
    return take(source, Recording).table
