"""Watches the order and the plausibility of frames; every frame is counted under one heading.

The sequence counter of the device (modulo `seq_modulus`) tells gaps, duplicates, late frames and resets. A device
without a counter is watched by its own time against its usual period. The balance at any time:
`received == good + duplicate + late + out_of_range + not_finite` and `expected == received - duplicate - late + gap`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

from highside.codec.frame import Frame

RESTART_STEP = 0.5
"""A counter that jumps by more than this share of its modulus while device time runs backwards has been reset."""
SHORTEST_PERIOD_S = 1e-6
"""No frames follow one another faster; a smaller step of a clock is no period."""


@dataclass(slots=True)
class MonitorCounts:
    """What became of the frames that the codec decoded."""

    received: int = 0
    good: int = 0
    duplicate: int = 0
    late: int = 0
    """came after a frame with a higher sequence number; not used"""
    gap: int = 0
    """frames that never came, from the sequence counter, or estimated from device time where there is none"""
    resets: int = 0
    """the device began again"""
    out_of_range: int = 0
    not_finite: int = 0
    """a reading without all three accelerations"""
    stuck: dict[str, int] = field(default_factory=lambda: {"ax": 0, "ay": 0, "az": 0})
    """times an axis was found to repeat one value while others moved"""
    frozen: int = 0
    """times all three axes were found to repeat their values: a converter that died behind a living counter"""

    @property
    def expected(self) -> int:
        return self.received - self.duplicate - self.late + self.gap

    def balanced(self) -> bool:
        return self.received == self.good + self.duplicate + self.late + self.out_of_range + self.not_finite

    def as_dict(self) -> dict[str, object]:
        return asdict(self) | {"expected": self.expected}


class Monitor:
    """Judges one frame at a time; `check` says whether it may be used.

    `seq_modulus` is the period of the device's counter (None: no counter), `range_g` the largest believable reading,
    `stuck_frames` after how many equal readings in a row an axis is called stuck while another one moves.
    """

    def __init__(self, *, seq_modulus: int | None, range_g: float, stuck_frames: int) -> None:
        self.counts = MonitorCounts()
        self._modulus = seq_modulus
        self._range = range_g
        self._stuck_frames = stuck_frames
        self._seq: int | None = None
        self._t: float | None = None
        self._period: float | None = None
        self._last = (0.0, 0.0, 0.0)
        self._repeats = [0, 0, 0]
        self._frozen_for = 0
        self.stuck_axes: tuple[str, ...] = ()
        self.frozen = False

    def apply(self, *, range_g: float, stuck_frames: int) -> None:
        """Take new limits; the order and the counts go on."""
        self._range, self._stuck_frames = range_g, stuck_frames

    def check(self, frame: Frame) -> bool:
        """Count the frame; True if it is to be used."""
        counts = self.counts
        counts.received += 1
        if frame.seq is not None and self._modulus:
            if not self._in_order(frame.seq, frame.t_s):
                return False
        elif frame.t_s is not None and not self._in_time(frame.t_s):
            return False
        if frame.t_s is not None:
            self._t = frame.t_s
        a = (frame.ax, frame.ay, frame.az)
        limit = self._range
        if not (-limit <= a[0] <= limit and -limit <= a[1] <= limit and -limit <= a[2] <= limit):
            if a[0] == a[0] and a[1] == a[1] and a[2] == a[2]:
                counts.out_of_range += 1
            else:
                counts.not_finite += 1
            return False
        if a[0] == self._last[0] or a[1] == self._last[1] or a[2] == self._last[2] or self.stuck_axes:
            self._watch_repeats(a)
        elif any(self._repeats) or self._frozen_for:
            self._repeats, self._frozen_for, self.frozen = [0, 0, 0], 0, False
        self._last = a
        counts.good += 1
        return True

    def link_reopened(self) -> None:
        """After a break in the link the next frame starts a new order: what was lost meanwhile is still counted."""
        self._repeats = [0, 0, 0]

    def _in_order(self, seq: int, t_s: float | None) -> bool:
        last, self_t = self._seq, self._t
        modulus = self._modulus
        if last is None or modulus is None:
            self._seq = seq
            return True
        step = (seq - last) % modulus
        backwards = t_s is not None and self_t is not None and t_s < self_t
        if step == 0 and (t_s is None or t_s == self_t):
            self.counts.duplicate += 1
            return False
        if backwards:
            # an old frame keeps the clock it had; a device that began again has a clock near its start
            if t_s is not None and self_t is not None and step > modulus * RESTART_STEP and self_t - t_s < 1.0:
                self.counts.late += 1
                return False
            self.counts.resets += 1
        elif step > modulus * RESTART_STEP and t_s is None:
            self.counts.late += 1
            return False
        elif step == 0:
            self.counts.gap += modulus - 1
        else:
            self.counts.gap += step - 1
            if self._period is None and t_s is not None and self_t is not None and step == 1:
                self._period = t_s - self_t
            elif t_s is not None and self_t is not None and self._period and t_s - self_t > modulus * self._period:
                # the counter went round at least once while nothing came
                turns = round(((t_s - self_t) / self._period - step) / modulus)
                self.counts.gap += max(turns, 0) * modulus
        self._seq = seq
        return True

    def _in_time(self, t_s: float) -> bool:
        last = self._t
        if last is None:
            return True
        step = t_s - last
        if step == 0.0:
            self.counts.duplicate += 1
            return False
        if step < 0.0:
            if step > -1.0:
                self.counts.late += 1
                return False
            self.counts.resets += 1
            self._period = None
            return True
        if self._period is None:
            self._period = max(step, SHORTEST_PERIOD_S)
        elif step > 1.5 * self._period:
            self.counts.gap += max(round(step / self._period) - 1, 1)
        else:
            # follows a slow clock, is not pulled by jitter
            self._period += 0.02 * (step - self._period)
        return True

    def _watch_repeats(self, a: tuple[float, float, float]) -> None:
        same = [value == before for value, before in zip(a, self._last, strict=True)]
        moving = not all(same)
        self._frozen_for = 0 if moving else self._frozen_for + 1
        if self._frozen_for >= self._stuck_frames and not self.frozen:
            self.counts.frozen += 1
        self.frozen = self._frozen_for >= self._stuck_frames
        found = []
        for axis, (name, equal) in enumerate(zip(("ax", "ay", "az"), same, strict=True)):
            if not equal:
                self._repeats[axis] = 0
                continue
            self._repeats[axis] += moving
            if self._repeats[axis] >= self._stuck_frames:
                found.append(name)
                if name not in self.stuck_axes:
                    self.counts.stuck[name] += 1
        self.stuck_axes = tuple(found)
