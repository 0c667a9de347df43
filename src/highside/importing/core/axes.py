"""The maker's axes against a reference: which signed arrangement makes gravity point where the bench says."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from highside.codec.axes import AxisMap
from highside.errors import InputError
from highside.importing.core.policy import POLICY, ImportPolicy

Block = NDArray[np.float64]
_RIGHT_HANDED = 1


@dataclass(frozen=True, slots=True)
class AxesGuess:
    """An arrangement as `codec.axes.AxisMap` reads it, and the reasons; `open` what stays undecided."""

    axes: str
    evidence: tuple[str, ...]
    open: str | None = None
    likely: bool = False


UNREFERENCED = AxesGuess(
    "xyz",
    (
        "as in the file: no reference shows how they lie in the tool",
        "nor whether an axis that points up reads +1 g or -1 g; +1 g is assumed",
    ),
)
"""Without a reference. Gravity and the reaction to it turn alike: readings and rates agree with either sign."""


def axes_given(axes: str, *, rates: bool) -> AxesGuess:
    """What the user says. Accelerations alone may be mirrored: a left-handed sensor, or a toolface that runs the other
    way; with `rates` a mirror is refused, for then the sense of every rotation is open. Raises InputError."""
    if rates and AxisMap.parse(axes, allow_mirror=True).determinant < 0:
        nothing = " ".join(f"--map g{axis}_dps=none" for axis in "xyz")
        what = f"{axes} is a mirror: gyros would turn the other way"
        raise InputError(what, field="--axes", remedy=f"check the signs, or {nothing}")
    AxisMap.parse(axes, allow_mirror=True)
    return AxesGuess(axes, ("as given",))


def axes_by_reference(gravity: Block, inc_deg: Block, tf_deg: Block, policy: ImportPolicy = POLICY) -> AxesGuess:
    """Compare gravity (3, N) as measured with the reference (N,) under every arrangement of axes."""
    good = np.isfinite(gravity).all(axis=0) & np.isfinite(inc_deg) & np.isfinite(tf_deg)
    rows = np.flatnonzero(good)[:: max(1, int(good.sum()) // policy.judged_rows)]
    size = np.linalg.norm(gravity[:, rows], axis=0)
    rows, size = rows[size > 0], size[size > 0]
    if rows.size == 0:
        return AxesGuess("xyz", ("as in the file: no row has a reference",))
    u = gravity[:, rows] / size
    inc, tf = np.radians(inc_deg[rows]), np.radians(tf_deg[rows])
    ref = np.vstack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])
    products = u @ ref.T / rows.size
    errors: list[tuple[float, str, int]] = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            mean_cosine = sum(signs[axis] * products[order[axis], axis] for axis in range(3))
            rms = float(np.degrees(np.sqrt(max(0.0, 2.0 * (1.0 - mean_cosine)))))
            text = "".join(("-" if signs[axis] < 0 else "") + "xyz"[order[axis]] for axis in range(3))
            errors.append((rms, text, _handed(order, signs)))
    own = next(rms for rms, text, _ in errors if text == "xyz")
    errors.sort()
    best, next_best = errors[0], errors[1]
    if own <= max(policy.angle_floor_deg, min(policy.angle_rms_deg, policy.angle_ratio * best[0])):
        return AxesGuess("xyz", (f"as in the file: {own:.2g} deg rms from the reference",))
    why = (f"{best[0]:.2g} deg rms from the reference; as in the file {own:.3g} deg",)
    if best[0] > policy.angle_rms_deg or next_best[0] < policy.angle_ratio * best[0]:
        return AxesGuess(
            "xyz",
            (f"as in the file: {own:.3g} deg rms from the reference",),
            "no arrangement of axes agrees with the reference",
        )
    if best[2] != _RIGHT_HANDED:
        return AxesGuess(best[1], why, f"only {best[1]} agrees with the reference, and that is a mirror")
    return AxesGuess(best[1], why, likely=True)


def _handed(order: tuple[int, ...], signs: tuple[float, ...]) -> int:
    i, j, k = order
    return round((j - i) * (k - i) * (k - j) // 2 * signs[0] * signs[1] * signs[2])
