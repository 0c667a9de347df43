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
    """Nats that a law found so must be worth where noise as far above the floor stays beside it. Source: law/308 of
    that deck: a false law of 15.6 nats in 14 poses beside 29 times the floor; right ones had 20 to 134."""
    between: tuple[float, ...] = (0.5, 0.67, 0.33)
    """Powers of that noise at which it begins. Source: chosen; of 0.5 alone two of nine cases of that deck are not
    found."""


FEW_VALUES = FewValuesPolicy()
