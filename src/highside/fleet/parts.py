"""Where results stand: `DIR/parts/*.parquet`, a row each, those of a batch in one file, and `DIR/catalogue.parquet`:
which recording has which. Calibration records stand in `DIR/records` besides.

The key is the SHA-256 of what determines the answer: the content of the recording, the model, the version of highside,
the seed and the job. So a result is computed once whoever asks for it, a second run goes on where the first was
stopped; of two runs at the same time both may compute it, and whoever reads takes one of two rows of a key. A part is
written beside and renamed: it is whole or not there. That of one row is named by its key, of several by all of theirs.
Which tool and lot a recording belongs to stands in the catalogue alone, and may be corrected later.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from highside.errors import InputError
from highside.fleet.catalogue import Entry
from highside.fleet.columns import table_of, table_of_texts
from highside.fleet.flushed import write_records
from highside.reading import read_bytes
from highside.reading.columnar import PARQUET_MAGIC
from highside.reading.files import open_file
from highside.recording.files import make_directory, write_whole

__all__ = ["DAMAGED", "PartStore", "content_digest", "key_of"]

DAMAGED = "remove it, run again"
SEVERAL = "batch-"
"""how the name of a part of several rows begins"""
PIECE = 1 << 20
"""bytes of a file that are looked at at a time"""


def content_digest(path: Path) -> bytes:
    """SHA-256 of a recording's content, unzipped; of Parquet, which may be longer than a memory, piece by piece."""
    with open_file(path) as file:
        if file.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC:
            digest = hashlib.sha256(PARQUET_MAGIC)
            while piece := file.read(PIECE):
                digest.update(piece)
            return digest.digest()
    return hashlib.sha256(read_bytes(path)).digest()


def key_of(content: bytes, *rest: str) -> str:
    """The name of a result, of the digest of a recording's content and what else determines it."""
    digest = hashlib.sha256(content)
    for text in rest:
        digest.update(hashlib.sha256(text.encode()).digest())
    return digest.hexdigest()


class PartStore:
    """The results of one folder. Raises InputError where it cannot be made or written, or pyarrow is missing."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._parts = folder / "parts"
        self._keys: dict[str, tuple[str, ...]] = {}
        self._known: set[str] = set()
        try:
            make_directory(self._parts)
        except OSError as error:
            raise InputError(f"cannot be made: {error.strerror}", where=str(folder), field="--out") from None

    @classmethod
    def existing(cls, folder: Path) -> Self:
        """A folder that is there. Raises InputError where it is not."""
        if not (folder / "parts").is_dir():
            raise InputError(
                "holds no results", where=str(folder), field="DIR", remedy="run highside fleet diagnose first"
            )
        return cls(folder)

    @property
    def pattern(self) -> str:
        """All parts, as DuckDB takes it."""
        return str(self._parts / "*.parquet")

    @property
    def catalogue(self) -> Path:
        """Which recording has which key."""
        return self.folder / "catalogue.parquet"

    def look(self) -> None:
        """Take note of which results are there by now. Raises InputError for a part that cannot be read."""
        with os.scandir(self._parts) as entries:
            names = {one.name for one in entries if one.name.endswith(".parquet") and not one.name.startswith(".")}
        self._keys = {name: self._keys[name] if name in self._keys else _keys_of(self._parts / name) for name in names}
        self._known = {key for keys in self._keys.values() for key in keys}

    def has(self, key: str) -> bool:
        """Whether that result was there when it was looked last, or was written here since."""
        return key in self._known

    def write(self, rows: Mapping[str, Mapping[str, Any]]) -> None:
        """Write results of one job, by their keys, as one part, whole; before it the calibration records among them,
        each as the file that `calibrate apply` and `fleet records` read."""
        if not rows:
            return
        done = [row for row in rows.values() if row.get("record") and row["verdict"] == "done"]
        if done:
            write_records(self.folder / "records", {f"{row['record_id']}.json": row["record"].encode() for row in done})
        (name, *more) = sorted(rows)
        if more:
            name = SEVERAL + hashlib.sha256("".join([name, *more]).encode()).hexdigest()
        write_whole(self._parts / f"{name}.parquet", _parquet(table_of([{"key": k, **row} for k, row in rows.items()])))
        self._known.update(rows)

    def read(self, columns: Sequence[str] | None = None) -> dict[str, dict[str, Any]]:
        """The rows of all results, by key."""
        import pyarrow.parquet as pq

        found: dict[str, dict[str, Any]] = {}
        for path in sorted(self._parts.glob("*.parquet")):
            wanted = None if columns is None else ["key", *columns]
            found |= {row["key"]: row for row in pq.ParquetFile(path).read(wanted).to_pylist()}
        return found

    def write_catalogue(self, entries: Sequence[Entry], keys: Mapping[str, str], job: str) -> None:
        """Note the key of every entry that has one; of other recordings and jobs what was noted before stays."""
        rows = {(row["uri"], row["job"]): row for row in self.read_catalogue()}
        for entry in entries:
            if entry.uri in keys:
                own = {"uri": entry.uri, "job": job, "key": keys[entry.uri], "tool": entry.tool, "lot": entry.lot}
                rows[entry.uri, job] = {**entry.more, **own}
        names = list(dict.fromkeys(name for row in rows.values() for name in row))
        write_whole(self.catalogue, _parquet(table_of_texts([{n: row.get(n) for n in names} for row in rows.values()])))

    def read_catalogue(self) -> list[dict[str, Any]]:
        """What was noted; nothing where nothing was."""
        if not self.catalogue.exists():
            return []
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            return list(pq.read_table(self.catalogue).to_pylist())
        except (pa.ArrowInvalid, OSError) as error:
            raise InputError(f"is damaged: {error}", where=str(self.catalogue), remedy=DAMAGED) from None


def _keys_of(part: Path) -> tuple[str, ...]:
    if not part.name.startswith(SEVERAL):
        # its one key is its name; whether it was cut short is seen by its end
        try:
            with part.open("rb") as file:
                file.seek(-min(part.stat().st_size, len(PARQUET_MAGIC)), os.SEEK_END)
                end = file.read()
        except FileNotFoundError:
            return ()
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", where=str(part), remedy=DAMAGED) from None
        if end != PARQUET_MAGIC:
            raise InputError("is damaged: its end is missing", where=str(part), remedy=DAMAGED)
        return (part.stem,)
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return tuple(pq.ParquetFile(part).read(["key"]).column("key").to_pylist())
    except FileNotFoundError:
        return ()
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(f"is damaged: {error}", where=str(part), remedy=DAMAGED) from None


def _parquet(table: Any) -> bytes:
    import pyarrow.parquet as pq

    out = io.BytesIO()
    pq.write_table(table, out, compression="zstd")
    return out.getvalue()
