"""Laws put into open recordings of real sensors, and real clocks moved: `real/...`.

* `rest`: what a real sensor gave at rest, for minutes, is the noise of a session of this deck, unscaled; a law is
  hidden in it. Its quantisation, wandering and warm-up are what they are.
* `still`: the same with nothing hidden.
* `hand`: a step, a warm-up, a ramp, a kink of the load is put on one channel of a session by hand.
* `clock`: optical ground truth (BROAD) predicts what the recorded accelerometer reads; its times are moved by 5 ms to
  1 s. The true delay of the recording is what is found without the move.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.signal import butter, sosfiltfilt

from studies.sealed import real_recordings
from studies.sealed.real_recordings import DATA, HAND, STATIC

from . import by_hand, deck, designs, laws, world
from .answers import Case, model_of
from .noises import Noise

OFFSETS_MS = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
CLOCK_RIGHT = ("lever_arm", "bandwidth_lag", "size_effect", "verdict:partial", "verdict:unknown")
"""what the recording shows by itself beside the moved clock: the sensor is not where the optics follow the body"""
OPTICS_HZ = 12.0
"""above it the twice differenced optics are noise"""


def cases(seed: str, each: int = 10) -> dict[str, Callable[[], Case]]:
    """Every real case; none where the recordings are not there."""
    if not DATA.exists():
        return {}
    found: dict[str, Callable[[], Case]] = {}
    for k in range(each):
        for sensor in STATIC:
            for kind in ("rest", "still"):
                name = f"real/{kind}, {sensor}/{k}"
                found[name] = partial(_bench, name, seed, sensor, kind == "rest", k)
    for sensor in HAND:
        for kind in by_hand.KINDS:
            for mg in (0.3, 3.0, 30.0) if kind != "nothing" else (0.0,):
                name = f"real/hand, {sensor}, {kind}/{mg:g}"
                found[name] = partial(_hand, name, seed, sensor, kind, mg)
    for sensor in STATIC:
        for mg in (0.3, 1.0, 3.0, 10.0, 20.0, 50.0):
            name = f"real/step at rest, {sensor}/{mg:g}"
            found[name] = partial(_step_at_rest, name, seed, sensor, mg)
    found["real/clock/0"] = partial(clock, "real/clock/0", seed, 0.0)
    for ms in OFFSETS_MS:
        for sign in (1, -1):
            name = f"real/clock/{sign * ms:g}"
            found[name] = partial(clock, name, seed, sign * ms)
    return found


def _bench(name: str, seed: str, which: str, hides: bool, k: int) -> Case:
    """A rotation of the deck whose noise is a real sensor's, row by row as it came."""
    rng = deck.rng_of(seed, name)
    real = real_recordings.recording(which)
    noise = real.accel - np.median(real.accel, axis=1, keepdims=True)
    hz = (real.t.size - 1) / float(real.t[-1] - real.t[0])
    n = min(6000, real.t.size)
    start = int(rng.integers(0, real.t.size - n + 1))
    rates = rng.uniform(-2.0, 2.0, int(rng.integers(4, 16)))
    s = designs._turn(rng, hz, n / hz, rates, rng.uniform(20, 80), slips=False, gyros=False)
    s = s.rows(np.arange(s.n) < n)
    noise = noise[:, start : start + s.n]
    sigma = float(np.median(np.abs(np.diff(noise, axis=1))) / 0.6745 / np.sqrt(2.0)) or real.step
    sensor = world.drawn_sensor(rng)
    white = Noise("real", (sigma,) * 3)
    hidden: tuple[laws.Law, ...] = ()
    if hides:
        law = laws.drawn_law(rng, s, repeats=True)
        hidden = (deck.sized(s, sensor, law, white, float(np.exp(rng.uniform(np.log(400), np.log(1e5))))),)
    data = world.readings(s, sensor, hidden) + noise
    case = Case(name, "real", "rotation", world.columns(s, data), model_of(s), "real", laws=hidden, first=s)
    case.sigma, case.note = white.sigma, f"noise of {which}"
    added = world.off_base(s, world.contribution(s, sensor, hidden))
    case.hidden = added / sigma
    case.strength = float(np.sum(case.hidden**2))
    if hidden:
        other = designs.second(rng, s)
        case.other = other
        case.second = world.columns(other, world.readings(other, sensor, hidden) + noise[:, : other.n].mean())
        truth = world.contribution(other, sensor, hidden)
        case.kept_from = np.where(deck.visited(s, other, hidden), truth, np.nan)
    else:
        case.right = ("verdict:nothing_left_out", "verdict:wander", "warmup")
    return case


