"""Simulated rotations for the development deck of `highside diagnose`: seeded designs, noise, effects and outsiders.

A design: 240 s at 50 Hz, inclination 25 to 85 deg, ten steady rates of both senses up to 2 turns a second in random
order, a temperature loop, vibration that differs from rate to rate; a sensor with bias, scale and misalignment drawn
anew. Noise of 80 ug: white, coloured, one loud channel, following the vibration, a wandering offset. `strength` is the
energy of the signal in units of the true noise, outside of the base.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from highside.diagnosis.core.observed import Observed
from highside.diagnosis.rows.session import RotationSession
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.plan import Profile, RotationPlan, Session, Site
from highside.physics.state import ChainState
from studies.scenario import random_sensor

Array = NDArray[np.float64]

SIGMA_G = 80e-6
SIGMA_RADPS = np.radians(0.02)
FREE = ("bias", "scale", "misalignment")
GYRO_FREE = ("gyro_bias", "gyro_scale")
LATITUDE = np.radians(52.0)

SINGLES: dict[str, dict[str, float]] = {
    "lever_arm": {},
    "size_effect": {},
    "coriolis": {},
    "vibration_rectification": {},
    "bandwidth_lag": {},
    "time_offset": {},
    "clock_skew": {},
    "encoder_first_harmonic": {},
    "encoder_second_harmonic": {},
    "cogging": {"k": 5.0},
    "wobble": {"k": 3.0},
    "backlash": {},
    "stiction": {},
    "quadratic": {},
    "cubic": {},
    "asymmetry": {},
    "cross_product": {},
    "temperature_bias": {},
    "temperature_bias_curvature": {},
    "temperature_scale": {},
    "thermal_lag": {"tau": 90.0},
    "thermal_hysteresis": {"width": 2.0},
    "warmup": {"tau": 70.0},
    "bias_drift": {},
    "bias_step": {"t0": 97.3},
    "tone": {"f": 13.7},
    "aliased_vibration": {"n": 7.3},
}
GYRO_SINGLES: dict[str, dict[str, float]] = {
    "gyro_g_sensitivity": {},
    "gyro_asymmetry": {},
    "gyro_nonlinearity": {},
    "earth_rotation": {},
    "time_offset": {},
    "bandwidth_lag": {},
    "lever_arm": {},
}
KINDS = ("white", "coloured", "per-channel", "vibration-modulated")
NULL_KINDS = (*KINDS, "heavy tails", "random walk")


def design(seed: int, *, seconds: float = 240.0) -> ChainState:
    """The rows of one case."""
    rng = np.random.default_rng([seed, 77])
    sizes = np.array([0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 0.4])
    rates = rng.permutation(sizes * rng.uniform(0.9, 1.1, 10)) * np.where(rng.permutation(10) % 2, 1, -1)
    ramp = float(rng.uniform(1, 3))
    hold = (seconds - 9 * ramp) / 10
    vibration = tuple(float(v) for v in np.abs(rng.normal(0.3, 0.2, 10)))
    plan = RotationPlan(
        float(rng.uniform(25, 85)), tuple(2 * np.pi * rates), hold, ramp, 50.0, float(rng.uniform(0, 360)), vibration
    )
    top = float(rng.uniform(35, 60))
    temperature = Profile((25.0, 25 + 0.6 * (top - 25), top, 25 + 0.7 * (top - 25), top - 2, 25 + rng.uniform(0, 4)))
    site = Site(latitude_rad=LATITUDE, azimuth_rad=float(rng.uniform(0, 2 * np.pi)))
    return Session(plan, site, temperature).rows().state


@dataclass(frozen=True)
class Noise:
    """Colour (AR(1) coefficient), size of each channel (C,) and of each row (n,), degrees of freedom of Student's t,
    and the walk's step in units of the white size."""

    phi: float
    size: Array
    rows: Array
    tails: float = np.inf
    walk: float = 0.0

    def draw(self, rng: np.random.Generator) -> Array:
        shape = (self.size.size, self.rows.size)
        drive = rng.standard_normal(shape)
        if np.isfinite(self.tails):
            drive = rng.standard_t(self.tails, shape) * np.sqrt((self.tails - 2) / self.tails)
        coloured = lfilter([np.sqrt(1 - self.phi**2)], [1, -self.phi], drive, axis=1)
        return self.size[:, None] * (self.rows * coloured + self.walk * np.cumsum(rng.standard_normal(shape), axis=1))

    def whitened(self, signal: Array) -> Array:
        """(..., C, n) in units of the noise, the walk left aside."""
        relative = signal / self.size[:, None] / self.rows
        return np.asarray(lfilter([1, -self.phi], [np.sqrt(1 - self.phi**2)], relative, axis=-1))


