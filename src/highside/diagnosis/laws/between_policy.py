"""The numbers that decide for laws with a number that lies between those tried.

Each stands with its unit, its meaning and what set it. They are no settings for users.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LawLagsPolicy:
    """Time constants of a temperature that lags, of a law that was found."""

    ratio: float = 1.5
    """Of two neighbours of the list. Source: `highside.physics.covariates.LAGS_S`."""
    finer: float = 0.25
    """Step of the first look between two neighbours, in powers of that ratio. Source: chosen; 11 %."""
    each_side: int = 3
    """Steps on either side. Source: up to the neighbours."""
    steps: tuple[float, ...] = (0.25, 0.0625)
    """Steps of further looks, in units of the first. Source: the last leaves a lag of 0.6 % and of 1 s; of a law of
    strength 1e6 half of that leaves about 10."""
    steps_of_wave: tuple[float, ...] = (0.25, 0.0625, 1 / 64, 1 / 256, 1 / 1024)
    """The same of the period of a wave. Source: the last leaves 1e-4 turns over the session; of a wave of strength 1e9
    half of that leaves about 10."""
    large: float = 500.0
    """Nats that the best group gains, from which others are refined before it is taken. Source: arithmetic; a number
    halfway between two that are tried leaves a fiftieth, 10 nats of these."""
    near: float = 0.8
    """Share of that which a group must gain to be refined. Source: chosen; a line of a session of three turns, its
    order off by a twentieth, keeps 0.93 of itself."""
    refined: int = 4
    """Groups that are refined at a time, each in its place and of its quantities. Source: chosen."""


LAW_LAGS = LawLagsPolicy()
