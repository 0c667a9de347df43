"""What another program may have left out, made of what was recorded: effects of single channels, and of motion.

No forward model is at hand, only its output s on each channel. So an effect here is a set of columns over the rows:

    offset b; gain k s; cross-coupling m s_d; drift d t; temperature c (T - mean), k s (T - mean)
    sampled at t - t0: -t0 ds/dt; first-order lag: (H_tau - 1) s; lever arm: w x (w x r) + a x r; travel: k v w

Where an effect of the library is meant, its name, story and splitter are taken from there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.simulation.session import SimulationSession
from highside.physics.effect import Effect, LinearEffect, Parameter, Stage
from highside.physics.effects import all_effects
from highside.physics.gravity import STANDARD_GRAVITY_MPS2
from highside.physics.state import ChainState

Array = NDArray[np.float64]

ANY = (-1e9, 1e9)
LAGS_S = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
ARM_M = 3.0


class ColumnEffect(LinearEffect):
    """An effect that is given by its columns (k, C, n)."""

    columns: Array = np.empty((0, 0, 0))
    depends_on_input = False

    def basis(self, state: ChainState, x: Array) -> Array:
        return self.columns


@dataclass(frozen=True)
class Tried:
    """An effect with columns (k, C, n) at each value of its shape that is tried, and which amplitudes may act alone."""

    effect: Effect
    shapes: list[tuple[dict[str, float], Array]]
    parts: list[tuple[int, ...]]


_OWN = {
    "offset": ("Zero offset", "b", "The channel has a constant offset.", "repeat with the input at zero"),
    "gain": ("Gain", "k s", "The channel's gain is off.", "repeat with a larger input"),
    "cross_coupling": (
        "Cross-coupling", "m s_d", "The channel also answers to what another channel measures.",
        "move one quantity at a time",
    ),
    "centripetal": (
        "Centripetal acceleration of travel", "k v w",
        "What moves along a curve at the speed v and turns at the rate w is accelerated by v w towards the inside.",
        "the same curve at another speed, and the same speed straight on",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Around:
    """Where effects that are not linear are taken: a delay, and a lag of each kind of channel; s, 0 at nothing."""

    delay_s: float = 0.0
    lags_s: tuple[float, ...] = ()


_STORIES = {
    "bandwidth_lag": "The channel answers with a delay and a loss of swing, as any filter of finite bandwidth.",
    "time_offset": "The recording and the prediction do not mean the same instant by the same time.",
    "lever_arm": "The accelerometers do not sit at the point whose motion is predicted, so turning throws them outward "
    "and speeding up drags them sideways.",
    "gyro_bias": "The gyro shows a small rotation where there is none.",
}
"""Where the library's words speak of a tool on a bench."""


def effects_of(session: SimulationSession, around: Around) -> list[Tried]:
    """Everything whose covariates were recorded."""
    return [*_channels(session), *_coupled(session), *_timed(session, around), *_slow(session), *_moved(session)]


def kind_of(name: str, unit: str) -> str:
    """What a channel measures: "accel", "rate" or its unit."""
    if unit in ("g", "m/s2"):
        return "accel"
    return "rate" if unit in ("deg/s", "rad/s") else unit


def _effect(effect_id: str, parameters: Sequence[Parameter], stage: Stage = Stage.SENSOR) -> Effect:
    """An effect with these parameters, described as in the library where it is known there."""
    known = all_effects().get(effect_id)
    if known is not None:
        title, formula, story, splitter = known.title, known.formula, known.story, known.splitter
        confused, stage = known.confused_with, known.stage
        story = _STORIES.get(effect_id, story)
    else:
        title, formula, story, splitter = _OWN[effect_id]
        confused = ()
    made = type(
        "ColumnEffectOf", (ColumnEffect,),
        {
            "id": effect_id, "title": title, "formula": formula, "story": story, "splitter": splitter,
            "confused_with": confused, "stage": stage, "parameters": tuple(parameters),
        },
    )  # fmt: skip
    found = made()
    assert isinstance(found, Effect)
    return found


def described(effect_id: str) -> Effect:
    """An effect without columns, for what is said of it."""
    return _effect(effect_id, ())


def title_of(effect_id: str) -> str:
    """What an effect is called, of the library or of this module."""
    known = all_effects().get(effect_id)
    return known.title if known is not None else _OWN[effect_id][0]


def _alone(count: int) -> list[tuple[int, ...]]:
    """All together, or each by itself."""
    whole = tuple(range(count))
    return [whole] if count == 1 else [whole, *((k,) for k in whole)]


def _by_kind(session: SimulationSession) -> dict[str, list[int]]:
    kinds: dict[str, list[int]] = {}
    for c, (name, unit) in enumerate(zip(session.names, session.units, strict=True)):
        kinds.setdefault(kind_of(name, unit), []).append(c)
    return kinds


