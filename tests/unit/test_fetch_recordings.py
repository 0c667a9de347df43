"""`make data`: recordings are fetched whole, by their hash, or one line says why not."""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

PLAIN, LONG, TEXT = bytes(range(256)) * 9, b"kept" * 50 + b"not kept" * 50, b"t_s,ax_g\n0,1\n" * 30


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *reported: object) -> None:
        pass


@pytest.fixture
def published(tmp_path: Path) -> Iterator[str]:
    """Files as their makers publish them, on a server of this machine; its address."""
    folder = tmp_path / "published"
    folder.mkdir()
    for name, contents in (("plain.bin", PLAIN), ("long.bin", LONG), ("text.csv", TEXT)):
        (folder / name).write_bytes(contents)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def entry(path: str, contents: bytes, **more: str) -> dict[str, Any]:
    sha256 = hashlib.sha256(contents).hexdigest()
    return {"path": path, "bytes": len(contents), "sha256": sha256, "origin": "someone/somewhere", **more}


def fetch(project_root: Path, folder: Path, entries: list[dict[str, Any]]) -> subprocess.CompletedProcess[str]:
    listed = folder.with_name("list.json")
    listed.write_text(json.dumps({"recordings": entries}))
    command = [sys.executable, project_root / "tests/data/fetch.py", "--list", listed]
    env = os.environ | {"HIGHSIDE_DATA": str(folder), "no_proxy": "127.0.0.1"}
    return subprocess.run(command, capture_output=True, text=True, timeout=60, env=env)


def test_what_has_an_address_is_fetched_cut_and_packed_and_the_rest_is_named(
    project_root: Path, tmp_path: Path, published: str
) -> None:
    folder = tmp_path / "data"
    entries = [
        entry("a/plain.bin", PLAIN, url=f"{published}/plain.bin"),
        entry("a/first_part.bin", LONG[:200], url=f"{published}/long.bin"),
        entry("b/text.csv.gz", TEXT, url=f"{published}/text.csv"),
        entry("b/arrays.npz", b"?", not_fetched="converted"),
    ]
    done = fetch(project_root, folder, entries)
    assert (done.returncode, done.stderr) == (0, "")
    assert (folder / "a/plain.bin").read_bytes() == PLAIN
    assert (folder / "a/first_part.bin").read_bytes() == LONG[:200]
    assert gzip.decompress((folder / "b/text.csv.gz").read_bytes()) == TEXT
    assert f"3 of 4 recordings are in {folder}\nnot fetched: b/arrays.npz (someone/somewhere): converted" in done.stdout

    # what is there is not fetched again; what was damaged is
    (folder / "b/text.csv.gz").write_bytes(b"torn")
    again = fetch(project_root, folder, entries)
    assert again.returncode == 0
    assert [line for line in again.stdout.splitlines() if line.startswith("fetched")] == ["fetched b/text.csv.gz"]


def test_other_contents_are_not_kept(project_root: Path, tmp_path: Path, published: str) -> None:
    done = fetch(project_root, tmp_path / "data", [entry("a/plain.bin", b"another", url=f"{published}/plain.bin")])
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "a/plain.bin: what" in done.stderr
    assert "SHA-256" in done.stderr
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize("address", ["http://127.0.0.1:1/plain.bin", "{published}/absent.bin"])
def test_without_a_network_one_line_says_so(project_root: Path, tmp_path: Path, published: str, address: str) -> None:
    url = address.format(published=published)
    done = fetch(project_root, tmp_path / "data", [entry("a/plain.bin", PLAIN, url=url)])
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith(f"fetch: {url}: cannot be fetched (")
    assert not (tmp_path / "data").exists()


def test_a_folder_that_cannot_be_written_is_named(project_root: Path, tmp_path: Path, published: str) -> None:
    (tmp_path / "data").write_text("a file")
    done = fetch(project_root, tmp_path / "data", [entry("a/plain.bin", PLAIN, url=f"{published}/plain.bin")])
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert str(tmp_path / "data/a/plain.bin") in done.stderr


def test_the_list_describes_the_recordings_that_the_tests_read(project_root: Path, shared_data: Path) -> None:
    listed = json.loads((project_root / "tests/data/recordings.json").read_text())["recordings"]
    for one in listed:
        assert ("url" in one) != ("not_fetched" in one), one["path"]
        contents = (shared_data / one["path"]).read_bytes()
        if one["path"].endswith(".gz"):
            contents = gzip.decompress(contents)
        assert (len(contents), hashlib.sha256(contents).hexdigest()) == (one["bytes"], one["sha256"]), one["path"]


@pytest.mark.parametrize(("ci", "outcome"), [("true", ("1 failed", "1 error")), ("", ("1 skipped",))])
@pytest.mark.parametrize("empty", [False, True])
def test_a_checkout_without_recordings_says_how_to_get_them(
    project_root: Path, tmp_path: Path, ci: str, outcome: tuple[str, ...], empty: bool
) -> None:
    folder = tmp_path / "none"
    if empty:
        folder.mkdir()
    test = "tests/unit/test_link_detect.py::test_real_vn100_bytes_are_recognised_between_their_text"
    env = os.environ | {"HIGHSIDE_DATA": str(folder), "CI": ci}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", test]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=env, cwd=project_root)
    assert done.stdout.splitlines()[-1].startswith(outcome), done.stdout
    assert f"real recordings: 25 of 25 are not in {folder}; `make data` fetches 9," in done.stdout
    assert f"no real recordings at {folder}" in done.stdout
    assert "`make data` fetches them, or HIGHSIDE_DATA names the folder that has them" in done.stdout
    assert "Traceback" not in done.stdout


def test_a_recording_that_cannot_be_fetched_says_so(project_root: Path, tmp_path: Path) -> None:
    test = "tests/unit/test_physics_scenario.py::test_the_published_inclinations_are_those_of_the_tables"
    env = os.environ | {"HIGHSIDE_DATA": str(tmp_path), "CI": ""}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", test]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=env, cwd=project_root)
    assert done.stdout.splitlines()[-1].startswith("1 skipped"), done.stdout
    assert "table1_conventional.csv: it cannot be fetched (typed from the paper's tables" in done.stdout
