"""The numbers that decide for laws that set in midway, and for several edges of one session.

Each stands with its unit, its meaning and what set it. They are no settings for users.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OnsetsPolicy:
    """Laws that act from some time of a session on."""

    most: int = 4
    """Laws of one start, at most. Source: as `LawSearchPolicy.most_first`."""
    before: int = 3
    """Values before an onset, at least. Source: chosen; nothing of the law acts on them, and they need only show that.
    Of 16 poses, 7 of them before the onset, none was tried with eight (law/104 of the open world, seed a8d2cc90)."""
    values: int = 8
    """Values after an onset, at least. Source: of 13 poses, 8 of them after the onset, curves of the
    toolface and of the load on either axis were within 12 nats of each other, and none was right (law/618 of the open
    world of seed onset-tune-1)."""
    rounds: int = 2
    """Rounds in which each is put where it does best beside the others. Source: as `LawSearchPolicy.rounds`."""
    most_values: float = 0.9
    """Share of the values whose rows lie within the time over which an onset is placed among rows. Source: chosen; some
    cells of a rotation hold rows of far turns."""
    span: float = 3.5
    """That time, in standard deviations of the times of a value's rows. Source: the root of 12, of even times."""
    in_a_value: int = 9
    """Times tried within a value that stands for many rows. Source: chosen."""
    rounds_to_the_row: int = 3
    """Rounds of them, each four times as fine. Source: a value of ten turns is of some hundred rows."""


ONSETS = OnsetsPolicy()


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
