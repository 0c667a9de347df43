"""`highside docs` and `highside examples`: what travels with the package for those who read."""

from __future__ import annotations

import difflib
import shutil
import threading
import webbrowser
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Annotated

import typer

from highside.cli.say import echo
from highside.errors import InputError
from highside.packaged import example_files, site


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the name is the base's
        """Nobody wants a line a request."""


def docs(
    page: Annotated[
        str, typer.Argument(help="Page to begin with: errors, configuration, commands, bench ...")
    ] = "index",
    port: Annotated[int, typer.Option("--port", min=0, max=65_535, help="Port of the loopback; 0: any free one.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
) -> None:
    """Show the documentation of this version, with its search, from this computer alone. Ctrl-C ends it."""
    folder = site()
    path = _page(folder, page)
    try:
        server = ThreadingHTTPServer(("127.0.0.1", port), partial(_Quiet, directory=str(folder)))
    except OSError as error:
        raise InputError(f"{port} cannot be used: {error.strerror}", field="--port", remedy="leave it out") from None
    address = f"http://127.0.0.1:{server.server_address[1]}/{path}"
    echo(f"{address}  (Ctrl-C ends it)")
    if browser:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
    with server:
        server.serve_forever()


def _page(folder: Path, name: str) -> str:
    """The page of that name, from the root of the site."""
    pages = {path.stem.lower(): path for path in sorted(folder.rglob("*.html"), reverse=True)}
    found = pages.get(name.lower().removesuffix(".html"))
    if found is None:
        near = difflib.get_close_matches(name.lower(), pages, n=3) or ["index", "commands", "configuration", "errors"]
        raise InputError("there is no such page", field=name, remedy=f"e.g. {', '.join(near)}")
    return found.relative_to(folder).as_posix()


def examples(
    folder: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Copy them there; files of yours are kept.")
    ] = None,
) -> None:
    """List the example configurations, models and broker settings of this version, or copy them to a folder."""
    found = example_files()
    if folder is None:
        for name, path in found.items():
            echo(f"{name:24} {_first_words(path)}")
        return
    copied = 0
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, path in found.items():
            if not (folder / name).exists():
                shutil.copyfile(path, folder / name)
                copied += 1
    except OSError as error:
        raise InputError(
            f"cannot be written: {error.strerror}", where=str(folder), remedy="give another folder"
        ) from None
    kept = len(found) - copied
    echo(f"{folder}: {copied} examples" + (f", {kept} that were there are kept" if kept else ""))


def _first_words(path: Path) -> str:
    """What the file says of itself in its first line."""
    first = path.read_text().partition("\n")[0]
    return first.removeprefix("# ") if first.startswith("# ") else ""
