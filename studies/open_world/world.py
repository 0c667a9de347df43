"""Sessions of a sensor on a bench, and what it reads: textbook physics, in closed form at each row.

Room: z up. The bench turns the tool by Euler angles, the inclination about y and then the toolface about the tool's z,
so that "up" is seen as Rz(T) Ry(I) (0, 0, 1) = (sin I cos T, sin I sin T, cos I). The triad reads M f + b of the
specific force f; the gyros read G w + d of the angular rate w. Angles rad, accelerations g, times s, temperatures degC.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .laws import Law

Columns = dict[str, np.ndarray]
G_MPS2 = 9.80665
LATITUDE_DEG, AZIMUTH_DEG = 52.0, 30.0


@dataclass(frozen=True)
class Session:
    """Where the bench says that the tool is, and what surrounds it, at each of n rows."""

    kind: str
    """poses | rotation"""
    t: np.ndarray
    inc: np.ndarray
    tf: np.ndarray
    """not wrapped"""
    temp: np.ndarray
    pose: np.ndarray
    """number of the pose of each row; empty in a rotation"""
    side: np.ndarray
    """+1, -1: from which side a pose was approached; direction of rotation"""
    rate: np.ndarray
    """of the toolface, rad/s"""
    acceleration: np.ndarray
    """of the toolface, rad/s^2"""
    vibration: np.ndarray
    """rms, g"""
    returns: bool = False
    """poses are approached from both sides"""
    gyros: bool = False
    extra: Columns = field(default_factory=dict)
    """further columns of the recording"""

    @property
    def n(self) -> int:
        return self.t.size

    def rows(self, kept: np.ndarray) -> Session:
        """The session with only those rows."""
        names = ("t", "inc", "tf", "temp", "side", "rate", "acceleration", "vibration")
        return replace(
            self, **{name: getattr(self, name)[kept] for name in names},
            pose=self.pose[kept] if self.pose.size else self.pose,
            extra={name: values[kept] for name, values in self.extra.items()},
        )  # fmt: skip


@dataclass(frozen=True)
class Sensor:
    """A triad's and its gyros' own plain errors, which the simulation may refit."""

    matrix: np.ndarray
    bias: np.ndarray
    gyro_matrix: np.ndarray
    gyro_bias: np.ndarray


IDEAL = Sensor(np.eye(3), np.zeros(3), np.eye(3), np.zeros(3))


def drawn_sensor(rng: np.random.Generator) -> Sensor:
    """Offsets of some mg, scale and misalignment of some parts in a thousand."""
    return Sensor(
        np.eye(3) + rng.normal(0, 3e-3, (3, 3)), rng.normal(0, 4e-3, 3), np.eye(3) + rng.normal(0, 2e-3, (3, 3)),
        rng.normal(0, 2e-4, 3),
    )  # fmt: skip


def euler_up(inc: np.ndarray, tf: np.ndarray, tilt_x: np.ndarray, tilt_y: np.ndarray) -> np.ndarray:
    """ "Up" (3, n) as the tool sees it on a bench whose base leans by two small angles."""
    n = inc.size
    zero, one = np.zeros(n), np.ones(n)
    size = np.sqrt(1.0 + tilt_x**2 + tilt_y**2)
    room = np.stack([tilt_x, tilt_y, one]) / size
    c, s = np.cos(inc), np.sin(inc)
    about_y = np.array([[c, zero, s], [zero, one, zero], [-s, zero, c]])
    c, s = np.cos(tf), np.sin(tf)
    about_z = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]])
    return np.einsum("ijn,jkn,kn->in", about_z, about_y, room)


def loads(s: Session) -> np.ndarray:
    """The specific force (3, n) of an ideal bench."""
    return euler_up(s.inc, s.tf, np.zeros(s.n), np.zeros(s.n))


def spin(inc: np.ndarray, tf: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Angular rate (3, n) seen by the tool, rad/s: its own turning, and the Earth's at the bench's site.

    The toolface grows clockwise looking down-hole, which is turning by minus that angle about the tool's z.
    """
    earth = np.radians(15.041 / 3600.0)
    latitude, azimuth = np.radians(LATITUDE_DEG), np.radians(AZIMUTH_DEG)
    north = np.cos(latitude)
    sky = earth * np.array([north * np.cos(azimuth), north * np.sin(azimuth), np.sin(latitude)])
    c, s = np.cos(inc), np.sin(inc)
    x, y, z = c * sky[0] + s * sky[2], np.full(inc.size, sky[1]), -s * sky[0] + c * sky[2]
    c, s = np.cos(tf), np.sin(tf)
    return np.stack([c * x - s * y, s * x + c * y, z - rate])


