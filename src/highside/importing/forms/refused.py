"""Forms that are known and not read: each refused with the way out of the program that wrote it."""

from __future__ import annotations

from highside.errors import InputError
from highside.importing.core.source import SourceTable

_BEGINS: dict[bytes, tuple[str, str]] = {
    b"TDSm": ("is LabVIEW's TDMS, which is not read", "save it as .lvm, as text, or as HDF5"),
    b"\xd0\xcf\x11\xe0": ("is a workbook of Excel 97 to 2003 (.xls), which is not read", "save it as .xlsx"),
    b"MDF     ": ("is a measurement file of ASAM (MDF), which is not read", "export it as CSV, Parquet or MATLAB"),
    b"#datatype": (
        "is InfluxDB's annotated CSV with one value a line",
        'pivot(rowKey: ["_time"], columnKey: ["_field"], valueColumn: "_value") before the export',
    ),
}
"""the first bytes of a file: what it is, and what to do"""


def is_refused(data: bytes) -> bool:
    """Whether it begins as one of these."""
    return data.startswith(tuple(_BEGINS))


def refuse(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """Raises InputError."""
    what, remedy = next(said for begin, said in _BEGINS.items() if data.startswith(begin))
    raise InputError(what, where=where, remedy=remedy)
