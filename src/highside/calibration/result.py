"""What every calibration method returns: parameters with covariance, where they hold, and how good they are.

The sensor is `m = A g + b` (equation 4 of the balance-correction paper), with optional quadratic, cubic and cross terms
and, where several temperatures were visited, A and b as polynomials in temperature. A *zone* is one such sensor model
with the range of inclination and temperature in which it may be used: a joint or conventional calibration has one zone
named "global", a balance calibration one for each inclination.

The error of a corrected vector is `-C (dA g + db + ...)`, C = A^-1: the second term of equation 6, taken with the
covariance of the parameters. In a balance zone the estimated matrix has swallowed the offset, so that `dA` and `db` are
correlated in such a way that an error d common to the poses vanishes at the zone's own inclination Ic and comes back as
`d (1 - cos I / cos Ic)` away from it. The one covariance therefore says both how good a zone is and how it fails
outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.poses import DEFAULT_NOISE_G, PoseSet
from highside.calibration.sensor import (
    MATRIX_NAMES,
    OFFSET_NAMES,
    UNITS,
    SensorModel,
    sensor_columns,
    sensor_of,
)
from highside.calibration.student import with_widening
from highside.errors import InputError, Refused
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction, gravity_jacobians
from highside.physics.state import ChainState

UNIFORM_ANGLE_STD_RAD = float(np.pi / np.sqrt(3.0))
"""Standard deviation of an angle of which nothing is known: 103.9 deg."""

TILT_NAMES = ("tilt_x", "tilt_y")
"""Bench tilt in the plane of inclination and across it."""
BENCH_NAMES = ("bench_x", "bench_y")
"""The same tilt where a method takes it for zero: its covariance with the sensor's parameters says how far it moves
them, and hence what several zones of one session have in common."""
SHARED_NAMES = (*BENCH_NAMES, "offset_x", "offset_y", "offset_z")
"""All that is taken for known (zero) and moves every zone of a session, each by its own lever: the tilt of the bench,
and what is not known of the sensor's offset where a method does not observe it."""


class Reason(StrEnum):
    """Why a calibration is refused, or what its user must know. The text is for the person at the bench."""

    NEAR_HORIZONTAL = "near_horizontal"
    """balance at 90 deg: the third row of W vanishes"""
    SINGULAR = "singular"
    """the poses do not determine the matrix"""
    TOO_FEW_POSES = "too_few_poses"
    NOT_FOUR_QUADRANTS = "not_four_quadrants"
    CLOSURE = "closure"
    """the four readings of a ring contradict one another"""
    BAD_POSE = "bad_pose"
    """a reading that the others do not predict; left out"""
    SWAPPED_POSES = "swapped_poses"
    UNOBSERVABLE = "unobservable"
    """quantities that the poses cannot tell apart"""
    OFFSET_NOT_OBSERVABLE = "offset_not_observable"
    TOO_MANY_BAD = "too_many_bad"
    NOT_NOMINAL = "not_nominal"
    """axes, signs or units confused"""
    TEMPERATURE_HYSTERESIS = "temperature_hysteresis"
    TEMPERATURE_SPAN = "temperature_span"
    NOISE_ASSUMED = "noise_assumed"
    BENCH_SCATTER = "bench_scatter"
    """the bench repeats worse than it was said to"""
    MISFIT = "misfit"
    """scatter that neither reading noise nor bench explains"""
    GAUGE = "gauge"
    """what a calibration without reference attitude leaves open"""


@dataclass(frozen=True, slots=True)
class Remark:
    """One thing the user must know. `poses` names the poses it speaks of; `refused`: a part of the input was refused,
    so that a command that writes the result ends with exit status 1 all the same."""

    reason: Reason
    text: str
    poses: tuple[str, ...] = ()
    refused: bool = False


class CalibrationRefused(Refused):
    """The poses were read and understood, and no calibration follows from them. `remark` says why and what to do."""

    def __init__(self, reason: Reason, text: str, poses: tuple[str, ...] = ()) -> None:
        self.remark = Remark(reason, text, poses)
        super().__init__(text)


