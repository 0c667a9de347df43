"""All forms of files that are read, in the order in which they are tried. A form is added here and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from highside.importing.core.source import SourceTable
from highside.importing.forms import (
    arrays,
    columnar,
    dataflash,
    delimited,
    excel,
    matlab,
    messages,
    refused,
    topics,
    vectornav,
)
from highside.reading.columnar import ARROW_MAGIC, MCAP_MAGIC, PARQUET_MAGIC

HEAD_BYTES = 512
"""by which a form is recognised"""

Reader = Callable[[bytes, str, str], tuple[SourceTable, ...]]
"""content, name of the file for errors, its stem -> the tables in it"""


@dataclass(frozen=True, slots=True)
class FileForm:
    """A form of files: what it is called, how its content is recognised (its name says nothing), its reader."""

    name: str
    matches: Callable[[bytes], bool]
    read: Reader


def _zip_with(member: bytes) -> Callable[[bytes], bool]:
    return lambda data: data[:4] == b"PK\x03\x04" and member in data[:HEAD_BYTES] + data[-(64 << 10) :]


FORMS = (
    FileForm("Parquet", lambda data: data[:4] == PARQUET_MAGIC, columnar.read_parquet),
    FileForm("Arrow", lambda data: data[:6] == ARROW_MAGIC, columnar.read_arrow),
    FileForm("MCAP", lambda data: data[:8] == MCAP_MAGIC, columnar.read_mcap),
    FileForm("NumPy archive", _zip_with(b".npy"), arrays.read_npz),
    FileForm("NumPy array", lambda data: data[:6] == b"\x93NUMPY", arrays.read_npy),
    FileForm("Excel", _zip_with(b"xl/workbook"), excel.read_excel),
    FileForm("MATLAB 5", lambda data: data[:19] == matlab.MAT5, matlab.read_mat5),
    FileForm("HDF5", matlab.is_hdf5, matlab.read_hdf5),
    FileForm("PX4 ULog", lambda data: data[:7] == messages.ULOG, messages.read_ulog),
    FileForm("ROS 1 bag", lambda data: data[:12] == messages.ROSBAG, messages.read_rosbag),
    FileForm("ROS 2 bag", lambda data: data[:16] == topics.SQLITE, topics.read_db3),
    FileForm("VectorNav ASCII", vectornav.is_vectornav, vectornav.read_vectornav),
    FileForm("ArduPilot log", dataflash.is_dataflash, dataflash.read_dataflash),
    FileForm("ArduPilot log as text", dataflash.is_dataflash_text, dataflash.read_dataflash_text),
    FileForm("not read", refused.is_refused, refused.refuse),
    FileForm("candump", delimited.is_candump, delimited.refuse_candump),
    FileForm("text", lambda data: True, delimited.read_delimited),
)


def form_of(data: bytes) -> FileForm:
    """The form of this content; text where it is of no other."""
    return next(form for form in FORMS if form.matches(data))
