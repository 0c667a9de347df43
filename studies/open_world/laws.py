"""Laws: what of a session (covariates) changes what of a reading (place), by which function (shape)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from . import shapes, world
from .shapes import Shape
from .world import Session

FILTER_S = 600.0
"""time constant of the filtered temperature of a law, s"""


def _since_move(s: Session) -> np.ndarray:
    """Seconds since the pose was reached."""
    starts = np.flatnonzero(np.diff(s.pose, prepend=s.pose[0] - 1))
    return s.t - s.t[starts][np.cumsum(np.isin(np.arange(s.n), starts)) - 1]


def _previous(s: Session, values: np.ndarray) -> np.ndarray:
    """What the pose before had; the first pose follows itself."""
    starts = np.flatnonzero(np.diff(s.pose, prepend=s.pose[0] - 1))
    number = np.cumsum(np.isin(np.arange(s.n), starts)) - 1
    return values[starts][np.maximum(number - 1, 0)]


def _lagged(s: Session) -> np.ndarray:
    """Temperature behind a first-order filter, solved exactly for a straight line between two rows."""
    out = np.empty(s.n)
    held = s.temp[0]
    out[0] = held
    steps = np.diff(s.t)
    decay = np.exp(-steps / FILTER_S)
    slope = np.diff(s.temp) / steps
    for k in range(s.n - 1):
        held = s.temp[k + 1] - slope[k] * FILTER_S + (held - s.temp[k] + slope[k] * FILTER_S) * decay[k]
        out[k + 1] = held
    return out


COVARIATES: dict[str, Callable[[Session], np.ndarray]] = {
    "load_x": lambda s: world.loads(s)[0],
    "load_y": lambda s: world.loads(s)[1],
    "load_z": lambda s: world.loads(s)[2],
    "inc": lambda s: s.inc,
    "tf": lambda s: s.tf,
    "temp": lambda s: s.temp,
    "temp_rate": lambda s: np.gradient(s.temp, s.t),
    "temp_filtered": _lagged,
    "rate": lambda s: s.rate,
    "rate_sign": lambda s: np.sign(s.rate),
    "acceleration": lambda s: s.acceleration,
    "vibration": lambda s: s.vibration,
    "time": lambda s: s.t - s.t[0],
    "time_since_move": _since_move,
    "previous_load_x": lambda s: _previous(s, world.loads(s)[0]),
    "previous_load_y": lambda s: _previous(s, world.loads(s)[1]),
    "previous_load_z": lambda s: _previous(s, world.loads(s)[2]),
}
ANGLES = frozenset({"tf"})


def covariate(s: Session, name: str) -> np.ndarray:
    """A covariate (n,) by its name, or by that of a further column."""
    return COVARIATES[name](s) if name in COVARIATES else s.extra[name]


@dataclass(frozen=True)
class Law:
    """place x covariates -> size * shape(scaled covariates)."""

    place: str
    """offset | scale | matrix | inclination | toolface | timing | level | gyro_offset | gyro_scale"""
    covariates: tuple[str, ...]
    shape: Shape
    ranges: tuple[tuple[float, float], ...]
    """of each covariate, scaled to -1..1; not used of an angle"""
    size: float = 1.0
    """largest departure: g, rad, s, rad/s or a share"""
    weights: tuple[float, ...] = (1.0, 0.0, 0.0)
    """of each channel, or of each of two tilts"""
    element: tuple[int, int] = (0, 0)
    """of the load matrix"""
    onset_s: float | None = None
    """acts only from this time of a session on"""

    def values(self, s: Session) -> np.ndarray:
        """The departure at each row (n,)."""
        u = np.stack([
            covariate(s, name) if name in ANGLES else 2.0 * (covariate(s, name) - low) / (high - low) - 1.0
            for name, (low, high) in zip(self.covariates, self.ranges, strict=True)
        ])  # fmt: skip
        value = self.size * self.shape(u)
        return value if self.onset_s is None else value * (s.t - s.t[0] >= self.onset_s)

    def sized(self, factor: float) -> Law:
        return replace(self, size=self.size * factor)

    def plain(self) -> dict[str, Any]:
        """What the sealed answer stores of it."""
        return asdict(self)


def restored(plain: dict[str, Any]) -> Law:
    """A law from what `plain` gave, also by way of JSON."""
    kept = plain | {
        "shape": Shape(**plain["shape"]), "covariates": tuple(plain["covariates"]),
        "ranges": tuple((low, high) for low, high in plain["ranges"]), "weights": tuple(plain["weights"]),
        "element": tuple(plain["element"]),
    }  # fmt: skip
    return Law(**kept)


def repeatable(law: Law) -> bool:
    """Whether another session can confirm it: a law of the session's own time cannot be."""
    return "time" not in law.covariates


