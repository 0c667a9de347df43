"""What the library says of an argument, a command says of its option: `pose_sigma_deg` is `--pose-sigma-deg`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from highside.errors import HighsideError, InputError

_ARGUMENT = re.compile(
    r"\b(align|calibration|model|of|rate_terms|reference|rest|simulation|tool)=(?:'([\w.]+)'|\"([\w.]+)\")?"
)
"""How the library names an argument that would help, `rest=` or `align="none"`: each is an option of its command."""


def in_options(said: HighsideError | str) -> str:
    """A remark, or an error with its remedy, in which arguments that are named as a call would are options:
    `align="none"` is `--align none`. File names and what stood in them are left as they are."""
    if isinstance(said, InputError):
        remedy = None if said.remedy is None else in_options(said.remedy)
        return str(InputError(said.what, where=said.where, field=said.field, remedy=remedy))
    if isinstance(said, HighsideError):
        return str(said)

    def option(found: re.Match[str]) -> str:
        value = found[2] or found[3]
        return f"--{found[1].replace('_', '-')}{f' {value}' if value else ''}"

    return _ARGUMENT.sub(option, said)


@contextmanager
def as_options(*names: str, **options: str) -> Iterator[None]:
    """Within it an InputError about one of these arguments names the option of that name, or the one that is given."""
    try:
        yield
    except InputError as error:
        if error.field in options:
            raise InputError(error.what, where=error.where, field=options[error.field], remedy=error.remedy) from None
        if error.where is None and error.field in names:
            option = "--" + error.field.replace("_", "-")
            raise InputError(error.what, field=option, remedy=error.remedy) from None
        raise
