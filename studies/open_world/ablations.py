"""Parts of `diagnose` that are no switch of it, left out one at a time.

- `floor`: how well means repeat, by the rows within the poses. Without it the noise is what the misfit leaves.
- `free_rivals`: for every name the best law in its place. Without them a name stands against other names alone.
- `stability`: whether a size is the same over parts of the session.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any
from unittest import mock

import numpy as np

PARTS = ("floor", "free_rivals", "stability")


def _no_rival(claims: Sequence[Any], found: Any) -> tuple[tuple[Any, ...], dict[str, float]]:
    """The claims as they are, each ahead of every law."""
    places = {term.group.effect for term in found.terms}
    return tuple(claims), {claim.effect: np.inf for claim in claims if claim.effect in places}


@contextlib.contextmanager
def leaving_out(part: str) -> Iterator[None]:
    """The command `diagnose` without one of `PARTS`, of sessions of poses."""
    replaced = {
        "floor": ("highside.diagnosis.poses.session.floor_of_means", lambda *given: None),
        "free_rivals": ("highside.diagnosis.beside_laws.with_free_rivals", _no_rival),
        "stability": ("highside.diagnosis.core.still_problem.StillProblem.stability", lambda *given: None),
    }
    with mock.patch(*replaced[part]):
        yield
