"""What the demonstration does to its own cable: pulled once, put back, and what the service made of it, as lines."""

from __future__ import annotations

from dataclasses import dataclass, field

from highside.link.base import LinkState
from highside.link.device import SimulatedDevice
from highside.service.app import Service

PULLED_AT_S = 5.0
"""after the first survey (a still of 4 s) is out"""
OUT_FOR_S = 1.5


@dataclass(slots=True)
class PulledPlug:
    """The plug is pulled at 5 s and put back 1.5 s later; `events` (seconds, text) tell what happened then."""

    device: SimulatedDevice
    service: Service
    events: list[tuple[float, str]] = field(default_factory=list)
    _pulled_s: float | None = None
    _noticed: bool = False
    _back_s: float | None = None
    _missing: int = 0
    _attitudes: int = 0
    _ended: bool = False

    def tend(self, elapsed_s: float, attitudes: int) -> None:
        """To be called again and again; `attitudes`: how many were delivered until now."""
        if self._ended or elapsed_s < PULLED_AT_S:
            return
        counts, state = self.service.pipeline.monitor.counts, self.service.supervisor.stats.state
        if self._pulled_s is None:
            self.device.unplug()
            self._pulled_s, self._missing = elapsed_s, counts.gap
            self._say(elapsed_s, "the plug is pulled")
        elif not self._noticed and state is not LinkState.UP:
            self._noticed = True
            self._attitudes = attitudes
            after_ms = 1e3 * (elapsed_s - self._pulled_s)
            self._say(elapsed_s, f"noticed within {after_ms:.0f} ms: link {state.value}, no I and T are sent")
        if self._back_s is None and elapsed_s >= self._pulled_s + OUT_FOR_S:
            self.device.plug()
            self._back_s = elapsed_s
            self._say(elapsed_s, "the plug is in again")
        elif self._back_s is not None and state is LinkState.UP and attitudes > self._attitudes:
            self._ended = True
            missing = counts.gap - self._missing
            after_s = elapsed_s - self._back_s
            self._say(
                elapsed_s, f"I and T again after {after_s:.1f} s; {missing} frames missed and counted, none made up"
            )

    def _say(self, elapsed_s: float, text: str) -> None:
        self.events.append((elapsed_s, text))
