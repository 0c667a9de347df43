"""The second deck: effects put into open recordings of real sensors, with shams into which nothing is put.

Four sorts of case, all on noise that nobody made up - with its quantisation, wandering, warm-up and hands:

* `hand`, `rest`: the recording itself; the diagnosis knows |g| alone (`[reference] kind = "magnitude"`).
* `poses`, `rotation`: the deck's own world (a bench session, a continuous rotation), and as noise what a real sensor
  gave at rest, unscaled. So effects of the bench and of motion, which |g| cannot show, meet real noise as well.

What |g| of still readings can show by design: curvature of the triad (square, cube, |f|, products), offset, scale and
the symmetric part of the misalignment where they are withheld, what follows time, temperature or vibration. At rest, in
one attitude, only the last remains, and offset and scale cannot be told apart. What it cannot show: anything that only
turns the reading (mounting, tilt, sag, encoders, backlash), anything that needs rotation, tones (they average out),
clipping (without an attitude nothing says that different loads gave one value). Temperature and vibration are recorded
by an instrument of the deck's own where the recording has none, also in the shams.

Strength: energy of the effect outside of the base fit in units of the real noise - of a still reading's |a|, of a pose
mean (differences of neighbours), of a row of a rotation. A case that would need an implausible size is not made.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from . import deck, real_recordings, world
from .deck import Case, Draw
from .real_recordings import HAND, REST, STATIC, Real
from .world import Programme, Sensor, Values

PLAIN = Sensor(np.zeros(3), np.eye(3), np.zeros(3), np.eye(3))
FREE = ("bias", "scale", "misalignment")
WARMS = {"vn100": ("temperature_bias", "temperature_bias_curvature")}
"""What a recording shows by itself (it warms up): the model of a case in which something else is hidden knows it."""
SETTLES = {"sunsided": ("warmup",)}
"""What a recording shows by itself and no model is told of; to name it is no mistake. Plain means of sixteen stretches
of this one begin 0.48 (y) and 0.38 mg (z) above the whole's, with standard errors of 0.05 and 0.08 mg, fall by 0.2 and
0.3 mg in the first 41 s, then by less and less, and stay after three minutes. No diagnosis is needed to see it."""

HAND_EFFECTS: dict[str, Draw] = {
    "quadratic": deck.POSE_EFFECTS["quadratic"],
    "cubic": deck.POSE_EFFECTS["cubic"],
    "asymmetry": deck.POSE_EFFECTS["asymmetry"],
    "cross_product": deck.POSE_EFFECTS["cross_product"],
    "bias_step": deck.POSE_EFFECTS["bias_step"],
    "bias_drift": deck.POSE_EFFECTS["bias_drift"],
    "warmup": deck.POSE_EFFECTS["warmup"],
    "temperature_bias": deck.POSE_EFFECTS["temperature_bias"],
    "temperature_scale": deck.POSE_EFFECTS["temperature_scale"],
    "thermal_lag": deck.POSE_EFFECTS["thermal_lag"],
    "vibration_rectification": deck.ROTATION_EFFECTS["vibration_rectification"],
}
REST_EFFECTS = ("bias_step", "bias_drift", "warmup", "temperature_bias", "thermal_lag", "vibration_rectification")
ROTATION_EFFECTS = tuple(e for e in deck.ROTATION_EFFECTS if e not in deck.GYRO_EFFECTS)
PLAUSIBLE = {
    "quadratic": 5e-3, "cubic": 5e-3, "asymmetry": 1e-2, "cross_product": 5e-3, "vibration_rectification": 5e-3,
    "temperature_bias": 3e-3, "temperature_bias_curvature": 2e-4, "temperature_scale": 1e-3, "thermal_lag": 3e-3,
    "thermal_hysteresis": 5e-3, "warmup": 2e-2, "bias_drift": 1e-5, "bias_step": 5e-2, "lever_arm": 0.2,
    "size_effect": 0.1, "bandwidth_lag": 0.1, "time_offset": 0.5, "clock_skew": 1e-2, "coriolis": 0.1, "tone": 1e-2,
    "aliased_vibration": 1e-2, "base_tilt": 5e-2, "axis_nonorthogonality": 1e-2, "encoder_first_harmonic": 1e-2,
    "encoder_second_harmonic": 1e-2, "cogging": 5e-3, "wobble": 5e-3, "backlash": 2e-2, "sag": 3.5e-2,
    "reference_twist": 1e-2,
}  # fmt: skip
"""The largest amplitude that an instrument may have, in the effect's own units; nothing larger is put in."""

