"""A simulated operator at a simulated bench: looks at snapshots, turns the table, gives commands. And makes mistakes.

It knows of the session what anybody at the screen knows, and does at the bench what hands do. Used by
`highside calibrate bench --auto` and, on a simulated clock, by the tests: the same session, link aside.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from highside.bench.session.snapshot import Command, CommandName, PoseState, SessionState, Snapshot
from highside.bench.simulated_bench import SimulatedBench

REST_S = 4.0
"""The table has been at rest for so long, and the session still asks: the pose has to be set anew."""
HAND_S = 14.0
"""By hand: long enough in one attitude, whatever the session says."""


class OperatorMistake(StrEnum):
    """What can go wrong with one pose."""

    WRONG_TF = "wrong_tf"
    """toolface set 5 deg off, kept until requested again"""
    SHOCK = "shock"
    """a shock in mid-hold"""
    TREMOR = "tremor"
    """shaking for some seconds in mid-hold"""
    MOVE = "move"
    """turned away in mid-hold"""
    REPEAT = "repeat"
    """goes back to a pose already taken first"""
    UNPLUG = "unplug"
    """the plug is pulled in mid-hold, for 20 s"""
    PAUSE = "pause"
    UNDO = "undo"

    @classmethod
    def _missing_(cls, value: object) -> OperatorMistake | None:
        # the word of older files
        return cls.SHOCK if value == "knock" else None


@dataclass(frozen=True, slots=True)
class Habits:
    """`mistakes`: what goes wrong at the n-th pose set (counted from 0). `hand_poses`: attitudes in a session without
    a bench."""

    name: str = "simulated"
    mistakes: tuple[tuple[int, OperatorMistake], ...] = ()
    hand_poses: int = 20
    seed: int = 1


class SimulatedOperator:
    """`look(snapshot)` acts at the bench and returns the commands to give."""

    def __init__(self, bench: SimulatedBench, habits: Habits | None = None, *, ids: str = "auto") -> None:
        self.bench = bench
        self.habits = habits or Habits()
        self._ids = (f"{ids}-{k}" for k in itertools.count())
        self._mistakes = dict(self.habits.mistakes)
        self._rng = np.random.default_rng([self.habits.seed, 5])
        self._set: tuple[str, float] | None = None
        """pose set last, and when it came to rest"""
        self._away = False
        self._settings = 0
        self._oven: float | None = None
        self._plug_back_s: float | None = None
        self._spoil: OperatorMistake | None = None

    def look(self, snapshot: Snapshot) -> list[Command]:
        """What the operator does about it."""
        self._correct_mistake()
        match snapshot.state:
            case SessionState.IDLE:
                return [self._prompt(CommandName.START)]
            case SessionState.PAUSED:
                return [self._prompt(CommandName.RESUME)]
            case SessionState.SOAKING:
                wanted = snapshot.plan.stage_temp_c
                if wanted is not None and wanted != self._oven:
                    self._oven = wanted
                    self.bench.set_oven(wanted)
            case SessionState.GUIDING | SessionState.SETTLING:
                if snapshot.plan.poses is None:
                    return self._by_hand(snapshot)
                self._set_pose(snapshot)
            case SessionState.CAPTURING:
                return self._meddle(snapshot)
            case SessionState.REVIEW:
                accept = CommandName.ACCEPT in snapshot.allowed
                return [self._prompt(CommandName.ACCEPT if accept else CommandName.REJECT)]
            case _:
                pass
        return []

    def _prompt(self, name: CommandName, pose: str | None = None) -> Command:
        return Command(name=name, request_id=next(self._ids), operator=self.habits.name, pose=pose)

    def _set_pose(self, snapshot: Snapshot) -> None:
        target = snapshot.target
        if target is None:
            return
        now = self.bench.time_s
        if self._set is not None and now < self._set[1]:
            return  # under way
        if self._set is not None and self._set[0] == target.pose and not self._away:
            if now < self._set[1] + REST_S:
                return
            # at rest, and still requested: away and back again
            self._away = True
            self._set = (target.pose, self.bench.turn_to(target.inc_deg, target.tf_deg + 30.0) + 1.0)
            return
        self._away = False
        mistake = self._mistakes.pop(self._settings, None)
        self._settings += 1
        inc, tf, wrong = target.inc_deg, target.tf_deg, 0.0
        if mistake is OperatorMistake.WRONG_TF:
            wrong = 5.0
        elif mistake is OperatorMistake.REPEAT:
            done = [pose for pose in snapshot.poses if pose.state is PoseState.DONE and pose.inc_deg is not None]
            if done and done[0].tf_deg is not None and done[0].inc_deg is not None:
                inc, tf = done[0].inc_deg, done[0].tf_deg
        else:
            self._spoil = mistake
        self._set = (target.pose, self.bench.turn_to(inc, tf, wrong_tf_deg=wrong))

    def _meddle(self, snapshot: Snapshot) -> list[Command]:
        """In mid-hold: the mistake planned for this pose."""
        capture = snapshot.capture
        if snapshot.plan.poses is None and capture is not None and capture.progress >= 1.0:
            self._lay_down()
            return []
        if self._spoil is None or capture is None or capture.elapsed_s < 1.2:
            return []
        mistake, self._spoil = self._spoil, None
        match mistake:
            case OperatorMistake.SHOCK:
                self.bench.tremble(0.05, 0.5)
            case OperatorMistake.TREMOR:
                self.bench.tremble(0.002, 6.0)
            case OperatorMistake.MOVE:
                target = snapshot.target
                if target is not None:
                    self._set = (target.pose, self.bench.turn_to(target.inc_deg, target.tf_deg + 20.0))
            case OperatorMistake.UNPLUG:
                self.bench.unplug()
                self._plug_back_s = self.bench.time_s + 20.0
            case OperatorMistake.PAUSE:
                return [self._prompt(CommandName.PAUSE)]
            case OperatorMistake.UNDO:
                return [self._prompt(CommandName.UNDO)] if CommandName.UNDO in snapshot.allowed else []
            case _:
                pass
        return []

    def _correct_mistake(self) -> None:
        if self._plug_back_s is not None and self.bench.time_s >= self._plug_back_s:
            self._plug_back_s = None
            self.bench.plug()

    def _by_hand(self, snapshot: Snapshot) -> list[Command]:
        """Lay the tool down somewhere new; after enough attitudes say so."""
        if snapshot.plan.done >= self.habits.hand_poses:
            return [self._prompt(CommandName.ACCEPT)]
        if self._set is None or self.bench.time_s >= self._set[1] + HAND_S:
            self._lay_down()
        return []

    def _lay_down(self) -> None:
        if self._set is None or self.bench.time_s >= self._set[1]:
            inc = float(np.rad2deg(np.arccos(self._rng.uniform(-1.0, 1.0))))
            self._set = ("", self.bench.turn_to(inc, float(self._rng.uniform(0.0, 360.0))))