def noise_of(kind: str, state: ChainState, rng: np.random.Generator, gyros: bool = False) -> Noise:
    """The noise of a case."""
    size = np.array([SIGMA_G] * 3 + [SIGMA_RADPS] * 3 * gyros)
    rows = np.ones(state.n)
    if kind == "coloured":
        return Noise(float(rng.uniform(0.4, 0.9)), size, rows)
    if kind == "per-channel":
        return Noise(float(rng.choice([0.0, 0.5])), size * rng.uniform(0.5, 4, size.size), rows)
    if kind == "vibration-modulated":
        return Noise(0.0, size, np.sqrt(0.4 + (state.vibration_rms_g / 0.25) ** 2))
    if kind == "heavy tails":
        return Noise(0.0, size, rows, tails=4.0)
    if kind == "random walk":
        return Noise(float(rng.choice([0.0, 0.6])), size, rows, walk=float(rng.choice([0.004, 0.01, 0.03])))
    return Noise(0.0, size, rows)


def outsiders(state: ChainState) -> dict[str, Array]:
    """Signals (3, n) of no effect of the library."""
    x, y, _ = gravity_direction(state.inc_rad, state.tf_rad)
    warm = (state.temp_c - state.temp_c.mean()) / 10.0
    tf, nothing = state.tf_rad, np.zeros(state.n)
    rate = state.rotor_rate_radps / np.abs(state.rotor_rate_radps).max()
    u = (state.t_s - state.t_s[0]) / np.ptp(state.t_s)
    bump = np.exp(-0.5 * ((np.mod(np.degrees(tf), 360) - 130) / 20) ** 2)
    return {
        "square wave over toolface": np.stack([np.sign(np.cos(3 * tf + 0.3)), nothing, nothing]),
        "bump at one toolface": np.stack([nothing, bump, nothing]),
        "temperature x x^2": np.stack([warm * x**2, nothing, nothing]),
        "temperature x cos 3T": np.stack([warm * np.cos(3 * tf), nothing, nothing]),
        "sense x y^2": np.stack([nothing, np.sign(rate) * y**2, nothing]),
        "rate^4 on z": np.stack([nothing, nothing, rate**4]),
        "rate window on x": np.stack([np.abs(np.abs(rate) - 0.5) < 0.2, nothing, nothing]).astype(float),
        "rate x sin 2T on x": np.stack([rate * np.sin(2 * tf), nothing, nothing]),
        "time x x y on y": np.stack([nothing, u * x * y, nothing]),
    }


def _base(sensor: ForwardModel, state: ChainState, gyros: bool) -> Array:
    free = FREE + GYRO_FREE if gyros else FREE
    blank = np.zeros((6 if gyros else 3, state.n))
    return Observed(state, blank).jacobian(sensor, free)


