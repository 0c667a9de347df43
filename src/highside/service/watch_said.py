"""What a watch says, as the message that is published."""

from __future__ import annotations

from collections.abc import Callable

from highside.service.watch_messages import (
    WatchDeparture,
    WatchError,
    WatchMessage,
    WatchNoise,
    WatchParameter,
    WatchSize,
    WatchTakenBack,
)
from highside.service.watch_stage import WatchStage, claim_key
from highside.watch.result import AttitudeError, WatchClaim

__all__ = ["message"]


def message(stage: WatchStage, now_s: float, now_mono: float | None = None) -> WatchMessage:
    """What `watch` says. `now_s`: UTC; times of the watch are taken back from there, `now_mono` being the same by the
    host's clock, or, where it is None, that of the last reading."""
    said, watch_s = stage.said, stage.t_s if now_mono is None else stage.now_s(now_mono)

    def utc(t_s: float) -> float:
        return round(now_s - (watch_s - t_s), 3)

    return WatchMessage(
        t=round(now_s, 6),
        verdict=said.verdict,
        cal_id=stage.cal_id,
        claims=[_departure(claim, stage, utc) for claim in said.claims],
        parameters={
            name: WatchParameter(
                value=one.value, std=one.std, unit=one.unit, stated_std=one.stated_std, observable=one.observable
            )
            for name, one in said.parameters.items()
        },
        not_observable={one.parameter: one.why for one in said.not_observable},
        advice=list(said.advice),
        inclination_deg=said.inclination_deg,
        toolface_deg=said.toolface_deg,
        measured_t=None if said.measured_s is None else utc(said.measured_s),
        age_s=0.0 if said.measured_s is None else max(watch_s - said.measured_s, 0.0),
        stale=said.stale,
        still_unseen=_error(said.still_unseen),
        never_seen=_error(said.never_seen),
        stated=_error(said.stated),
        taken_back=None
        if said.taken_back is None
        else WatchTakenBack(alarm_t=utc(said.taken_back.alarm_s), t=utc(said.taken_back.at_s)),
        noise_grown=said.noise_grown,
        noise_ratio=said.noise_ratio,
        undecided=said.undecided,
        noise_changes=[
            WatchNoise(
                axis=one.axis,
                effect=one.effect,
                of=one.of,
                factor=one.factor,
                scatter_g=one.scatter_g,
                since_t=utc(one.since_s),
                rests=one.rests,
            )
            for one in said.noise_changes
        ],
        watched_s=said.duration_s,
        stills=said.counts.stills,
        turns=said.counts.turns,
        left_out=stage.left_out,
        began=stage.began,
    )


def _error(error: AttitudeError | None) -> WatchError | None:
    if error is None:
        return None
    return WatchError(inc_deg=error.inc_deg, tf_sin_inc_deg=error.tf_sin_inc_deg, tf_deg=error.tf_deg)


def _departure(claim: WatchClaim, stage: WatchStage, utc: Callable[[float], float]) -> WatchDeparture:
    size = claim.parameters[claim.parameter]
    return WatchDeparture(
        effect=claim.effect,
        parameter=claim.parameter,
        equivalence_class=list(claim.equivalence_class),
        size=size.value,
        std=size.std,
        low=size.low,
        high=size.high,
        unit=size.unit,
        sizes={
            name: WatchSize(value=one.value, std=one.std, low=one.low, high=one.high, unit=one.unit)
            for name, one in claim.parameters.items()
        },
        since_t=utc(claim.since_s),
        since_low_t=utc(claim.since_low_s),
        since_high_t=utc(claim.since_high_s),
        alarm_t=utc(claim.alarm_s),
        evidence=claim.evidence,
        error=_error(claim.error),
        acknowledged=claim_key(claim) in stage.acknowledged,
    )
