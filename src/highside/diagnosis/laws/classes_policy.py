"""Thresholds of the class of a law, what a session cannot tell from it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LawClassPolicy:
    """When a group of functions is in the class of a law."""

    same: float = 8.0
    """Nats behind the best within which a group is in the class. Source: truth in the class 97.5 % of 239 sessions."""
    same_confounded: float = 20.0
    """As `same`, where one covariate is a function of the other in the session. Source: the same trial."""
    same_reproduced: float = 40.0
    """As `same`, of a group that can do what the law does: what sets it behind is how many functions it has. Source: a
    surface over inclination and temperature, told as a lagging temperature alone, was behind by 24 to 36 (sweep/108 of
    the open world of seed cec047d2)."""
    reproduced: float = 12.0
    """Strength of a law that another group cannot do, below which this session does not tell them apart, if the group
    is within `same_reproduced`. Source: `diagnosis.core.policy.RIVALS.same_class_evidence`, the same for names."""
    worth_asking: float = 0.01
    """Share of a law's strength that a group may leave by inner products, beyond `reproduced`, for an exact look at it.
    Source: rounding, and the ridge of a fit without a prior, leave less than a millionth of it."""
    function: float = 0.98
    """Share of a covariate's variance that a smooth function of another explains, from which it is one of it. Source:
    chosen; the rest of a confounded pair is its noise."""
    ran_along: float = 0.9
    """The same of a further quantity of a surface, from which it is no quantity of its own beside what a law follows.
    Source: chosen; a correlation of 0.95."""
    one_quantity: float = 0.99
    """The same of each by the other, from which they are one quantity, and a law of the one is a law of the other.
    Source: fourteen cosines of the load along the tool leave 0.0015 to 0.0055 of the inclination (24 to 200 poses at
    random), as its slope has no end at 0 and 180 deg; fourteen of the inclination leave 1e-5 of that load."""
    most_class: int = 12
    """Members of a class that are reported, temperatures that lag by different times as one. Source: chosen."""


LAW_CLASS = LawClassPolicy()
