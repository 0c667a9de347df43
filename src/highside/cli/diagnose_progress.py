"""Progress of a long diagnosis: on stderr, and only where that is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress_on_terminal() -> Iterator[Callable[[float, str], None]]:
    """A function that takes a share done and words; it shows nothing where nobody watches."""
    if not sys.stderr.isatty():
        yield lambda share, words: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    with bar:
        task = bar.add_task("diagnosis", total=None)

        def show(share: float, words: str) -> None:
            # a share of nothing yet is a spinner that runs on
            bar.update(task, description=words, total=1.0 if share > 0 else None, completed=share)

        yield show
