"""Random operators, hands, plugs and disks: never stuck, no moving pose is taken, none that was taken is lost."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from rehearsal import Rehearsal, command

from highside.arrays import Array
from highside.bench.session import plans
from highside.bench.session.entries import Entry, Reopened, Skipped, TakenPose, Undone
from highside.bench.session.guidance import angle_between_deg
from highside.bench.session.journal import read_journal
from highside.bench.session.plans import Limits
from highside.bench.session.session import StorageError
from highside.bench.session.snapshot import CommandName, PoseState, SessionState
from highside.bench.session.view import View
from highside.bench.simulated_operator import SimulatedOperator
from highside.physics.gravity import gravity_direction

PLAN = plans.custom_plan(
    [(20.0, 0.0), (20.0, 120.0), (20.0, 240.0), (70.0, 60.0), (70.0, 180.0), (110.0, 300.0)],
    "joint",
    Limits(std_error_g=3e-5, min_hold_s=1.5, max_hold_s=4.0),
)
RATE_HZ = 50.0


class RandomSession(RuleBasedStateMachine):
    """Every rule does something that can happen at a bench; the invariants hold after each."""

    @initialize(seed=st.integers(0, 1000))
    def begin(self, seed: int) -> None:
        self.rehearsal = Rehearsal(PLAN, seed=seed, rate_hz=RATE_HZ)
        self.session, self.bench = self.rehearsal.session, self.rehearsal.bench
        self.view = View(self.session)
        self.disk_full = False
        self.rehearsal.refuse_writing = self._disk
        self.dark_s = 0.0
        self.done: dict[str, Array] = {}
        self.seen = 0

    def _disk(self, entry: Entry) -> None:
        if self.disk_full:
            raise StorageError("disk full")

    @rule(seconds=st.sampled_from([0.2, 1.0, 3.0, 6.0]))
    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds * 10)):
            frames = list(self.bench.frames(round(RATE_HZ / 10)))
            if self.bench.plugged_in:
                self.session.readings(frames, self.bench.time_s)
            self.session.tick(self.bench.time_s)
            job = self.session.work()
            if job is not None:
                self.session.finish_work(job(), self.bench.time_s)

    @rule(pose=st.sampled_from(PLAN.poses))
    def turn_to_a_pose(self, pose: plans.PlannedPose) -> None:
        self.bench.turn_to(pose.inc_deg, pose.tf_deg)
        self.wait(6.0)

    @rule(inc=st.floats(0, 180), tf=st.floats(0, 360))
    def turn_anywhere(self, inc: float, tf: float) -> None:
        self.bench.turn_to(inc, tf)
        self.wait(1.0)

    @rule(size=st.sampled_from([0.0005, 0.005, 0.1]))
    def shake(self, size: float) -> None:
        self.bench.tremble(size, 1.0)
        self.wait(1.0)

    @rule()
    def creep(self) -> None:
        """The table sinks slowly out of the pose."""
        from highside.physics.motion import Leg, Motion

        now = self.bench.truth(self.bench.time_s)
        inc, tf = math.degrees(now.inclination_rad), math.degrees(now.toolface_rad)
        self.bench.set_motion(
            Motion((Leg(20.0, inclination_to_deg=min(inc + 1.0, 179.0)), Leg(1.0)), inc, tf, repeat=False)
        )
        self.wait(6.0)

    @rule(seconds=st.sampled_from([0.3, 3.0]))
    def unplug(self, seconds: float) -> None:
        self.bench.unplug()
        self.session.link_down("unplugged", self.bench.time_s)
        self.wait(seconds)
        self.bench.plug()

    @rule(
        name=st.sampled_from(sorted(set(CommandName) - {CommandName.ABORT, CommandName.REJECT, CommandName.ACCEPT})),
        who=st.sampled_from(["ann", "ben"]),
        pose=st.sampled_from([None, "1", "4", "no such pose"]),
    )
    def say(self, name: CommandName, who: str, pose: str | None) -> None:
        before = self.session.state
        reply = self.session.command(command(name, who, pose), self.bench.time_s)
        assert reply.state is self.session.state
        if not reply.accepted:
            assert reply.reason and reply.text
            assert self.session.state is before

    @rule(full=st.booleans())
    def disk(self, full: bool) -> None:
        self.disk_full = full

    @rule(frames=st.integers(1, 200))
    def lose_frames(self, frames: int) -> None:
        list(self.bench.frames(frames))

    @rule()
    def step_the_clock(self) -> None:
        self.session.clock_stepped(3600.0, self.bench.time_s)

    @rule()
    def start_again(self) -> None:
        """The process dies and comes back: all that remains is the journal."""
        journal = read_journal(self.rehearsal.journal)
        self.rehearsal.encoder = journal.encoder
        self.session = self.rehearsal.session = self.rehearsal.make_session(journal.ledger())
        self.view = View(self.session)

    @invariant()
    def the_picture_can_be_shown(self) -> None:
        snapshot = self.view.snapshot()
        assert snapshot.prompt
        assert type(snapshot).model_validate_json(snapshot.to_json()) == snapshot

    @invariant()
    def no_moving_and_no_wrong_pose_is_taken(self) -> None:
        for entry in self.rehearsal.entries[self.seen :]:
            if isinstance(entry, TakenPose):
                span = np.arange(entry.readings.t_start_s, entry.readings.t_stop_s + 1e-6, 1.0 / RATE_HZ)
                motion = self.bench.truth_block(span)
                moved = [angle_between_deg(motion.gravity[:, 0], g) for g in motion.gravity.T]
                assert max(moved) <= 2 * PLAN.limits.pose_sigma_deg
                assert float(np.sqrt(np.mean(motion.vibration_rms_g**2))) <= self.bench.settings.noise_g
                wanted = gravity_direction(np.deg2rad([entry.inc_deg or 0.0]), np.deg2rad([entry.tf_deg or 0.0]))[:, 0]
                assert angle_between_deg(wanted, motion.gravity[:, 0]) <= 2.0

    @invariant()
    def what_was_taken_is_kept(self) -> None:
        news = self.rehearsal.entries[self.seen :]
        self.seen = len(self.rehearsal.entries)
        given_up = {entry.pose for entry in news if isinstance(entry, Reopened | Skipped)}
        undone = any(isinstance(entry, Undone) for entry in news)
        for name, mean in self.done.items():
            line = self.session.ledger.lines[name]
            if name not in given_up and not undone:
                assert line.state is PoseState.DONE
                assert line.readings is not None and np.array_equal(line.readings.mean(), mean)
        self.done = {
            line.id: np.array(line.readings.mean()) for line in self.session.ledger.done if line.readings is not None
        }

    @invariant()
    def the_journal_tells_the_same(self) -> None:
        assert read_journal(self.rehearsal.journal).ledger().to_plain() == self.session.ledger.to_plain()

    def teardown(self) -> None:
        """Never stuck: a patient operator brings every session to its end."""
        if not hasattr(self, "rehearsal"):
            return
        self.disk_full = False
        self.rehearsal.operator = SimulatedOperator(self.bench, ids="patient")
        if self.session.ledger.operator not in (None, "simulated"):
            holder = self.session.ledger.operator
            self.session.command(command(CommandName.PAUSE, holder), self.bench.time_s)
        for line in self.session.ledger.lines.values():
            if line.state is PoseState.SKIPPED:
                self.session.command(
                    command(CommandName.REDO, self.session.ledger.operator or "simulated", line.id), 0.0
                )
        self.rehearsal.run(limit_s=900.0)
        assert self.session.state is SessionState.ACCEPTED, (self.session.state, self.view.snapshot().prompt)
        assert self.session.record is not None
        assert self.rehearsal.replayed()[2].id == self.session.record.id  # type: ignore[attr-defined]


RandomSession.TestCase.settings = settings(
    max_examples=12,
    stateful_step_count=20,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much],
)
TestRandomSession = RandomSession.TestCase