def strength_of(signal: Array, base: Array, noise: Noise) -> float:
    """Whitened energy of a signal (C, n) outside of base columns (P, C, n)."""
    columns = noise.whitened(base).reshape(len(base), -1)
    columns = columns / np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-300)
    values, vectors = np.linalg.eigh(columns @ columns.T)
    good = values > 1e-10
    space = (vectors[:, good] / np.sqrt(values[good])).T @ columns
    flat = noise.whitened(signal).reshape(-1)
    return float(flat @ flat - np.sum((space @ flat) ** 2))


def predicted(model: ForwardModel, state: ChainState, gyros: bool) -> Array:
    """(C, n) readings without noise."""
    reading = model.predict(state)
    return np.concatenate([reading, model.gyro(state)]) if gyros else np.asarray(reading)


def _sensor(rng: np.random.Generator, gyros: bool) -> ForwardModel:
    sensor = random_sensor(rng)
    if not gyros:
        return sensor
    bias, scale = rng.normal(0, 5e-4, 3), rng.normal(0, 2e-3, 3)
    return sensor.with_effects(
        {
            "gyro_bias": dict(zip(("b_x", "b_y", "b_z"), bias.tolist(), strict=True)),
            "gyro_scale": dict(zip(("s_x", "s_y", "s_z"), scale.tolist(), strict=True)),
        }
    )


@dataclass(frozen=True)
class Case:
    """A recording, what is concealed in it, and the base that may be refitted."""

    session: RotationSession
    truth: dict[str, dict[str, float]]
    gyros: bool


def case(effects: tuple[str, ...], strength: float, kind: str, seed: int, gyros: bool = False) -> Case:
    """A recording with effects concealed in it, each of this strength; none: nothing left out."""
    rng = np.random.default_rng([seed, *"+".join((*effects, kind)).encode()])
    state = design(int(rng.integers(2**31)))
    sensor = _sensor(rng, gyros)
    noise = noise_of(kind, state, rng, gyros)
    base, clean = _base(sensor, state, gyros), predicted(sensor, state, gyros)
    shapes = {**SINGLES, **(GYRO_SINGLES if gyros else {})}
    truth: dict[str, dict[str, float]] = {}
    for effect_id in effects:
        effect = library.get(effect_id)
        values = {}
        for p in effect.parameters:
            size = float(rng.normal()) * p.typical
            values[p.name] = shapes[effect_id][p.name] if p.shape else (abs(size) if p.gate[0] == 0.0 else size)
        if effect_id == "earth_rotation":
            truth[effect_id] = {"share": 1.0}
            continue
        factor = 0.1
        for _ in range(3):
            truth[effect_id] = {p.name: values[p.name] * (1 if p.shape else factor) for p in effect.parameters}
            added = predicted(sensor.with_effects({effect_id: truth[effect_id]}), state, gyros) - clean
            factor *= float(np.sqrt(strength / strength_of(added, base, noise)))
    readings = predicted(sensor.with_effects(truth), state, gyros) + noise.draw(rng)
    return Case(RotationSession(readings, state), truth, gyros)


def outsider(name: str, strength: float, kind: str, seed: int) -> Case:
    """A recording with a signal that the library does not have."""
    rng = np.random.default_rng([seed, *name.encode()])
    state = design(int(rng.integers(2**31)))
    sensor = _sensor(rng, False)
    noise = noise_of(kind, state, rng)
    signal = outsiders(state)[name]
    factor = np.sqrt(strength / strength_of(signal, _base(sensor, state, False), noise))
    return Case(RotationSession(sensor.predict(state) + factor * signal + noise.draw(rng), state), {}, False)


def jittered(sigma_s: float, seed: int) -> Case:
    """A recording whose rows are sampled at random early or late."""
    rng = np.random.default_rng([seed, 5])
    state = design(seed)
    sensor = _sensor(rng, False)
    late = state.shifted(sigma_s * rng.standard_normal(state.n))
    readings = sensor.predict(late) + noise_of("white", state, rng).draw(rng)
    return Case(RotationSession(readings, state), {"sampling_jitter": {"sigma": sigma_s}}, False)
