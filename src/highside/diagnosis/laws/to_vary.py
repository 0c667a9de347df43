"""What another session must vary to part a law from what else may be behind it, in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from highside.physics.covariates import covariate, lag_of
from highside.words import said

FRACTION = "tf_fraction"
"""the toolface as a covariate that does not come round"""
SEVERAL_PERIODS = "hold one pose for several periods, at another rate of recording"
"""what tells more of an offset that oscillates in time"""


def to_vary(depends_on: Sequence[str], rivals: Iterable[str]) -> str:
    """What another session must vary: what a law follows, apart from what else may be behind it.

    What comes round after a turn and what does not (an order that is no whole number) part over several turns.
    """
    others = set(rivals) - set(depends_on)
    turns = FRACTION in others
    if turns:
        others = (others | {"tf"}) - {FRACTION, *depends_on}
    words = " and ".join(covariate(name).title for name in depends_on)
    apart = ", ".join(_titles(others))
    if turns and others:
        return f"vary {words} over the range that matters and over several turns, independently of {apart}"
    if turns:
        return f"vary {words} over the range that matters and over several turns"
    if others:
        return f"vary {words} over the range that matters, independently of {apart}"
    return f"vary {words} over the range that matters"


def _titles(names: Iterable[str]) -> list[str]:
    """Titles of covariates; of several temperatures that lag one, with the shortest and the longest lag."""
    lags = sorted(filter(None, map(lag_of, names)))
    if len(lags) < 2:
        return [covariate(name).title for name in sorted(names)]
    titles = [covariate(name).title for name in sorted(names) if not lag_of(name)]
    return [*titles, said("temperature with lags from %(low)s to %(high)s s", low=lags[0], high=lags[-1])]
