"""Where results stand: `DIR/parts/KEY.parquet`, one row each, and `DIR/catalogue.parquet`: which recording has which.
Calibration records stand in `DIR/records` besides.

The key is the SHA-256 of what determines the answer: the content of the recording, the model, the version of highside,
the seed and the job. So a result is computed once whoever asks for it, a second run goes on where the first was
stopped, and two processes that compute the same write the same. A part is written beside and renamed: it is whole or
not there. Which tool and lot a recording belongs to stands in the catalogue alone, and may be corrected later.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from highside.errors import InputError
from highside.fleet.catalogue import Entry
from highside.recording.files import make_directory, write_whole

__all__ = ["PartStore", "key_of"]


def key_of(content: bytes, *rest: str) -> str:
    """The name of a result, of a recording's content and what else determines it."""
    digest = hashlib.sha256(hashlib.sha256(content).digest())
    for text in rest:
        digest.update(hashlib.sha256(text.encode()).digest())
    return digest.hexdigest()


class PartStore:
    """The results of one folder. Raises InputError where it cannot be made or written, or pyarrow is missing."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._parts = folder / "parts"
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

    def has(self, key: str) -> bool:
        """Whether that result is there."""
        return (self._parts / f"{key}.parquet").exists()

    def write(self, key: str, row: Mapping[str, Any]) -> None:
        """Write one result, whole."""
        write_whole(self._parts / f"{key}.parquet", _parquet([{"key": key, **row}]))

    def write_record(self, record_id: str, text: str) -> None:
        """Write a calibration record as the file that `calibrate apply` and `fleet records` read."""
        make_directory(self.folder / "records")
        write_whole(self.folder / "records" / f"{record_id}.json", text.encode())

    def write_catalogue(self, entries: Sequence[Entry], keys: Mapping[str, str], job: str) -> None:
        """Note the key of every entry that has one; of other recordings and jobs what was noted before stays."""
        rows = {(row["uri"], row["job"]): row for row in self.read_catalogue()}
        for entry in entries:
            if entry.uri in keys:
                own = {"uri": entry.uri, "job": job, "key": keys[entry.uri], "tool": entry.tool, "lot": entry.lot}
                rows[entry.uri, job] = {**entry.more, **own}
        names = list(dict.fromkeys(name for row in rows.values() for name in row))
        write_whole(self.catalogue, _parquet([{name: row.get(name) for name in names} for row in rows.values()]))

    def read_catalogue(self) -> list[dict[str, Any]]:
        """What was noted; nothing where nothing was."""
        if not self.catalogue.exists():
            return []
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            return list(pq.read_table(self.catalogue).to_pylist())
        except (pa.ArrowInvalid, OSError) as error:
            raise InputError(f"is damaged: {error}", where=str(self.catalogue), remedy="remove it, run again") from None


def _parquet(rows: Sequence[Mapping[str, Any]]) -> bytes:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputError(
            "a fleet needs pyarrow, which is not installed", remedy="pip install 'highside[fleet]'"
        ) from None
    out = io.BytesIO()
    pq.write_table(pa.Table.from_pylist([dict(row) for row in rows]), out, compression="zstd")
    return out.getvalue()
