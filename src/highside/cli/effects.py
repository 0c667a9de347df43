"""`highside effects`: what the library of effects holds, and a law as a new effect of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from highside.cli.options import as_options
from highside.cli.own_effects import EffectFolders, take_in
from highside.cli.say import echo

app = typer.Typer(name="effects", help="The library of effects: its page, and new effects made of laws.")


@app.callback(invoke_without_command=True)
def effects(context: typer.Context, folders: EffectFolders = None) -> None:
    """Print the page of the library of effects (Markdown): stories, formulas, parameters, ranges, confounders."""
    from highside.physics.effects_page import markdown

    take_in(folders)
    if context.invoked_subcommand is None:
        echo(markdown(), nl=False)


@app.command()
def new(
    source: Annotated[Path, typer.Option("--from", metavar="JSON", help="diagnosis.json of a diagnosis with a law.")],
    effect_id: Annotated[str, typer.Option("--id", help="Id of the new effect: a-z, 0-9 and _.")],
    folder: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of effects of your own.")],
    law: Annotated[str | None, typer.Option("--law", help="Which law, where several are claimed.")] = None,
) -> None:
    """Write a law that a diagnosis found as an effect of your own: a Python file, found again by --effects DIR."""
    from highside.api.learning import new_effect

    with as_options(id="--id", law="--law"):
        path = new_effect(source, effect_id, folder, law=law)
    echo(f"{path}: written; fill in its story, then use it with --effects {folder}")
