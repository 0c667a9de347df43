"""The formats that stand on disk, and tables of other libraries.

`table` is the Recording and the pose table (CSV), `frames` takes and gives DataFrames and dicts of arrays, `wire` and
`candump` are recordings as they came from a link, `calibration_store` keeps records, `keys` signs them.
"""

from __future__ import annotations

__all__ = ["calibration_store", "candump", "export", "files", "frames", "keys", "shown", "table", "wire"]
"""the ways in: modules, loaded on request"""
