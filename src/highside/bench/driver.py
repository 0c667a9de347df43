"""A bench session live: link, codec, session, journal and store together, for any number of faces.

One event loop; readings go from the link through codec and monitor into the session, which is synchronous and quick.
What is slow runs in a thread (solving). Commands are done one after the other, as they come; a command is on the disk
before its reply. Faces read snapshots: one is made on request and something has changed, and shared.

The store gets the record when the session is accepted; after a crash in between, going on with the journal makes the
same record again, with the same id.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from highside.bench import photographs
from highside.bench.journal_file import SUFFIX, JournalFile, session_name, sessions, unfinished
from highside.bench.session import outcome
from highside.bench.session.commands import Origin
from highside.bench.session.driver import REMARK_MAX, REMARKS_MAX, Kept
from highside.bench.session.entries import Entry, Noted, Photographed
from highside.bench.session.journal import StorageError
from highside.bench.session.reasons import Refusal
from highside.bench.session.session import BenchSession
from highside.bench.session.snapshot import Command, Reply, Snapshot, UncertaintyState
from highside.bench.session.time_to_go import Pace
from highside.bench.session.view import View
from highside.bench.setup import header_of, simulated_bench, turntable_path
from highside.bench.simulated_bench import SimulatedBench
from highside.bench.store import BenchStore, keep_turntable
from highside.codec.frame import ByteCodec, CanCodec
from highside.config.bench import BenchFile
from highside.errors import HighsideError, InputError
from highside.link.base import Batch, Chunk, LinkReason, LinkState, LinkSupervisor, SupervisorSettings, Transport
from highside.link.tcp_wire import local_reader
from highside.printable import one_line
from highside.service.monitor import Monitor

log = logging.getLogger("highside")

TICK_S = 0.2
CLOCK_STEP_S = 2.0
AFTER_END_S = 0.5
"""Faces see the last snapshot for so long before `subscribe` ends."""


class BenchDriver:
    """One session. Make it with `begin` or `go_on`; `run` it; use it from any task of the same loop."""

    def __init__(
        self,
        settings: BenchFile,
        session: BenchSession,
        journal: JournalFile,
        bench: SimulatedBench | None,
        store: BenchStore,
    ) -> None:
        self.settings = settings
        self.session = session
        self.bench = bench
        self._store = store
        self._journal = journal
        self._view = View(session)
        self._codec: ByteCodec | CanCodec = settings.codec.build()
        self._monitor = Monitor(range_g=20.0, stuck_frames=200, seq_modulus=self._codec.seq_modulus)
        self._wall_offset = time.time() - time.monotonic()
        self._cached: Snapshot | None = None
        self._of_the_link = 0
        """changes of the link: each shows at once, also where the session does not move and no reading follows"""
        self._changed = asyncio.Event()
        self._over = asyncio.Event()
        self.ended = asyncio.Event()
        """set when acquisition is over and the record is stored"""
        self._commands = asyncio.Lock()
        self._looking_ahead: asyncio.Task[None] | None = None
        self._remarks = 0
        self._photographs = asyncio.Lock()
        self.stored: Path | None = None
        """the record in the store, once it is there"""

    # --- making one --------------------------------------------------------------------------------------------

    @classmethod
    def begin(cls, settings: BenchFile, *, operator: str | None = None) -> BenchDriver:
        """A new session with a new journal. Raises InputError."""
        now = time.time()
        directory = settings.store.sessions
        header = header_of(settings, session_name(directory, settings.tool.id, now), now, operator)
        # a key that is refused must leave no empty journal behind
        store = BenchStore.of(settings.store, settings.tool.serial)
        journal = JournalFile.create(directory, header)
        session = BenchSession(header, _keeper(journal), time.time, known_noise_g=settings.tool.noise_g, store=store)
        return cls(settings, session, journal, _bench(settings, 0), store)

    @classmethod
    def go_on(cls, settings: BenchFile, name: str | None = None) -> BenchDriver:
        """The session of that name, or the newest of this tool that has poses and has not ended. Raises InputError."""
        directory, tool = settings.store.sessions, settings.tool.id
        path = _session_of(settings, name) if name is not None else None
        if path is None:
            stored = kept_by(settings.store.directory)
            # one that somebody is at is refused by its name below
            found = unfinished(directory, tool, stored) or next(
                (one for one in sessions(directory, tool, stored) if one.held), None
            )
            if found is None:
                raise InputError(
                    f"there is no unfinished session with poses of tool {tool!r}",
                    where=str(directory),
                    remedy="begin one without --resume; `highside calibrate sessions` lists them",
                )
            path = found.path
        store = BenchStore.of(settings.store, settings.tool.serial)
        journal, read = JournalFile.reopen(path)
        ledger = read.ledger()
        attempt = 1 + sum(isinstance(entry, Noted) and entry.code == "interrupted" for entry in read.entries)
        noise = settings.tool.noise_g
        session = BenchSession(
            read.header,
            _keeper(journal),
            time.time,
            ledger=ledger,
            known_noise_g=noise,
            store=store,
            pace=Pace.of(read.entries, read.times_s),
        )
        if ledger.began:
            try:
                session.note_interruption()
            except StorageError as error:
                journal.close()
                raise InputError(f"cannot be written: {error}", remedy="free the disk") from None
        return cls(settings, session, journal, _bench(settings, attempt), store)

    @property
    def journal_path(self) -> str | None:
        return str(self._journal.path)

    # --- the sink of the link ----------------------------------------------------------------------------------

    def on_batch(self, batch: Batch) -> None:
        codec = self._codec
        if isinstance(batch, Chunk):
            frames = codec.receive(batch.data, batch.t_mono) if hasattr(codec, "receive") else []
        else:
            frames = codec.receive_can(batch) if hasattr(codec, "receive_can") else []
        good = [frame for frame in frames if self._monitor.check(frame)]
        if good:
            self.session.readings(good, time.monotonic())
            self._changed.set()

    def on_state(self, state: LinkState, reason: LinkReason | None, message: str) -> None:
        now = time.monotonic()
        if state is LinkState.DOWN:
            self._codec.reset()
            self._monitor.link_reopened()
            self.session.link_down(message, now)
        elif state is LinkState.ENDED:
            self.session.data_ended(now)
        self._of_the_link += 1
        self._changed.set()

    # --- what faces use ----------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        seq = self._seq(self.session.seq)
        if self._cached is None or self._cached.seq != seq:
            self._cached = self._view.snapshot().model_copy(update={"seq": seq})
        return self._cached

    def _seq(self, of_session: int) -> int:
        return of_session + self._of_the_link

    async def subscribe(self, max_rate_hz: float = 10.0) -> AsyncIterator[Snapshot]:
        shown = -1
        while True:
            snapshot = self.snapshot()
            if snapshot.seq != shown:
                shown = snapshot.seq
                yield snapshot
            if self._over.is_set():
                return
            # a face looks again when it is ready to: nothing is kept for it meanwhile
            await asyncio.sleep(1.0 / max_rate_hz)

    async def command(self, command: Command, origin: Origin = Origin.HERE) -> Reply:
        async with self._commands:
            reply = self.session.command(command, time.monotonic(), origin)
            reply = reply.model_copy(update={"seq": self._seq(reply.seq)})
            if reply.accepted and self.session.record is not None and self.stored is None:
                try:
                    await asyncio.to_thread(self._keep_record)
                except HighsideError as error:
                    log.error("the record could not be stored: %s", error)
                    text = f"{Refusal.STORAGE.text} ({error}) The journal has it: go on with --resume."
                    reply = reply.model_copy(update={"text": text})
        self._changed.set()
        return reply

    async def remark(self, operator: str, text: str) -> Kept:
        who, said = one_line(operator).strip()[:64], one_line(text).strip()
        if not who or not said or len(said) > REMARK_MAX:
            return Kept(False, f"A note has 1 to {REMARK_MAX} letters, and an operator.")
        async with self._commands:
            if self._remarks >= REMARKS_MAX:
                return Kept(False, f"There are {REMARKS_MAX} notes already: begin anew, or write them elsewhere.")
            try:
                self.session.remark(who, said, time.monotonic())
            except StorageError as error:
                return Kept(False, f"{Refusal.STORAGE.text} ({error})")
            self._remarks += 1
        self._changed.set()
        return Kept(True, "The note is in the journal.")

    async def photograph(self, operator: str, text: str, sent: bytes) -> Kept:
        who, said = one_line(operator).strip()[:64], one_line(text).strip()[:REMARK_MAX]
        if not who:
            return Kept(False, "Say who you are: the field Operator is empty.")
        async with self._photographs:
            try:
                picture = await asyncio.to_thread(self._kept_photograph, sent)
                entry = Photographed(who, said, picture.sha256, picture.width, picture.height)
                async with self._commands:
                    self.session.photographed(entry, time.monotonic())
            except HighsideError as error:
                return Kept(False, f"Not kept: {error}.")
            except StorageError as error:
                return Kept(False, f"{Refusal.STORAGE.text} ({error})")
        self._changed.set()
        return Kept(True, f"The photograph is kept with the session (SHA-256 {picture.sha256[:12]}).")

    def _kept_photograph(self, sent: bytes) -> photographs.Picture:
        """The file of a photograph, on the disk. Raises HighsideError, StorageError."""
        photographs.refuse_more(self._journal.path)
        picture = photographs.drawn_anew(sent)
        photographs.keep(self._journal.path, picture)
        return picture

    def _keep_record(self) -> None:
        solved, record = self.session.solved, self.session.record
        assert record is not None
        if solved is not None and solved.turntable is not None:
            # before the record: while that is missing, going on with the journal makes both again
            keep_turntable(turntable_path(self.settings), solved.turntable)
        self.stored = self._store.keep(record)

    # --- running -----------------------------------------------------------------------------------------------

    @property
    def open(self) -> bool:
        """Whether faces are still shown the session and answered."""
        return not self._over.is_set()

    async def run(self, *, stay: bool = False) -> None:
        """Run until the session has ended; the link is then closed, and the journal.

        `stay`: for as long as it is not cancelled the faces may still look and put the calibration in force.
        """
        try:
            await self._acquire()
            self._changed.set()
            self.ended.set()
            await (asyncio.Event().wait() if stay else asyncio.sleep(AFTER_END_S))
        finally:
            self._over.set()
            self._journal.close()

    async def _acquire(self) -> None:
        supervisor = LinkSupervisor(self._transport_factory(), self, self._supervisor_settings())
        if self.bench is not None:
            self.bench.start()
        link = asyncio.create_task(supervisor.run())
        try:
            while not self.session.state.ended:
                await self._turn()
                if link.done() and (error := link.exception()) is not None:
                    raise error
            if self.session.record is not None and self.stored is None:
                await asyncio.to_thread(self._keep_record)
        finally:
            link.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await link
            if self.bench is not None:
                await asyncio.to_thread(self.bench.stop)

    async def _turn(self) -> None:
        """One look at the clock, and the solver's work if there is some."""
        now = time.monotonic()
        offset = time.time() - now
        if abs(offset - self._wall_offset) > CLOCK_STEP_S:
            self.session.clock_stepped(offset - self._wall_offset, now)
            self._wall_offset = offset
        self.session.tick(now)
        job = self.session.work()
        if job is not None:
            solved: outcome.Solved = await asyncio.to_thread(job)
            self.session.finish_work(solved, time.monotonic())
            self._changed.set()
            return
        ahead = self.session.look_ahead()
        if ahead is not None:
            self._looking_ahead = asyncio.create_task(self._look_ahead(ahead))
        self._changed.clear()
        with contextlib.suppress(TimeoutError):
            # not wait_for: in Python 3.11 it may swallow a cancellation that comes together with the event
            async with asyncio.timeout(TICK_S):
                await self._changed.wait()

    async def _look_ahead(self, job: Callable[[], UncertaintyState | None]) -> None:
        """How good the calibration is by now; acquisition goes on meanwhile."""
        self.session.finish_look_ahead(await asyncio.to_thread(job))
        self._changed.set()

    def _transport_factory(self) -> Callable[[], Transport]:
        bench, link = self.bench, self.settings.link
        if bench is not None:
            # the port's name is requested anew at each attempt: after an unplug it may be another
            return lambda: local_reader(bench.address)
        assert link is not None, "one of the two is configured"
        return link.transport

    def _supervisor_settings(self) -> SupervisorSettings:
        link = self.settings.link
        if link is not None:
            return link.supervisor()
        return SupervisorSettings(backoff_max_s=0.5)


def _keeper(journal: JournalFile) -> Callable[[Entry], None]:
    return lambda entry: journal.write(entry, time.time())


def _session_of(settings: BenchFile, name: str) -> Path:
    """The journal of a session by its name. Raises InputError for one that is not there or is over."""
    directory, tool = settings.store.sessions, settings.tool.id
    for found in sessions(directory, tool, kept_by(settings.store.directory)):
        if found.name != name.removesuffix(SUFFIX):
            continue
        if found.resumable or found.state in ("unfinished", "not begun"):
            return found.path
        remedy = "end the process that drives it first" if found.state == "in use" else "begin a new one"
        raise InputError(
            f"session {found.name} is {found.state}", where=str(found.path), field="--resume", remedy=remedy
        )
    raise InputError(
        f"there is no session {name!r} of tool {tool!r}",
        where=str(directory),
        field="--resume",
        remedy="`highside calibrate sessions` lists them",
    )


def kept_by(directory: Path) -> Callable[[str], bool]:
    return lambda record: (directory / "records" / f"{record}.json").is_file()


def _bench(settings: BenchFile, attempt: int) -> SimulatedBench | None:
    return None if settings.simulated is None else simulated_bench(settings.simulated, attempt=attempt)
