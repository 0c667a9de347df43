"""What every command refuses before it begins, and in which language it refuses."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

import typer

from highside.cli.finite import finite_numbers
from highside.cli.options import refusing
from highside.cli.overwriting import own_outputs

_MARK = "is_guarded"
"""attribute of a command that is: the modules of groups are loaded once, and added to each application that is made"""


def guard(app: typer.Typer) -> None:
    """Let every command of `app` and its groups refuse numbers that are none, and outputs that are not its own."""
    for group in app.registered_groups:
        assert group.typer_instance is not None
        guard(group.typer_instance)
    for command in app.registered_commands:
        if command.callback is not None and not hasattr(command.callback, _MARK):
            command.callback = _guarded(command.callback)


def _guarded(function: Callable[..., Any]) -> Callable[..., Any]:
    made = _spoken(finite_numbers(own_outputs(function)))
    setattr(made, _MARK, True)
    return made


def _spoken(function: Callable[..., Any]) -> Callable[..., Any]:
    """A command that has `--language` refuses in it, too."""
    if "language" not in inspect.signature(function).parameters:
        return function

    @functools.wraps(function)
    def guarded(*args: Any, **given: Any) -> Any:
        with refusing(given.get("language")):
            return function(*args, **given)

    return guarded