def readings(s: Session, sensor: Sensor, laws: Sequence[Law] = ()) -> np.ndarray:
    """Noise-free readings (3, n) in g, or (6, n) with the gyros' in rad/s, with the laws in force.

    Each law is evaluated once, at what the bench reads: a law of the angle given does not feed on the angle that it
    changed itself.
    """
    inc, tf = s.inc.copy(), s.tf.copy()
    tilt = np.zeros((2, s.n))
    offset, factor = np.zeros((6, s.n)), np.zeros((3, 3, s.n))
    gyro_factor = np.zeros((3, s.n))
    for law in laws:
        value = law.values(s)
        if law.place == "inclination":
            inc += value
        elif law.place == "toolface":
            tf += value
        elif law.place == "timing":
            # the bench's angles belong to another moment than the reading
            tf += s.rate * value + 0.5 * s.acceleration * value**2
        elif law.place == "level":
            tilt += np.asarray(law.weights)[:2, None] * value
        elif law.place == "offset":
            offset[:3] += np.asarray(law.weights)[:, None] * value
        elif law.place == "scale":
            factor[np.arange(3), np.arange(3)] += np.asarray(law.weights)[:, None] * value
        elif law.place == "matrix":
            i, j = law.element
            factor[i, j] += value
        elif law.place == "gyro_offset":
            offset[3:] += np.asarray(law.weights)[:, None] * value
        elif law.place == "gyro_scale":
            gyro_factor += np.asarray(law.weights)[:, None] * value
        else:
            raise ValueError(law.place)
    force = euler_up(inc, tf, tilt[0], tilt[1])
    # a factor that follows something multiplies the load itself, before the plain errors of the channel
    accel = sensor.matrix @ force + np.einsum("ijn,jn->in", factor, force) + sensor.bias[:, None] + offset[:3]
    if not s.gyros:
        return accel
    rate = spin(s.inc, s.tf, s.rate)
    gyro = sensor.gyro_matrix @ rate + gyro_factor * rate + sensor.gyro_bias[:, None] + offset[3:]
    return np.concatenate([accel, gyro])


def contribution(s: Session, sensor: Sensor, laws: Sequence[Law]) -> np.ndarray:
    """What the laws add to the readings (C, n), without noise."""
    return readings(s, sensor, laws) - readings(s, sensor)


def off_base(s: Session, signal: np.ndarray) -> np.ndarray:
    """A signal (C, n) without what offset, scale and misalignment of each channel can take up."""
    left = np.empty_like(signal)
    drives = [loads(s)] + ([spin(s.inc, s.tf, s.rate)] if s.gyros else [])
    for k, drive in enumerate(drives):
        base = np.concatenate([np.ones((1, s.n)), drive])
        u, size, _ = np.linalg.svd(base.T, full_matrices=False)
        q = u[:, size > 1e-7 * size[0]]  # a constant angle makes a column twice
        rows = signal[3 * k : 3 * k + 3]
        left[3 * k : 3 * k + 3] = rows - (rows @ q) @ q.T
    return left


def columns(s: Session, data: np.ndarray) -> Columns:
    """The recording in the interchange format."""
    found = {"t_s": s.t, **{f"a{axis}_g": data[k] for k, axis in enumerate("xyz")}}
    if s.gyros:
        found |= {f"g{axis}_dps": np.degrees(data[3 + k]) for k, axis in enumerate("xyz")}
    found |= {"temp_c": s.temp, "inc_ref_deg": np.degrees(s.inc), "tf_ref_deg": np.degrees(s.tf) % 360.0}
    if s.kind == "poses":
        found["pose"] = s.pose.astype(float)
        if s.returns:
            found["direction"] = s.side
    else:
        found |= {"rotor_deg": np.degrees(s.tf), "rotor_rate_dps": np.degrees(s.rate)}
    if np.ptp(s.vibration) > 0.0:
        found["vibration_rms_g"] = s.vibration
    return found | s.extra
