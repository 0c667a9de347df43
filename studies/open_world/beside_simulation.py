"""A recording and another program's prediction of it: late, without a motion, with a constant that is off."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from .answers import Case
from .world import G_MPS2, Columns

MODEL = '[sensor]\nfree = ["bias"]\n[reference]\nkind = "simulation"\n'
SIGMA_G, SIGMA_DPS = 5e-4, 0.05


class Motion:
    """A hand-held motion in closed form: roll and pitch as sums of waves, and a translation on request."""

    def __init__(self, rng: np.random.Generator, *, hz: float = 1.0, waves: int = 8, tone: bool = False) -> None:
        self.frequency = rng.uniform(0.1, hz, (2, waves)) if not tone else np.full((2, 1), hz)
        count = self.frequency.shape[1]
        self.size = rng.uniform(0.1, 0.5, (2, count)) / (1.0 if tone else 2.0)
        self.phase = rng.uniform(0, 2 * np.pi, (2, count))

    def angles(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Roll and pitch (2, n), rad, and their rates, rad/s."""
        wave = 2 * np.pi * self.frequency[:, :, None] * t + self.phase[:, :, None]
        size = self.size[:, :, None]
        return (size * np.sin(wave)).sum(axis=1), (2 * np.pi * self.frequency[:, :, None] * size * np.cos(wave)).sum(
            axis=1
        )

    def sensed(self, t: np.ndarray, push: np.ndarray | None = None) -> np.ndarray:
        """Accelerations (g) and rates (deg/s) of a perfect sensor, (6, n); `push` (3, n) of the room, m/s^2."""
        (roll, pitch), (roll_rate, pitch_rate) = self.angles(t)
        zero, one = np.zeros(t.size), np.ones(t.size)
        up = np.stack([zero, zero, one]) if push is None else np.stack([zero, zero, one]) + push / G_MPS2
        c, s = np.cos(pitch), np.sin(pitch)
        about_y = np.stack([c * up[0] - s * up[2], up[1], s * up[0] + c * up[2]])
        c2, s2 = np.cos(roll), np.sin(roll)
        accel = np.stack([about_y[0], c2 * about_y[1] + s2 * about_y[2], -s2 * about_y[1] + c2 * about_y[2]])
        rates = np.stack([roll_rate, c2 * pitch_rate, -s2 * pitch_rate])
        return np.concatenate([accel, np.degrees(rates)])


NAMES = ("ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps")


def _recorded(rng: np.random.Generator, t: np.ndarray, clean: np.ndarray, bias: float = 0.0) -> Columns:
    noise = np.array([SIGMA_G] * 3 + [SIGMA_DPS] * 3)[:, None] * rng.standard_normal(clean.shape)
    return {"t_s": t, **dict(zip(NAMES, clean + noise, strict=True))}


def early(name: str, rng: np.random.Generator, seconds: float, *, span: float = 120.0) -> Case:
    """A prediction whose times are too small by so many seconds."""
    motion = Motion(rng)
    t = np.arange(int(span * 100)) / 100.0
    when = np.arange(int((span + 8) * 143)) / 143.0 - 4.0
    prediction = {"t_s": when - seconds, **dict(zip(NAMES, motion.sensed(when), strict=True))}
    case = Case(name, "beside", "beside", _recorded(rng, t, motion.sensed(t)), MODEL, prediction=prediction)
    case.effects = {"time_offset": {"t0": seconds}}
    # aligning the clocks is an answer as well: nothing is left out then, and the shift is told
    case.right, case.note = ("verdict:nothing_left_out",), f"prediction early by {1e3 * seconds:g} ms"
    return case


