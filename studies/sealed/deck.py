"""The sealed deck: cases that did not exist before the engine was frozen, and their truth.

The seed is the hash of the commit that last touched the engine (`frozen_seed`), so nobody can have looked at a case
while working on it. A case is a recording in highside's interchange format, the model that the simulation is given,
and the truth, which only the scorer opens.

Strength is the energy of the concealed effect in units of the noise of a row, outside of what the base fit absorbs
(offset, scale and misalignment of the triad, and of the gyros where there are any).
"""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from . import world
from .world import Programme, Sensor, Values

ROOT = Path(__file__).resolve().parents[2]
ENGINE = ("src/highside/diagnosis", "src/highside/physics")

SIGMA_POSE = 60e-6
"""of the mean of a pose, g"""
SIGMA_ROW = 80e-6
"""of a row of a rotation, g"""
SIGMA_GYRO = np.radians(0.02)
"""of a row of a rotation, rad/s"""

XYZ = "xyz"
SETTINGS = 60
"""A covariate of at most so many values is stepped."""


def frozen_seed() -> str:
    """Hash of the last commit that changed the engine; an engine that differs from it has no seed yet."""
    changed = subprocess.run(
        ["git", "status", "--porcelain", "--", *ENGINE], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    if changed:
        raise SystemExit(f"the engine is not frozen; commit first, or give --seed:\n{changed}")
    return subprocess.run(
        ["git", "log", "-1", "--format=%H", "--", *ENGINE], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


# --- effects of the deck: how large their parts are beside one another, and their shape ----------------------------

Draw = Callable[[np.random.Generator], Values]


def _triad(stem: str, size: float) -> Draw:
    return lambda rng: {f"{stem}_{axis}": float(rng.normal(0, size)) for axis in XYZ}


def _named(**sizes: float) -> Draw:
    return lambda rng: {name: float(rng.normal(0, size)) for name, size in sizes.items()}


def _with(draw: Draw, **shape: tuple[float, float] | tuple[float, ...]) -> Draw:
    """Shapes are drawn evenly between two numbers (of their logarithms), or from a tuple of more."""

    def both(rng: np.random.Generator) -> Values:
        values = draw(rng)
        for name, choice in shape.items():
            if len(choice) == 2:
                values[name] = float(np.exp(rng.uniform(np.log(choice[0]), np.log(choice[1]))))
            else:
                values[name] = float(rng.choice(choice))
        return values

    return both


def _all(*draws: Draw) -> Draw:
    return lambda rng: {name: value for draw in draws for name, value in draw(rng).items()}


def _cross(rng: np.random.Generator) -> Values:
    pairs = ("xy", "xz", "yz")
    return {f"k_{i}_{pair}": float(rng.normal(0, 1e-4)) for i in XYZ for pair in pairs}


def _g_sensitivity(rng: np.random.Generator) -> Values:
    return {f"g_{i}{j}": float(rng.normal(0, 1e-4)) for i in XYZ for j in XYZ}


POSE_EFFECTS: dict[str, Draw] = {
    "base_tilt": _named(tilt_x=1e-4, tilt_y=1e-4),
    "axis_nonorthogonality": _named(eps=1e-4),
    "reference_twist": _named(k=1e-4),
    "encoder_first_harmonic": _named(c1=1e-4, s1=1e-4),
    "encoder_second_harmonic": _named(c2=1e-4, s2=1e-4),
    "cogging": _with(_named(ck=1e-4, sk=1e-4), k=(3.0, 4.0, 5.0)),
    "wobble": _with(_named(ck=1e-4, sk=1e-4, dk=1e-4, tk=1e-4), k=(2.0, 3.0, 4.0)),
    "backlash": _named(h_tf=1e-4, h_inc=5e-5),
    "sag": _named(s=1e-4),
    "quadratic": _triad("k2", 1e-4),
    "cubic": _triad("k3", 1e-4),
    "asymmetry": _triad("ka", 1e-4),
    "cross_product": _cross,
    "temperature_bias": _triad("bt", 1e-5),
    "temperature_bias_curvature": _all(_triad("b2", 3e-7), _triad("b3", 3e-9)),
    "temperature_scale": _triad("st", 1e-5),
    "thermal_lag": _with(_triad("c", 1e-5), tau=(150.0, 900.0)),
    "thermal_hysteresis": _with(_triad("h", 1e-4), width=(1.5, 5.0)),
    "warmup": _with(_triad("a", 1e-4), tau=(200.0, 1500.0)),
    "bias_drift": _triad("d", 1e-8),
    "bias_step": _with(_triad("a", 1e-4), t0=(1500.0, 9000.0)),
}
ROTATION_EFFECTS: dict[str, Draw] = {
    "lever_arm": _named(r_x=1e-3, r_y=1e-3),
    "size_effect": _named(x_x=1e-3, y_x=1e-3, x_y=1e-3, y_y=1e-3),
    "bandwidth_lag": lambda rng: {"tau": abs(float(rng.normal(0, 1e-3))) + 1e-5},
    "time_offset": _named(t0=1e-3),
    "clock_skew": _named(eps=1e-5),
    "coriolis": _named(v_x=1e-3, v_y=1e-3),
    "tone": _with(_all(_triad("c", 1e-4), _triad("s", 1e-4)), f=(3.0, 22.0)),
    "aliased_vibration": _with(_all(_triad("c", 1e-4), _triad("s", 1e-4)), n=(5.3, 7.3, 9.2, 11.4)),
    "vibration_rectification": _triad("kv", 1e-5),
    "encoder_first_harmonic": _named(c1=1e-4, s1=1e-4),
    "encoder_second_harmonic": _named(c2=1e-4, s2=1e-4),
    "backlash": lambda rng: {"h_tf": float(rng.normal(0, 1e-4)), "h_inc": 0.0},
    "quadratic": _triad("k2", 1e-4),
    "temperature_bias": _triad("bt", 1e-5),
    "bias_step": _with(_triad("a", 1e-4), t0=(40.0, 200.0)),
    "warmup": _with(_triad("a", 1e-4), tau=(15.0, 80.0)),
    "gyro_g_sensitivity": _g_sensitivity,
    "gyro_asymmetry": _triad("ka", 1e-4),
    "gyro_nonlinearity": _all(_triad("k2", 2e-5), _triad("k3", 2e-6)),
}
GYRO_EFFECTS = {"gyro_g_sensitivity", "gyro_asymmetry", "gyro_nonlinearity"}


# --- cases ---------------------------------------------------------------------------------------------------------


@dataclass
class Case:
    """One case with its truth."""

    name: str
    group: str
    """null | single | pair | open | blind"""
    design: str
    """poses | rotation"""
    columns: dict[str, np.ndarray]
    model: str
    strength: float = 0.0
    truth: dict[str, Values] = field(default_factory=dict)
    channels: tuple[str, ...] = ()
    """channels that carry more than a tenth of the strongest one's share of the effect"""
    interval: tuple[str, float, float] | None = None
    """where the effect sits, if it has a place: covariate, from, to (in the units of the recording)"""
    noise: str = "white"
    legit: tuple[str, ...] = ()
    """what the recording shows by itself"""

    @property
    def settings(self) -> list[float] | None:
        """The values of the covariate that the effect has an interval of, where the recording steps through it."""
        if self.interval is None:
            return None
        values = np.unique(np.round(self.columns[self.interval[0]], 3))
        return values.tolist() if values.size <= SETTINGS else None


def _model(gyros: bool, p: Programme, earth: bool) -> str:
    free = ["bias", "scale", "misalignment"]
    if gyros:
        free += ["gyro_bias", "gyro_scale", "gyro_misalignment"]
    included = '["earth_rotation"]\n[effects.earth_rotation]\nshare = 1.0' if gyros and earth else "[]"
    return (
        f"[sensor]\nfree = {free}\n[site]\ngravity_mps2 = 9.80665\nlatitude_deg = {np.degrees(p.latitude):.6f}\n"
        f"azimuth_deg = {np.degrees(p.azimuth):.6f}\n[effects]\nincluded = {included}\n"
    ).replace("'", '"')


def _weight(p: Programme) -> np.ndarray:
    """Standard deviation of a row of each channel."""
    if p.kind == "poses":
        return np.full(3, SIGMA_POSE * np.sqrt(world.ROWS_A_POSE))
    return np.concatenate([np.full(3, SIGMA_ROW), np.full(3, SIGMA_GYRO)])[: 6 if p.gyros else 3]


def _stacked(accel: np.ndarray, gyro: np.ndarray | None) -> np.ndarray:
    return accel if gyro is None else np.concatenate([accel, gyro])


def outside_base(p: Programme, signal: np.ndarray) -> np.ndarray:
    """What the base fit leaves of a signal (C, n), in units of the noise of a row."""
    force = world.readings(p, Sensor(np.zeros(3), np.eye(3), np.zeros(3), np.eye(3)), {})
    left = []
    for rows, values, sigma in ((signal[:3], force[0], _weight(p)[:3]), (signal[3:], force[1], _weight(p)[3:])):
        if values is None or not rows.size:
            continue
        base = np.stack([np.ones(p.n), *values])
        # a constant angle makes a column twice: the orthogonal basis of what there is
        u, s, _ = np.linalg.svd(base.T, full_matrices=False)
        q = u[:, s > 1e-9 * s[0]]
        scaled = rows / sigma[:, None]
        left.append(scaled - (scaled @ q) @ q.T)
    return np.concatenate(left)


def _signal(p: Programme, sensor: Sensor, effects: dict[str, Values], without: dict[str, Values]) -> np.ndarray:
    return _stacked(*world.readings(p, sensor, effects)) - _stacked(*world.readings(p, sensor, without))


def _scaled(values: Values, factor: float) -> Values:
    return {name: value if _is_shape(name, values) else value * factor for name, value in values.items()}


def _is_shape(name: str, values: Values) -> bool:
    if name in ("width", "f", "n"):
        return True
    if name == "k":  # a harmonic's number; alone it is the size of the reference twist
        return len(values) > 1
    if name in ("tau", "t0"):  # alone it is the size of a lag or of an offset in time
        return len(values) > 1
    return False


def sized(
    p: Programme, sensor: Sensor, name: str, values: Values, base: dict[str, Values], strength: float
) -> tuple[Values, np.ndarray]:
    """The values scaled so that the effect has its strength, and its signal outside of the base, in noise units."""
    for _ in range(4):
        left = outside_base(p, _signal(p, sensor, {**base, name: values}, base))
        energy = float(np.sum(left**2))
        if energy <= 0.0:
            break
        values = _scaled(values, float(np.sqrt(strength / energy)))
    return values, outside_base(p, _signal(p, sensor, {**base, name: values}, base))


def _noise(p: Programme, kind: str, rng: np.random.Generator) -> np.ndarray:
    """(C, n) noise of one of the kinds; its rms, or for a walk its white part, is that of the design."""
    sigma = _weight(p)
    n, c = p.n, sigma.size
    white = rng.standard_normal((c, n))
    if kind == "white":
        return sigma[:, None] * white
    if kind == "coloured":
        from scipy.signal import lfilter

        memory = 0.85
        if p.kind == "poses":
            # remembered from pose to pose: common to the rows of a pose
            steps = lfilter([np.sqrt(1 - 0.5**2)], [1, -0.5], rng.standard_normal((c, int(p.pose[-1]) + 1)))
            return sigma[:, None] * (0.7 * white + 0.7 * steps[:, p.pose] / np.sqrt(world.ROWS_A_POSE))
        red = lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.standard_normal((c, n)))
        return sigma[:, None] * np.sqrt(0.5) * (white + red)
    if kind == "per channel":
        factors = np.ones(c)
        factors[rng.integers(3)] = 4.0
        return sigma[:, None] * factors[:, None] * white
    if kind == "modulated":
        # by a vibration that the recording tells (rotation), by the bench's own unrest that it does not (poses)
        size = 0.5 + 3.0 * p.vibration if p.kind == "rotation" else 0.6 + 0.8 * (np.sin(p.t / 1500.0) ** 2)
        return sigma[:, None] * size * white
    if kind == "walk":
        step = rng.uniform(0.008, 0.03) if p.kind == "rotation" else rng.uniform(0.1, 0.3) / np.sqrt(world.ROWS_A_POSE)
        if p.kind == "poses":
            path = np.cumsum(rng.standard_normal((c, int(p.pose[-1]) + 1)), axis=1)[:, p.pose]
        else:
            path = np.cumsum(rng.standard_normal((c, n)), axis=1)
        return sigma[:, None] * (white + step * path)
    raise ValueError(kind)


NOISES = ("white", "coloured", "per channel", "modulated", "walk")


def _columns(p: Programme, data: np.ndarray) -> dict[str, np.ndarray]:
    columns = {"t_s": p.t, "ax_g": data[0], "ay_g": data[1], "az_g": data[2]}
    if p.gyros:
        columns |= {f"g{axis}_dps": np.degrees(data[3 + k]) for k, axis in enumerate(XYZ)}
    columns |= {"temp_c": p.temp, "inc_ref_deg": np.degrees(p.inc)}
    if p.kind == "poses":
        columns |= {"tf_ref_deg": np.degrees(p.tf), "pose": p.pose.astype(float), "direction": p.side}
    else:
        rate = np.interp(p.t, np.arange(p.rate_fine.size) / world.FINE_HZ, p.rate_fine)
        columns |= {
            "tf_ref_deg": np.degrees(p.tf) % 360.0, "rotor_deg": np.degrees(p.tf), "rotor_rate_dps": np.degrees(rate),
            "vibration_rms_g": p.vibration,
        }  # fmt: skip
    return columns


def _channels(left: np.ndarray) -> tuple[str, ...]:
    names = ("ax", "ay", "az", "gx", "gy", "gz")[: len(left)]
    energy = np.sum(left**2, axis=1)
    return tuple(n for n, e in zip(names, energy, strict=True) if e > 0.1 * energy.max())


def _programme(design: str, rng: np.random.Generator, gyros: bool) -> Programme:
    return world.pose_programme(rng) if design == "poses" else world.rotation_programme(rng, gyros=gyros)


def _earth(p: Programme) -> dict[str, Values]:
    return {"earth_rotation": {"share": 1.0}} if p.gyros else {}


def _case(
    name: str,
    group: str,
    p: Programme,
    rng: np.random.Generator,
    effects: dict[str, Draw],
    strength: float,
    noise: str = "white",
) -> Case:
    sensor = world.some_sensor(rng)
    base = _earth(p)
    truth: dict[str, Values] = {}
    lefts = []
    for effect, draw in effects.items():
        truth[effect], left = sized(p, sensor, effect, draw(rng), base, strength)
        lefts.append(left)
    data = _stacked(*world.readings(p, sensor, {**base, **truth})) + _noise(p, noise, rng)
    channels = _channels(sum(lefts)) if lefts else ()
    case = Case(
        name, group, p.kind, _columns(p, data), _model(p.gyros, p, True), strength, truth, channels, noise=noise
    )
    if list(truth) == ["bias_step"]:
        # it is there from its time on; what the base fit makes of that is no matter of where it is
        case.interval = ("t_s", float(p.t[0] + truth["bias_step"]["t0"]), float(p.t[-1]))
    return case


# --- outside of the library ----------------------------------------------------------------------------------------


def _outside(p: Programme, kind: str, rng: np.random.Generator) -> tuple[np.ndarray, tuple[str, float, float] | None]:
    """A signal (C, n) that no effect of the library makes, and where it sits."""
    x, _, z = world.readings(p, Sensor(np.zeros(3), np.eye(3), np.zeros(3), np.eye(3)), {})[0]
    nothing = np.zeros(p.n)
    warm = (p.temp - 40.0) / 10.0
    tf = np.degrees(p.tf) % 360.0
    if kind == "square wave over toolface":
        rows, place = [np.sign(np.cos(3 * p.tf + rng.uniform(0, 6))), nothing, nothing], None
    elif kind == "bump at one toolface":
        middle = rng.uniform(60, 300)
        rows = [nothing, np.exp(-0.5 * ((tf - middle) / 20.0) ** 2), nothing]
        place = ("tf_ref_deg", middle - 40.0, middle + 40.0)
    elif kind == "temperature times z to the fifth":
        rows, place = [nothing, nothing, warm * z**5], None
    elif kind == "temperature times cos 3T":
        rows, place = [warm * np.cos(3 * p.tf), nothing, nothing], None
    elif kind == "side of approach times x squared":
        rows, place = [nothing, p.side * x**2, nothing], None
    elif kind == "one ring off":
        ring = float(rng.choice(np.unique(np.round(np.degrees(p.inc), 6))[2:-2]))
        at = np.abs(np.degrees(p.inc) - ring) < 0.1
        rows, place = [nothing, nothing, at * 1.0], ("inc_ref_deg", ring - 0.1, ring + 0.1)
    elif kind == "a burst":
        middle = rng.uniform(0.3, 0.7) * p.t[-1]
        width = 0.05 * p.t[-1]
        rows = [np.where(np.abs(p.t - middle) < width, np.sign(np.sin(p.t * 2.1)), 0.0), nothing, nothing]
        place = ("t_s", middle - width, middle + width)
    elif kind == "tanh of the rate times cos T":
        rate = np.interp(p.t, np.arange(p.rate_fine.size) / world.FINE_HZ, p.rate_fine)
        rows, place = [np.tanh(rate / 2.0) * np.cos(2 * p.tf), nothing, nothing], None
    elif kind == "square wave that turns along":
        rows, place = [nothing, np.sign(np.cos(5 * p.tf + 0.4)), nothing], None
    else:
        raise ValueError(kind)
    signal = np.zeros((6 if p.gyros else 3, p.n))
    signal[:3] = rows
    return signal, place


OUTSIDE = {
    "poses": (
        "square wave over toolface", "bump at one toolface", "temperature times z to the fifth",
        "temperature times cos 3T", "side of approach times x squared", "one ring off",
    ),
    "rotation": (
        "bump at one toolface", "a burst", "tanh of the rate times cos T", "square wave that turns along",
        "temperature times cos 3T",
    ),
}  # fmt: skip


def _open_case(name: str, p: Programme, rng: np.random.Generator, kind: str, strength: float) -> Case:
    sensor = world.some_sensor(rng)
    signal, place = _outside(p, kind, rng)
    left = outside_base(p, signal)
    factor = float(np.sqrt(strength / np.sum(left**2)))
    data = _stacked(*world.readings(p, sensor, _earth(p))) + factor * signal + _noise(p, "white", rng)
    case = Case(name, "open", p.kind, _columns(p, data), _model(p.gyros, p, True), strength, {}, _channels(left), place)
    case.truth = {kind: {}}
    return case


# --- designs that cannot show an effect ----------------------------------------------------------------------------


def _blind_designs() -> list[tuple[str, Callable[[np.random.Generator], Programme], Values]]:
    """Effect, a programme in which nothing of it is left outside of the base fit, and a size for it."""
    one_ring: Any = lambda rng: world.pose_programme(rng, (90.0, 90.0, 90.0), 12)  # noqa: E731
    one_side: Any = lambda rng: world.pose_programme(rng, both_sides=False)  # noqa: E731
    level: Any = lambda rng: world.pose_programme(rng, temperature="constant")  # noqa: E731
    steady: Any = lambda rng: world.rotation_programme(rng, rates_hz=(1.0, 1.0), temperature="constant")  # noqa: E731
    return [
        ("sag", one_ring, {"s": 1e-3}),
        ("reference_twist", one_ring, {"k": 1e-3}),
        ("backlash", one_side, {"h_tf": 3e-4, "h_inc": 0.0}),
        ("temperature_bias", level, {"bt_x": 1e-4, "bt_y": 1e-4, "bt_z": 1e-4}),
        ("temperature_scale", level, {"st_x": 1e-4, "st_y": 1e-4, "st_z": 1e-4}),
        ("thermal_lag", level, {"c_x": 1e-4, "c_y": 1e-4, "c_z": 1e-4, "tau": 300.0}),
        ("lever_arm", steady, {"r_x": 5e-3, "r_y": 5e-3}),
        ("time_offset", steady, {"t0": 1e-3}),
        ("temperature_bias", steady, {"bt_x": 1e-4, "bt_y": 1e-4, "bt_z": 1e-4}),
    ]


# --- the deck ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Size:
    """How many cases of each sort."""

    nulls: int = 30
    """of each kind of noise, for each design: 10 times this in all"""
    singles: int = 4
    """of each effect at each strength"""
    strengths: tuple[float, ...] = (100.0, 400.0)
    weak: int = 1
    """of each effect at a strength of 30"""
    pairs: int = 40
    """for each design, at 100 and at 400 by turns"""
    opens: int = 12
    """of each signal outside of the library"""
    blind: int = 7
    """of each design that cannot show an effect"""


def cases(seed: str, size: Size) -> dict[str, Callable[[], Case]]:
    """Every case by its name, made when it is called for: the same for the same seed, whatever of them is used."""
    found: dict[str, Callable[[], Case]] = {}

    def rng_of(name: str) -> np.random.Generator:
        return np.random.default_rng(list(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:16]))

    for design in ("poses", "rotation"):
        library = POSE_EFFECTS if design == "poses" else ROTATION_EFFECTS
        for kind, k in product(NOISES, range(size.nulls)):
            name = f"null/{design}/{kind}/{k}"
            found[name] = partial(_null, name, design, kind, k % 3 == 2, rng_of)
        for effect in library:
            for strength, count in ((30.0, size.weak), *((s, size.singles) for s in size.strengths)):
                for k in range(count):
                    name = f"single/{design}/{effect}/{strength:g}/{k}"
                    gyros = effect in GYRO_EFFECTS or k % 4 == 3
                    found[name] = partial(_single, name, design, effect, strength, gyros, rng_of)
        for k in range(size.pairs):
            name = f"pair/{design}/{k}"
            found[name] = partial(_pair, name, design, (100.0, 400.0)[k % 2], k % 3 == 2, rng_of)
        for kind, k in product(OUTSIDE[design], range(size.opens)):
            name = f"open/{design}/{kind}/{k}"
            found[name] = partial(_open, name, design, kind, rng_of)
    for number, (effect, programme, values) in enumerate(_blind_designs()):
        for k in range(size.blind):
            name = f"blind/{number}/{effect}/{k}"
            found[name] = partial(_blind, name, effect, programme, values, rng_of)
    for k in range(2 * size.singles):
        name = f"single/rotation/earth_rotation/natural/{k}"
        found[name] = partial(_earth_left_out, name, rng_of)
    return found


