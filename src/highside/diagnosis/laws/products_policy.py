"""The numbers that decide for laws that are a product of one function of each of two quantities.

Each stands with its unit, its meaning and what set it. They are no settings for users.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ProductsPolicy:
    """Products that are sought among all pairs of quantities."""

    turns: int = 6
    """Turns in which the two functions are fitted, of all pairs. Source: chosen; what is near is fitted to the end."""
    at_once: int = 100
    """Pairs whose inner products are held together. Source: 16 MB of 143 functions each."""
    refined: int = 8
    """Pairs, the best of these, that are. Source: chosen."""
    refined_turns: int = 25
    """Turns of these. Source: chosen; of six laws looked at none changed its worth by a nat after fifteen."""
    starts: int = 2
    """Functions of the second quantity that are begun with, beside the one that the readings drive most. Source:
    chosen; the constant and the first wave."""
    tried: int = 4
    """Products beside which the noise is learnt, of each start. Source: chosen."""
    rounds: int = 2
    """Turns of product and noise. Source: as `LawSearchPolicy.rounds`."""
    lengths: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    """Lengths of the prior of the second function, in orders. Source: as those of `LawEvidencePolicy`, every other."""
    ridge: float = 1e-9
    """Share of the largest power of a product of functions, below which it drives nothing. Source: rounding."""


PRODUCTS = ProductsPolicy()
