"""What every command refuses before it begins."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import typer

from highside.cli.finite import finite_numbers
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
    made = finite_numbers(own_outputs(function))
    setattr(made, _MARK, True)
    return made
