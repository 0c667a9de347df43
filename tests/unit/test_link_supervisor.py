"""The one owner of re-connection: what it reports and when it tries again, with a clock that tests turn by hand."""

from __future__ import annotations

import asyncio
import heapq
import random
from collections.abc import Callable

import pytest

from highside.codec.frame import CanFrame
from highside.link.base import (
    Batch,
    Chunk,
    Deliver,
    LinkError,
    LinkReason,
    LinkState,
    LinkSupervisor,
    SupervisorSettings,
)

SETTINGS = SupervisorSettings(
    backoff_initial_s=1.0, backoff_max_s=8.0, jitter=0.0, stale_after_s=2.0, reopen_after_s=10.0
)


class HandClock:
    """Time passes only when a test says so."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.sleeps = 0
        self._sleepers: list[tuple[float, int, asyncio.Future[None]]] = []

    def monotonic(self) -> float:
        return self.now

    def wall(self) -> float:
        return 1e9 + self.now

    async def sleep(self, seconds: float) -> None:
        self.sleeps += 1
        assert self.sleeps < 10_000, "it never rests"
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (self.now + seconds, id(future), future))
        await future

    async def advance(self, seconds: float) -> None:
        end = self.now + seconds
        await settle()
        while self._sleepers and self._sleepers[0][0] <= end:
            when, _, future = heapq.heappop(self._sleepers)
            if not future.done():
                self.now = max(self.now, when)
                future.set_result(None)
                await settle()
        self.now = end


async def settle() -> None:
    for _ in range(20):
        await asyncio.sleep(0)


class FakeTransport:
    """Does what a test tells it."""

    def __init__(self, refuse: LinkError | None = None) -> None:
        self.refuse = refuse
        self.deliver: Deliver | None = None
        self.ended: asyncio.Future[LinkError] = asyncio.get_running_loop().create_future()
        self.ready = asyncio.Event()
        self.closed = 0
        self.kernel_drops = 0

    async def open(self, deliver: Deliver) -> None:
        if self.refuse:
            raise self.refuse
        self.deliver = deliver

    async def wait_closed(self) -> LinkError:
        return await asyncio.shield(self.ended)

    async def wait_ready(self) -> None:
        await self.ready.wait()

    async def close(self) -> None:
        self.closed += 1

    def send(self, data: bytes = b"x") -> None:
        assert self.deliver is not None
        self.deliver(Chunk(0.0, 0.0, data))


class Recorded:
    def __init__(self) -> None:
        self.batches: list[Batch] = []
        self.states: list[tuple[LinkState, LinkReason | None]] = []
        self.fault: Exception | None = None

    def on_batch(self, batch: Batch) -> None:
        if self.fault:
            raise self.fault
        self.batches.append(batch)

    def on_state(self, state: LinkState, reason: LinkReason | None, message: str) -> None:
        assert message
        self.states.append((state, reason))


class Bench:
    """A supervisor with its clock, its sink and all transports it made."""

    def __init__(
        self, make: Callable[[], FakeTransport] = FakeTransport, settings: SupervisorSettings = SETTINGS
    ) -> None:
        self.clock, self.sink = HandClock(), Recorded()
        self.transports: list[FakeTransport] = []
        self._make = make
        self.supervisor = LinkSupervisor(self._next, self.sink, settings, self.clock, random.Random(1))
        self.task = asyncio.create_task(self.supervisor.run())

    def _next(self) -> FakeTransport:
        assert all(transport.closed for transport in self.transports), "two transports at once"
        self.transports.append(self._make())
        return self.transports[-1]

    @property
    def last(self) -> FakeTransport:
        return self.transports[-1]

    async def end(self) -> None:
        self.task.cancel()
        await asyncio.wait({self.task})


async def test_data_makes_a_link_up_and_an_end_of_file_makes_it_down() -> None:
    bench = Bench()
    await settle()
    bench.last.send(b"abc")
    bench.last.ended.set_result(LinkError(LinkReason.END_OF_FILE, "gone"))
    await settle()
    assert bench.sink.states == [
        (LinkState.CONNECTING, None),
        (LinkState.UP, None),
        (LinkState.DOWN, LinkReason.END_OF_FILE),
    ]
    assert bench.last.closed
    assert bench.supervisor.stats.bytes == 3
    await bench.end()


async def test_attempts_without_data_back_off_to_the_maximum_and_data_resets_the_pause() -> None:
    bench = Bench(lambda: FakeTransport(LinkError(LinkReason.BUSY, "taken")))
    await settle()
    times = []
    for _ in range(320):
        before = len(bench.transports)
        await bench.clock.advance(0.125)
        if len(bench.transports) > before:
            times.append(bench.clock.now - 1000.0)
    assert times == [1.0, 3.0, 7.0, 15.0, 23.0, 31.0, 39.0]
    assert bench.sink.states == [(LinkState.CONNECTING, None), (LinkState.DOWN, LinkReason.BUSY)], "told once"
    assert bench.supervisor.stats.failures == {LinkReason.BUSY: 8}
    bench._make = FakeTransport
    await bench.clock.advance(8.0)
    bench.last.send()
    bench.last.ended.set_result(LinkError(LinkReason.IO_ERROR, "bad cable"))
    count = len(bench.transports)
    await bench.clock.advance(1.05)
    assert len(bench.transports) == count + 1
    await bench.end()


async def test_a_device_that_comes_back_is_opened_at_once_whatever_the_pause() -> None:
    bench = Bench(lambda: FakeTransport(LinkError(LinkReason.NOT_FOUND, "absent")))
    await bench.clock.advance(30.0)
    count = len(bench.transports)
    bench.last.ready.set()
    await settle()
    assert len(bench.transports) == count + 1
    await bench.end()


async def test_silence_is_stale_after_two_seconds_and_reopened_after_ten() -> None:
    bench = Bench()
    await settle()
    bench.last.send()
    await bench.clock.advance(1.9)
    assert bench.sink.states[-1] == (LinkState.UP, None)
    await bench.clock.advance(0.2)
    assert bench.sink.states[-1] == (LinkState.STALE, LinkReason.SILENT)
    bench.last.send()
    assert bench.sink.states[-1] == (LinkState.UP, None)
    await bench.clock.advance(1.9)
    assert bench.sink.states[-1] == (LinkState.UP, None)
    await bench.clock.advance(0.2)
    assert bench.sink.states[-1] == (LinkState.STALE, LinkReason.SILENT), "the first limit counts again"
    await bench.clock.advance(7.8)
    assert bench.sink.states[-1] == (LinkState.STALE, LinkReason.SILENT)
    assert len(bench.transports) == 1
    await bench.clock.advance(0.2)
    assert bench.sink.states[-1] == (LinkState.DOWN, LinkReason.SILENT)
    await bench.clock.advance(1.0)
    assert len(bench.transports) == 2
    await bench.end()


async def test_steady_data_is_never_stale() -> None:
    bench = Bench()
    await settle()
    for _ in range(100):
        bench.last.send()
        await bench.clock.advance(1.5)
    assert bench.sink.states == [(LinkState.CONNECTING, None), (LinkState.UP, None)]
    await bench.end()


async def test_error_frames_are_counted_and_are_no_sign_of_life() -> None:
    bench = Bench()
    await settle()
    complaint = CanFrame(0.0, 0.0, 4, bytes(8), error=True)
    for _ in range(12):
        assert bench.last.deliver
        bench.last.deliver([complaint])
        await bench.clock.advance(1.0)
    assert (LinkState.UP, None) not in bench.sink.states
    assert bench.supervisor.stats.error_frames == 12
    assert bench.supervisor.stats.failures == {LinkReason.SILENT: 1}
    await bench.end()


async def test_kernel_drops_add_up_over_re_opens() -> None:
    bench = Bench()
    await settle()
    for drops in (5, 7):
        bench.last.kernel_drops = drops
        bench.last.send()
        bench.last.ended.set_result(LinkError(LinkReason.IO_ERROR, "x"))
        await bench.clock.advance(1.1)
    bench.last.send()
    assert bench.supervisor.stats.kernel_drops == 12
    await bench.end()


async def test_a_replay_that_finished_ends_the_link() -> None:
    bench = Bench()
    await settle()
    bench.last.send()
    bench.last.ended.set_result(LinkError(LinkReason.FINISHED, "played"))
    await asyncio.wait_for(bench.task, 1.0)
    assert bench.sink.states[-1] == (LinkState.ENDED, LinkReason.FINISHED)
    assert bench.last.closed


async def test_a_fault_of_the_sink_ends_run_and_closes_the_transport() -> None:
    bench = Bench()
    await settle()
    bench.sink.fault = RuntimeError("defect in the pipeline")
    bench.last.send()
    with pytest.raises(RuntimeError, match="defect in the pipeline"):
        await asyncio.wait_for(bench.task, 1.0)
    assert bench.last.closed


async def test_an_os_error_while_opening_is_a_failure_like_any_other() -> None:
    class Broken(FakeTransport):
        async def open(self, deliver: Deliver) -> None:
            raise OSError(5, "Input/output error")

    bench = Bench(Broken)
    await settle()
    assert bench.sink.states[-1] == (LinkState.DOWN, LinkReason.IO_ERROR)
    await bench.end()


@pytest.mark.parametrize("when", ["open", "waiting"])
async def test_cancellation_closes_the_transport(when: str) -> None:
    bench = Bench() if when == "open" else Bench(lambda: FakeTransport(LinkError(LinkReason.BUSY, "taken")))
    await settle()
    await bench.end()
    assert bench.task.cancelled()
    assert bench.last.closed
    assert len(asyncio.all_tasks()) == 1


async def test_a_cancellation_that_arrives_while_a_failed_attempt_is_cleared_away_is_not_swallowed() -> None:
    clearing = asyncio.Event()

    class SlowToEnd(FakeTransport):
        async def wait_ready(self) -> None:
            try:
                await asyncio.Event().wait()
            finally:
                clearing.set()
                await asyncio.sleep(0.05)

    class Absent(SlowToEnd):
        async def open(self, deliver: Deliver) -> None:
            raise LinkError(LinkReason.NOT_FOUND, "no such device")

    class Ignoring:
        def on_batch(self, batch: Batch) -> None: ...

        def on_state(self, state: LinkState, reason: LinkReason | None, message: str) -> None: ...

    settings = SupervisorSettings(backoff_initial_s=0.01, backoff_max_s=0.01)
    task = asyncio.create_task(LinkSupervisor(Absent, Ignoring(), settings).run())
    await asyncio.wait_for(clearing.wait(), 5.0)
    task.cancel()
    done, _ = await asyncio.wait({task}, timeout=2.0)
    assert done, "the link goes on after its cancellation"
    assert task.cancelled()


async def test_times_of_next_to_nothing_leave_the_processor_to_others() -> None:
    """Each of these is accepted: the service would look, or try, as often as the processor allows."""
    bench = Bench(settings=SupervisorSettings(stale_after_s=1e-300, reopen_after_s=100.0))
    await settle()
    bench.last.send()
    before = bench.clock.sleeps
    await bench.clock.advance(1.0)
    assert bench.clock.sleeps - before <= 110
    await bench.end()
    gone = LinkError(LinkReason.NOT_FOUND, "gone")
    bench = Bench(lambda: FakeTransport(gone), SupervisorSettings(backoff_initial_s=1e-300, backoff_max_s=1.0))
    await settle()
    await bench.clock.advance(1.0)
    assert 2 <= len(bench.transports) <= 12
    await bench.end()


async def test_without_a_watchdog_silence_is_allowed() -> None:
    bench = Bench(settings=SupervisorSettings(stale_after_s=0.0))
    await settle()
    bench.last.send()
    await bench.clock.advance(3600.0)
    assert bench.sink.states[-1] == (LinkState.UP, None)
    await bench.end()


async def test_other_limits_hold_at_once_and_the_link_stays_open() -> None:
    bench = Bench(settings=SETTINGS.model_copy(update={"stale_after_s": 0.0}))
    await settle()
    bench.last.send()
    await bench.clock.advance(5.0)
    assert bench.sink.states[-1] == (LinkState.UP, None)
    bench.supervisor.apply(SETTINGS)
    await settle()
    await bench.clock.advance(0.2)
    assert bench.sink.states[-1] == (LinkState.STALE, LinkReason.SILENT)
    assert len(bench.transports) == 1 and not bench.last.closed
    await bench.end()


def test_jitter_spreads_the_pauses() -> None:
    settings = SupervisorSettings(backoff_initial_s=1.0, jitter=0.5)

    async def pause(seed: int) -> float:
        slept = []

        class Counting(HandClock):
            async def sleep(self, seconds: float) -> None:
                slept.append(seconds)

        clock = Counting()
        made = 0

        def make() -> FakeTransport:
            nonlocal made
            made += 1
            return FakeTransport(LinkError(LinkReason.FINISHED if made > 1 else LinkReason.BUSY, "x"))

        await LinkSupervisor(make, Recorded(), settings, clock, random.Random(seed)).run()
        return slept[0]

    pauses = [asyncio.run(pause(seed)) for seed in range(20)]
    assert all(0.5 <= p <= 1.5 for p in pauses)
    assert max(pauses) - min(pauses) > 0.25
