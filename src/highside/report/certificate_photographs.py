"""The annex of a certificate: the photographs of its session, smaller than they are kept and of bounded size.

They show how the tool was clamped, and prove nothing: no figure of the certificate rests on them. Each names the file
that is kept with the session by its SHA-256; one that is not that file any more is not shown, and that is said.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

from highside.bench.photographs import Found, photographs
from highside.bench.session.journal import read_journal
from highside.calibration.record import CalibrationRecord, to_utc
from highside.errors import InputError
from highside.reading import read_bytes
from highside.report.document import Sheets
from highside.words import _, told

SHOWN_MAX = 8
"""Photographs of one certificate, the first ones: two on a sheet."""
SIDE_MAX = 1000
"""Points of the longer side: 180 mm at 140 dpi."""
QUALITY = 80
"""of JPEG, 1 to 95"""
BYTES_MAX = 1_500_000
"""Bytes of all of them together: a certificate goes by mail."""


def annex(out: Sheets, taken: Sequence[Found]) -> None:
    """The sheets with photographs; nothing where there are none."""
    if not taken:
        return
    out.new_sheet()
    out.heading(_("Annex: photographs of the session"))
    out.paragraph(_("They show the item on the bench; no result rests on them. The session keeps them larger."))
    left, shown = BYTES_MAX, 0
    for one in taken:
        entry = one.entry
        by = f"{entry.operator}: {entry.text}" if entry.text else entry.operator
        if one.trouble:
            out.paragraph(_("Not shown: %(why)s.", why=told(one.trouble)))
            continue
        small = smaller(one.data) if shown < SHOWN_MAX else b""
        if not small or len(small) > left:
            continue
        out.photograph(small, f"{to_utc(one.at_s)} {by} (SHA-256 {entry.sha256})")
        left, shown = left - len(small), shown + 1
    more = sum(1 for one in taken if not one.trouble) - shown
    if more:
        out.paragraph(_("Further photographs that the session keeps, not shown here: %(count)s.", count=more))


def smaller(jpeg: bytes) -> bytes:
    """A photograph as it is printed. Where Pillow is not installed, as it is."""
    try:
        from PIL import Image
    except ImportError:
        return jpeg
    with Image.open(io.BytesIO(jpeg), formats=("JPEG",)) as opened:
        picture = opened.convert("RGB")
    picture.thumbnail((SIDE_MAX, SIDE_MAX))
    drawn = io.BytesIO()
    picture.save(drawn, "JPEG", quality=QUALITY)
    return drawn.getvalue()


def of_session(path: Path, record: CalibrationRecord) -> tuple[Found, ...]:
    """Those of a session by its journal. Raises InputError for one that the record does not follow from."""
    where = str(path)
    journal = read_journal(read_bytes(path), where=where)
    ended = journal.ledger().ended
    if ended is None or ended.record != record.id:
        raise InputError(
            f"is not the session that record {record.id[:12]} follows from",
            where=where,
            remedy=f"give the journal of {record.content['raw']['name']}",
        )
    return tuple(photographs(journal, path))