@dataclass(frozen=True, slots=True)
class Parameters:
    """P named numbers with their covariance (P, P). Matrix elements have no unit; offsets and K are in g; tilts in rad.

    `student` (P, P): the widening of `covariance` where the variances behind it are themselves estimates; None where
    they are not (see `highside.calibration.student`).

    Names of the sensor: `A_xy` (row, column), `b_x`, `K2_x`, `K3_x`, `KX_x_yz` (channel x, product g_y g_z); with `@k`
    the coefficient of the k-th power of reduced temperature (`b_x@1`).
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    student: Array | None = None

    def __post_init__(self) -> None:
        size = len(self.names)
        square = [self.covariance] if self.student is None else [self.covariance, self.student]
        if self.values.shape != (size,) or any(matrix.shape != (size, size) for matrix in square):
            raise InputError(f"{size} names, values {self.values.shape}, covariance {self.covariance.shape}")

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def get(self, name: str, default: float = 0.0) -> float:
        return float(self.values[self.names.index(name)]) if name in self.names else default

    def std(self, name: str) -> float:
        """Standard deviation of one parameter, widening included; 0 for one that is not estimated."""
        if name not in self.names:
            return 0.0
        i = self.names.index(name)
        variance = self.covariance[i, i] + (0.0 if self.student is None else self.student[i, i])
        return float(np.sqrt(max(variance, 0.0)))

    @property
    def estimated(self) -> int:
        """How many of them the poses were asked for: all but what was taken for known."""
        return sum(name not in SHARED_NAMES for name in self.names)

    def unit(self, name: str) -> str:
        return UNITS.get(name.partition("_")[0], "rad")

    def block(self, names: tuple[str, ...]) -> Array:
        """Values of `names`, zero where absent."""
        return np.array([self.get(name) for name in names])

    def to_dict(self) -> dict[str, Any]:
        out: dict[str, Any] = {
            "names": list(self.names),
            "units": [self.unit(name) for name in self.names],
            "values": self.values.tolist(),
            "covariance": self.covariance.tolist(),
        }
        return out if self.student is None else out | {"student": self.student.tolist()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Parameters:
        student = data.get("student")
        return cls(
            tuple(data["names"]),
            np.array(data["values"], dtype=float),
            np.array(data["covariance"], dtype=float),
            None if student is None else np.array(student, dtype=float),
        )


@dataclass(frozen=True, slots=True)
class TemperatureRange:
    """Temperatures visited. Reduced temperature is `u = (T - ref_c) / scale_c`."""

    ref_c: float
    scale_c: float
    min_c: float
    max_c: float

    def reduced(self, temp_c: float) -> float:
        return (temp_c - self.ref_c) / self.scale_c

    def inside(self, temp_c: float) -> bool:
        return self.min_c <= temp_c <= self.max_c


@dataclass(frozen=True, slots=True)
class Zone:
    """One sensor model and where it holds.

    `inc_center_rad` is the inclination of a local correction (None for a global one); `inc_min_rad`, `inc_max_rad` the
    range in which it may be used. `parameters` hold the sensor's and, where estimated together, the bench's.
    `condition` is the condition number of the problem that gave them.
    """

    name: str
    inc_center_rad: float | None
    inc_min_rad: float
    inc_max_rad: float
    parameters: Parameters
    condition: float
    temperature: TemperatureRange | None = None

    @property
    def is_local(self) -> bool:
        return self.inc_center_rad is not None

    def holds_at(self, inc_rad: float) -> bool:
        return self.inc_min_rad <= inc_rad <= self.inc_max_rad

    def model(self, temp_c: float | None = None) -> SensorModel:
        """The sensor at a temperature. Outside of the range visited the polynomial goes on along its tangent at the
        edge, and `temperature_covariance` grows. Without polynomials, or without a temperature, that at the
        reference."""
        p = self.parameters

        def block(names: tuple[str, ...], shape: tuple[int, ...]) -> Array:
            values = p.block(names)
            for power, weight in self._temperature_weights(temp_c):
                values = values + weight * p.block(tuple(f"{name}@{power}" for name in names))
            return values.reshape(shape)

        return replace(sensor_of(p.names, p.values), A=block(MATRIX_NAMES, (3, 3)), b=block(OFFSET_NAMES, (3,)))

    def max_power(self) -> int:
        """Highest power of temperature among the parameters."""
        return max((int(name.partition("@")[2] or 0) for name in self.parameters.names), default=0)

    def _temperature_weights(self, temp_c: float | None) -> list[tuple[int, float]]:
        powers = range(1, self.max_power() + 1)
        if self.temperature is None or temp_c is None or not powers:
            return []
        u, edge = self.temperature.reduced(temp_c), self.temperature.reduced(self._clamped(temp_c))
        return [(k, edge**k + k * edge ** (k - 1) * (u - edge)) for k in powers]

    def _clamped(self, temp_c: float) -> float:
        assert self.temperature is not None
        return min(max(temp_c, self.temperature.min_c), self.temperature.max_c)

    def design(self, g: Array, temp_c: float | None = None) -> Array:
        """Derivative (3, P, N) of a reading at gravity `g` (3, N) by the parameters; zero columns for the bench's."""
        out = sensor_columns(self.parameters.names, g).transpose(1, 0, 2)
        if self.max_power():
            weights = dict(self._temperature_weights(temp_c))
            powers = [name.partition("@")[2] for name in self.parameters.names]
            out = out * np.array([weights.get(int(power), 0.0) if power else 1.0 for power in powers])[:, None]
        return out

    def covariance_of(self, g: Array, temp_c: float | None = None) -> Array:
        """Covariance (3, 3) in g^2 of the corrected vector `g` (3,) by the errors of the calibration alone.

        For `g` (3, N): (N, 3, 3). Outside of the range of temperature the change beyond its edge is itself taken as one
        standard deviation."""
        wide = np.atleast_2d(np.asarray(g, dtype=float).T).T.reshape(3, -1)
        C = self.model(temp_c).C
        J = np.einsum("ij,jpn->nip", C, self.design(wide, temp_c))
        cov = self.stated_covariance(J, wide, temp_c)
        return np.asarray(cov[0] if np.ndim(g) == 1 else cov)

    def stated_covariance(self, J: Array, g: Array, temp_c: float | None, rest: Array | float = 0.0) -> Array:
        """Covariance (N, 3, 3) in g^2 of corrected vectors `g` (3, N) that `J` (N, 3, P) makes of the errors of the
        parameters, and of errors of their own with covariance `rest`: the reading's noise."""
        p, across = self.parameters, J.transpose(0, 2, 1)
        cov = J @ p.covariance @ across
        beyond = self._beyond_temperature(g, temp_c)
        if beyond is not None:
            cov = cov + np.einsum("in,jn->nij", beyond, beyond)
        return with_widening(cov, None if p.student is None else J @ p.student @ across, rest)

    def _beyond_temperature(self, g: Array, temp_c: float | None) -> Array | None:
        if self.temperature is None or temp_c is None or self.temperature.inside(temp_c) or not self.max_power():
            return None
        edge = self.model(self._clamped(temp_c))
        return np.asarray(edge.C @ (self.model(temp_c).forward(g) - edge.forward(g)))

    def outside_error(self, inc_rad: Array | float, common_g: float) -> Array:
        """Size (g) of what an error `common_g` common to the poses of a local zone leaves at inclination `inc_rad`:
        `d (1 - cos I / cos Ic)`. Zero for a global zone, which estimates the offset itself."""
        if self.inc_center_rad is None:
            return np.zeros_like(np.asarray(inc_rad, dtype=float))
        return np.asarray(common_g * np.abs(1.0 - np.cos(inc_rad) / np.cos(self.inc_center_rad)))

    def to_dict(self) -> dict[str, Any]:
        t = self.temperature
        return {
            "name": self.name,
            "inc_center_rad": self.inc_center_rad,
            "inc_min_rad": self.inc_min_rad,
            "inc_max_rad": self.inc_max_rad,
            "parameters": self.parameters.to_dict(),
            "condition": self.condition,
            "temperature": None
            if t is None
            else {"ref_c": t.ref_c, "scale_c": t.scale_c, "min_c": t.min_c, "max_c": t.max_c},
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Zone:
        t = data.get("temperature")
        return cls(
            name=data["name"],
            inc_center_rad=data["inc_center_rad"],
            inc_min_rad=data["inc_min_rad"],
            inc_max_rad=data["inc_max_rad"],
            parameters=Parameters.from_dict(data["parameters"]),
            condition=data["condition"],
            temperature=None if t is None else TemperatureRange(**t),
        )


@dataclass(frozen=True, slots=True)
class Closure:
    """The closure `S1 - S2 + S3 - S4` of the four poses of a ring, which an affine sensor on a perfect rig makes zero.

    `value` (3,) and `covariance` (3, 3) in g and g^2 (reading noise and the bench's pose repeatability), `chi2` its
    squared length in units of that covariance (3 degrees of freedom), `p` the probability of a larger one,
    `worst_pose` the pose to measure again if it is too large ("" where the ring itself cannot tell).
    """

    inc_rad: float
    value: Array
    covariance: Array
    chi2: float
    p: float
    poses: tuple[str, ...]
    worst_pose: str = ""

    def to_dict(self) -> dict[str, Any]:
        return {
            "inc_rad": self.inc_rad,
            "value": self.value.tolist(),
            "covariance": self.covariance.tolist(),
            "chi2": self.chi2,
            "p": self.p,
            "poses": list(self.poses),
            "worst_pose": self.worst_pose,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Closure:
        return cls(
            inc_rad=data["inc_rad"],
            value=np.array(data["value"], dtype=float),
            covariance=np.array(data["covariance"], dtype=float),
            chi2=data["chi2"],
            p=data["p"],
            poses=tuple(data["poses"]),
            worst_pose=data["worst_pose"],
        )


@dataclass(frozen=True, slots=True)
class PoseFit:
    """How the N poses fit: `residual_g` (3, N), `studentised` (N,): how many standard deviations a pose lies from what
    the others predict (0 where the method has no redundancy), `used` (N,)."""

    ids: tuple[str, ...]
    residual_g: Array
    studentised: Array
    used: NDArray[np.bool_]

    def to_dict(self) -> dict[str, Any]:
        return {
            "ids": list(self.ids),
            "residual_g": self.residual_g.tolist(),
            "studentised": self.studentised.tolist(),
            "used": self.used.tolist(),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> PoseFit:
        return cls(
            ids=tuple(data["ids"]),
            residual_g=np.array(data["residual_g"], dtype=float).reshape(3, -1),
            studentised=np.array(data["studentised"], dtype=float),
            used=np.array(data["used"], dtype=bool),
        )


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """A calibration, whichever method made it.

    `method`: the name of the method, "least-squares" or "magnitude". `options`: how it was run. `frame`:
    what the corrected vector is referred to, "gravity" (the bench's tilt was estimated) or "bench" (the bench was
    taken as level; its tilt is then in the stated uncertainty if its size was stated). `zones`: see `Zone`.
    `variance`: standard deviations of the error components (`reading_g` of one reading; `pose_inc_rad`, `pose_tf_rad`,
    `ring_inc_rad`, `station_tf_rad`). `toolface_zero_rad`, `toolface_zero_std_rad`: the chuck's toolface zero, a
    convention that no pose can reveal, kept apart.
    """

    method: str
    options: Mapping[str, str | float | bool]
    frame: str
    zones: tuple[Zone, ...]
    poses: PoseFit
    closures: tuple[Closure, ...] = ()
    variance: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[Remark, ...] = ()
    toolface_zero_rad: float = 0.0
    toolface_zero_std_rad: float = 0.0

    @property
    def refused(self) -> bool:
        """Whether a part of the input was refused (a ring, a pose): the result stands, but scripts must see it."""
        return any(remark.refused for remark in self.remarks)

    @property
    def main(self) -> Zone:
        """The global zone, or the first one."""
        return next((zone for zone in self.zones if not zone.is_local), self.zones[0])

    @property
    def A(self) -> Array:  # noqa: N802
        return self.main.model().A

    @property
    def b(self) -> Array:
        return self.main.model().b

    @property
    def C(self) -> Array:  # noqa: N802
        return self.main.model().C

    @property
    def tilt_rad(self) -> tuple[float, float]:
        """Bench tilt (in the plane of inclination, across it); zero where not estimated."""
        p = self.main.parameters
        return p.get("tilt_x"), p.get("tilt_y")

    @property
    def reading_noise_g(self) -> float:
        """Standard deviation of one reading (mean of the three axes)."""
        return float(self.variance.get("reading_g", DEFAULT_NOISE_G))

    def zone_at(self, inc_rad: float) -> Zone | None:
        """The zone to use at an inclination: the local one nearest in the sine among those that hold there, else the
        global one, else None (a local matrix is never extrapolated)."""
        local = [zone for zone in self.zones if zone.inc_center_rad is not None and zone.holds_at(inc_rad)]
        if local:
            return min(local, key=lambda z: abs(np.sin(inc_rad) - np.sin(z.inc_center_rad or 0.0)))
        return next((zone for zone in self.zones if not zone.is_local and zone.holds_at(inc_rad)), None)

    def correct(self, a: Array, temp_c: float | None = None, zone: Zone | None = None) -> Array:
        """Gravity in the tool frame (3,) or (3, N) from raw readings, with one zone (the main one if not named).

        Choosing and blending zones reading by reading is the schedule's work."""
        return (zone or self.main).model(temp_c).correct(np.asarray(a, dtype=float))

    def covariance_of(self, g: Array, temp_c: float | None = None, zone: Zone | None = None) -> Array:
        """Covariance (3, 3) in g^2 of a corrected vector `g` (3,) due to the calibration; (N, 3, 3) for (3, N)."""
        return (zone or self.main).covariance_of(g, temp_c)

    def predict_std(
        self,
        inc_rad: Array | float,
        tf_rad: Array | float,
        noise_g: Array | float | None = None,
        *,
        zone: Zone | None = None,
        temp_c: float | None = None,
        frame: str = "gravity",
    ) -> tuple[Array, Array]:
        """Standard deviations (rad) of I and T of readings with noise `noise_g` (one, or one each; the record's own if
        None; 0 for the calibration's part alone). In the bench's frame the errors of the estimated tilt count with
        their correlation."""
        inc, tf = np.broadcast_arrays(np.atleast_1d(np.asarray(inc_rad, dtype=float)), np.asarray(tf_rad, dtype=float))
        use = zone or self.main
        g = gravity_direction(inc, tf)
        C = use.model(temp_c).C
        noise = self.reading_noise_g if noise_g is None else noise_g
        J = np.einsum("ij,jpn->nip", C, use.design(g, temp_c))
        if frame == "bench":
            # bench I = I - tx, bench T = T - ty / sin I: the tilt's error adds to that of the vector, sign included
            radial = np.stack([np.cos(inc) * np.cos(tf), np.cos(inc) * np.sin(tf), -np.sin(inc)])
            across = np.stack([-np.sin(tf), np.cos(tf), np.zeros_like(tf)])
            for name, direction in zip(TILT_NAMES, (radial, across), strict=True):
                if name in use.parameters:
                    J[:, :, use.parameters.names.index(name)] += direction.T
        own = np.square(np.broadcast_to(noise, inc.shape))[:, None, None] * (C @ C.T)
        std_inc, std_tf = angle_std(inc, tf, use.stated_covariance(J, g, temp_c, own))
        if self.toolface_zero_std_rad:
            std_tf = np.minimum(np.hypot(std_tf, self.toolface_zero_std_rad), UNIFORM_ANGLE_STD_RAD)
        return std_inc, std_tf

    def to_bench_frame(self, inc_rad: Array, tf_rad: Array) -> tuple[Array, Array]:
        """I and T as the bench reads them: `I - tx`, `T - ty / sin I`."""
        tx, ty = self.tilt_rad
        with np.errstate(divide="ignore", invalid="ignore"):
            shift = np.where(np.sin(inc_rad) > 0, ty / np.sin(inc_rad), 0.0)
        return inc_rad - tx, tf_rad - shift

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; every float comes back exactly."""
        return {
            "method": self.method,
            "options": dict(self.options),
            "frame": self.frame,
            "zones": [zone.to_dict() for zone in self.zones],
            "poses": self.poses.to_dict(),
            "closures": [closure.to_dict() for closure in self.closures],
            "variance": dict(self.variance),
            "remarks": [
                {"reason": r.reason.value, "text": r.text, "poses": list(r.poses), "refused": r.refused}
                for r in self.remarks
            ],
            "toolface_zero_rad": self.toolface_zero_rad,
            "toolface_zero_std_rad": self.toolface_zero_std_rad,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> CalibrationResult:
        return cls(
            method=data["method"],
            options=dict(data["options"]),
            frame=data["frame"],
            zones=tuple(Zone.from_dict(zone) for zone in data["zones"]),
            poses=PoseFit.from_dict(data["poses"]),
            closures=tuple(Closure.from_dict(closure) for closure in data["closures"]),
            variance=dict(data["variance"]),
            remarks=tuple(
                Remark(Reason(r["reason"]), r["text"], tuple(r["poses"]), r["refused"]) for r in data["remarks"]
            ),
            toolface_zero_rad=data["toolface_zero_rad"],
            toolface_zero_std_rad=data["toolface_zero_std_rad"],
        )


def angle_std(inc_rad: Array, tf_rad: Array, cov: Array) -> tuple[Array, Array]:
    """Standard deviations (N,) of I and T (rad) from covariances `cov` (N, 3, 3) of the gravity vector (equation 3).

    At I = 0 toolface is undefined: its standard deviation goes to that of a uniform angle and never beyond it.
    """
    ci, si, ct, st = np.cos(inc_rad), np.sin(inc_rad), np.cos(tf_rad), np.sin(tf_rad)
    radial = np.stack([ci * ct, ci * st, -si], axis=-1)
    across = np.stack([-st, ct, np.zeros_like(st)], axis=-1)
    var_inc = np.einsum("ni,nij,nj->n", radial, cov, radial)
    var_across = np.einsum("ni,nij,nj->n", across, cov, across)
    with np.errstate(divide="ignore"):
        std_tf = np.sqrt(np.maximum(var_across, 0.0)) / np.abs(si)
    return np.sqrt(np.maximum(var_inc, 0.0)), np.minimum(np.where(si == 0, np.inf, std_tf), UNIFORM_ANGLE_STD_RAD)


@dataclass(frozen=True, slots=True)
class BenchAccuracy:
    """What is known beforehand about a bench (one standard deviation each).

    `tilt_rad`: of each of the two tilts; `pose_rad`: of one setting of inclination or toolface (a step of 0.018 deg,
    rounded, gives 0.0052 deg).
    """

    tilt_rad: float = float(np.deg2rad(0.05))
    pose_rad: float = float(np.deg2rad(0.0052))


NOMINAL_BENCH = BenchAccuracy()


def linear_covariance(
    weights: Array,
    A: Array,
    poses: PoseSet,
    bench: BenchAccuracy,
    offset_std_g: float,
    offset_weights: Array | None = None,
) -> Array:
    """Covariance of the errors of (A row by row, b) and of what is taken for zero, for an estimator that is linear in
    the pose means: (14, 14) with the bench's tilt, (17, 17) with the unknown part of the offset too (`SHARED_NAMES`).

    `A_hat = S weights` with `weights` (N, 3); where the offset is estimated too, `b_hat = S offset_weights` (N,), else
    it is taken as known with standard deviation `offset_std_g` in each axis, the same offset that stands in every
    column of S. Errors of S: reading noise, pose repeatability, the bench's tilt (common to all poses).
    """
    inc, tf = poses.reference()
    by_inc, by_tf = (A @ d for d in gravity_jacobians(inc, tf))
    tilt = library.get("base_tilt")
    level = ForwardModel(((tilt, tilt.vector()),)).linearise(ChainState.build(inc, tf))
    # lever of an error at each pose on the 12 parameters, for one axis: (N, 4)
    lever = np.column_stack([weights, np.zeros(len(poses)) if offset_weights is None else offset_weights])
    mean_var = poses.noise_of_mean() ** 2
    per_pose = np.einsum("in,jn->nij", by_inc, by_inc) + np.einsum("in,jn->nij", by_tf, by_tf)
    per_pose = per_pose * bench.pose_rad**2
    per_pose[:, range(3), range(3)] += mean_var.T
    # cov[(i,k),(j,l)] = sum_n Sigma_n[i,j] lever[n,k] lever[n,l]
    cov = np.einsum("nij,nk,nl->ikjl", per_pose, lever, lever)
    by_tilt = np.stack([np.einsum("in,nk->ik", direction, lever) for direction in A @ level.columns])
    cov += np.einsum("tik,tjl->ikjl", by_tilt, by_tilt) * bench.tilt_rad**2
    by_shared, sizes = by_tilt, [bench.tilt_rad] * 2
    if offset_weights is None and offset_std_g > 0:
        taken_up = lever.sum(axis=0)  # what the matrix swallows of the offset
        taken_up[3] = -1.0  # and what the model then lacks
        by_offset = np.eye(3)[:, :, None] * taken_up  # of each axis, on its own channel
        cov += np.einsum("tik,tjl->ikjl", by_offset, by_offset) * offset_std_g**2
        by_shared, sizes = np.concatenate([by_tilt, by_offset]), sizes + [offset_std_g] * 3
    flat = cov.reshape(12, 12)
    order = [4 * i + k for i in range(3) for k in range(3)] + [4 * i + 3 for i in range(3)]
    variances = np.square(sizes)
    out = np.zeros((12 + len(sizes), 12 + len(sizes)))
    out[:12, :12] = flat[np.ix_(order, order)]
    out[12:, 12:] = np.diag(variances)
    out[12:, :12] = by_shared.reshape(len(sizes), 12)[:, order] * variances[:, None]
    out[:12, 12:] = out[12:, :12].T
    return out


def linear_parameters(A: Array, b: Array, covariance: Array) -> Parameters:
    """Parameters of an affine sensor from A (3, 3), b (3,) and their covariance (12, 12), or that of
    `linear_covariance`, with what was taken for zero."""
    unknown = SHARED_NAMES[: len(covariance) - 12]
    values = np.concatenate([A.ravel(), b, np.zeros(len(unknown))])
    return Parameters(MATRIX_NAMES + OFFSET_NAMES + unknown, values, covariance)
