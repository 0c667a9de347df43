"""The commands by name, each loaded when it is asked for, and what ends them: one line and an exit status.

`highside diagnose ...` loads what `diagnose` needs and nothing of the others. Whoever asks for help, or for a command
that there is not, loads them all.
"""

from __future__ import annotations

import errno
import os
import sys
import warnings
from importlib import import_module
from typing import Any

import typer

from highside.cli import examples
from highside.cli.guards import guard
from highside.cli.loading import loading
from highside.cli.options import as_options, asked_language, refusal
from highside.cli.say import echo
from highside.errors import HighsideError
from highside.printable import one_line
from highside.version import __version__

__all__ = ["COMMANDS", "app_of", "run"]

COMMANDS = {
    "confirm": "confirm.confirm",
    "decode": "decode.decode",
    "demo": "demo.demo",
    "detect": "detect.detect",
    "docs": "documentation.docs",
    "examples": "documentation.examples",
    "drift": "drift.drift",
    "diagnose": "diagnose.diagnose",
    "doctor": "doctor.doctor",
    "predict": "predict.predict",
    "replay": "replay.replay",
    "calibrate": "calibrate.app",
    "reproduce": "reproduce.app",
    "rotation": "rotation.app",
    "run": "run.run",
    "serve": "serve.serve",
    "simulate": "simulate.simulate",
    "effects": "effects.app",
    "fleet": "fleet.app",
    "export": "export.export",
    "init": "init.init",
    "import": "importing.import_file",
    "keys": "keys.app",
    "surveys": "surveys.app",
    "toolface": "toolface.app",
    "users": "users.app",
    "watch": "watch.app",
    "check": "run.check",
    "schema": "run.schema",
}
"""name, in the order of the help: its module in this package and its function there, or the group of that module"""


def app_of(only: str | None = None) -> typer.Typer:
    """The whole command, or the one with a single sub-command."""
    app = typer.Typer(
        name="highside",
        no_args_is_help=True,
        rich_markup_mode="markdown",
        pretty_exceptions_enable=False,
        help="Live acquisition and calibration for the accelerometers and gyros of a directional drilling tool.",
    )
    app.callback()(_top)
    for name in COMMANDS if only is None else (only,):
        module, attribute = COMMANDS[name].split(".")
        found = getattr(import_module(f"highside.cli.{module}"), attribute)
        if isinstance(found, typer.Typer):
            app.add_typer(found)
        else:
            app.command(name)(found)
    examples.attach(app)
    guard(app)
    return app


def _version(show: bool) -> None:
    if show:
        echo(__version__)
        raise typer.Exit


def _top(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version and exit."
    ),
    max_bytes: str | None = typer.Option(
        None,
        "--max-bytes",
        envvar="HIGHSIDE_MAX_BYTES",
        metavar="SIZE",
        help="Longest file to read, unzipped (e.g. 8G); 2G if not given.",
    ),
) -> None:
    """Options of the whole command."""
    if max_bytes is not None:
        from highside.reading.files import allow_bytes, size

        with as_options("max_bytes"):
            allow_bytes(size(max_bytes))


UsageFault: type[Exception] = next(
    kind for kind in reversed(typer.BadParameter.__mro__) if hasattr(kind, "format_message")
)
"""The class of everything that is wrong with a command line. typer carries its parser inside itself and exports the
leaves of its errors only; their common root is therefore found from a leaf, whatever module it lives in."""


def _usage(error: Any) -> int:
    """Say in one line what is wrong with the command line (typer would draw a box of five); the exit status."""
    from highside.words import _, told

    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":
        # a group without a command: its help is printed already
        text = _("no command given; choose one of those above")
    else:
        # what of it pydantic says, it says as of a class of errors
        text = told(one_line(error.format_message()).replace("Value error, ", ""), "commands")
    if context is not None:
        text = _("%(what)s (see %(command)s --help)", what=text, command=context.command_path)
    echo(f"highside: {text}", err=True)
    return int(error.exit_code)


_NO_ROOM = frozenset({errno.ENOSPC, errno.EFBIG, errno.EIO})
"""what a full or failing disk behind `> FILE` answers"""
_OF_THE_PLACE = _NO_ROOM | {errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG, errno.ELOOP, errno.ESTALE}
"""what a file system answers of a path that this user may not or cannot use, wherever it is asked"""


_OF_ARITHMETIC = r"(overflow|underflow|invalid value|divide by zero) encountered"
"""How numpy's warnings begin. They name lines of this program and no file, row or remedy: what becomes of a reading of
1e300 is said by the answer."""


def _is_no_text(argument: str) -> bool:
    """Whether the command line had bytes there that are not UTF-8: a file may be called so, what is written may not."""
    try:
        argument.encode()
    except UnicodeEncodeError:
        return True
    return False


def run(arguments: list[str]) -> int:
    """Do what the command line says; the exit status."""
    if not sys.warnoptions and not os.environ.get("HIGHSIDE_DEBUG"):
        warnings.filterwarnings("ignore", _OF_ARITHMETIC, RuntimeWarning)
    try:
        with loading():
            app = app_of(arguments[0] if arguments and arguments[0] in COMMANDS else None)
        return int(app(arguments, standalone_mode=False) or 0)
    except HighsideError as error:
        # a service's refusals stand in its log, which is English
        code = "en" if arguments[:1] == ["run"] else asked_language(arguments)
        echo(f"highside: {refusal(error, code)}", err=True)
        return error.exit_status
    except BrokenPipeError:
        # the reader of our output went away (`| head`): not an error of ours
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (Exception, KeyboardInterrupt) as error:
        from highside.words import in_language

        with in_language(asked_language(arguments)):
            return _ended(error, arguments)


def _ended(error: BaseException, arguments: list[str]) -> int:
    """Say what ended a command that did not refuse anything; the exit status. Raises it again for who debugs."""
    from highside.words import _

    if isinstance(error, UsageFault):
        return _usage(error)
    if isinstance(error, typer.Abort | KeyboardInterrupt):
        if not isinstance(error.__context__, EOFError):
            return 130
        echo("", err=True)
        text = _("the input ended before all questions were answered; give them as options")
    elif isinstance(error, OSError) and error.filename is None and error.errno in _NO_ROOM:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        text = _("the output cannot be written: %(why)s; make room, or send it elsewhere", why=error.strerror)
    elif isinstance(error, UnicodeEncodeError) and (given := next(filter(_is_no_text, arguments), None)) is not None:
        text = _("%(argument)s: holds bytes that are no text; write it in UTF-8", argument=one_line(given))
    elif os.environ.get("HIGHSIDE_DEBUG"):
        raise error
    elif isinstance(error, OSError) and error.filename is not None and error.errno in _OF_THE_PLACE:
        where = one_line(os.fsdecode(error.filename) if isinstance(error.filename, bytes) else str(error.filename))
        text = _("%(file)s: %(why)s; name another place, or mend this one", file=where, why=error.strerror)
    else:
        what = f"{type(error).__name__}: {one_line(str(error))}"
        echo(f"highside: {_('internal error: %(what)s (set HIGHSIDE_DEBUG=1 for details)', what=what)}", err=True)
        return 70
    echo(f"highside: {text}", err=True)
    return 2
