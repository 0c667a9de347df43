"""The `highside` command, as the console script enters it; what it can do stands in `cli/commands.py`.

Exit status: 0 done; 1 the work was done and the answer is bad news that scripts must see; 2 wrong usage or input;
70 a defect of highside itself (set HIGHSIDE_DEBUG=1 to see where).
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

from highside.cli.say import echo_version
from highside.version import __version__

if TYPE_CHECKING:
    import typer

    app: typer.Typer
    """the whole command; made when it is asked for"""


def __getattr__(name: str) -> Any:
    """`app`, with all commands loaded."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from highside.cli.commands import app_of

    globals()[name] = app_of()
    return globals()[name]


def main() -> None:
    """Entry point of the console script."""
    if sys.argv[1:] == ["--version"]:
        # asked by scripts and packages before anything else: nothing is loaded for it
        echo_version(__version__)
        return
    # our matrices are small: threads inside a product cost more than they bring (read when numpy is first imported)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if sys.platform == "win32":
        # the MQTT client waits for its socket as the other systems' event loops let it
        import asyncio

        asyncio.set_event_loop_policy(asyncio.WindowsSelectorEventLoopPolicy())
    from highside.cli.loading import loading, own_process

    own_process()
    with loading():
        from highside.cli.commands import run
    sys.exit(run(sys.argv[1:]))
