"""Commands of `highside` inside the process of the tests, which spares the start of one: a second of a processor each.

What only a process has (its exit, signals, a terminal, what is imported when) is tested where processes are started.
"""

from __future__ import annotations

import contextlib
import io
import subprocess
from pathlib import Path
from unittest import mock

from highside.cli.commands import run


def highside_inside(
    *arguments: object, cwd: Path | None = None, environment: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Exit status, output and errors of a command; there is nothing to read on its standard input."""
    words = [str(argument) for argument in arguments]
    out, err = io.StringIO(), io.StringIO()
    place = contextlib.nullcontext() if cwd is None else contextlib.chdir(cwd)
    with (
        place,
        mock.patch.dict("os.environ", environment or {}),
        mock.patch("sys.stdin", io.StringIO()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        status = run(words)
    return subprocess.CompletedProcess(words, status, out.getvalue(), err.getvalue())