WITHHELD = (
    ("hand", ("bias", "scale"), ("misalignment",)),
    ("hand", ("bias", "misalignment"), ("scale",)),
    ("hand", ("scale", "misalignment"), ("bias",)),
    ("hand", ("bias",), ("scale", "misalignment")),
    ("vn100", FREE, ("temperature_bias",)),
)
"""What the sensor really has and the model is not told of."""
FAULTS = ("stuck_bit", "quantisation", "duplicated_frames", "reversed_time", "wrong_unit", "constant_channel",
          "missing_values", "missing_column")  # fmt: skip
BLIND = (("hand", "mounting"), ("hand", "base_tilt"), ("rest", "quadratic"), ("rest", "misalignment"))
SEVERITY = 3e-3
"""of what is put in where it cannot show: rad, g/g^2"""


@dataclass(frozen=True)
class Size:
    """How many cases of each sort."""

    strengths: tuple[float, ...] = (100.0, 400.0, 1600.0)
    singles: int = 1
    """of each effect at each strength on each recording (bench: in all)"""
    shams: int = 10
    """of each recording, and three times this of each bench"""
    blind: int = 3


def cases(seed: str, size: Size) -> dict[str, Callable[[], Case | None]]:
    """Every case by its name; one that cannot be made of a plausible size gives None."""
    found: dict[str, Callable[[], Case | None]] = {}

    def rng_of(name: str) -> np.random.Generator:
        return np.random.default_rng(list(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:16]))

    def add(name: str, make: Callable[..., Case | None], *what: Any) -> None:
        found[f"real/{name}"] = partial(make, f"real/{name}", rng_of(f"real/{name}"), *what)

    for kind, names in (("hand", HAND), ("rest", REST)):
        for recording in names:
            add(f"null/{kind}/{recording}/untouched", _untouched, recording)
            for k in range(size.shams):
                add(f"null/{kind}/{recording}/{k}", _sham, recording)
            for effect in HAND_EFFECTS if kind == "hand" else REST_EFFECTS:
                for strength in size.strengths:
                    for k in range(size.singles):
                        add(
                            f"single/{kind}/{recording}/{effect}/{strength:g}/{k}", _single, recording, effect, strength
                        )
            for fault in FAULTS:
                add(f"fault/{kind}/{recording}/{fault}", _fault, recording, fault)
            for whose, effect in BLIND:
                if whose == kind:
                    for k in range(size.blind):
                        add(f"blind/{kind}/{recording}/{effect}/{k}", _blind, recording, effect)
            for whose, free, truth in WITHHELD:
                if whose in (kind, recording):
                    add(f"withheld/{kind}/{recording}/{'+'.join(truth)}", _withheld, recording, free, truth)
    for design, effects in (("poses", tuple(deck.POSE_EFFECTS)), ("rotation", ROTATION_EFFECTS)):
        for k in range(3 * size.shams):
            add(f"null/{design}/{STATIC[k % 2]}/{k}", _bench, design, STATIC[k % 2], None, 0.0)
        for number, effect in enumerate(effects):
            for turn, strength in enumerate(size.strengths):
                for k in range(size.singles):
                    source = STATIC[(number + turn + k) % 2]
                    add(f"single/{design}/{effect}/{strength:g}/{k}", _bench, design, source, effect, strength)
    return found


# --- the recordings themselves -------------------------------------------------------------------------------------


