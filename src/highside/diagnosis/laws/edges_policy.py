"""The numbers that decide for several edges of one session.

Each stands with its unit, its meaning and what set it. They are no settings for users.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EdgesPolicy:
    """Steps, ramps and decays that are sought together."""

    most: int = 6
    """Edges of one session, at most. Source: as `LawSearchPolicy.most`."""
    rounds: int = 4
    """Rounds in which each edge is put where it does best beside the others. Source: chosen; two and three steps of one
    offset (`python -m studies.odd_faults --design poses`) stay where they are after two."""
    steps_over: int = 24
    """Places over another covariate at which a step is tried, at most. Source: chosen; half of those in time, and
    places between them are tried once one is found."""


EDGES = EdgesPolicy()
