"""Numbers of options: what is no number (nan), or is beyond all of them (inf), is refused before a command begins."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable
from typing import Any, get_args

from typer.models import OptionInfo

from highside.errors import InputError


def finite_numbers(function: Callable[..., Any]) -> Callable[..., Any]:
    """A command that refuses numbers that are none."""

    @functools.wraps(function)
    def guarded(*args: Any, **given: Any) -> Any:
        for name, value in given.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise InputError(f"{value} is not a finite number", field=_option(function, name))
        return function(*args, **given)

    return guarded


def _option(function: Callable[..., Any], name: str) -> str:
    """As the user writes it."""
    parameter = inspect.signature(function, eval_str=True).parameters[name]
    for info in (*get_args(parameter.annotation), parameter.default):
        if isinstance(info, OptionInfo):
            # a single name stands where a default would
            names = [one for one in (info.default, *(info.param_decls or ())) if str(one).startswith("--")]
            return str(names[0]) if names else f"--{name.replace('_', '-')}"
    return name.upper()
