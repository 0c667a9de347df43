"""What the tool is doing, from the data alone: still, quiet, turning, vibrating (one verdict a second).

    STILL      the gyro may be measured against the Earth's rotation (zero-rate update)
    QUIET      gravity may be believed, but the tool is not known to stand
    TURNING    gravity may be believed, the tool turns: never a zero-rate update
    VIBRATING  the gyro carries the attitude; gravity counts by its scatter

Quiet means: scatter of |a|, offset of |a| from the still record and scatter of the gyros are below thresholds, which
are multiples of what the tool's own first still record showed. Entering takes `ENTER` times and a dwell of two
seconds, leaving `LEAVE` times and is immediate. Still means quiet, and a mean rate that stays within 0.05 deg/s of
that of the still record.

A mean rate that small may still be a real, slow turn (a curved hole), and a zero-rate update would then take all of it
for gyro bias. `stop_test.stop_agrees` bounds that: it asks whether the rate observed since the stop began agrees with
the bias as known before the stop. A declared stop is believed and not tested, unless the tool turns for all to see.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.gyro.blocks import Batch, Block
from highside.gyro.frames import to_body


class MotionState(IntEnum):
    """Verdict on one block."""

    VIBRATING = 0
    TURNING = 1
    QUIET = 2
    STILL = 3


ENTER, LEAVE = 1.75, 3.0
DWELL_S = 2.0
STILL_RATE_RADPS = math.radians(0.05)
VISIBLE_RATE_RADPS = math.radians(1.0)
"""a declared stop is believed up to this mean rate beyond that of the still record"""
LEARN_S = 20.0
"""length of the still record from which the thresholds are taken"""

NO_REST = (
    f"the recording does not begin with {LEARN_S:g} s of rest, so that no stop is found in it and the azimuth rests on"
    " less; name the stops with rest=, or begin at rest"
)
"""What is to be said of stops where `Gate.still` stays unknown."""
NO_REST_GATE = (
    f": it does not begin with {LEARN_S:g} s of rest to compare with, so that all but rough vibration is believed; name"
    " the stops with rest=, or begin at rest"
)
"""The same of a method that tests vibration only."""
NO_REST_LIVE = (
    f"the tool did not rest in the first {LEARN_S:g} s, so that no stop is found by itself and the azimuth rests on"
    " less; declare one with the command connection, or restart (the command) while the tool rests"
)
"""The same of a tool that is followed live."""

_ACCEL_BIAS_G = 0.01

# what a first record may show and still be taken for a tool at rest
_PLAUSIBLE_NORM_STD_G = 0.03
_PLAUSIBLE_RATE_STD_RADPS = math.radians(1.0)
_PLAUSIBLE_RATE_RADPS = math.radians(3.0)


@dataclass(frozen=True, slots=True)
class StillStatistics:
    """What the tool shows at rest. Rates are of the body frame, rad/s."""

    norm_std_g: float
    norm_error_g: float
    rate_std: float
    rate: Array
    """(3,) mean: bias and Earth rate together"""

    def as_list(self) -> list[float]:
        """Six numbers, for a file."""
        return [self.norm_std_g, self.norm_error_g, self.rate_std, *self.rate.tolist()]

    @classmethod
    def of(cls, blocks: list[Block]) -> StillStatistics | None:
        """From the blocks of a first record, or None if the tool cannot have been at rest in it."""
        seconds = sum(block.seconds for block in blocks)
        if not blocks or seconds <= 0.0:
            return None
        weights = np.array([block.n for block in blocks], dtype=float)
        norm_std = float(np.average([block.norm_std for block in blocks], weights=weights))
        rates = np.array([block.rate for block in blocks])
        rate = np.average(rates, axis=0, weights=weights)
        rate_std = float(np.average([float(block.rate_std.max()) for block in blocks], weights=weights))
        departure = float(np.abs(rates - rate).max())
        up = np.array([block.accel for block in blocks])
        up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
        # a slow, even turn is as steady as rest, and would be taken for the gyros' bias: gravity shows it
        turned = float(np.linalg.norm(up[-1] - up[0]))
        scatter = norm_std / math.sqrt(max(float(weights.min()), 1.0))
        if (
            norm_std > _PLAUSIBLE_NORM_STD_G
            or rate_std > _PLAUSIBLE_RATE_STD_RADPS
            or float(np.abs(rate).max()) > _PLAUSIBLE_RATE_RADPS
            or departure > max(STILL_RATE_RADPS, 3.0 * rate_std)
            or turned > max(STILL_RATE_RADPS * seconds, 6.0 * scatter)
        ):
            return None
        error = float(np.average([block.norm_error for block in blocks], weights=weights))
        return cls(norm_std, error, rate_std, rate)


class Gate:
    """The classifier: give it each block in turn. Before it has learned, only declared stops are known."""

    def __init__(self, *, learn_s: float = LEARN_S) -> None:
        self._learn_s = learn_s
        self._record: list[Block] = []
        self._recorded_s = 0.0
        self._learned = False
        self.still: StillStatistics | None = None
        self._quiet = False
        self._quiet_s = 0.0

    @property
    def without_rest(self) -> bool:
        """Whether the first record is over and showed no tool at rest."""
        return self._learned and self.still is None

    def know(self, still: StillStatistics | None) -> None:
        """Take the thresholds of an earlier still record, if there was one."""
        if still is not None:
            self.still, self._learned, self._record = still, True, []

    def verdict(self, block: Block, *, declared: bool = False) -> MotionState:
        """What the tool did in this block. `declared`: the operator says that it stood."""
        if not self._learned:
            self._record.append(block)
            self._recorded_s += block.seconds
            if self._recorded_s >= self._learn_s:
                self._learned = True
                self.still = StillStatistics.of(self._record)
                self._record = []
        if declared:
            turns = self.still is not None and float(np.abs(block.rate - self.still.rate).max()) > VISIBLE_RATE_RADPS
            return MotionState.TURNING if turns else MotionState.STILL
        if self.still is None:
            return MotionState.VIBRATING if block.norm_std > _PLAUSIBLE_NORM_STD_G else MotionState.TURNING
        self._follow(block, self.still)
        if not self._quiet:
            return MotionState.VIBRATING
        if float(np.abs(block.rate - self.still.rate).max()) > STILL_RATE_RADPS:
            self._quiet_s = 0.0
            return MotionState.TURNING
        return MotionState.STILL if self._quiet_s >= DWELL_S else MotionState.QUIET

    def _follow(self, block: Block, still: StillStatistics) -> None:
        factor = LEAVE if self._quiet else ENTER
        limit = factor * still.norm_std_g
        self._quiet = (
            block.norm_std < limit
            # its own bias changes |a| with the toolface
            and abs(block.norm_error - still.norm_error_g) < limit + _ACCEL_BIAS_G
            and block.rate_noise < factor * still.rate_std
            and block.gap_s == 0.0
        )
        steady = self._quiet and float(block.rate_std.max()) < factor * still.rate_std
        self._quiet_s = self._quiet_s + block.seconds if steady else 0.0


def quiet_rows(t_s: Array, rate: Array, accel: Array, rest: Array) -> tuple[NDArray[np.bool_], StillStatistics | None]:
    """(N,) rows in which gravity may be believed, for the methods that know only yes and no; and what was learned of
    the tool at rest, None where the beginning shows none or `rest` was requested instead. Tool frame.

    This is the paper's gate: in strong vibration the gyro alone carries the attitude, in quiet and at every stop
    gravity shows the drift. Within `rest` (K, 2) if it is given; else where the gate finds a row's own
    block and the one before it quiet: a row is judged with the second it lies in, since the first readings of vibration
    that were believed would throw an attitude that is replaced by every reading.
    Where the first record shows no tool at rest, what no tool at rest would show is vibration.
    """
    if rest.size:
        inside = np.zeros(t_s.size, dtype=bool)
        for begin, end in rest:
            inside |= (t_s >= begin) & (t_s <= end)
        return inside, None
    batch = Batch.of(t_s, to_body(rate), to_body(accel))
    gate = Gate()
    verdicts = [gate.verdict(block) for block in batch.blocks()]
    believed = np.array([verdict > MotionState.VIBRATING for verdict in verdicts])
    before = np.concatenate([believed[:1], believed[:-1]])
    return np.asarray((believed & before)[batch.number], dtype=bool), gate.still
