"""Sessions of which |g| alone is known: a sensor held still in many attitudes by hand, and one that lies at rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from .answers import Case
from .world import Columns

MODEL = '[sensor]\nfree = ["bias", "scale", "misalignment"]\n[reference]\nkind = "magnitude"\n'
AT_REST = '[sensor]\nfree = ["bias"]\n[reference]\nkind = "magnitude"\n'
SIGMA = 1e-3
"""of a row, g: what a hand-held MEMS sensor has"""


@dataclass(frozen=True)
class Held:
    """A session by hand: time, "up" as the sensor sees it (3, n), temperature, and which rows are held still."""

    t: np.ndarray
    up: np.ndarray
    temp: np.ndarray
    still: np.ndarray
    hold: np.ndarray
    """number of the hold of each row, -1 on the way"""


def held(
    rng: np.random.Generator, *, holds: int = 31, hold_s: float = 4.0, move_s: float = 2.0, hz: float = 50.0
) -> Held:
    """Attitudes over the whole sphere, joined by smooth turns."""
    aims = rng.standard_normal((holds, 3))
    aims /= np.linalg.norm(aims, axis=1, keepdims=True)
    period = hold_s + move_s
    t = np.arange(int(holds * period * hz)) / hz
    which = np.minimum((t / period).astype(int), holds - 1)
    into = t - which * period
    share = np.clip((into - hold_s) / move_s, 0.0, 1.0)
    soft = share**2 * (3 - 2 * share)
    nearer, later = aims[which], aims[np.minimum(which + 1, holds - 1)]
    up = (1 - soft)[:, None] * nearer + soft[:, None] * later
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    still = share == 0.0
    temp = 25.0 + rng.uniform(3, 10) * (1 - np.exp(-t / (0.4 * t[-1])))
    return Held(t, up.T, temp, still, np.where(still, which, -1))


def columns(s: Held, accel: np.ndarray) -> Columns:
    return {"t_s": s.t, **{f"a{axis}_g": accel[k] for k, axis in enumerate("xyz")}, "temp_c": s.temp}


def sensed(
    rng: np.random.Generator, s: Held, added: np.ndarray, *, sigma: float = SIGMA, walk: float = 0.0
) -> np.ndarray:
    """What a triad reads, with what is hidden (3, n) and noise; it shakes on the way from hold to hold."""
    matrix, bias = np.eye(3) + rng.normal(0, 5e-3, (3, 3)), rng.normal(0, 1e-2, 3)
    noise = sigma * rng.standard_normal(s.up.shape)
    noise += walk * sigma * np.cumsum(rng.standard_normal(s.up.shape), axis=1) * np.sqrt(s.t[1] - s.t[0])
    shaken = np.where(s.still, 0.0, 0.05) * rng.standard_normal(s.up.shape)
    return matrix @ s.up + bias[:, None] + added + noise + shaken


def strength(s: Held, added: np.ndarray, sigma: float = SIGMA) -> float:
    """Noncentrality in |a| of the holds, off what offset and matrix take up."""
    count = int(s.hold.max()) + 1
    rows = np.bincount(s.hold[s.still], minlength=count)
    along = np.sum(s.up * added, axis=0)
    mean = np.bincount(s.hold[s.still], along[s.still], count) / rows
    x, y, z = (np.bincount(s.hold[s.still], s.up[k][s.still], count) / rows for k in range(3))
    base = np.array([x, y, z, x * x, y * y, z * z, x * y, x * z, y * z]).T
    q, _ = np.linalg.qr(base)
    left = mean - q @ (q.T @ mean)
    return float(np.sum(left**2 * rows) / sigma**2)


KINDS = ("step", "warm-up", "ramp", "temperature", "kink of load", "nothing")
FITTING = {
    "step": ("bias_step",), "warm-up": ("warmup",), "ramp": ("bias_drift",), "temperature": ("temperature_bias",),
    "kink of load": (), "nothing": ("verdict:nothing_left_out", "verdict:not_testable"),
}  # fmt: skip
"""the library's name of each"""


def signal(
    rng: np.random.Generator, kind: str, t: np.ndarray, temp: np.ndarray, load: np.ndarray, size: float
) -> np.ndarray:
    """What is hidden (3, n): on one channel, of a size in g."""
    u = (t - t[0]) / np.ptp(t)
    course = {
        "step": lambda: (u >= rng.uniform(0.35, 0.65)).astype(float),
        "warm-up": lambda: np.exp(-u / rng.uniform(0.1, 0.25)),
        "ramp": lambda: u,
        "temperature": lambda: (temp - temp[0]) / max(float(np.ptp(temp)), 1e-9),
        "nothing": lambda: np.zeros(t.size),
    }
    axis = int(rng.integers(3))
    row = np.maximum(load[axis] - 0.3, 0.0) if kind == "kink of load" else course[kind]()
    return size * np.eye(3)[axis][:, None] * row


def hand_case(name: str, rng: np.random.Generator, kind: str, size: float) -> Case:
    """Something hidden in a session by hand."""
    s = held(rng, holds=int(rng.integers(24, 50)))
    added = signal(rng, kind, s.t, s.temp, s.up, size)
    case = Case(name, "hand", "hand", columns(s, sensed(rng, s, added)), MODEL, sigma=(SIGMA,) * 3)
    case.strength, case.right, case.note = strength(s, added), FITTING[kind], f"{kind} of {1e3 * size:g} mg"
    return case


def rest_case(name: str, rng: np.random.Generator, kind: str, size: float, *, seconds: float = 1200.0) -> Case:
    """Something hidden in a rest of one attitude."""
    t = np.arange(int(seconds * 10.0)) / 10.0
    up = rng.standard_normal(3)
    up /= np.linalg.norm(up)
    temp = 25.0 + 12.0 * (1 - np.exp(-t / (0.6 * seconds)))
    along = signal(rng, kind, t, temp, np.repeat(up[:, None], t.size, axis=1), size)
    # |g| of a rest shows what acts along gravity: hidden on the axis that lies most along it
    added = np.zeros_like(along)
    added[int(np.argmax(np.abs(up)))] = along.sum(axis=0)
    accel = up[:, None] * 1.002 + added + SIGMA * rng.standard_normal((3, t.size))
    recording = {"t_s": t, **{f"a{axis}_g": accel[k] for k, axis in enumerate("xyz")}, "temp_c": temp}
    case = Case(name, "hand", "rest", recording, AT_REST, sigma=(SIGMA,) * 3)
    left = up @ added
    case.strength = float(np.sum((left - left.mean()) ** 2)) / SIGMA**2
    case.right, case.note = FITTING[kind], f"{kind} of {1e3 * size:g} mg at rest"
    return case


def _one(seed: str, name: str, make: Callable[..., Case], kind: str, size: float) -> Case:
    from .deck import rng_of

    return make(name, rng_of(seed, name), kind, size)


def cases(seed: str, each: int = 8) -> dict[str, Callable[[], Case]]:
    """Sessions by hand and at rest: every kind of hidden course, of 0.3 to 50 mg."""
    found: dict[str, Callable[[], Case]] = {}
    for kind in KINDS:
        for k in range(each):
            size = 0.0 if kind == "nothing" else float(np.geomspace(3e-4, 5e-2, each)[k])
            found[f"hand/by hand, {kind}/{k}"] = partial(_one, seed, f"hand/by hand, {kind}/{k}", hand_case, kind, size)
            if kind != "kink of load":
                found[f"hand/at rest, {kind}/{k}"] = partial(
                    _one, seed, f"hand/at rest, {kind}/{k}", rest_case, kind, size
                )
    return found
