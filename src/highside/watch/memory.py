"""What a watch knows, as plain numbers: to be kept and taken up again.

A watch that went on from its memory says, rounding aside, what one says that never stopped. The prior is not part of
it: it follows from the calibration record, and a memory belongs to one record.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.watch.parameters import CALIBRATION, NAMES, SIZE

__all__ = ["LAYOUT", "WatchMemory", "checked"]

TRACE_WIDTH = 3 + 2 * CALIBRATION
"""time, deviations, their standard deviations, inclination, evidence"""
_LARGEST = 1e15
"""of any number: evidence of many years stays far below it"""
_LEAST_VARIANCE = -1e-9
"""of the scaled covariance's eigenvalues: rounding, below it is none"""


def _layout() -> str:
    from highside.watch.bank import HYPOTHESES

    return " ".join([*NAMES, *(one.name + "@" * one.onsets for one in HYPOTHESES)])


LAYOUT = _layout()
"""the order of the state and of the hypotheses, and which of these may begin at any time (`@`): a memory with another
one is of another version"""


@dataclass(frozen=True)
class WatchMemory:
    """`arrays`: filter, bank and trace. The rest is named as in `Watch`; times in s of the watch."""

    arrays: Mapping[str, Array]
    start_s: float | None = None
    last_s: float = 0.0
    onset_s: float | None = None
    depth_km: float | None = None
    deeper_km: float = 0.0
    ref_c: float | None = None
    warmer_c: float = 0.0
    alarm_s: float | None = None
    at_rest: bool = False
    stills: int = 0
    turns: int = 0
    left_out: Mapping[str, int] = field(default_factory=dict)


def checked(arrays: Mapping[str, Array]) -> None:
    """Raises ValueError for numbers that can be no memory; those of the bank are checked by `Bank.recall`."""
    shapes: dict[str, tuple[int, ...]] = {"state": (SIZE,), "alone_state": (SIZE,)}
    shapes |= dict.fromkeys(("covariance", "alone_covariance", "walked"), (SIZE, SIZE))
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise ValueError(f"{name} has another shape")
    if any(not (np.abs(values) < _LARGEST).all() for values in arrays.values()):
        raise ValueError("a number is beyond reason")
    for name in ("covariance", "alone_covariance", "walked"):
        _is_covariance(arrays[name], name)
    if arrays["f"].shape not in ((3,), (0,)):
        raise ValueError("f has another shape")
    for name, width in (("beyond", 2), ("squares", 2), ("trace", TRACE_WIDTH)):
        if arrays[name].ndim != 2 or arrays[name].shape[1] != width:
            raise ValueError(f"{name} has another shape")
    if "beyond_axes" in arrays and (arrays["beyond_axes"].ndim != 2 or arrays["beyond_axes"].shape[1] != 6):
        raise ValueError("beyond_axes has another shape")
    if (arrays["squares"] < [0.0, 1.0]).any():
        raise ValueError("the innovations are none")


def _is_covariance(P: Array, name: str) -> None:
    scale = np.sqrt(np.maximum(np.diag(P), 0.0))
    scaled = P / np.outer(np.maximum(scale, 1e-150), np.maximum(scale, 1e-150))
    if not np.allclose(scaled, scaled.T, rtol=1e-6, atol=1e-9) or np.linalg.eigvalsh(scaled).min() < _LEAST_VARIANCE:
        raise ValueError(f"{name} is none")
