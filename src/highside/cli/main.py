"""The `highside` command: registers the sub-commands and turns errors into one line and an exit status.

Exit status: 0 done; 1 the work was done and the answer is bad news that scripts must see; 2 wrong usage or input;
70 a defect of highside itself (set HIGHSIDE_DEBUG=1 to see where).
"""

from __future__ import annotations

import os
import sys
from typing import Any

import typer

from highside import __version__
from highside.cli import (
    calibrate,
    confirm,
    decode,
    demo,
    detect,
    diagnose,
    doctor,
    documentation,
    drift,
    effects,
    examples,
    export,
    fleet,
    importing,
    init,
    keys,
    predict,
    replay,
    reproduce,
    rotation,
    run,
    simulate,
    toolface,
)
from highside.cli.options import as_options, in_options
from highside.cli.say import echo
from highside.errors import HighsideError
from highside.printable import one_line

app = typer.Typer(
    name="highside",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="Live acquisition and calibration for the accelerometers and gyros of a directional drilling tool.",
)


def _version(show: bool) -> None:
    if show:
        echo(__version__)
        raise typer.Exit


@app.callback()
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


app.command()(confirm.confirm)
app.command()(decode.decode)
app.command()(demo.demo)
app.command()(detect.detect)
app.command()(documentation.docs)
app.command()(documentation.examples)
app.command()(drift.drift)
app.command()(diagnose.diagnose)
app.command()(doctor.doctor)
app.command()(predict.predict)
app.command()(replay.replay)
app.add_typer(calibrate.app)
app.add_typer(reproduce.app)
app.add_typer(rotation.app)
app.command()(run.run)
app.command()(simulate.simulate)
app.add_typer(effects.app)
app.add_typer(fleet.app)
app.command()(export.export)
app.command()(init.init)
app.command("import")(importing.import_file)
app.add_typer(keys.app)
app.add_typer(toolface.app)
app.command()(run.check)
app.command()(run.schema)
examples.attach(app)


UsageFault: type[Exception] = next(
    kind for kind in reversed(typer.BadParameter.__mro__) if hasattr(kind, "format_message")
)
"""The class of everything that is wrong with a command line. typer carries its parser inside itself and exports the
leaves of its errors only; their common root is therefore found from a leaf, whatever module it lives in."""


def _usage(error: Any) -> int:
    """Say in one line what is wrong with the command line (typer would draw a box of five); the exit status."""
    context = getattr(error, "ctx", None)
    text = one_line(error.format_message())
    if type(error).__name__ == "NoArgsIsHelpError":
        # a group without a command: its help is printed already
        text = "no command given; choose one of those above"
    remedy = f" (see {context.command_path} --help)" if context is not None else ""
    echo(f"highside: {text}{remedy}", err=True)
    return int(error.exit_code)


def main() -> None:
    """Entry point of the console script."""
    # our matrices are small: threads inside a product cost more than they bring (read when numpy is first imported)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if sys.platform == "win32":
        # the MQTT client waits for its socket as the other systems' event loops let it
        import asyncio

        asyncio.set_event_loop_policy(asyncio.WindowsSelectorEventLoopPolicy())
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except UsageFault as error:
        sys.exit(_usage(error))
    except (typer.Abort, KeyboardInterrupt):
        sys.exit(130)
    except HighsideError as error:
        echo(f"highside: {in_options(error)}", err=True)
        sys.exit(error.exit_status)
    except BrokenPipeError:
        # the reader of our output went away (`| head`): not an error of ours
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except Exception as error:
        if os.environ.get("HIGHSIDE_DEBUG"):
            raise
        echo(
            f"highside: internal error: {type(error).__name__}: {one_line(str(error))}"
            " (set HIGHSIDE_DEBUG=1 for details)",
            err=True,
        )
        sys.exit(70)