def _on(session: SimulationSession, rows: Sequence[tuple[int, Array]]) -> Array:
    """(k, C, n): each function on its channel."""
    columns = np.zeros((len(rows), len(session.names), session.n))
    for k, (c, function) in enumerate(rows):
        columns[k, c] = function
    return columns


def _tried(effect: Effect, columns: Array) -> Tried:
    return Tried(effect, [({}, columns)], _alone(len(columns)))


def _channels(session: SimulationSession) -> list[Tried]:
    """Offset and gain of each channel."""
    found = []
    for kind, members in _by_kind(session).items():
        names = {"accel": ("bias", "scale"), "rate": ("gyro_bias", "gyro_scale")}.get(kind, ("offset", "gain"))
        limits = {"g": 0.3, "m/s2": 3.0, "deg/s": 20.0, "rad/s": 0.35}
        offsets = [
            Parameter(f"b_{session.names[c]}", session.units[c], max(_typical(session, c), 1e-9),
                      (-limits.get(session.units[c], 1e9), limits.get(session.units[c], 1e9)))
            for c in members
        ]  # fmt: skip
        gains = [Parameter(f"k_{session.names[c]}", "1", 0.01, (-0.5, 0.5)) for c in members]
        found.append(_tried(_effect(names[0], offsets), _on(session, [(c, np.ones(session.n)) for c in members])))
        found.append(_tried(_effect(names[1], gains), _on(session, [(c, session.predicted[c]) for c in members])))
    return found


def _typical(session: SimulationSession, channel: int) -> float:
    return 0.01 * float(session.predicted[channel].std()) or 1e-3


def _coupled(session: SimulationSession) -> list[Tried]:
    """What one channel takes of another."""
    found = []
    kinds = _by_kind(session)
    for kind, members in kinds.items():
        name = {"accel": "misalignment", "rate": "gyro_misalignment"}.get(kind, "cross_coupling")
        pairs = [(c, d) for c in members for d in members if c != d]
        if pairs:
            unit = "rad" if name != "cross_coupling" else "1"
            parameters = [
                Parameter(f"m_{session.names[c]}_{session.names[d]}", unit, 3e-3, (-0.3, 0.3)) for c, d in pairs
            ]
            found.append(_tried(_effect(name, parameters), _on(session, [(c, session.predicted[d]) for c, d in pairs])))
    across = [
        (c, d) for kind, own in kinds.items() for c in own for other, members in kinds.items() if other != kind
        for d in members
    ]  # fmt: skip
    if across:
        parameters = [
            Parameter(f"m_{session.names[c]}_{session.names[d]}", f"{session.units[c]}/({session.units[d]})",
                      0.01 * float(session.readings[c].std()) / max(float(session.predicted[d].std()), 1e-12), ANY)
            for c, d in across
        ]  # fmt: skip
        tried = _tried(
            _effect("cross_coupling", parameters), _on(session, [(c, session.predicted[d]) for c, d in across])
        )
        same = next((k for k, one in enumerate(found) if one.effect.id == "cross_coupling"), None)
        if same is None:
            found.append(tried)
        else:
            both = [*found[same].effect.parameters, *parameters]
            columns = np.concatenate([found[same].shapes[0][1], tried.shapes[0][1]])
            found[same] = _tried(_effect("cross_coupling", both), columns)
    return found


def _timed(session: SimulationSession, around: Around) -> list[Tried]:
    """Sampled late, all channels alike; answering slowly, each kind of channel for itself.

    Neither is linear in its time, so the columns are what the time expected does, in proportion.
    """
    found = []
    if session.alignment.same_clock:
        late = _effect("time_offset", [Parameter("t0", "s", 1e-3, (-0.5, 0.5))])
        found.append(_tried(late, _delayed(session, around.delay_s)[None]))
    kinds = _by_kind(session)
    parameters = [Parameter(f"tau_{kind.replace('/', '_')}", "s", 1e-3, (0.0, 3.0)) for kind in kinds]
    shapes: list[tuple[dict[str, float], Array]] = []
    tried = [(tau,) * len(kinds) for tau in LAGS_S if session.step_s / 3 < tau < 0.2 * session.n * session.step_s]
    if any(around.lags_s):
        tried = [tuple(tau or session.step_s for tau in around.lags_s)]
    for taus in tried:
        of_channel = np.zeros(len(session.names))
        for tau, own in zip(taus, kinds.values(), strict=True):
            of_channel[own] = tau
        behind = np.stack([
            _behind(s, session.step_s, tau) for s, tau in zip(session.predicted, of_channel, strict=True)
        ])  # fmt: skip
        rows = [np.where(np.isin(np.arange(of_channel.size), own)[:, None], behind, 0.0) for own in kinds.values()]
        shapes.append(({}, np.stack(rows)))
    if shapes:
        found.append(Tried(_effect("bandwidth_lag", parameters), shapes, _alone(len(parameters))))
    return found


def _behind(values: Array, step_s: float, tau: float) -> Array:
    """(n,) what a first-order lag changes, for each second of its time constant."""
    return np.asarray((_through(values, step_s, lambda w: 1 / (1 + 1j * w * tau)) - values) / tau)