def motion_missing(name: str, rng: np.random.Generator) -> Case:
    """The room moves and the prediction does not know."""
    motion = Motion(rng)
    t = np.arange(12000) / 100.0
    push = np.stack([
        rng.uniform(0.3, 1.0) * np.sin(2 * np.pi * rng.uniform(0.3, 2.0) * t + rng.uniform(0, 6)) for _ in range(3)
    ])  # fmt: skip
    prediction = {"t_s": t, **dict(zip(NAMES, motion.sensed(t), strict=True))}
    case = Case(name, "beside", "beside", _recorded(rng, t, motion.sensed(t, push)), MODEL, prediction=prediction)
    case.right = ("verdict:unknown", "verdict:partial", "law:*", "tone")
    case.note = "motion missing from the prediction"
    return case


def frequency_off(name: str, rng: np.random.Generator, share: float) -> Case:
    """A periodic motion on one clock, its frequency in the simulation off by a share."""
    t = np.arange(6000) / 100.0
    hz = rng.uniform(0.4, 1.5)
    true = Motion(np.random.default_rng(5), hz=hz, tone=True)
    wrong = Motion(np.random.default_rng(5), hz=hz * (1 + share), tone=True)
    prediction = {"t_s": t, **dict(zip(NAMES, wrong.sensed(t), strict=True))}
    case = Case(name, "beside", "beside", _recorded(rng, t, true.sensed(t)), MODEL, prediction=prediction)
    case.effects = {"clock_skew": {"eps": share}}
    case.right = ("law:*channel_delay*", "motion_rate*", "rate*", "clock*")
    case.note = f"a frequency of the simulation off by {100 * share:g} %"
    return case


def hidden(name: str, rng: np.random.Generator, kind: str) -> Case:
    """Something on one channel that the prediction lacks."""
    motion = Motion(rng)
    t = np.arange(12000) / 100.0
    clean = motion.sensed(t)
    axis = int(rng.integers(3))
    size = float(np.exp(rng.uniform(np.log(3e-3), np.log(3e-2))))
    temp = 25.0 + 10.0 * (1 - np.exp(-t / 40.0))
    course = {
        "step": lambda: (t > rng.uniform(40, 80)).astype(float), "quadratic": lambda: clean[axis] ** 2,
        "factor by temperature": lambda: clean[axis] * (temp - 25.0) / 10.0,
        "kink of the rate": lambda: np.maximum(clean[3] - 20.0, 0.0) / 50.0, "nothing": lambda: np.zeros(t.size),
    }[kind]()  # fmt: skip
    clean = clean.copy()
    clean[axis] += size * course
    recording = _recorded(rng, t, clean) | {"temp_c": temp}
    prediction = {"t_s": t, **dict(zip(NAMES, motion.sensed(t), strict=True))}
    case = Case(name, "beside", "beside", recording, MODEL, prediction=prediction, note=kind)
    case.right = {
        "step": ("bias_step", "*step*", "law:*offset*time*"), "quadratic": ("quadratic", "law:*load*"),
        "factor by temperature": ("temperature_scale", "law:*factor*temp*"), "kink of the rate": ("law:*rate*",),
        "nothing": ("verdict:nothing_left_out",),
    }[kind]  # fmt: skip
    return case


def _one(seed: str, name: str, make: Callable[..., Case], *what: object) -> Case:
    from .deck import rng_of

    return make(name, rng_of(seed, name), *what)


def cases(seed: str, each: int = 4) -> dict[str, Callable[[], Case]]:
    """Pairs of a recording and a prediction."""
    found: dict[str, Callable[[], Case]] = {}

    def put(row: str, make: Callable[..., Case], *what: object) -> None:
        found[f"beside/{row}"] = partial(_one, seed, f"beside/{row}", make, *what)

    for k, ms in enumerate((5, 10, 20, 30, 50, 100, 200, 500, 1000)):
        put(f"early/{k}", early, 1e-3 * ms)
        put(f"late/{k}", early, -1e-3 * ms)
    for k in range(each):
        put(f"motion missing/{k}", motion_missing)
        put(f"frequency/{k}", frequency_off, (0.02, -0.03, 0.05, 0.01)[k % 4])
        for kind in ("step", "quadratic", "factor by temperature", "kink of the rate", "nothing"):
            put(f"{kind}/{k}", hidden, kind)
    return found
