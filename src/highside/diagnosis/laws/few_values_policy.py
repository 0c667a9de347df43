"""The numbers that decide where a session of few poses is searched again beside less noise than was learnt.

Each stands with its unit, its meaning and what set it. They are no settings for users.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FewValuesPolicy:
    """A start beside white noise between the floor and the noise that was learnt."""

    most: int = 48
    """Values of a channel, at most. Source: of 28 laws that the deck of 6e7a832 closed to less than 0.8, of up to 48
    values, 9 close more by it; of three of 94 to 191 values none, in three to eight times the time."""
    far: float = 10.0
    """Noise that was learnt, in units of the floor, from which there is such a start. Source: as
    `LawVerdictPolicy.most_left`."""
    gain: float = 24.0
    """Nats that a law found so must be worth where noise as far above the floor stays beside it; of laws chosen one by
    one, on one of its channels. Source: law/308 of that deck: a false law of 15.6 nats in 14 poses beside 29 times the
    floor; right ones had 20 to 134."""
    between: tuple[float, ...] = (0.5, 0.67, 0.33)
    """Powers of that noise at which it begins. Source: chosen; of 0.5 alone two of nine cases of that deck are not
    found."""
    unmeasured: float = 1e4
    """Noise that was learnt, in units of the floor, from which that is no floor of noise but the readings' rounding,
    as in a table of means: what is far above it is no sign of a law. Source: a law of strength 1e6, the largest of the
    decks, leaves 384 (law/006 of handtune-a); the poses of a simulated bench in a table without rows 1e5."""
    powers: tuple[float, ...] = (0.33, 0.5, 0.67, 0.8)
    """Powers of the noise that was learnt beside the laws so far, at each of which laws that are chosen one by one are
    looked at. Source: `between`, and one nearer to that noise, where fewer functions gain more."""
    first: int = 12
    """Laws at each of these that are tried with the noise learnt again. Source: law/318 of the deck of a8d2cc90: of two
    laws of 44 and 34 nats the first was eighth at 0.8, and the second twelfth at 0.33."""
    settled: int = 4
    """The likeliest of these that are refitted and varied beside their own noise. Source: chosen; rivals of the best
    were within its class."""


FEW_VALUES = FewValuesPolicy()