def _delayed(session: SimulationSession, delay_s: float) -> Array:
    """(C, n) change of the prediction for each second of delay, at that delay."""
    step = session.step_s
    if abs(delay_s) < 1e-9:
        return np.stack([_through(s, step, lambda w: -1j * w) for s in session.predicted])
    late = np.stack([_through(s, step, lambda w: np.exp(-1j * w * delay_s)) for s in session.predicted])
    return np.asarray((late - session.predicted) / delay_s)


def _through(values: Array, step_s: float, response: Callable[[Any], Any]) -> Array:
    """Values (n,) through a linear system, exact for what is sampled finely enough; both ends are turned over."""
    n = values.size
    reach = min(n - 1, max(64, n // 8))
    before = 2 * values[0] - values[reach:0:-1]
    after = 2 * values[-1] - values[-2 : -reach - 2 : -1]
    whole = np.concatenate([before, values, after])
    # what the two far ends differ by is no jump: a straight line is taken off, and follows by itself
    at = np.arange(whole.size)
    slope = (whole[-1] - whole[0]) / (whole.size - 1)
    line = whole[0] + slope * at
    omega = np.asarray(2 * np.pi * np.fft.rfftfreq(whole.size, step_s), dtype=float)
    gain = response(omega)
    gain = np.where(np.arange(omega.size) == omega.size - 1, gain.real, gain) if whole.size % 2 == 0 else gain
    turned = np.fft.irfft(np.fft.rfft(whole - line) * gain, whole.size)
    small = 1e-6
    at_rest = float(np.real(response(np.array([0.0], dtype=float))[0]))
    lateness = float(-np.imag(response(np.array([small]))[0]) / small)
    straight = at_rest * line - slope / step_s * lateness
    return np.asarray((turned + straight)[reach : reach + n])


def _slow(session: SimulationSession) -> list[Tried]:
    """What follows time or temperature."""
    channels = range(len(session.names))
    elapsed = session.state.t_s - session.state.t_s.mean()
    drift = [Parameter(f"d_{n}", f"{u}/s", 1e-6, ANY) for n, u in zip(session.names, session.units, strict=True)]
    found = [_tried(_effect("bias_drift", drift), _on(session, [(c, elapsed) for c in channels]))]
    if session.warm:
        warm = session.state.temp_c - session.state.temp_c.mean()
        bias = [Parameter(f"bt_{n}", f"{u}/C", 1e-4, ANY) for n, u in zip(session.names, session.units, strict=True)]
        scale = [Parameter(f"st_{n}", "1/C", 1e-4, (-0.01, 0.01)) for n in session.names]
        found.append(_tried(_effect("temperature_bias", bias), _on(session, [(c, warm) for c in channels])))
        found.append(
            _tried(
                _effect("temperature_scale", scale), _on(session, [(c, warm * session.predicted[c]) for c in channels])
            )
        )
    return found


def _moved(session: SimulationSession) -> list[Tried]:
    """What turning and travelling add to accelerations."""
    axes = {
        c: (name[1], 1.0 / STANDARD_GRAVITY_MPS2 if unit == "g" else 1.0)
        for c, (name, unit) in enumerate(zip(session.names, session.units, strict=True))
        if unit in ("g", "m/s2") and name[:1] == "a" and name[1:2] in "xyz" and name[2:3] == "_"
    }
    if not axes or not session.rates:
        return []
    nothing = np.zeros(session.n)
    rate = np.stack([session.rates.get(axis, nothing) for axis in "xyz"])
    found = []
    arms = np.zeros((3, len(session.names), session.n))
    angular = np.gradient(rate, session.step_s, axis=1)
    for k in range(3):
        unit = np.zeros((3, 1))
        unit[k] = 1.0
        felt = np.cross(rate, np.cross(rate, unit, axis=0), axis=0) + np.cross(angular, unit, axis=0)
        for c, (axis, size) in axes.items():
            arms[k, c] = size * felt["xyz".index(axis)]
    shown = [k for k in range(3) if np.any(arms[k] != 0)]
    if shown:
        parameters = [Parameter(f"r_{'xyz'[k]}", "m", 0.01, (-ARM_M, ARM_M)) for k in shown]
        found.append(_tried(_effect("lever_arm", parameters, Stage.KINEMATIC), arms[shown]))
    if session.speed is not None:
        rows = [
            (c, size * session.speed * session.rates[other], f"k_{session.names[c]}_{other}")
            for c, (axis, size) in axes.items() for other in session.rates if other != axis
        ]  # fmt: skip
        if rows:
            parameters = [Parameter(name, "1", 0.1, (-1.5, 1.5)) for _, _, name in rows]
            columns = _on(session, [(c, function) for c, function, _ in rows])
            found.append(_tried(_effect("centripetal", parameters, Stage.KINEMATIC), columns))
    return found
