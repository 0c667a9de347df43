"""Fetches the public recordings that the tests read: `make data`, or `python3 tests/data/fetch.py [FOLDER]`.

Each recording keeps its own licence and so stands beside the checkout, never inside it: in FOLDER, else in the folder
that the environment variable HIGHSIDE_DATA names, else in `../shared/data`. `recordings.json` says of each where it
comes from, how large it is and what its SHA-256 is; nothing is kept whose SHA-256 is another. Some were converted from
what their makers published and are at no address: they are listed with the reason; tests that need them are
skipped, and fail where CI=true.

Nothing but the standard library is needed. Exit status: 0 all that have an address are there; 1 an address gives
something else; 2 the network or the folder cannot be used.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import http.client
import json
import os
import sys
import urllib.request
import zlib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("recordings.json")
TIMEOUT_S = 30.0
"""Seconds without a byte after which an address counts as out of reach."""


class FetchError(Exception):
    """One line for the user, and the exit status."""

    def __init__(self, message: str, status: int) -> None:
        super().__init__(message)
        self.status = status


@dataclass(frozen=True)
class Recording:
    """One file; `size` and `sha256` are those of its contents, unpacked where it is a `.gz`."""

    path: str
    size: int
    sha256: str
    origin: str
    url: str | None
    not_fetched: str | None

    def is_there(self, folder: Path) -> bool:
        """Whether the folder holds it, with the right contents."""
        try:
            return self._is(self._contents((folder / self.path).read_bytes()))
        except (OSError, EOFError, zlib.error):
            return False

    def fetch(self, folder: Path) -> None:
        """Fetch it, compare its hash, put it in its place as a whole."""
        assert self.url is not None
        try:
            with urllib.request.urlopen(self.url, timeout=TIMEOUT_S) as answer:
                contents = answer.read(self.size)
        except (OSError, http.client.HTTPException) as error:
            reason = getattr(error, "reason", None) or error
            raise FetchError(f"{self.url}: cannot be fetched ({reason}); is there a network?", 2) from error
        if not self._is(contents):
            raise FetchError(
                f"{self.path}: what {self.url} gives has another SHA-256 than recordings.json says; it was not kept", 1
            )
        target = folder / self.path
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            part = target.with_name(target.name + ".part")
            # without a time of writing the same contents give the same file
            part.write_bytes(gzip.compress(contents, mtime=0) if target.suffix == ".gz" else contents)
            part.replace(target)
        except OSError as error:
            raise FetchError(f"{target}: cannot be written ({error.strerror}); name another folder", 2) from error

    def _contents(self, data: bytes) -> bytes:
        return gzip.decompress(data) if self.path.endswith(".gz") else data

    def _is(self, contents: bytes) -> bool:
        return hashlib.sha256(contents).hexdigest() == self.sha256


def data_folder() -> Path:
    """Where the tests look for the recordings."""
    return Path(os.environ.get("HIGHSIDE_DATA") or ROOT.parent / "shared" / "data")


def recordings(listed: Path = LIST) -> list[Recording]:
    """All that the tests know."""
    return [
        Recording(one["path"], one["bytes"], one["sha256"], one["origin"], one.get("url"), one.get("not_fetched"))
        for one in json.loads(listed.read_text())["recordings"]
    ]


def fetch_all(folder: Path, wanted: list[Recording]) -> None:
    """Fetch what is not there yet; the first address that fails ends it."""
    left = []
    for one in wanted:
        if one.is_there(folder):
            continue
        if one.url is None:
            left.append(one)
            continue
        one.fetch(folder)
        print(f"fetched {one.path}", flush=True)
    print(f"{len(wanted) - len(left)} of {len(wanted)} recordings are in {folder}")
    for one in left:
        print(f"not fetched: {one.path} ({one.origin}): {one.not_fetched}")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Fetch the public recordings that the tests read.")
    parser.add_argument("folder", type=Path, nargs="?", default=data_folder(), help="default: %(default)s")
    parser.add_argument(
        "--list", type=Path, default=LIST, help="of what to fetch; default: recordings.json beside this"
    )
    options = parser.parse_args(arguments)
    try:
        fetch_all(options.folder, recordings(options.list))
    except FetchError as error:
        print(f"fetch: {error}", file=sys.stderr)
        return error.status
    return 0


if __name__ == "__main__":
    sys.exit(main())
