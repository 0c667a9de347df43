"""Looks at every window of readings and says what it means for the session: an `SessionEvent`, and why.

At a bench the planned pose nearest to the reading is recognised; without one, any attitude that is new. The hold under
way lives here. A pose that was refused as it stood has to be left before it is measured again: the same setting would
only give the same reading.

Some plans have two settings of the bench that read the same (an inclination and its reverse; toolfaces at the
vertical). Which of them the table stands at is known only by what was requested: the tool stands at the pose that was
the target when it came there, until it leaves. Taken from the wrong side such a pose would be wrong by twice the tilt
of the bench.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.bench.session.entries import HoldReadings
from highside.bench.session.faults import Faults
from highside.bench.session.guidance import (
    VERTICAL_SIN,
    CandidatePose,
    Chart,
    Provisional,
    Recognised,
    axes_that_fit,
    recognise,
)
from highside.bench.session.hold import Hold
from highside.bench.session.ledger import Ledger, PoseLine
from highside.bench.session.machine import SessionEvent
from highside.bench.session.reasons import Fault, Rejection
from highside.bench.session.snapshot import PoseState
from highside.bench.session.stillness import LOOK_BACK, ReadingWindow
from highside.bench.session.tracker import Tracker

SAME_ATTITUDE_DEG = 1.0
"""Poses found by themselves are different when they lie further apart than this."""
TRIM_WINDOWS = 3
"""Omitted at the end of a hold that ended because the tool was moved."""
STILL_ELSEWHERE = 10
"""windows of rest at no open pose after which the operator is notified"""
LONGEST_SHARE = 0.9


class Watch:
    """`hold`: the one under way. `blame`: what spoilt the last one. `repeated`: a pose visited a second time, to be
    reported once."""

    def __init__(self, ledger: Ledger, tracker: Tracker, faults: Faults) -> None:
        self.ledger = ledger
        self.plan = ledger.plan
        self.tracker = tracker
        self.hold: Hold | None = None
        self.recognised: Recognised | None = None
        self.must_leave: str | None = None
        self.blame: tuple[Rejection, str] | None = None
        self.repeated: str | None = None
        self.stands_at: str | None = None
        """of several poses that read the same: the one that the tool came to, until it has left"""
        self.model = self._nothing_known()
        self._faults = faults
        self._elsewhere = 0
        self._chart: tuple[tuple[int, int], Chart] | None = None

    # --- what is requested -------------------------------------------------------------------------------------

    @property
    def target(self) -> CandidatePose | None:
        """The pose requested: the one under way, else the first open one of the plan, those requested again first."""
        lines = self.ledger.open_lines
        if not lines or self.plan.open_ended:
            return None
        under_way = self.hold.pose if self.hold is not None else None
        chosen = next((line for line in lines if line.id == under_way), None)
        chosen = chosen or next((line for line in lines if line.state is PoseState.AGAIN), lines[0])
        return _candidate(chosen)

    def chart(self) -> Chart:
        """The poses of the present stage."""
        key = (self.ledger.revision, self.ledger.stage)
        if self._chart is None or self._chart[0] != key:
            poses = [_candidate(line) for line in self.ledger.lines.values() if line.stage == key[1]]
            self._chart = (key, Chart.of(poses, self.model, self.plan.limits))
        return self._chart[1]

    def learn_again(self) -> None:
        """The poses changed: the provisional fit follows."""
        self._chart = None
        lines = [(line, line.readings) for line in self.ledger.done]
        if self.plan.reference != "pose" or not lines:
            self.model = self._nothing_known()
            return
        a = np.array([r.mean() if r is not None else (0.0, 0.0, 0.0) for _, r in lines]).T
        inc = [float(line.inc_deg or 0.0) for line, _ in lines]
        tf = [float(line.tf_deg or 0.0) for line, _ in lines]
        self.model = Provisional.fit(inc, tf, a, self.plan.limits)

    def go_on(self) -> None:
        """A journal was read back: the tool may still stand where it was measured last."""
        self.learn_again()
        last = self.ledger.last_taken
        self.stands_at = last if last is not None and self.chart().alike.get(last) else None

    @property
    def alike(self) -> str | None:
        """The pose at which the tool stands where the target reads the same: it has to be left first."""
        target = self.target
        if self.stands_at is None or target is None or self.stands_at not in self.chart().alike.get(target.id, ()):
            return None
        return self.stands_at

    def _nothing_known(self) -> Provisional:
        return Provisional.fit((), (), np.zeros((3, 0)), self.plan.limits)

    # --- the hold ----------------------------------------------------------------------------------------------

    def begin_hold(self) -> None:
        pose = self.recognised.pose.id if self.recognised is not None and self.recognised.pose is not None else None
        rate = self.tracker.rate_hz or 1.0
        self.hold = Hold(pose, self.tracker.floor, self.tracker.allan, self.plan.limits, rate)
        if self.plan.open_ended:
            # nobody waits for the sign that it began: what stillness was judged by belongs to it, ends are trimmed
            last = self._last_readings()
            for window in self.tracker.stillness.recent:
                if last is None or window.t_s - window.a.shape[1] / rate >= last.t_stop_s:
                    self.hold.add(window)

    def reference(self) -> Array | None:
        """Mean (3,) of the hold under way, once it is worth comparing with. By hand a tool may sink slowly into what it
        lies on: its |g| stays."""
        hold = None if self.plan.open_ended else self.hold
        return hold.mean if hold is not None and len(hold.windows) >= LOOK_BACK else None

    # --- looking -----------------------------------------------------------------------------------------------

    def look(self, window: ReadingWindow) -> list[SessionEvent]:
        """What a window, already judged for stillness, means; the events in order."""
        if self.tracker.mirrored():
            self._faults.put(Fault.MIRRORED)
        if self.tracker.left_temperature(self.plan.stages[self.ledger.stage]):
            self.blame = (Rejection.TEMPERATURE, "")
            return [SessionEvent.UNSTEADY]
        return self._by_hand(window) if self.plan.open_ended else self._at_bench(window)

    def _at_bench(self, window: ReadingWindow) -> list[SessionEvent]:
        stillness = self.tracker.stillness
        still = stillness.still
        found = recognise(window.mean, self.model, self.chart(), self.target, self.plan.limits)
        self.recognised = replace(found, pose=self._distinguished(found.pose))
        pose, hold = self.recognised.pose, self.hold
        if hold is not None:
            if pose is None or pose.id != hold.pose:
                self.blame = (Rejection.WRONG_POSE if still else stillness.cause, "")
                return [SessionEvent.AWAY]
            if not still:
                self.blame = (stillness.cause, "")
                return [SessionEvent.AT_POSE]
            hold.add(window)
            return [SessionEvent.STILL, SessionEvent.FULL] if hold.full() else [SessionEvent.STILL]
        if not still or pose is None or pose.id != self.must_leave:
            self.must_leave = None
        if pose is not None and pose.open and pose.id != self.must_leave:
            self._elsewhere = 0
            return [SessionEvent.STILL if still else SessionEvent.AT_POSE]
        self._elsewhere = self._elsewhere + 1 if still else 0
        if self._elsewhere == STILL_ELSEWHERE:
            self._rests_elsewhere(window, pose)
        return [SessionEvent.AWAY]

    def _distinguished(self, pose: CandidatePose | None) -> CandidatePose | None:
        """`pose` where no other reads the same; else the one of them that the tool is known to stand at, if any."""
        chart, target = self.chart(), self.target
        if self.stands_at is not None and (
            pose is None
            or pose.id not in chart.alike.get(self.stands_at, frozenset()) | {self.stands_at}
            or (abs(math.sin(math.radians(pose.inc_deg))) < VERTICAL_SIN and self.tracker.stillness.moving)
        ):
            self.stands_at = None
        unclear = False
        if pose is not None and chart.alike[pose.id]:
            if self.stands_at is not None:
                pose = chart.candidate(self.stands_at)
            elif target is not None and pose.id == target.id:
                self.stands_at = pose.id
            else:
                pose, unclear = None, self.tracker.stillness.still
        self._faults.set(Fault.READS_ALIKE, unclear)
        return pose

    def _rests_elsewhere(self, window: ReadingWindow, pose: CandidatePose | None) -> None:
        """The tool rests, but at no open pose: a pose measured already, or axes confused from the beginning."""
        if pose is not None:
            if pose.id not in (self.ledger.last_taken, self.must_leave):
                self.repeated = pose.id
            return
        target = self.target
        if target is not None and self.ledger.last_taken is None and Fault.READS_ALIKE not in self._faults:
            fits = axes_that_fit(window.mean, self.model, target, self.plan.limits)
            self._faults.set(Fault.AXES_SUSPECT, bool(fits), f"axes {fits[0]} would fit" if fits else "")

    def _by_hand(self, window: ReadingWindow) -> list[SessionEvent]:
        still, hold = self.tracker.stillness.still, self.hold
        if hold is None:
            return [SessionEvent.STILL if still and not self._is_last(window.mean) else SessionEvent.AWAY]
        if still:
            hold.add(window)
            return (
                [SessionEvent.STILL, SessionEvent.FULL]
                if hold.elapsed_s >= self.plan.limits.max_hold_s
                else [SessionEvent.STILL]
            )
        del hold.windows[-TRIM_WINDOWS:]
        hold.trim()
        self.blame = (Rejection.TOO_SHORT, "")
        return [SessionEvent.FULL if hold.long_enough else SessionEvent.AWAY]

    def _is_last(self, mean: Array) -> bool:
        """Whether an attitude is that of the pose taken last, held as long as is allowed."""
        readings = self._last_readings()
        longest = self.plan.limits.max_hold_s * (self.tracker.rate_hz or 1.0)
        if readings is None or readings.n < LONGEST_SHARE * longest:
            return False
        return bool(np.linalg.norm(mean - np.array(readings.mean())) < np.deg2rad(SAME_ATTITUDE_DEG))

    def _last_readings(self) -> HoldReadings | None:
        last = self.ledger.last_taken
        return self.ledger.lines[last].readings if last is not None else None


def _candidate(line: PoseLine) -> CandidatePose:
    return CandidatePose(line.id, float(line.inc_deg or 0.0), float(line.tf_deg or 0.0), line.open)
