"""`--effects DIR`: effects of the user's own, beside those of the library and of installed packages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from highside.cli.options import as_options
from highside.cli.say import echo

EffectFolders = Annotated[
    list[Path] | None,
    typer.Option(
        "--effects",
        metavar="DIR",
        envvar="HIGHSIDE_EFFECTS",
        help="Folder of effects of your own, one Python file each; may be repeated. They are code and are run.",
    ),
]


def take_in(folders: Sequence[Path] | None) -> None:
    """Use the effects of these folders; say which of installed packages cannot be used.

    Raises InputError (file, what) for a file that is no effect.
    """
    from highside.physics.effects import unusable, use_folders

    with as_options(effects="--effects"):
        use_folders(folders or ())
    for line in unusable():
        echo(line, err=True)
