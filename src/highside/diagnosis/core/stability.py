"""Is the size of a claim a constant: does it agree over thirds of the session and halves of the inclinations or rates?

The columns of a claim are split by parts of the recording and each part gets a size of its own, base and the other
claims common to all. If the sizes agree, that gains nothing but chance: chi-square with the parts' own widths, as an F
test. A size that changes is no constant of the instrument, and its name does not stand; it may be a law of what it
changes with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.policy import REGRESSION, STABILITY
from highside.diagnosis.core.regression import log10_p, outside, span
from highside.physics.state import ChainState

Parts = NDArray[np.intp]


@dataclass(frozen=True)
class Stability:
    """The least stable split of a claim: its name, -log10 p, and the share of the claim's gain that it adds."""

    split: str
    log_p: float
    share: float
    factors: tuple[float, ...]
    """size in each part, in units of the size in all"""

    @property
    def stable(self) -> bool:
        """Whether the sizes agree to within chance, or to within what is of no matter."""
        return self.log_p < STABILITY.log_p or self.share < STABILITY.share

    @property
    def words(self) -> str:
        """The sizes side by side."""
        parts = " / ".join(f"{factor:.2f}" for factor in self.factors)
        return f"its size over {self.split} is {parts} times that over all"


def splits_of(state: ChainState) -> Mapping[str, Parts]:
    """(n,) number of the part of each row or pose, by the name of the split."""
    found = {"thirds of the session": _equal_parts(np.argsort(np.argsort(state.t_s, kind="stable")), 3)}
    for name, values in (
        ("halves of the inclinations", state.inc_rad),
        ("halves of the rates", np.abs(state.rotor_rate_radps)),
    ):
        levels = np.unique(np.round(values, STABILITY.decimals))
        if levels.size >= STABILITY.levels:
            found[name] = (values > np.median(levels)).astype(np.intp)
    return found


def _equal_parts(rank: NDArray[np.intp], count: int) -> Parts:
    return np.asarray(rank * count // rank.size, dtype=np.intp)


def stability(
    columns: Array,
    white: Callable[[Array], Array],
    others: Array,
    residual: Array,
    freedom: float,
    splits: Mapping[str, Parts],
) -> Stability | None:
    """The least stable of the splits. `columns` (k, C, n) of the claim, `white` takes (k, C, n) to (k, N); `others`
    (r, N) orthonormal: base and other claims; `residual` (N,) whitened."""
    whole = outside(others, white(columns))
    own = span(whole, tolerance=REGRESSION.visible)
    explained = float(np.sum((own @ residual) ** 2))
    if explained <= 0.0:
        return None
    size = np.linalg.lstsq(whole.T, residual, rcond=REGRESSION.visible)[0] @ columns.reshape(len(columns), -1)
    signal = size.reshape(columns.shape[1:])
    worst: Stability | None = None
    for name, part in splits.items():
        # the claim as it was fitted, with one factor for each part: few directions, so that a change stands out
        pieces = np.stack([signal * (part == k) for k in range(int(part.max()) + 1)])
        rows = outside(others, white(pieces))
        space = span(rows, tolerance=REGRESSION.visible)
        dof = len(space) - 1
        if dof < 1:
            continue
        gain = max(float(np.sum((space @ residual) ** 2)) - explained, 0.0)
        log_p = float(log10_p(np.array(gain), np.array(dof), freedom, float(len(splits))))
        factors = np.linalg.lstsq(rows.T, residual, rcond=REGRESSION.visible)[0]
        one = Stability(name, log_p, gain / explained, tuple(float(f) for f in factors))
        if worst is None or one.log_p > worst.log_p:
            worst = one
    return worst