def _hand(name: str, seed: str, which: str, kind: str, mg: float) -> Case:
    rng = deck.rng_of(seed, name)
    real = real_recordings.recording(which)
    temp = 25.0 + 8.0 * (1 - np.exp(-(real.t - real.t[0]) / (0.4 * np.ptp(real.t))))
    added = by_hand.signal(rng, kind, real.t, temp, real.force, 1e-3 * mg)
    columns = {"t_s": real.t - real.t[0], **{f"a{a}_g": (real.accel + added)[k] for k, a in enumerate("xyz")}}
    case = Case(name, "real", "hand", columns | {"temp_c": temp}, by_hand.MODEL, "real")
    case.strength = real_recordings.energy(real, added)
    case.right, case.note = by_hand.FITTING[kind], f"{kind} of {mg:g} mg in {which}"
    return case


def _step_at_rest(name: str, seed: str, which: str, mg: float) -> Case:
    rng = deck.rng_of(seed, name)
    real = real_recordings.recording(which)
    rows = slice(0, min(real.t.size, 30_000))
    t, accel = real.t[rows] - real.t[0], real.accel[:, rows].copy()
    axis = int(np.argmax(np.abs(np.median(accel, axis=1))))
    accel[axis] += 1e-3 * mg * (t > rng.uniform(0.4, 0.6) * t[-1])
    columns = {"t_s": t, **{f"a{a}_g": accel[k] for k, a in enumerate("xyz")}}
    case = Case(name, "real", "rest", columns, by_hand.AT_REST, "real")
    added = np.zeros_like(real.accel)
    added[axis, rows] = accel[axis] - real.accel[axis, rows]
    case.strength, case.right = real_recordings.energy(real, added), ("bias_step",)
    case.note = f"step of {mg:g} mg at rest, {which}"
    return case


def clock(name: str, seed: str, ms: float) -> Case:
    """What optics say the accelerometer should read, its times moved."""
    with np.load(DATA / "broad" / "07_undisturbed_fast_rotation_B.npz") as z:
        hz, acc = float(z["fs"]), z["imu_acc"].T.astype(float) / world.G_MPS2
        quaternion, place = z["opt_quat"].astype(float), z["opt_pos"].astype(float)
    t = np.arange(acc.shape[1]) / hz
    lost = ~(np.isfinite(quaternion).all(axis=1) & np.isfinite(place).all(axis=1))
    # one sign throughout, so that it may be joined over gaps
    steps = np.sum(quaternion[~lost][1:] * quaternion[~lost][:-1], axis=1)
    quaternion[~lost] *= np.concatenate([[1.0], np.cumprod(np.where(steps < 0, -1.0, 1.0))])[:, None]
    for column in (*quaternion.T, *place.T):
        column[lost] = np.interp(t[lost], t[~lost], column[~lost])
    w, x, y, z_ = (quaternion / np.linalg.norm(quaternion, axis=1)[:, None]).T
    to_room = np.array([
        [1 - 2 * (y * y + z_ * z_), 2 * (x * y - w * z_), 2 * (x * z_ + w * y)],
        [2 * (x * y + w * z_), 1 - 2 * (x * x + z_ * z_), 2 * (y * z_ - w * x)],
        [2 * (x * z_ - w * y), 2 * (y * z_ + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    calm = sosfiltfilt(butter(4, OPTICS_HZ, fs=hz, output="sos"), place, axis=0)
    push = np.gradient(np.gradient(calm, 1 / hz, axis=0), 1 / hz, axis=0).T / world.G_MPS2
    predicted = np.einsum("jin,jn->in", to_room, push + np.array([[0.0], [0.0], [1.0]]))
    predicted[:, lost] = np.nan
    names = ("ax_g", "ay_g", "az_g")
    recording = {"t_s": t, **dict(zip(names, acc, strict=True))}
    prediction = {"t_s": t - 1e-3 * ms, **dict(zip(names, predicted, strict=True))}
    case = Case(name, "real", "beside", recording, _SIMULATION, "real", prediction=prediction)
    case.effects = {"time_offset": {"t0": 1e-3 * ms}} if ms else {}
    case.right = CLOCK_RIGHT
    case.note = f"clock moved by {ms:g} ms"
    return case


_SIMULATION = f'[sensor]\nfree = {json.dumps(["bias", "scale", "misalignment"])}\n[reference]\nkind = "simulation"\n'
