"""Photographs to a session: a hostile file is one clear sentence, what is kept is pixels alone, and the journal's hash
finds out what was changed."""

from __future__ import annotations

import hashlib
import io
import struct
import zlib
from pathlib import Path

import pytest
from PIL import Image, ImageFile
from rehearsal import Rehearsal

from highside.bench import photographs
from highside.bench.session import plans
from highside.bench.session.entries import Photographed
from highside.bench.session.journal import encode_all, read_journal
from highside.errors import InputError, Refused
from highside.report.session_page import session_page
from tests.photograph import GPS, a_photograph


def png_that_says(width: int, height: int) -> bytes:
    """A PNG of that size by its head, with one row of points: a bomb where the size is believed."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(64))) + chunk(b"IEND", b"")


def gif() -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (40, 40)).save(out, "GIF")
    return out.getvalue()


HOSTILE = {
    "nothing": (b"", "no photograph"),
    "text": (b"<svg xmlns='http://www.w3.org/2000/svg' onload='alert(1)'/>", "no photograph"),
    "another kind": (gif(), "no photograph"),
    "cut off": (a_photograph()[:900], "no photograph"),
    "a bomb": (png_that_says(60_000, 60_000), "too many points"),
    "just too many points": (png_that_says(10_000, 5_001), "too many points"),
    "points that are not there": (png_that_says(800, 600), "no photograph"),
    "a dot": (a_photograph(4, 4), "too small"),
    "too long": (b"\xff\xd8" + bytes(photographs.SENT_MAX), "too large"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_no_photograph_is_refused_in_one_sentence(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # as it is once a PDF was drawn in the same process
    monkeypatch.setattr(ImageFile, "LOAD_TRUNCATED_IMAGES", True)
    sent, said = HOSTILE[name]
    with pytest.raises(Refused, match=said) as refused:
        photographs.drawn_anew(sent)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", photographs.KINDS)
def test_what_is_kept_stands_upright_and_says_nothing_but_its_points(kind: str) -> None:
    sent = a_photograph(2400, 1800, kind)
    assert Image.open(io.BytesIO(sent)).getexif().get_ifd(GPS), "it is there at first"
    # what stands behind the picture is not kept either
    kept = photographs.drawn_anew(sent + b"<script>alert(1)</script>")
    picture = Image.open(io.BytesIO(kept.data))
    assert (picture.format, picture.size) == ("JPEG", (1200, 1600)) == ("JPEG", (kept.width, kept.height))
    assert not picture.getexif() and b"script" not in kept.data
    # a gradient from top to bottom, turned by a quarter: dark at the right
    bright = [picture.convert("L").getpixel((x, 800)) for x in (20, 1180)]
    assert bright[0] > 200 > 60 > bright[1]


def test_the_journal_finds_out_what_was_changed(tmp_path: Path) -> None:
    done = Rehearsal(plans.balance_plan([40.0])).run()
    path = tmp_path / "tool_20261125T080000Z.journal"
    pictures = [photographs.drawn_anew(a_photograph(400, 300 + k)) for k in range(3)]
    entries = [(entry, 1.0) for entry in done.entries]
    for picture in pictures:
        photographs.keep(path, picture)
        entries.append((Photographed("A. Operator", "clamp", picture.sha256, picture.width, picture.height), 2.0))
    path.write_bytes(encode_all(done.header, entries))
    journal = read_journal(path.read_bytes())
    assert [one.data for one in photographs.photographs(journal, path)] == [picture.data for picture in pictures]

    folder = photographs.folder_of(path)
    (folder / f"{pictures[0].sha256}.jpg").write_bytes(pictures[1].data)
    (folder / f"{pictures[1].sha256}.jpg").unlink()
    found = photographs.photographs(journal, path)
    assert ["changed" in found[0].trouble, "missing" in found[1].trouble, found[2].trouble] == [True, True, ""]
    page = session_page(journal, found)
    assert page.count("<img") == 1 and "was changed after it was taken" in page and "is missing" in page


def test_no_line_of_a_journal_names_a_file_elsewhere(tmp_path: Path) -> None:
    done = Rehearsal(plans.balance_plan([40.0])).run()
    for name in ("../../secret", "A" * 64, hashlib.sha256(b"").hexdigest() + "/x"):
        lines = encode_all(done.header, [(Photographed("A", "", name, 1, 1), 1.0), (done.entries[0], 2.0)])
        with pytest.raises(InputError, match="SHA-256"):
            read_journal(lines)


def test_no_more_than_so_many(tmp_path: Path) -> None:
    path = tmp_path / "tool_20261125T080000Z.journal"
    folder = photographs.folder_of(path)
    photographs.refuse_more(path)
    folder.mkdir()
    for k in range(photographs.KEPT_MAX):
        (folder / f"{k}.jpg").touch()
    with pytest.raises(Refused, match="already"):
        photographs.refuse_more(path)
