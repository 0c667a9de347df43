"""A device's wrapping time counter, unwrapped to seconds.

A counter of `period` ticks is read modulo its period: of all times that agree with a reading, the one nearest to the
last is taken, so a step is never longer than half a period, and a late frame or a restarted device goes backwards.
After a silence longer than that the arrival times, where there are any, say how many whole periods went by.
"""

from __future__ import annotations


class DeviceClock:
    """Turns raw counter values into seconds that do not wrap.

    `backward` counts the steps backwards: late frames, or a device that started anew (its time goes on from the value
    it sends; nobody can know how long it was away).
    """

    __slots__ = ("_half", "_last_mono", "_period", "_ticks", "_ticks_per_second", "backward")

    def __init__(self, period: int, ticks_per_second: int) -> None:
        self._period = period
        self._half = period // 2
        self._ticks_per_second = ticks_per_second
        self._ticks: int | None = None
        self._last_mono = 0.0
        self.backward = 0

    def seconds(self, raw: int, t_mono: float = 0.0) -> float:
        """Device time in s of a raw value `0 <= raw < period` that arrived at `t_mono` (s; 0.0 where unknown)."""
        ticks = self._ticks
        if ticks is None:
            ticks = raw
        else:
            step = (raw - ticks + self._half) % self._period - self._half
            if t_mono and self._last_mono:
                silence = int((t_mono - self._last_mono) * self._ticks_per_second)
                if silence > self._half:
                    step += (silence - step + self._half) // self._period * self._period
            if step < 0:
                self.backward += 1
            ticks += step
        self._ticks = ticks
        self._last_mono = t_mono
        return ticks / self._ticks_per_second
