"""Poses of which nobody wrote down from which side their toolface was approached: what is said of that."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from highside.diagnosis.core.result import Claim
from highside.physics.effects import registry

WITHOUT_SIDE = (
    "the recording has no column direction: from which side each toolface was approached is taken from the order in "
    "which they were set, of a table that does not turn over its zero"
)
SIDES = "rate_sign"
"""the covariate of the side of approach, and of the sense of a rotation"""


def of_sides(claims: Iterable[Claim], columns: Mapping[str, Any]) -> tuple[str, ...]:
    """Notes on claims of poses that the side of approach makes, or may make, where no column of the recording tells
    it."""
    if "direction" in columns:
        return ()
    known = registry()
    sided = (
        SIDES in claim.depends_on
        or any(name in known and "direction" in known[name].needs for name in (claim.effect, *claim.equivalence_class))
        for claim in claims
    )
    return (WITHOUT_SIDE,) if any(sided) else ()