# --- drawing --------------------------------------------------------------------------------------------------------

POSE_PLACES = ("offset", "scale", "matrix", "inclination", "toolface", "level")
ROTATION_PLACES = ("offset", "scale", "matrix", "toolface", "timing")
GYRO_PLACES = ("gyro_offset", "gyro_scale")
ENVIRONMENT = ("temp", "temp_rate", "temp_filtered", "vibration", "time")


def _sources(s: Session, place: str) -> list[str]:
    """Covariates that may cause something at a place, in this design, and that vary there."""
    if place in ("offset", "scale"):
        names = ["load_x", "load_y", "load_z", "tf", "inc", *ENVIRONMENT]
    elif place in ("inclination", "toolface"):
        names = ["inc", "tf", "temp", "time", "load_x", "load_y"]
    elif place == "timing":
        names = ["rate", "temp", "time"]
    elif place == "level":
        names = ["temp", "time", "inc"]
    elif place in GYRO_PLACES:
        names = ["temp", "temp_rate", "temp_filtered", "rate", "time", "vibration", "load_x", "load_y"]
    else:
        names = ["temp", "temp_filtered", "time", "vibration"]
    if place == "offset" and s.kind == "poses":
        names += ["previous_load", "time_since_move"]
    if place in ("offset", "scale", "toolface") and s.kind == "rotation":
        names += ["rate", "acceleration"]
    if place not in ("timing", "level"):
        names += list(s.extra)
    return [name for name in names if name == "previous_load" or _varies(s, name)]


SETTINGS = 5
"""fewer values than this of a covariate make no curve"""


def _varies(s: Session, name: str) -> bool:
    values = covariate(s, name)
    return bool(np.ptp(values) > 1e-6 and np.unique(np.round(values / np.ptp(values), 3)).size >= SETTINGS)


def drawn_law(rng: np.random.Generator, s: Session, *, repeats: bool | None = None) -> Law:
    """A law that the session can show; `repeats` True: one that another session can confirm."""
    places = list(POSE_PLACES if s.kind == "poses" else ROTATION_PLACES)
    if s.gyros:
        places += list(GYRO_PLACES) * 2
    while True:
        place = str(rng.choice(places))
        names = _sources(s, place)
        if repeats:
            names = [name for name in names if name != "time"]
        element = tuple(int(k) for k in rng.integers(0, 3, 2))
        axis = int(rng.integers(3))
        together = rng.random() < 0.25 and place in ("offset", "scale", "gyro_offset", "gyro_scale")
        # one scale for all channels, or an axis alone; a level leans about one axis
        weights = rng.normal(0, 1, 3) if together else np.eye(3)[axis]
        if place == "scale" and together:
            weights = np.ones(3)
        if place == "level":
            weights = np.eye(3)[int(rng.integers(2))]
        if place == "scale":
            # a load's own factor that follows the load is a law of the offset by that load
            names = [name for name in names if not name.startswith("load")]
        if place == "matrix" and element[0] == element[1]:
            continue
        if place == "toolface" and s.kind == "rotation":
            names = [name for name in names if not name.startswith("load")]
        if together:
            # what a channel's own load in the pose before left behind is that channel's alone
            names = [name for name in names if name != "previous_load"]
        names = [f"previous_load_{'xyz'[axis]}" if name == "previous_load" else name for name in names]
        if not names:
            continue
        count = 2 if len(names) > 1 and rng.random() < 0.3 else 1
        chosen = tuple(str(name) for name in rng.choice(names, count, replace=False))
        formula = bool(rng.random() < 0.5)
        ranges = tuple((float(covariate(s, n).min()), float(covariate(s, n).max())) for n in chosen)
        law = Law(place, chosen, _shape(rng, chosen, formula=formula), ranges, 1.0, tuple(map(float, weights)), element)
        peak = float(np.max(np.abs(law.values(s))))
        if peak > 0.0 and np.isfinite(peak):
            return law.sized(1.0 / peak)


def _shape(rng: np.random.Generator, names: tuple[str, ...], *, formula: bool) -> Shape:
    if len(names) == 1:
        return shapes.drawn(rng, names[0] in ANGLES, formula=formula)
    if not formula and not ANGLES & set(names):
        return shapes.process(rng, tuple(rng.uniform(0.4, 1.2, 2).tolist()))
    parts = [asdict(shapes.drawn(rng, name in ANGLES, formula=formula)) for name in names]
    return Shape("product", {"parts": parts})
