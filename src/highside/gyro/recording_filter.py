"""The error-state filter (`filter`) over a whole recording: samples into blocks, blocks through the filter, then rows.

Causal: a row is predicted from the blocks before its own, and the last row of a block knows that block too. With
`smooth` every row knows the whole recording (`smoother`). Recordings long enough to be worth it go through compiled
code (`compiled`), others through numpy; both make the same steps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude.quaternion import from_rotation_vector, multiply
from highside.gyro import error_state, filter_state, measurements
from highside.gyro.blocks import SUMS, Batch, Block, finished
from highside.gyro.compiled import Kernels, kernels
from highside.gyro.filter import FilterSettings, aligned, azimuth_basis, azimuth_std, constants_of, predicted, refused
from highside.gyro.frames import attitude, std_to_tool, to_body, to_tool
from highside.gyro.gates import NO_REST, Gate, MotionState
from highside.gyro.result import DriftResult
from highside.gyro.smoother import smoothed


@dataclass(frozen=True, slots=True)
class Gathered:
    """A recording in blocks. `laid` holds its samples where no compiled code goes through them."""

    table: Array
    """(M, 34), rows as `blocks.finished`"""
    number: NDArray[np.intp]
    """(N,) block of a sample"""
    laid: Batch | None


def gathered(t_s: Array, rate: Array, accel: Array, block_s: float, compiled: Kernels | None) -> Gathered:
    """Samples of the tool frame, t_s (N,), rate (3, N) rad/s, accel (3, N) g, in blocks."""
    if compiled is None:
        batch = Batch.of(t_s, to_body(rate), to_body(accel), block_s)
        return Gathered(np.ascontiguousarray(batch.table().T), batch.number, batch)
    most = min(t_s.size, int((t_s[-1] - t_s[0]) / block_s) + 2)
    number, sums, edges = np.empty(t_s.size, dtype=np.intp), np.empty((SUMS, most)), np.empty((3, most))
    count = compiled.gather(t_s, rate, accel, block_s, number, sums, edges)
    return Gathered(np.ascontiguousarray(finished(sums[:, :count], *edges[:, :count]).T), number, None)


def error_state_filter(
    t_s: Array,
    rate: Array,
    accel: Array,
    settings: FilterSettings,
    *,
    rest: Array | None = None,
    smooth: bool = False,
) -> DriftResult:
    """The filter over a recording: t_s (N,), rate (3, N) rad/s and accel (3, N) g in the *tool* frame.

    `rest` (K, 2): intervals (s) in which the tool is declared to stand. Without any, stops are detected.
    """
    t_s, rate, accel = np.ascontiguousarray(t_s), np.ascontiguousarray(rate), np.ascontiguousarray(accel)
    compiled = kernels(t_s.size)
    data = gathered(t_s, rate, accel, settings.block_s, compiled)
    intervals = np.zeros((0, 2)) if rest is None else rest
    settings = replace(settings, detect_stops=settings.detect_stops and not intervals.size)
    declared = declared_blocks(data.table[:, 32], data.table[:, 33], intervals)
    gate = Gate()
    pairs = zip(data.table, declared.tolist(), strict=True)
    verdicts = np.array([gate.verdict(Block(row), declared=flag) for row, flag in pairs], dtype=np.int64)
    state, constants = aligned(Block(data.table[0]), settings), constants_of(settings)
    if declared[0]:
        measurements.zero_rate_update(data.table[0], True, state, constants)
    trace = _empty_trace(data.table.shape[0], smooth=smooth)
    error_state.run(data.table, verdicts, declared, state, constants, trace)
    still_s, turned, gap_s = (
        float(state.tally[i]) for i in (filter_state.STILL_S, filter_state.TURNED, filter_state.GAP_S)
    )
    leap = np.zeros((data.table.shape[0], 3))
    if smooth:
        trace, leap = smoothed(data.table, trace, carried=settings.velocity_std_mps > 0.0)
    earth = np.array([constants.earth_e, constants.earth_n, constants.earth_u])
    angles = _angles(t_s, rate, accel, data, trace, leap, earth, compiled, causal=not smooth)
    known = data.number
    if not smooth:
        last = np.append(np.flatnonzero(np.diff(data.number)), t_s.size - 1)
        known = np.maximum(data.number - 1, 0)
        known[last] = data.number[last]
    return DriftResult(
        t_s=t_s,
        inc_rad=angles[0],
        tf_rad=angles[1],
        azi_rad=angles[2],
        azi_std_rad=azimuth_std(trace.azimuth_var, trace.moved_s, trace.shaken, settings)[known],
        bias_radps=to_tool(trace.bias.T)[:, known],
        bias_std_radps=std_to_tool(np.sqrt(trace.bias_var).T)[:, known],
        basis=azimuth_basis(settings, still_s, turned),
        notes=_notes(settings, gap_s, refused(state.tally), rest_known=gate.still is not None),
        scale=float(trace.scale[-1]),
        motion=trace.motion.astype(np.int8)[data.number],
    )


def declared_blocks(starts: Array, ends: Array, rest: Array) -> NDArray[np.bool_]:
    """Which blocks lie within a declared interval (with a tolerance of a millisecond)."""
    inside = np.zeros(starts.size, dtype=bool)
    for begin, end in rest:
        inside |= (starts >= begin - 1e-3) & (ends <= end + 1e-3)
    return inside


def _empty_trace(count: int, *, smooth: bool) -> error_state.Trace:
    kept, square = count if smooth else 0, (filter_state.STATES, filter_state.STATES)
    return error_state.Trace(
        q=np.empty((count, 4)),
        bias=np.empty((count, 3)),
        scale=np.empty(count),
        bias_var=np.empty((count, 3)),
        azimuth_var=np.empty(count),
        motion=np.empty(count),
        moved_s=np.empty(count),
        shaken=np.empty(count),
        accel=np.empty((count, 3)),
        q_before=np.empty((kept, 4)),
        accel_before=np.empty((kept, 3)),
        P=np.empty((kept, *square)),
        P_before=np.empty((kept, *square)),
    )


def _angles(
    t_s: Array,
    rate: Array,
    accel: Array,
    data: Gathered,
    trace: error_state.Trace,
    leap: Array,
    earth: Array,
    compiled: Kernels | None,
    *,
    causal: bool,
) -> Array:
    """Inclination, toolface, azimuth (3, N): predicted within a block, updated (or smoothed) at its end."""
    before = np.maximum(np.arange(trace.scale.size) - 1, 0)
    q, bias, scale = trace.q[before], trace.bias[before], trace.scale[before]
    # what the tool does in a block is known at its end; until then it goes on as before
    frozen = (trace.motion[before] if causal else trace.motion) == MotionState.STILL
    if compiled is not None:
        angles = np.empty((3, t_s.size))
        edges = np.ascontiguousarray(data.table[:, 31:].T)
        compiled.follow(t_s, rate, accel, data.number, q, bias, scale, frozen, leap, edges, trace.q, earth, angles)
        # the ends of blocks to the same bit as everywhere
        angles[:, np.append(np.flatnonzero(np.diff(data.number)), t_s.size - 1)] = attitude(trace.q.T)
        return angles
    assert data.laid is not None
    batch = data.laid
    within = np.empty((4, *batch.dt.shape))
    for j, sums in enumerate(batch.steps()):
        within[:, j] = np.where(frozen, q.T, predicted(q.T, bias.T, scale, earth, np.array(sums[:20])))
    rows = within[:, batch.place, batch.number]
    if not causal:
        length = np.maximum(batch.ends - batch.starts, 1e-9)
        share = (t_s - batch.starts[batch.number]) / length[batch.number]
        rows = multiply(rows, from_rotation_vector(share * leap.T[:, batch.number]))
    last = np.append(np.flatnonzero(np.diff(batch.number)), t_s.size - 1)
    first = batch.number == 0
    rows[:, first] = trace.q[:1].T
    rows[:, last] = trace.q.T
    return np.stack(attitude(rows))


def _notes(settings: FilterSettings, gap_s: float, unbelieved: dict[str, int], *, rest_known: bool) -> tuple[str, ...]:
    notes = []
    if settings.latitude_rad is None:
        notes.append("no latitude: the Earth's rotation (15 deg/h) is not modelled and counts as gyro bias")
    if settings.azimuth_rad is None:
        notes.append("no azimuth at the start: azimuths are relative to it")
        if settings.latitude_rad is not None:
            notes.append("the level part of the Earth's rotation needs the azimuth and counts as gyro bias")
    if settings.straight_hole_std_rad is not None:
        notes.append("straight hole asserted: a real change of azimuth is reported as none")
    if settings.detect_stops and not rest_known:
        notes.append(NO_REST)
    if gap_s > 0.0:
        notes.append(f"{gap_s:.1f} s in gaps were not integrated; the azimuth is uncertain by what may have happened")
    for kind, count in unbelieved.items():
        if count:
            what = (
                "detected stops refused as real, slow motion"
                if kind == "stop"
                else f"{kind} updates refused by their innovation"
            )
            notes.append(f"{count * settings.block_s:g} s of {what}")
    return tuple(notes)
