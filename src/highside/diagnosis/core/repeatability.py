"""Slow effects that leave no more than how well the readings repeat (`floor`): no random walk does as well.

A random walk that is as large as a step of three axes passes for the step. But few numbers take no walk down to a floor
that is known without it.
"""

from __future__ import annotations

from dataclasses import dataclass

from highside.diagnosis.core.policy import REPEATABILITY


@dataclass(frozen=True, slots=True)
class Remaining:
    """Sums of squares of readings in units of how well they repeat: after the base (`before`), and after what was
    chosen beside it (`left`, with so many degrees of freedom)."""

    before: float
    left: float
    freedom: float

    @property
    def ratio(self) -> float:
        """How many times more the readings disagree than they repeat."""
        return float((max(self.left, 0.0) / max(self.freedom, 1.0)) ** 0.5)

    @property
    def explained(self) -> bool:
        """Whether few parameters took a large misfit down to the floor, as no random walk lets them."""
        gone = self.before - self.left
        excess = self.left - self.freedom
        allowed = max(REPEATABILITY.slack * self.freedom, REPEATABILITY.remainder * gone)
        return gone > REPEATABILITY.strength and excess <= allowed and self.ratio <= REPEATABILITY.beyond