def _surroundings(real: Real, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Temperature up and down twice, degC, and vibration, rms in g, by the deck's own instruments."""
    u = (real.t - real.t[0]) / (real.t[-1] - real.t[0])
    knots = np.sort(rng.uniform(0.08, 0.92, 4))
    levels = np.array([0.0, 1.0, rng.uniform(0.2, 0.6), rng.uniform(0.7, 1.0), rng.uniform(0.3, 0.5), 0.0])
    temp = 25.0 + rng.uniform(10.0, 18.0) * np.interp(u, [0.0, *knots, 1.0], levels)
    vibration = 0.2 + 1.8 * np.interp(u, np.linspace(0, 1, 12), rng.uniform(0, 1, 12)) ** 2
    return np.round(temp + rng.normal(0, 0.01, u.size), 2), np.round(vibration, 4)


def _programme(real: Real, temp: np.ndarray, vibration: np.ndarray) -> Programme:
    none = np.zeros(0)
    return Programme("poses", real.t, none, none, none, temp, vibration, none)


def _model(free: tuple[str, ...]) -> str:
    words = ", ".join(f'"{name}"' for name in free)
    return f'[sensor]\nfree = [{words}]\n[reference]\nkind = "magnitude"\n'


def _columns(t: np.ndarray, accel: np.ndarray, **others: np.ndarray) -> dict[str, np.ndarray]:
    return {"t_s": t, "ax_g": accel[0], "ay_g": accel[1], "az_g": accel[2], **others}


def _own(real: Real) -> dict[str, np.ndarray]:
    return {} if real.temp is None else {"temp_c": real.temp}


def _case(name: str, group: str, real: Real, columns: dict[str, np.ndarray], free: tuple[str, ...]) -> Case:
    legit = SETTLES.get(real.name, ())
    return Case(name, group, real.kind, columns, _model(free), noise=real.name, legit=legit)


def _untouched(name: str, rng: np.random.Generator, recording: str) -> Case:
    del rng
    real = real_recordings.recording(recording)
    case = _case(name, "null", real, _columns(real.t, real.accel, **_own(real)), FREE)
    case.legit += WARMS.get(recording, ())
    return case


def _sham(name: str, rng: np.random.Generator, recording: str) -> Case:
    """A stretch of the recording with its axes exchanged, beside instruments that have nothing to do with it."""
    real = real_recordings.recording(recording)
    accel, n = _turned(real.accel, rng), real.t.size
    first = rng.integers(0, n // 8)
    rows = slice(int(first), int(first + n - n // 8))
    temp, vibration = _surroundings(real, rng)
    free, own = FREE, {"temp_c": temp}
    if recording in WARMS:
        # this one does change with its own temperature: the model knows, and no other thermometer is shown
        free, own = (*FREE, *WARMS[recording]), _own(real)
    others = {name: values[rows] for name, values in {**own, "vibration_rms_g": vibration}.items()}
    return _case(name, "null", real, _columns(real.t[rows], accel[:, rows], **others), free)


def _turned(accel: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return accel[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)[:, None]


def _single(name: str, rng: np.random.Generator, recording: str, effect: str, strength: float) -> Case | None:
    real = real_recordings.recording(recording)
    warms = WARMS.get(recording, ())
    temp, vibration = _surroundings(real, rng)
    others = {"vibration_rms_g": vibration, "temp_c": temp}
    known: tuple[np.ndarray, ...] = ()
    if warms:
        if "temp" in effect or "therm" in effect:
            return None  # it has a temperature of its own, which does the same
        assert real.temp is not None
        others["temp_c"] = real.temp
        known = (real.temp, real.temp**2, real.temp**3)
    p = _programme(real, temp, vibration)
    for _ in range(30):
        values = _shaped(real, effect, HAND_EFFECTS[effect](rng), rng)
        signal = _change(p, real.force, effect, values)
        shows = real_recordings.energy(real, signal, known)
        factor = float(np.sqrt(strength / max(shows, 1e-12)))
        values = deck._scaled(values, factor)
        if _plausible(effect, values):
            break
    else:
        return None
    accel = real.accel + _change(p, real.force, effect, values)
    case = _case(name, "single", real, _columns(real.t, accel, **others), (*FREE, *warms))
    case.truth, case.strength, case.channels = {effect: values}, strength, ("g_total",)
    return case


def _plausible(effect: str, values: Values) -> bool:
    return all(abs(v) <= PLAUSIBLE[effect] for n, v in values.items() if not deck._is_shape(n, values))


def _shaped(real: Real, effect: str, values: Values, rng: np.random.Generator) -> Values:
    """Times of the size of the recording; at rest all of it along gravity, since the rest does not show."""
    span = float(real.t[-1] - real.t[0])
    if "t0" in values:
        values["t0"] = span * float(rng.uniform(0.2, 0.8))
    if "tau" in values:
        values["tau"] = span * float(np.exp(rng.uniform(np.log(0.06), np.log(0.4))))
    if real.kind == "rest":
        size = float(rng.normal(0, 1e-4))
        along = dict(zip("xyz", real.force[:, 0], strict=True))
        values = {n: v if n in ("tau", "t0") else size * along[n[-1]] for n, v in values.items()}
    return values


def _change(p: Programme, force: np.ndarray, effect: str, values: Values) -> np.ndarray:
    """(3, n) what the effect adds to the readings."""
    e = {effect: values}
    return world._static(force, PLAIN, e) - force + world._slow(p, force, e)


def _withheld(
    name: str, rng: np.random.Generator, recording: str, free: tuple[str, ...], truth: tuple[str, ...]
) -> Case:
    del rng
    real = real_recordings.recording(recording)
    case = _case(name, "withheld", real, _columns(real.t, real.accel, **_own(real)), free)
    case.truth = {effect: {} for effect in truth}
    return case


def _fault(name: str, rng: np.random.Generator, recording: str, fault: str) -> Case | None:
    real = real_recordings.recording(recording)
    t, accel, n = real.t.copy(), real.accel.copy(), real.t.size
    axis = int(rng.integers(3))
    if fault == "stuck_bit":
        scatter = float(np.median(np.abs(np.diff(accel[axis])))) / 0.6745
        if real.step == 0.0:
            return None  # the maker's filter has smoothed the converter's steps away
        codes = np.round(accel[axis] / real.step).astype(int)
        bit = max(int(np.log2(max(scatter / real.step, 2.0))) - 1, 0)
        accel[axis] = real.step * (codes & ~(1 << bit))
    elif fault == "quantisation":
        # eight times what a rest scatters by
        step = 8.0 * float(np.median([accel[axis, s].std() for s in real.still]))
        accel[axis] = step * np.round(accel[axis] / step)
    elif fault == "duplicated_frames":
        again = np.sort(np.concatenate([np.arange(n), rng.choice(n, n // 50, replace=False)]))
        t, accel = t[again], accel[:, again]
    elif fault == "reversed_time":
        t = t[::-1].copy()
    elif fault == "wrong_unit":
        accel *= world.G0
    elif fault == "constant_channel":
        accel[axis] = accel[axis, 0]
    elif fault == "missing_values":
        accel[axis, rng.choice(n, n // 20, replace=False)] = np.nan
    columns = _columns(t, accel)
    if fault == "missing_column":
        del columns["xyz"[axis].join(("a", "_g"))]
    case = _case(name, "fault", real, columns, FREE)
    case.truth = {fault: {}}
    if recording in WARMS:
        # without its temperature, which a fault's file does not have, what it does while it warms up follows time
        case.legit = (*WARMS[recording], "warmup", "bias_drift", "thermal_lag")
    return case


def _blind(name: str, rng: np.random.Generator, recording: str, effect: str) -> Case:
    real = real_recordings.recording(recording)
    axis = rng.standard_normal(3)
    axis *= SEVERITY / np.linalg.norm(axis)
    if effect == "quadratic":
        accel = real.accel + axis[:, None] * real.force**2
    elif effect == "misalignment":
        accel = real.accel + np.cross(axis, real.force.T).T
    else:
        # the triad turned in its housing, or the whole room: each still reading keeps its length
        accel = world.rodrigues(axis, real.accel)
    case = _case(name, "blind", real, _columns(real.t, accel, **_own(real)), FREE)
    case.truth = {effect: {}}
    case.legit += WARMS.get(recording, ())
    return case


# --- a bench with the noise of a real rest -------------------------------------------------------------------------


def _rest_noise(p: Programme, recording: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(3, n) what a sensor at rest gave about its mean, axes exchanged, and the size of a reading's scatter (3,).

    A row of a rotation is the mean of two that follow one another (100 Hz to 50 Hz); a row of a bench session that of
    as many as the rest affords, so that its ten minutes with all their wandering are spread over the session.
    """
    real = real_recordings.recording(recording)
    accel = _turned(real.accel, rng)
    most = accel.shape[1] // p.n
    count = 2 if p.kind == "rotation" else int(rng.integers(most // 2, most + 1))
    first = int(rng.integers(0, accel.shape[1] - count * p.n + 1))
    rows = accel[:, first : first + count * p.n].reshape(3, p.n, count).mean(axis=2)
    rows -= rows.mean(axis=1, keepdims=True)
    if p.kind == "rotation":
        return rows, rows.std(axis=1)
    means = rows.reshape(3, -1, world.ROWS_A_POSE).mean(axis=2)
    return rows, np.diff(means, axis=1).std(axis=1) / np.sqrt(2.0)


def _bench(
    name: str, rng: np.random.Generator, design: str, recording: str, effect: str | None, strength: float
) -> Case | None:
    p = world.pose_programme(rng) if design == "poses" else world.rotation_programme(rng)
    noise, scatter = _rest_noise(p, recording, rng)
    sensor = world.some_sensor(rng)
    truth: dict[str, Values] = {}
    channels: tuple[str, ...] = ()
    if effect is not None:
        # the deck's strengths refer to its own noise
        ideal = deck.SIGMA_POSE if design == "poses" else deck.SIGMA_ROW
        library = deck.POSE_EFFECTS if design == "poses" else deck.ROTATION_EFFECTS
        for _ in range(30):
            wanted = strength * float(np.mean((scatter / ideal) ** 2))
            values, left = deck.sized(p, sensor, effect, library[effect](rng), {}, wanted)
            if _plausible(effect, values):
                break
        else:
            return None
        truth, channels = {effect: values}, deck._channels(left)
    data = world.readings(p, sensor, truth)[0] + noise
    group = "null" if effect is None else "single"
    return Case(
        name, group, design, deck._columns(p, data), deck._model(False, p, True), strength, truth, channels,
        noise=recording, legit=SETTLES.get(recording, ()),
    )  # fmt: skip
