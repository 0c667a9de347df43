"""`highside effects`: what the library of effects holds."""

from __future__ import annotations

from highside.cli.say import echo


def effects() -> None:
    """Print the page of the library of effects (Markdown): stories, formulas, parameters, ranges, confounders."""
    from highside.physics.effects_page import markdown

    echo(markdown(), nl=False)
