"""A bench and a tool of the deck's own: what the sealed cases are made with. Shares no code with highside.

Everything is stepped through time. A stepped session runs at one step a second, the stage dwells a minute a pose; a
rotation runs at two thousand steps a second: the rotor angle is summed from its rate, the place of each sensor in the
room is followed and differenced twice for its acceleration, filters and thermal masses are stepped one after the other.

Room: z up. A vector of the room is seen by the tool as Rz(T) Ry(I) v, with

    Ry(I) = [[c, 0, s], [0, 1, 0], [-s, 0, c]],   Rz(T) = [[c, -s, 0], [s, c, 0], [0, 0, 1]],

so that "up" reads (sin I cos T, sin I sin T, cos I). Angles rad, accelerations g, times s, temperatures degC.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import lfilter

G0 = 9.80665
EARTH = np.radians(15.041 / 3600.0)
FINE_HZ = 2000.0
SAMPLE_HZ = 50.0
EVERY = int(FINE_HZ / SAMPLE_HZ)

Values = dict[str, float]


@dataclass
class Programme:
    """What the operator does: the bench's own readings, and what surrounds the tool."""

    kind: str
    """'poses' or 'rotation'"""
    t: np.ndarray
    """time of each recorded row, s"""
    inc: np.ndarray
    tf: np.ndarray
    """what the bench reads, rad; tf not wrapped"""
    side: np.ndarray
    """+1, -1: the side from which a pose was approached (poses)"""
    temp: np.ndarray
    vibration: np.ndarray
    """rms, g"""
    pose: np.ndarray
    """number of the pose of each row; empty for a rotation"""
    gyros: bool = False
    rate_fine: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """rotor rate at each fine step, rad/s (rotation)"""
    latitude: float = np.radians(52.0)
    azimuth: float = np.radians(30.0)

    @property
    def n(self) -> int:
        return self.t.size


# --- rotation matrices of the deck's own ---------------------------------------------------------------------------


def about_y(angle: np.ndarray | float, v: np.ndarray) -> np.ndarray:
    """Ry(angle) v for v (3, n)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[0] + s * v[2], v[1], -s * v[0] + c * v[2]])


def about_x(angle: np.ndarray | float, v: np.ndarray) -> np.ndarray:
    """Rx(angle) v for v (3, n)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([v[0], c * v[1] - s * v[2], s * v[1] + c * v[2]])


def about_z(angle: np.ndarray | float, v: np.ndarray) -> np.ndarray:
    """Rz(angle) v for v (3, n)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])


def rodrigues(w: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Turn v (3, n) by the rotation vector w (3,)."""
    angle = float(np.linalg.norm(w))
    if angle == 0.0:
        return v
    k = (w / angle)[:, None]
    cross = np.stack([k[1] * v[2] - k[2] * v[1], k[2] * v[0] - k[0] * v[2], k[0] * v[1] - k[1] * v[0]])
    return v * np.cos(angle) + cross * np.sin(angle) + k * np.sum(k * v, axis=0) * (1 - np.cos(angle))


# --- programmes ----------------------------------------------------------------------------------------------------

POSE_S = 60
ROWS_A_POSE = 4


def pose_programme(
    rng: np.random.Generator,
    inclinations: tuple[float, ...] = (2.0, 5.0, 12.0, 25.0, 40.0, 55.0, 70.0, 82.0, 90.0, 110.0, 140.0),
    toolfaces: int = 12,
    *,
    both_sides: bool = True,
    temperature: str = "loop",
) -> Programme:
    """Equally spaced toolfaces at each inclination, then returns from the other side; one pose a minute."""
    stops = [(i, 360.0 * k / toolfaces, 1.0) for i in inclinations for k in range(toolfaces)]
    if both_sides:
        returns = [(i, 360.0 * k / toolfaces + 360.0 / (2 * toolfaces), -1.0)
                   for i in inclinations[1::2] for k in reversed(range(toolfaces))]  # fmt: skip
        stops += returns
    inc, tf, side = np.array(stops).T
    poses = inc.size
    rows = ROWS_A_POSE
    pose = np.repeat(np.arange(poses), rows)
    t = 60.0 * pose + 30.0 + 6.0 * np.tile(np.arange(rows), poses)
    span = 60.0 * poses
    if temperature == "loop":
        peak = rng.uniform(50.0, 60.0)
        knots = np.array([0.0, 0.22, 0.4, 0.5, 0.62, 1.0]) * span
        level = 25.0 + (peak - 25.0) * np.array([0.0, 0.6, 1.0, 0.75, 1.0, 0.02])
        temp = np.interp(t, knots, level)
    else:
        temp = np.full(t.size, 25.0)
    return Programme("poses", t, np.radians(inc)[pose], np.radians(tf)[pose], side[pose], temp, np.zeros(t.size), pose)