RngOf = Callable[[str], np.random.Generator]


def _null(name: str, design: str, noise: str, gyros: bool, rng_of: RngOf) -> Case:
    rng = rng_of(name)
    return _case(name, "null", _programme(design, rng, gyros=gyros), rng, {}, 0.0, noise)


def _single(name: str, design: str, effect: str, strength: float, gyros: bool, rng_of: RngOf) -> Case:
    rng = rng_of(name)
    library = POSE_EFFECTS if design == "poses" else ROTATION_EFFECTS
    return _case(name, "single", _programme(design, rng, gyros=gyros), rng, {effect: library[effect]}, strength)


def _pair(name: str, design: str, strength: float, gyros: bool, rng_of: RngOf) -> Case:
    rng = rng_of(name)
    library = POSE_EFFECTS if design == "poses" else ROTATION_EFFECTS
    p = _programme(design, rng, gyros=gyros and design == "rotation")
    able = [effect for effect in library if p.gyros or effect not in GYRO_EFFECTS]
    first, second = (able[i] for i in rng.choice(len(able), 2, replace=False))
    return _case(name, "pair", p, rng, {first: library[first], second: library[second]}, strength)


def _open(name: str, design: str, kind: str, rng_of: RngOf) -> Case:
    rng = rng_of(name)
    return _open_case(name, _programme(design, rng, gyros=False), rng, kind, 400.0)


def _blind(
    name: str, effect: str, programme: Callable[[np.random.Generator], Programme], values: Values, rng_of: RngOf
) -> Case:
    rng = rng_of(name)
    p = programme(rng)
    sensor = world.some_sensor(rng)
    data = _stacked(*world.readings(p, sensor, {effect: values})) + _noise(p, "white", rng)
    return Case(name, "blind", p.kind, _columns(p, data), _model(False, p, True), 0.0, {effect: values})


def _earth_left_out(name: str, rng_of: RngOf) -> Case:
    """Its size is no free number, so it has the strength that nature gives it."""
    rng = rng_of(name)
    p = _programme("rotation", rng, gyros=True)
    sensor = world.some_sensor(rng)
    effects = _earth(p)
    left = outside_base(p, _signal(p, sensor, effects, {}))
    data = _stacked(*world.readings(p, sensor, effects)) + _noise(p, "white", rng)
    return Case(
        name, "single", p.kind, _columns(p, data), _model(True, p, False), float(np.sum(left**2)), effects,
        _channels(left),
    )  # fmt: skip
