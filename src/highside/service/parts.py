"""What a configuration makes of the service: all parts that a reload may replace, as one value.

Parts are made without touching those that run; putting them in force is the assignment of this one value. So a reload
either happened or did not.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from highside.codec.frame import ByteCodec, CanCodec
from highside.config.links import LinkConfig
from highside.config.settings import Settings
from highside.link.base import Batch, LinkReason, LinkState, LinkSupervisor, Transport
from highside.link.opened import OpenedTransport
from highside.service.drift_keeper import DriftParts
from highside.service.guarded_codec import GuardedCodec
from highside.service.in_force import CalibrationInForce, CompensationInForce
from highside.service.outputs import AttitudeOutput, Survey
from highside.service.pipeline import Pipeline
from highside.service.places import ToolLock
from highside.service.publisher import Publisher
from highside.service.rig.rig import Rig, RigParts
from highside.service.watch_keeper import WatchParts


class LinkSink(Protocol):
    """The service, as a link sees it."""

    def on_batch(self, batch: Batch) -> None: ...

    def on_state(self, state: LinkState, reason: LinkReason | None, message: str) -> None: ...


class Tap:
    """What a link's supervisor speaks to: deaf unless its link is the one in force."""

    def __init__(self, sink: LinkSink, in_force: Callable[[], Tap]) -> None:
        self._sink, self._in_force = sink, in_force

    def on_batch(self, batch: Batch) -> None:
        if self._in_force() is self:
            self._sink.on_batch(batch)

    def on_state(self, state: LinkState, reason: LinkReason | None, message: str) -> None:
        if self._in_force() is self:
            self._sink.on_state(state, reason, message)


@dataclass(frozen=True, slots=True)
class ServiceParts:
    """Everything that follows from the configuration and can be replaced while the service runs."""

    settings: Settings
    calibration: CalibrationInForce
    rotation: CompensationInForce
    pipeline: Pipeline
    publisher: Publisher
    tap: Tap
    supervisor: LinkSupervisor
    drift: DriftParts
    watch: WatchParts
    rig: RigParts
    tool_lock: ToolLock | None = None
    """None before the service runs"""
    link_task: asyncio.Task[None] | None = None
    publisher_task: asyncio.Task[None] | None = None
    wits_task: asyncio.Task[None] | None = None

    @property
    def flags(self) -> tuple[str, ...]:
        """What is doubtful about every output."""
        return self.calibration.flags + self.rotation.flags


def make_supervisor(link: LinkConfig, tap: Tap, opened: OpenedTransport | None) -> LinkSupervisor:
    """The supervisor of a link whose first attempt, if it was opened ahead, is `opened`."""
    ahead = [] if opened is None else [opened]

    def transport() -> Transport:
        return ahead.pop() if ahead else link.transport()

    return LinkSupervisor(transport, tap, link.supervisor())


def make_pipeline(
    settings: Settings,
    codec: ByteCodec | CanCodec,
    calibration: CalibrationInForce,
    rotation: CompensationInForce,
    drift: DriftParts,
    watch: WatchParts,
    *,
    emit: Callable[[AttitudeOutput | Survey], None],
    rig: Rig,
) -> Pipeline:
    """A pipeline whose counts begin anew; `rig` knows the offset of the toolface, if one was set."""
    pipeline = Pipeline(
        codec=GuardedCodec(codec, settings.codec.name),
        tool=settings.tool,
        pipeline=settings.pipeline,
        monitor=settings.monitor,
        survey=settings.survey,
        correction=calibration.correction,
        rolling_bias=settings.rolling_bias,
        emit=emit,
        vibration=settings.vibration,
        toolface=settings.toolface,
        drift=drift.stage,
        rotation=rotation.live,
        watch=watch.stage,
    )
    pipeline.extra_flags = calibration.flags + rotation.flags
    pipeline.gravity = calibration.gravity(settings)
    if rig.offset is not None:
        pipeline.toolface_offset_deg = rig.offset.offset_deg
    return pipeline
