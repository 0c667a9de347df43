"""`highside confirm`: whether another session shows again what a model took up from the first."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from highside.cli.own_effects import EffectFolders, take_in
from highside.cli.say import echo


def confirm(
    model: Annotated[Path, typer.Argument(metavar="FOUND", help="Model file that diagnose --write-model wrote.")],
    recording: Annotated[
        Path, typer.Argument(metavar="REC2", help="Another session of the same sensor: Recording or pose table (CSV).")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    effects: EffectFolders = None,
) -> None:
    """Say of each law and effect of a model which share of it another session confirms; exit 1 where one is refuted."""
    from highside.api.confirmation import confirm as run

    take_in(effects)
    done = run(model, recording)
    if as_json:
        echo(json.dumps(done.to_dict(), indent=1))
    else:
        for claim in done.claims:
            echo(claim.in_words())
    if any(claim.verdict == "not_confirmed" for claim in done.claims):
        raise typer.Exit(1)