def rotation_programme(
    rng: np.random.Generator,
    *,
    seconds: float = 240.0,
    inclination_deg: float | None = None,
    rates_hz: tuple[float, ...] | None = None,
    gyros: bool = False,
    temperature: str = "loop",
) -> Programme:
    """Steps of the rate with ramps of two seconds between them, at one inclination."""
    inc = np.radians(rng.uniform(25.0, 75.0) if inclination_deg is None else inclination_deg)
    rates = rates_hz or (-2.0, -1.4, -0.9, -0.4, -0.15, 0.15, 0.45, 1.0, 1.5, 2.0)
    n = int(seconds * FINE_HZ)
    fine = np.arange(n) / FINE_HZ
    step = seconds / len(rates)
    knots, levels = [0.0], [rates[0]]
    for k in range(1, len(rates)):
        knots += [k * step - 1.0, k * step + 1.0]
        levels += [rates[k - 1], rates[k]]
    rate = 2 * np.pi * np.interp(fine, [*knots, seconds], [*levels, rates[-1]])
    # a ramp begins and ends softly: a moving average of 0.4 s
    width = int(0.4 * FINE_HZ)
    padded = np.concatenate([np.full(width, rate[0]), rate, np.full(width, rate[-1])])
    total = np.cumsum(padded)
    soft = (total[width:] - total[:-width]) / width
    rate = soft[width // 2 : width // 2 + n]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) / FINE_HZ])
    rows = slice(EVERY // 2, n, EVERY)
    t = fine[rows]
    temp = (
        25.0 + rng.uniform(10, 16) * np.interp(t / seconds, [0, 0.35, 0.5, 0.7, 1], [0, 1, 0.6, 0.9, 0.1])
        if temperature == "loop"
        else np.full(t.size, 25.0)
    )
    # shaken by something that has a programme of its own
    vibration = 0.2 + 0.6 * np.interp(t / seconds, np.linspace(0, 1, 9), rng.uniform(0, 1, 9)) ** 2
    return Programme(
        "rotation", t, np.full(t.size, inc), angle[rows], np.sign(rate[rows]), temp, vibration, np.zeros(0), gyros, rate
    )


# --- the chain -----------------------------------------------------------------------------------------------------


@dataclass
class Sensor:
    """The triad's own plain errors, which the simulation may refit."""

    bias: np.ndarray
    matrix: np.ndarray
    gyro_bias: np.ndarray
    gyro_matrix: np.ndarray


def some_sensor(rng: np.random.Generator) -> Sensor:
    """Offsets of a few mg, scale and misalignment of a few parts in a thousand."""
    return Sensor(
        rng.normal(0, 3e-3, 3), np.eye(3) + rng.normal(0, 3e-3, (3, 3)), rng.normal(0, 1e-4, 3),
        np.eye(3) + rng.normal(0, 2e-3, (3, 3)),
    )  # fmt: skip


def play(values: np.ndarray, slack: float) -> np.ndarray:
    """What follows `values` with a slack of `slack` on each side; begins in the middle."""
    out = np.empty_like(values)
    held = values[0]
    for k, v in enumerate(values):
        held = min(max(held, v - slack), v + slack)
        out[k] = held
    return out


def low_pass(values: np.ndarray, tau: float, step: float) -> np.ndarray:
    """First order, stepped exactly for a line between two steps; begins settled."""
    if tau <= 0.0:
        return values
    keep = np.exp(-step / tau)
    ramp = 1.0 - tau / step * (1.0 - keep)
    # y_k = keep y_(k-1) + (1 - keep - ramp) x_(k-1) + ramp x_k
    first = np.atleast_2d(values)
    out, _ = lfilter(
        [ramp, 1.0 - keep - ramp], [1.0, -keep], first, axis=-1,
        zi=(first[:, :1] * (1.0 - ramp)),
    )  # fmt: skip
    return out.reshape(values.shape)


Deed = Callable[[Programme], np.ndarray]


def readings(p: Programme, sensor: Sensor, effects: dict[str, Values]) -> tuple[np.ndarray, np.ndarray | None]:
    """Noise-free readings of the triad (3, n) and of the gyros (3, n) rad/s, with the effects in force."""
    return _poses(p, sensor, effects) if p.kind == "poses" else _rotation(p, sensor, effects)


def _angles(inc: np.ndarray, tf: np.ndarray, side: np.ndarray, e: dict[str, Values]) -> tuple[np.ndarray, np.ndarray]:
    """Where the bench truly points when it reads (inc, tf)."""
    true_inc, true_tf = inc.copy(), tf.copy()
    if v := e.get("encoder_first_harmonic"):
        true_tf += v["c1"] * np.cos(tf) + v["s1"] * np.sin(tf)
    if v := e.get("encoder_second_harmonic"):
        true_tf += v["c2"] * np.cos(2 * tf) + v["s2"] * np.sin(2 * tf)
    if v := e.get("cogging"):
        true_tf += v["ck"] * np.cos(v["k"] * tf) + v["sk"] * np.sin(v["k"] * tf)
    if v := e.get("reference_twist"):
        true_tf += v["k"] * np.cos(inc)
    if v := e.get("backlash"):
        true_tf += v["h_tf"] * side
        true_inc += v["h_inc"] * side
    if v := e.get("sag"):
        true_inc += v["s"] * np.sin(inc)
    return true_inc, true_tf


def _up(inc: np.ndarray, tf: np.ndarray, read_tf: np.ndarray, e: dict[str, Values]) -> np.ndarray:
    """ "Up" as the tool sees it, (3, n)."""
    v = np.zeros((3, inc.size))
    v[2] = 1.0
    if tilt := e.get("base_tilt"):
        v[0], v[1] = tilt["tilt_x"], tilt["tilt_y"]
        v /= np.linalg.norm(v, axis=0)
    return _to_tool(v, inc, tf, read_tf, e)


def _to_tool(v: np.ndarray, inc: np.ndarray, tf: np.ndarray, read_tf: np.ndarray, e: dict[str, Values]) -> np.ndarray:
    v = about_y(inc, v)
    if wobble := e.get("wobble"):
        k = wobble["k"]
        v = about_y(wobble["ck"] * np.cos(k * read_tf) + wobble["sk"] * np.sin(k * read_tf), v)
        v = about_x(wobble["dk"] * np.cos(k * read_tf) + wobble["tk"] * np.sin(k * read_tf), v)
    if skew := e.get("axis_nonorthogonality"):
        v = about_x(skew["eps"], v)
    return about_z(tf, v)


def _static(f: np.ndarray, sensor: Sensor, e: dict[str, Values]) -> np.ndarray:
    """The triad's answer to the specific force f (3, n)."""
    out = sensor.matrix @ f + sensor.bias[:, None]
    if v := e.get("quadratic"):
        out += _three(v, "k2") * f**2
    if v := e.get("cubic"):
        out += _three(v, "k3") * f**3
    if v := e.get("asymmetry"):
        out += _three(v, "ka") * np.abs(f)
    if v := e.get("cross_product"):
        for i, axis in enumerate("xyz"):
            for j, k in ((0, 1), (0, 2), (1, 2)):
                out[i] += v[f"k_{axis}_{'xyz'[j]}{'xyz'[k]}"] * f[j] * f[k]
    return out


def _slow(p: Programme, f: np.ndarray, e: dict[str, Values]) -> np.ndarray:
    """What follows time and temperature, (3, n), stepped a second at a time."""
    out = np.zeros((3, p.n))
    warm = p.temp - 25.0
    since = p.t - p.t[0]
    if v := e.get("temperature_bias"):
        out += _three(v, "bt") * warm
    if v := e.get("temperature_bias_curvature"):
        out += _three(v, "b2") * warm**2 + _three(v, "b3") * warm**3
    if v := e.get("temperature_scale"):
        out += _three(v, "st") * f * warm
    if v := e.get("bias_drift"):
        out += _three(v, "d") * since
    if v := e.get("warmup"):
        out += _three(v, "a") * np.exp(-since / v["tau"])
    if v := e.get("bias_step"):
        out += _three(v, "a") * (since >= v["t0"])
    if e.keys() & {"thermal_lag", "thermal_hysteresis"}:
        # a step of half a second through the whole programme
        clock = np.arange(p.t[0], p.t[-1] + 0.5, 0.5)
        outside = np.interp(clock, p.t, p.temp)
        if v := e.get("thermal_lag"):
            inside = low_pass(outside, v["tau"], 0.5)
            out += _three(v, "c") * np.interp(p.t, clock, inside - outside)
        if v := e.get("thermal_hysteresis"):
            slip = (outside - play(outside, v["width"])) / v["width"]
            out += _three(v, "h") * np.interp(p.t, clock, slip)
    if v := e.get("vibration_rectification"):
        out += _three(v, "kv") * p.vibration**2
    return out


def _three(v: Values, stem: str) -> np.ndarray:
    return np.array([v[f"{stem}_{axis}"] for axis in "xyz"])[:, None]


def _poses(p: Programme, sensor: Sensor, e: dict[str, Values]) -> tuple[np.ndarray, None]:
    inc, tf = _angles(p.inc, p.tf, p.side, e)
    if v := e.get("stiction"):
        tf = tf + play(p.tf, v["w"]) - p.tf
    f = _up(inc, tf, p.tf, e)
    if v := e.get("mounting"):
        f = rodrigues(np.array([v["tilt_x"], v["tilt_y"], v["roll"]]), f)
    return _static(f, sensor, e) + _slow(p, f, e), None


def _rotation(p: Programme, sensor: Sensor, e: dict[str, Values]) -> tuple[np.ndarray, np.ndarray | None]:
    h = 1.0 / FINE_HZ
    rate = p.rate_fine
    n = rate.size
    time = np.arange(n) * h
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) * h])
    inc = np.full(n, p.inc[0])
    true_inc, tf = _angles(inc, angle, np.sign(rate), e)
    up = _up(true_inc, tf, angle, e)
    f = up.copy()
    # the place of each sensor in a room that does not turn, differenced twice
    for axis in range(3):
        place = np.zeros(3)
        if v := e.get("lever_arm"):
            place += (v["r_x"], v["r_y"], 0.0)
        if (v := e.get("size_effect")) and axis < 2:
            place += (v[f"x_{'xy'[axis]}"], v[f"y_{'xy'[axis]}"], 0.0)
        if not place.any():
            continue
        room = about_z(-tf, np.broadcast_to(place[:, None], (3, n)))
        pull = np.zeros((3, n))
        pull[:, 1:-1] = (room[:, 2:] - 2 * room[:, 1:-1] + room[:, :-2]) / h**2
        pull[:, 0], pull[:, -1] = pull[:, 1], pull[:, -2]
        f[axis] += about_z(tf, pull)[axis] / G0
    if v := e.get("coriolis"):
        creep = np.array([v["v_x"], v["v_y"], 0.0])
        # creeping at a steady velocity in the tool's frame: twice the turning rate across it; the tool turns by -T
        f[0] += 2 * rate * creep[1] / G0
        f[1] -= 2 * rate * creep[0] / G0
    if v := e.get("bandwidth_lag"):
        f = low_pass(f, v["tau"], h)
    spin = None
    if p.gyros:
        spin = np.zeros((3, n))
        spin[2] = -np.gradient(tf, h)
    late = e.get("time_offset", {}).get("t0", 0.0)
    drift = e.get("clock_skew", {}).get("eps", 0.0)
    when = p.t - late + drift * (p.t - p.t[0])

    def sampled(rows: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(when, time, row) for row in rows])

    force = sampled(f)
    out = _static(force, sensor, e) + _slow(p, force, e)
    turn = np.interp(when, time, angle)
    turn -= 2 * np.pi * np.floor(p.tf[0] / (2 * np.pi))  # counted from the first recorded angle, as a reader would
    if v := e.get("tone"):
        out += _three(v, "c") * np.cos(2 * np.pi * v["f"] * p.t) + _three(v, "s") * np.sin(2 * np.pi * v["f"] * p.t)
    if v := e.get("aliased_vibration"):
        out += _three(v, "c") * np.cos(v["n"] * turn) + _three(v, "s") * np.sin(v["n"] * turn)
    if spin is None:
        return out, None
    w = sampled(spin)
    share = e.get("earth_rotation", {"share": 0.0})["share"]
    c = np.cos(p.latitude)
    sky = EARTH * np.array([c * np.cos(p.azimuth), c * np.sin(p.azimuth), np.sin(p.latitude)])
    w = w + share * sampled(_to_tool(np.broadcast_to(sky[:, None], (3, n)), true_inc, tf, angle, {}))
    gyro = sensor.gyro_matrix @ w + sensor.gyro_bias[:, None]
    if v := e.get("gyro_g_sensitivity"):
        gyro += np.array([[v[f"g_{i}{j}"] for j in "xyz"] for i in "xyz"]) @ force
    if v := e.get("gyro_asymmetry"):
        gyro += _three(v, "ka") * np.abs(w)
    if v := e.get("gyro_nonlinearity"):
        gyro += _three(v, "k2") * w**2 + _three(v, "k3") * w**3
    return out, gyro


def without_earth(e: dict[str, Values]) -> dict[str, Values]:
    """The effects but for Earth rotation."""
    return {name: values for name, values in e.items() if name != "earth_rotation"}


def changed(p: Programme, **what: object) -> Programme:
    """A copy of a programme with something different."""
    return replace(p, **what)  # type: ignore[arg-type]
