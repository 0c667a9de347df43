"""Which recordings there are: a table (CSV, Parquet) of one row a recording, a folder, or a pattern of names.

A table has the column `uri` and may have `tool`, `lot`, `model` and any others (`part_number`, `date`, `serial`), by
which a summary can group; what stands under `codec` is refused, since a recording of the wire is decoded first. A
relative uri or model is relative to the table. Without a table the tool is the name of the file and the lot that of its
folder. Places are those of fsspec (`s3://...`), which brings its own library for each.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from highside.errors import InputError
from highside.reading import read_bytes
from highside.reading.columnar import parquet_columns
from highside.reading.table import csv_header, csv_rows
from highside.reading.texts import at_line, decode_text

__all__ = ["INSTALL", "Entry", "catalogue_of"]

FORMS = (".csv", ".csv.gz", ".parquet", ".mcap")
"""What is taken out of a folder: as `export` writes recordings."""
INSTALL = "pip install 'highside[fleet]'"
OWN = ("uri", "tool", "lot", "model", "codec")


@dataclass(frozen=True, slots=True)
class Entry:
    """One recording."""

    uri: str
    tool: str
    lot: str = ""
    model: str | None = None
    """its own model file; None takes the command's"""
    more: Mapping[str, str] = field(default_factory=dict)
    """other columns of the catalogue"""
    size: int | None = None
    """bytes, where that is known"""
    stated: bool = False
    """whether the catalogue names the tool; else it is the name of the file"""


def catalogue_of(place: str) -> list[Entry]:
    """The recordings of a table, a folder or a pattern. Raises InputError for what holds none, or names one twice."""
    path = Path(place)
    is_table = path.is_file() and not place.endswith((".csv.gz", ".mcap"))
    entries = _of_table(path) if is_table else _of_files(place)
    if not entries:
        raise InputError(
            "holds no recording", where=place, field="CATALOGUE", remedy=f"files that end in {', '.join(FORMS)}"
        )
    seen: set[str] = set()
    for entry in entries:
        if entry.uri in seen:
            raise InputError(f"names {entry.uri} twice", where=place, field="uri", remedy="keep one of the rows")
        seen.add(entry.uri)
    return entries


def _of_table(path: Path) -> list[Entry]:
    names, rows = _parquet(path) if path.suffix == ".parquet" else _csv(path)
    if "uri" not in names:
        raise InputError(
            "is missing",
            where=str(path),
            field="uri",
            remedy="a catalogue has one row a recording: uri, tool, lot, ...",
        )
    entries = []
    for place, cells in rows:
        row = dict(zip(names, cells, strict=True))
        uri = row["uri"].strip()
        if not uri:
            raise InputError("is empty", where=place, field="uri", remedy="name the recording, or take the row out")
        if codec := row.get("codec", "").strip():
            raise InputError(
                f"{codec!r}: a fleet reads Recordings, not the wire",
                where=place,
                field="codec",
                remedy=f"run `highside decode {PurePosixPath(uri).name} --codec {codec} -o REC.csv.gz`, name the result"
                " and leave the cell empty",
            )
        entries.append(
            Entry(
                _beside(path, uri),
                row.get("tool", "").strip() or PurePosixPath(uri).name,
                row.get("lot", "").strip(),
                _beside(path, row["model"].strip()) if row.get("model", "").strip() else None,
                {name: cell for name, cell in row.items() if name not in OWN},
                stated=bool(row.get("tool", "").strip()),
            )
        )
    return entries


def _csv(path: Path) -> tuple[tuple[str, ...], Iterable[tuple[str, list[str]]]]:
    lines = decode_text(read_bytes(path), where=str(path), expected="a catalogue as CSV").splitlines()
    if not lines:
        raise InputError("is empty", where=str(path), remedy="a catalogue has a header with the column uri")
    names = csv_header(lines[0], where=str(path))
    rows = []
    for number, cells in enumerate(csv_rows(lines[1:], where=str(path)), start=2):
        if not any(cells):
            continue
        if len(cells) != len(names):
            raise InputError(
                f"{len(cells)} cells under {len(names)} names",
                where=at_line(str(path), number),
                remedy="correct the row",
            )
        rows.append((at_line(str(path), number), cells))
    return names, rows


def _parquet(path: Path) -> tuple[tuple[str, ...], Iterable[tuple[str, list[str]]]]:
    columns = parquet_columns(read_bytes(path), where=str(path))
    cells: list[list[str]] = []
    for column in columns:
        if column.texts is not None:
            cells.append(list(column.texts))
        elif column.integers is not None:
            cells.append([str(value) for value in column.integers.tolist()])
        elif column.numbers is not None:
            cells.append([f"{value:g}" for value in column.numbers.tolist()])
    names = tuple(column.name for column in columns)
    return names, [(f"{path}, row {i}", list(row)) for i, row in enumerate(zip(*cells, strict=True), start=1)]


def _beside(path: Path, uri: str) -> str:
    """A relative name, from the catalogue's folder."""
    return uri if "://" in uri or Path(uri).is_absolute() else str(path.resolve().parent / uri)


def _of_files(place: str) -> list[Entry]:
    fs, root = _file_system(place)
    try:
        pattern = any(c in root for c in "*?[")
        found: dict[str, Any] = fs.glob(root, detail=True) if pattern else fs.find(root, detail=True)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be listed: {error}", where=place, field="CATALOGUE") from None
    entries = []
    for name, about in sorted(found.items()):
        if about.get("type") != "file" or not name.endswith(FORMS):
            continue
        path = PurePosixPath(name)
        stem = path.name
        for form in (".gz", ".csv", ".parquet", ".mcap"):
            stem = stem.removesuffix(form)
        entries.append(Entry(fs.unstrip_protocol(name), stem, path.parent.name, size=about.get("size")))
    return [Entry(e.uri.removeprefix("file://"), e.tool, e.lot, size=e.size) for e in entries]


def _file_system(place: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError:
        raise InputError(
            "a fleet needs fsspec, which is not installed", remedy="pip install 'highside[fleet]'"
        ) from None
    try:
        fs, root = fsspec.core.url_to_fs(place)
    except (ImportError, ValueError) as error:
        raise InputError(f"is no place that can be read: {error}", where=place, field="CATALOGUE") from None
    return fs, root
