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
_STATE, _VARIANCE, _FOLD, _SIZE = 10.0, 100.0, 1e6, 1e9
"""no deviation from a calibration is 10 g, 10 g/g, 10 m or 10 rad, nor is a standard deviation; noise does not grow a
million times; a parameter does not move by 1e9 for a departure of size one, drifts in a year included"""
_REASON = {
    **dict.fromkeys(("state", "alone_state"), _STATE),
    **dict.fromkeys(("covariance", "alone_covariance", "walked"), _VARIANCE),
    **dict.fromkeys(("noise_rests", "noise_changed", "beyond_axes", "f"), 1e10),
    "squares": _FOLD**2,
    "jump": _FOLD,
    "bank_D": _SIZE,
}
_LONGEST_S, _HOTTEST_C, _DEEPEST_KM = 1e10, 1e3, 1e2
"""of the watch; of any temperature and difference of two; of any depth and difference of two"""
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


def checked(memory: WatchMemory) -> None:
    """Raises ValueError for numbers that can be no memory; those of the bank are checked by `Bank.recall`, too."""
    arrays = memory.arrays
    shapes: dict[str, tuple[int, ...]] = {"state": (SIZE,), "alone_state": (SIZE,)}
    shapes |= dict.fromkeys(("covariance", "alone_covariance", "walked"), (SIZE, SIZE))
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise ValueError(f"{name} has another shape")
    for name, values in arrays.items():
        if not (np.abs(values) < _REASON.get(name, _LARGEST)).all():
            raise ValueError(f"{name}: a number is beyond reason")
    for name in ("covariance", "alone_covariance", "walked"):
        _is_covariance(arrays[name], name)
        if name != "walked" and not (np.diag(arrays[name])[:CALIBRATION] > 0.0).all():
            raise ValueError(f"{name}: nothing is known exactly")
    if arrays["f"].shape not in ((3,), (0,)):
        raise ValueError("f has another shape")
    for name, width in (("beyond", 2), ("squares", 2), ("trace", TRACE_WIDTH)):
        if arrays[name].ndim != 2 or arrays[name].shape[1] != width:
            raise ValueError(f"{name} has another shape")
    if "beyond_axes" in arrays and (arrays["beyond_axes"].ndim != 2 or arrays["beyond_axes"].shape[1] != 6):
        raise ValueError("beyond_axes has another shape")
    _is_taken_back(arrays.get("taken_back", np.zeros((0, 2))), memory.last_s)
    if (arrays["squares"] < [0.0, 1.0]).any():
        raise ValueError("the innovations are none")
    _facts_are_some(memory)
    _is_trace(arrays["trace"], memory.last_s)
    if (arrays["bank_since"] < 0.0).any() or (arrays["bank_since"] > memory.last_s).any():
        raise ValueError("bank_since: an onset is not in the time of the watch")


def _is_taken_back(rows: Array, last_s: float) -> None:
    """Raises ValueError where an alarm that was taken back is not in the time of the watch. A memory of before that was
    kept has none."""
    if rows.shape not in ((0, 2), (1, 2)):
        raise ValueError("taken_back has another shape")
    if (rows < 0.0).any() or (rows > last_s).any() or (np.diff(rows) < 0.0).any():
        raise ValueError("taken_back: it is not in the order of time")


def _facts_are_some(memory: WatchMemory) -> None:
    bounds = {
        **dict.fromkeys(("start_s", "last_s", "onset_s", "alarm_s"), (0.0, _LONGEST_S)),
        **dict.fromkeys(("depth_km", "deeper_km"), (-_DEEPEST_KM, _DEEPEST_KM)),
        **dict.fromkeys(("ref_c", "warmer_c"), (-_HOTTEST_C, _HOTTEST_C)),
    }
    for name, (low, high) in bounds.items():
        value = getattr(memory, name)
        if value is not None and not low <= value <= high:
            raise ValueError(f"{name} is beyond reason")
    if any(not 0 <= count <= _LARGEST for count in (memory.stills, memory.turns, *memory.left_out.values())):
        raise ValueError("a count is beyond reason")


def _is_trace(rows: Array, last_s: float) -> None:
    """Raises ValueError where it is not in the order of time, or a deviation is beyond reason."""
    times, deviations, std = rows[:, 0], rows[:, 1 : 1 + CALIBRATION], rows[:, 1 + CALIBRATION : 1 + 2 * CALIBRATION]
    if (np.diff(times) < 0.0).any() or (times < 0.0).any() or (times > last_s).any():
        raise ValueError("trace: it is not in the order of time")
    if (np.abs(deviations) > _STATE).any() or (std < 0.0).any() or (std > _STATE).any():
        raise ValueError("trace: a deviation is beyond reason")


def _is_covariance(P: Array, name: str) -> None:
    if (np.diag(P) < 0.0).any():
        raise ValueError(f"{name} has a variance below zero")
    scale = np.sqrt(np.diag(P))
    scaled = P / np.outer(np.maximum(scale, 1e-150), np.maximum(scale, 1e-150))
    if (
        not np.allclose(scaled, scaled.T, rtol=1e-6, atol=1e-9)
        or (np.abs(scaled) > 1.0 + 1e-6).any()
        or np.linalg.eigvalsh(scaled).min() < _LEAST_VARIANCE
    ):
        raise ValueError(f"{name} is none")
