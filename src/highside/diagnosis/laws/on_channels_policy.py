"""The numbers that decide how many inner products a search keeps, channel by channel.

Each stands with its unit, its meaning and what set it. They are no settings for users.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OnChannelsPolicy:
    """What is kept of columns too many to be kept whitened."""

    shapes: int = 4
    """Shapes of a channel's noise whose inner products are kept. Source: a rotation of 360,000 rows with a law tried
    three at most (`python -m tests.bench.diagnosis_speed`)."""
    part: int = 16
    """One shape of a channel may keep this part of the numbers that `LawEvidencePolicy.kept` allows. Source: three
    channels of `shapes` each."""


ON_CHANNELS = OnChannelsPolicy()
