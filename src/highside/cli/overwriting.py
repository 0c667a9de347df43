"""No command writes over a file that it reads, nor two answers to one place: a recording is made once.

Its own earlier answers a command replaces, so that scripts can be run again. What no command makes with these options
and nobody can make a second time is not replaced at all: keys, recordings of the wire, journals of sessions, messages
that wait for the broker.
"""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import typer
from typer.models import OptionInfo

from highside.errors import InputError

WRITTEN = ("--output", "--out", "--html", "--write-model", "--poses")
"""Options that name what is written, wherever their value is a path."""


IRREPLACEABLE = {
    b"-----BEGIN": "a key or a certificate",
    b"HSWIRE1\n": "a recording of the wire",
    b"SQLite format 3\0": "a database",
}
"""First bytes of a file -> what it is; no output of a command begins like this."""
JOURNAL = ".journal"
"""Ends the name of a session's journal, which begins like other JSON."""


def refuse_own_inputs(app: typer.Typer) -> None:
    """Let every command of `app` and its groups refuse an output that is one of its inputs, before it begins."""
    for group in app.registered_groups:
        assert group.typer_instance is not None
        refuse_own_inputs(group.typer_instance)
    for command in app.registered_commands:
        if command.callback is not None and not hasattr(command.callback, "__wrapped__"):
            command.callback = _guarded(command.callback)


def _guarded(function: Callable[..., Any]) -> Callable[..., Any]:
    written = dict(_outputs(function))

    @functools.wraps(function)
    def guarded(*args: Any, **given: Any) -> Any:
        read = [path for name, value in given.items() if name not in written for path in _paths(value)]
        others: dict[str, str] = {}
        for name, option in written.items():
            for output in _paths(given.get(name)):
                if output.is_file() and any(path.exists() and output.samefile(path) for path in read):
                    raise _no(output, option, "is a file that this command reads")
                if kind := _irreplaceable(output):
                    raise InputError(
                        f"is there already and is {kind}, which is not replaced",
                        where=str(output),
                        field=option,
                        remedy="name another file, or take this one away",
                    )
                # of links that lead round in a circle `Path.resolve` makes an error
                place = os.path.realpath(output)
                if other := others.get(place):
                    raise _no(output, option, f"is what {other} names, too")
                others[place] = option
        return function(*args, **given)

    return guarded if written else function


def _irreplaceable(path: Path) -> str | None:
    """What the file is if no answer of a command may take its place."""
    if not path.is_file():
        return None
    if path.suffix == JOURNAL:
        return "the journal of a session"
    longest = max(map(len, IRREPLACEABLE))
    try:
        with path.open("rb") as file:
            start = file.read(longest)
    except OSError:
        return None  # whoever writes will say why it cannot be
    return next((kind for begin, kind in IRREPLACEABLE.items() if start.startswith(begin)), None)


def _no(output: Path, option: str, what: str) -> InputError:
    return InputError(what, where=str(output), field=option, remedy="name another file")


def _outputs(function: Callable[..., Any]) -> Iterator[tuple[str, str]]:
    """(parameter, option) of what is written."""
    for name, parameter in inspect.signature(function, eval_str=True).parameters.items():
        if get_origin(parameter.annotation) is Annotated:
            for info in get_args(parameter.annotation)[1:]:
                # a single name stands where a default would
                names = (info.default, *(info.param_decls or ())) if isinstance(info, OptionInfo) else ()
                yield from ((name, option) for option in WRITTEN if option in names)


def _paths(value: object) -> tuple[Path, ...]:
    values = value if isinstance(value, list | tuple) else (value,)
    return tuple(one for one in values if isinstance(one, Path))
