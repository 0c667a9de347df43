"""What the library says of an argument, a command says of its option: `pose_sigma_deg` is `--pose-sigma-deg`. And
options that several commands have."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Literal

import typer

from highside.errors import HighsideError, InputError

Code = Literal["en", "de", "nb", "es"]
_ELSE = "else as HIGHSIDE_LANGUAGE or the locale says."
Language = Annotated[Code | None, typer.Option("--language", help=f"Of report.html and of what is printed; {_ELSE}")]
PrintLanguage = Annotated[Code | None, typer.Option("--language", help=f"Of what is printed; {_ELSE}")]
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
def speaking(code: str | None) -> Iterator[None]:
    """Within it a command says everything in that language; `None`: in that of whoever sits at the terminal. What it
    refuses `spoken` tells."""
    from highside.words import in_language

    with in_language(_code(code)):
        yield


@contextmanager
def refusing(code: str | None) -> Iterator[None]:
    """Within it a command refuses in that language, as `speaking`."""
    from highside.cli.say import echo

    try:
        yield
    except HighsideError as error:
        if _code(code) == "en":
            raise
        echo(f"highside: {refusal(error, code)}", err=True)
        raise typer.Exit(error.exit_status) from None


def refusal(error: HighsideError, code: str | None) -> str:
    """What is wrong and what to do, in one line, in that language."""
    from highside.words import in_language
    from highside.words.errors import error_told

    if _code(code) == "en":
        return in_options(error)
    with in_language(_code(code)):
        return in_options(error_told(error, "commands"))


def asked_language(arguments: Sequence[str]) -> str:
    """That of `--language` on a command line, in whatever else is wrong with it; else that of the terminal."""
    code = None
    for one, following in zip(arguments, [*arguments[1:], ""], strict=False):
        name, _, value = one.partition("=")
        if name == "--language":
            code = value or following
    return _code(code)


def _code(code: str | None) -> str:
    from highside.words import LANGUAGES
    from highside.words.preferred import preferred_language

    return code if code in LANGUAGES else preferred_language()


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
