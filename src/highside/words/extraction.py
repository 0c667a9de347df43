"""What effects and covariates say of themselves, for the catalogue: they declare it as plain texts, without a mark.

A method of Babel (`.babel.cfg`): the texts of class attributes and arguments of these names are messages.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator, Mapping
from typing import IO

NAMES = ("title", "story", "splitter", "averages_out", "channel_story", "channel_needs")
"""Attributes of `physics.effect.Effect`, and of a covariate of laws, that a report shows."""


def declared(
    file: IO[bytes], keywords: Collection[str], comment_tags: Collection[str], options: Mapping[str, object]
) -> Iterator[tuple[int, None, str, list[str]]]:
    """Messages of a source file, as Babel wants them: line, function, message, comments."""
    for node in ast.walk(ast.parse(file.read())):
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            named: list[tuple[str, ast.expr]] = [(node.targets[0].id, node.value)]
        elif isinstance(node, ast.Call):
            named = [(one.arg or "", one.value) for one in node.keywords]
            if isinstance(node.func, ast.Name) and node.func.id == "Covariate":
                named += [("title", one) for one in node.args[1:2]]
            if isinstance(node.func, ast.Name) and node.func.id == "said":
                named += [("title", one) for one in node.args[:1]]
        else:
            continue
        for name, value in named:
            if name in NAMES and isinstance(value, ast.Constant) and isinstance(value.value, str) and value.value:
                yield node.lineno, None, value.value, []
