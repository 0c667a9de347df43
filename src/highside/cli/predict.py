"""`highside predict`: what a model says each row of a recording reads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from highside.cli.own_effects import EffectFolders, take_in
from highside.cli.say import echo


def predict(
    model: Annotated[Path, typer.Argument(help="Model file (TOML).")],
    recording: Annotated[
        Path, typer.Argument(metavar="REC", help="Recording or pose table (CSV) with inc_ref_deg, tf_ref_deg.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="The same columns, the readings as predicted.")],
    effects: EffectFolders = None,
) -> None:
    """Write what the model says each row reads, noise omitted: the recording with its readings replaced."""
    from highside.api.simulation import PREDICTED
    from highside.api.simulation import predict as run

    take_in(effects)
    made = run(model, recording)
    made.write(output)
    names = [name for name in PREDICTED if made.has(name)]
    without = made.rows_without(*names)
    echo(f"{output}: {made.n} rows, {', '.join(names)} as predicted")
    if without:
        echo(f"{without} rows lack time, reference or a covariate and have no prediction", err=True)
