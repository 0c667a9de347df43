"""Photographs to a session: what a camera gives is checked, drawn anew and kept beside the journal.

    sessions/tool-7_20261125T081500Z.journal
    sessions/tool-7_20261125T081500Z.photographs/3fa9....jpg

What is sent is a stranger's file: its kind is told by its content (JPEG, PNG or WebP), its size in bytes and in points
is limited before anything is drawn, and what is kept is a new JPEG of its points alone, the right way up. Where a
picture was taken, and whatever else stood in the file, is not kept. A file is named by its SHA-256, and the journal,
whose lines are chained, holds that: who reads the session finds out whether the file is still the same.
"""

from __future__ import annotations

import hashlib
import io
import warnings
from dataclasses import dataclass
from pathlib import Path

from highside.bench.session.entries import Photographed
from highside.bench.session.journal import Journal, StorageError
from highside.errors import InputError, Refused
from highside.reading import read_bytes
from highside.recording.files import make_directory, write_whole

KINDS = ("JPEG", "PNG", "WEBP")
"""what phones and cameras give, by Pillow's names"""
SENT_MAX = 16_000_000
"""Bytes of a file; a photograph of 50 million points as JPEG has some 12 MB."""
POINTS_MAX = 50_000_000
"""Points of a picture, each some 4 bytes while it is drawn."""
SIDE_MAX = 1600
"""Points of the longer side of what is kept: a scale on a clamp can be read in it, and it has some 0.3 MB."""
SIDE_MIN = 16
QUALITY = 85
"""of JPEG, 1 to 95"""
KEPT_MAX = 30
"""Photographs of one session: some 10 MB, which the report has in it."""
FOLDER_SUFFIX = ".photographs"


@dataclass(frozen=True, slots=True)
class Picture:
    """What is kept of a photograph: JPEG, its size in points."""

    data: bytes
    width: int
    height: int

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.data).hexdigest()


@dataclass(frozen=True, slots=True)
class Found:
    """A photograph read back: its entry, when it came, and the file, or what is wrong with that."""

    entry: Photographed
    at_s: float
    data: bytes = b""
    trouble: str = ""


def drawn_anew(sent: bytes) -> Picture:
    """A photograph as it is kept. Raises Refused, in one sentence, for what is none; InputError without Pillow."""
    if len(sent) > SENT_MAX:
        raise Refused(f"the photograph is too large: {SENT_MAX // 1_000_000} MB at most; send it smaller")
    try:
        from PIL import Image, ImageFile, ImageOps
    except ImportError:
        raise InputError("photographs need Pillow", remedy="pip install 'highside[web]'") from None
    # what draws PDF lets the library take files that were cut off, for all of the process
    cut_off_too, ImageFile.LOAD_TRUNCATED_IMAGES = ImageFile.LOAD_TRUNCATED_IMAGES, False
    try:
        with warnings.catch_warnings(), Image.open(io.BytesIO(sent), formats=KINDS) as opened:
            # what looks like a bomb is refused below, by our own limit
            warnings.simplefilter("ignore")
            if opened.width * opened.height > POINTS_MAX:
                raise Refused(f"the photograph has too many points: {POINTS_MAX // 1_000_000} million at most")
            if min(opened.size) < SIDE_MIN:
                raise Refused(f"the picture is too small: {SIDE_MIN} points at least on each side")
            # JPEG can be read at a half, a quarter or an eighth of its size: less memory
            opened.draft("RGB", (SIDE_MAX, SIDE_MAX))
            picture = ImageOps.exif_transpose(opened).convert("RGB")
            picture.thumbnail((SIDE_MAX, SIDE_MAX))
            # pixels alone: neither the place where it was taken nor anything that stood behind the picture
            plain = Image.new("RGB", picture.size)
            plain.paste(picture)
            out = io.BytesIO()
            plain.save(out, "JPEG", quality=QUALITY)
    except Refused:
        raise
    except Image.DecompressionBombError:
        raise Refused(f"the photograph has too many points: {POINTS_MAX // 1_000_000} million at most") from None
    except Exception as error:  # the library has an error of its own for each way in which a file can be broken
        raise Refused(
            f"that is no photograph that can be read (JPEG, PNG or WebP; {type(error).__name__}): take it again"
        ) from None
    finally:
        ImageFile.LOAD_TRUNCATED_IMAGES = cut_off_too
    return Picture(out.getvalue(), *plain.size)


def folder_of(journal: Path) -> Path:
    """Where the photographs of a journal are."""
    return journal.with_suffix(FOLDER_SUFFIX)


def keep(journal: Path, picture: Picture) -> None:
    """Put a photograph beside the journal. On the disk when this returns. Raises StorageError."""
    folder, name = folder_of(journal), f"{picture.sha256}.jpg"
    try:
        make_directory(folder)
        write_whole(folder / name, picture.data)
    except (OSError, InputError) as error:
        raise StorageError(f"{folder.name}: {getattr(error, 'strerror', None) or error}") from error


def refuse_more(journal: Path) -> None:
    """Raises Refused where as many are kept beside a journal as may be."""
    if sum(1 for _ in folder_of(journal).glob("*.jpg")) >= KEPT_MAX:
        raise Refused(f"there are {KEPT_MAX} photographs of this session already")


def photographs(journal: Journal, path: Path) -> list[Found]:
    """Those of a session in the order of time, each held against the journal's hash."""
    return [
        _found(entry, at_s, folder_of(path))
        for entry, at_s in zip(journal.entries, journal.times_s, strict=True)
        if isinstance(entry, Photographed)
    ]


def _found(entry: Photographed, at_s: float, folder: Path) -> Found:
    # the name follows from the hash: nothing that stands in a journal leads elsewhere
    path = folder / f"{entry.sha256}.jpg"
    try:
        data = read_bytes(path, max_bytes=SENT_MAX)
    except InputError:
        return Found(entry, at_s, trouble=f"photograph {entry.sha256[:12]} is missing or cannot be read")
    if hashlib.sha256(data).hexdigest() != entry.sha256:
        return Found(entry, at_s, trouble=f"photograph {entry.sha256[:12]} was changed after it was taken")
    return Found(entry, at_s, data)
