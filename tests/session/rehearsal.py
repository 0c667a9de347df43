"""Whole sessions on a simulated clock: a bench without a wire, a journal in memory, a simulated operator."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from highside.bench.session import outcome
from highside.bench.session.entries import Entry
from highside.bench.session.force import Store
from highside.bench.session.journal import Encoder, Header, read_journal
from highside.bench.session.ledger import Ledger
from highside.bench.session.plans import SessionPlan
from highside.bench.session.session import BenchSession
from highside.bench.session.snapshot import Command, CommandName, SessionState
from highside.bench.session.view import View
from highside.bench.simulated_bench import SimulatedBench
from highside.bench.simulated_operator import Habits, OperatorMistake, SimulatedOperator
from highside.calibration.record import CalibrationRecord, Environment
from highside.config.bench import SimulatedTurntable
from highside.link.device import DeviceSettings
from highside.physics.motion import still

MATRIX = ((0.9991, 0.0038, -0.0007), (-0.0019, 0.9989, 0.0001), (0.0009, 0.0003, 0.9982))
OFFSET_G = (0.0012, -0.0008, 0.0015)
WALL_S = 1_795_000_000.0


class NoWire:
    """Takes everything and leads nowhere."""

    unheard = 0
    address = "nowhere"
    pending = 0
    listened_to = False
    unread = False

    def plug(self) -> None: ...
    def unplug(self) -> None: ...
    def remove(self) -> None: ...
    def flush(self) -> None: ...
    def write(self, data: bytes) -> None: ...
    def write_frames(self, frames: Sequence[object]) -> None: ...


def rehearse(
    session: BenchSession,
    bench: SimulatedBench,
    operators: Iterable[SimulatedOperator],
    *,
    limit_s: float = 7200.0,
    step_s: float = 0.1,
    look_s: float = 0.5,
    on_step: Callable[[float], None] | None = None,
) -> float:
    """Run a session on a simulated clock until it ends or `limit_s` have passed; returns the time taken.

    The bench's frames go to the session as the codec would hand them over; what an unplugged tool says is lost.
    """
    view = View(session)
    people = list(operators)
    each = max(1, round(step_s * bench.settings.rate_hz))
    looked_s = -look_s
    now = bench.time_s
    start = now
    while not session.state.ended and now - start < limit_s:
        frames = list(bench.frames(each))
        now = bench.time_s
        if bench.plugged_in:
            session.readings(frames, now)
        session.tick(now)
        job = session.work()
        if job is not None:
            session.finish_work(job(), now)
        if on_step is not None:
            on_step(now)
        if now - looked_s >= look_s:
            looked_s = now
            for person in people:
                for command in person.look(view.snapshot()):
                    session.command(command, now)
    return now - start


def random_sensor(seed: int) -> tuple[tuple[tuple[float, ...], ...], tuple[float, ...]]:
    """Scale within 0.5 %, misalignment within 0.2 deg, offset within 2 mg."""
    rng = np.random.default_rng([seed, 11])
    matrix = np.eye(3) + np.diag(rng.uniform(-5e-3, 5e-3, 3))
    matrix += np.deg2rad(0.2) * rng.uniform(-1, 1, (3, 3)) * (1 - np.eye(3))
    return tuple(map(tuple, matrix.tolist())), tuple(rng.uniform(-2e-3, 2e-3, 3).tolist())


@dataclass
class Rehearsal:
    """One session with all that belongs to it."""

    plan: SessionPlan
    seed: int = 1
    mistakes: Sequence[tuple[int, OperatorMistake]] = ()
    rate_hz: float = 50.0
    bench_options: dict[str, object] = field(default_factory=dict)
    sensor: tuple[tuple[tuple[float, ...], ...], tuple[float, ...]] | None = None
    hand_poses: int = 20
    gyros: bool = True
    judged: CalibrationRecord | None = None
    store: Store | None = None
    expires_days: float | None = None

    def __post_init__(self) -> None:
        matrix, offset = self.sensor or (MATRIX, OFFSET_G)
        device = DeviceSettings(
            rate_hz=self.rate_hz,
            motion=still(12.0, 20.0),
            matrix=matrix,  # type: ignore[arg-type]
            offset_g=offset,  # type: ignore[arg-type]
            seed=self.seed,
            gyros=self.gyros,
        )
        options = {"tilt_deg": (0.02, -0.01), "seed": self.seed} | self.bench_options
        self.bench = SimulatedBench(device, SimulatedTurntable(**options), NoWire())  # type: ignore[arg-type]
        self.bench.plug()
        environment = Environment("simulated")
        self.header = Header(
            "rehearsal", "tool", "7", self.plan, environment, self.expires_days, "0", WALL_S, self.judged
        )
        self.encoder = Encoder()
        self.lines = [self.encoder.header(self.header)]
        self.entries: list[Entry] = []
        self.refuse_writing: Callable[[Entry], None] | None = None
        self.session = self.make_session()
        habits = Habits(mistakes=tuple(self.mistakes), hand_poses=self.hand_poses, seed=self.seed)
        self.operator = SimulatedOperator(self.bench, habits)
        self.took_s = 0.0

    def make_session(self, ledger: Ledger | None = None) -> BenchSession:
        return BenchSession(self.header, self.write, lambda: WALL_S + 1.0, ledger=ledger, store=self.store)

    def write(self, entry: Entry) -> None:
        if self.refuse_writing is not None:
            self.refuse_writing(entry)
        self.lines.append(self.encoder.entry(entry, WALL_S))
        self.entries.append(entry)

    def run(self, limit_s: float = 7200.0, **options: object) -> Rehearsal:
        self.took_s = rehearse(self.session, self.bench, [self.operator], limit_s=limit_s, **options)  # type: ignore[arg-type]
        return self

    @property
    def journal(self) -> bytes:
        return b"".join(self.lines)

    @property
    def state(self) -> SessionState:
        return self.session.state

    def errors_deg(self) -> tuple[float, float]:
        """Rms errors of I and T against the simulated truth."""
        assert self.session.record is not None
        temp = self.session.ledger.mean_temp_c()
        settings = self.bench.settings
        offset = self.bench.true_offset(25.0 if temp is None else temp)
        return outcome.errors_against(self.session.record, np.array(settings.matrix), offset, temp)

    def stated_deg(self) -> tuple[float, float]:
        solved = self.session.solved
        assert solved is not None and solved.inc_std_deg is not None and solved.tf_std_deg is not None
        return solved.inc_std_deg, solved.tf_std_deg

    def within(self, k: float) -> bool:
        """Whether the errors lie within `k` times what is stated."""
        return all(e <= k * s for e, s in zip(self.errors_deg(), self.stated_deg(), strict=True))

    def replayed(self) -> tuple[Ledger, outcome.Solved, object]:
        return outcome.replay(read_journal(self.journal))


_numbers = iter(range(10**9))


def command(name: CommandName, operator: str = "simulated", pose: str | None = None) -> Command:
    return Command(name=name, request_id=f"test-{next(_numbers)}", operator=operator, pose=pose)
