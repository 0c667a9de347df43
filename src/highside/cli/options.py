"""What the library says of an argument, a command says of its option: `pose_sigma_deg` is `--pose-sigma-deg`. And
options that several commands have."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Literal

import typer

from highside.errors import HighsideError, InputError

Language = Annotated[
    Literal["en", "de", "nb", "es"], typer.Option("--language", help="Of report.html and of what is printed.")
]
PrintLanguage = Annotated[Literal["en", "de", "nb", "es"], typer.Option("--language", help="Of what is printed.")]
PageLanguage = Annotated[
    Literal["en", "de", "nb", "es"], typer.Option("--language", help="Of the page that --html writes.")
]
_ARGUMENT = re.compile(
    r"\b(align|axial|azimuths|calibration|depths|model|of|rate_terms|reference|rest|simulation|tool)=(?:'([\w.]+)'|\"([\w.]+)\")?"
)
"""How the library names an argument that would help, `rest=` or `align="none"`: each is an option of its command."""


def in_options(message: HighsideError | str) -> str:
    """A remark, or an error with its remedy, in which arguments that are named as a call would are options:
    `align="none"` is `--align none`. File names and what stood in them are left as they are."""
    if isinstance(message, InputError):
        remedy = None if message.remedy is None else in_options(message.remedy)
        return str(InputError(message.what, where=message.where, field=message.field, remedy=remedy))
    if isinstance(message, HighsideError):
        return str(message)

    def option(found: re.Match[str]) -> str:
        value = found[2] or found[3]
        return f"--{found[1].replace('_', '-')}{f' {value}' if value else ''}"

    return _ARGUMENT.sub(option, message)


@contextmanager
def speaking(code: str, of: str = "") -> Iterator[None]:
    """Within it a command says everything in that language, what it refuses too. `of`: as of `told`."""
    from highside.cli.say import echo
    from highside.words import in_language
    from highside.words.errors import error_told

    with in_language(code):
        try:
            yield
        except HighsideError as error:
            if code == "en":
                raise
            echo(f"highside: {in_options(error_told(error, of))}", err=True)
            raise typer.Exit(error.exit_status) from None


@contextmanager
def as_options(*names: str, **options: str) -> Iterator[None]:
    """Within it an InputError about one of these arguments names the option of that name, or the one that is given."""
    try:
        yield
    except InputError as error:
        option = options.get(error.field or "")
        if option is None and error.where is None and error.field in names:
            option = "--" + error.field.replace("_", "-")
        if option is None:
            raise
        named = InputError(error.what, where=error.where, field=option, remedy=error.remedy)
        named.code = error.code
        raise named from None
