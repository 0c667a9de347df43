"""`highside effects`: what the library of effects holds."""

from __future__ import annotations

from highside.cli.own_effects import EffectFolders, take_in
from highside.cli.say import echo


def effects(folders: EffectFolders = None) -> None:
    """Print the page of the library of effects (Markdown): stories, formulas, parameters, ranges, confounders."""
    from highside.physics.effects_page import markdown

    take_in(folders)
    echo(markdown(), nl=False)
