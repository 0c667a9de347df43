"""What every calibration method returns: zones, the fit of the poses, closures and remarks.

A joint or conventional calibration has one zone named "global" (`highside.calibration.zone`), a balance calibration one
for each inclination.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude.scalar import UNIFORM_ANGLE_STD_RAD
from highside.calibration.poses import DEFAULT_NOISE_G
from highside.calibration.remark import Reason, Remark
from highside.calibration.zone import TILT_NAMES, Zone
from highside.physics.gravity import gravity_direction

_FORMER_VARIANCES = {"ring_inc_rad": "station_inc_rad"}
"""names of variances in older records, and those of today"""


@dataclass(frozen=True, slots=True)
class Closure:
    """The closure `S1 - S2 + S3 - S4` of the four poses of an inclination, which an affine sensor on a perfect rig
    makes zero.

    `value` (3,) and `covariance` (3, 3) in g and g^2 (reading noise and the bench's pose repeatability), `chi2` its
    squared length in units of that covariance (3 degrees of freedom), `p` the probability of a larger one,
    `worst_pose` the pose to measure again if it is too large ("" where the inclination itself cannot tell).
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
    `station_inc_rad`, `station_tf_rad`). `toolface_zero_rad`, `toolface_zero_std_rad`: the chuck's toolface zero, a
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
        """Whether a part of the input was refused (an inclination, a pose): the result stands, but scripts must see
        it."""
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
            variance={_FORMER_VARIANCES.get(name, name): value for name, value in data["variance"].items()},
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
