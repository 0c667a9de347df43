"""The readings of a calibration session: a set of still poses, checked once on the way in.

A *pose* (a position of a tumble test) is an interval in which the tool lay still: the mean of its readings, their
number and their scatter. On a bench the turntable gives the reference attitude (`inc_ref_rad`, `tf_ref_rad`); in a hand
session there is none, and only the magnitude of gravity is known.

Gravity in the tool frame at inclination I and toolface T is `physics.gravity.gravity_direction`; a bench that is not
level adds a tilt (`physics.effects.base_tilt`). A negative I is the table turned the other way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.errors import InputError
from highside.units import STANDARD_GRAVITY_MPS2

Indices = NDArray[np.intp]

DEFAULT_NOISE_G = 50e-6
"""Standard deviation assumed for one reading where a pose table states none."""

SAME_SETTING_RAD = float(np.deg2rad(0.02))
"""Settings of a bench closer than this are the same inclination or toolface station; just above the usual step of 0.018
deg."""


SAME_TEMPERATURE_C = 3.0
"""Poses within this of one another belong to one step of an oven cycle."""


def group_settings(values: Array, *, modulo: float | None = None, tolerance: float = SAME_SETTING_RAD) -> Indices:
    """Number the distinct settings among `values` (N,): equal numbers for neighbours within `tolerance`.

    `modulo` folds the values first (2 pi for toolfaces).
    """
    row = np.asarray(values, dtype=float)
    if modulo is not None:
        row = np.mod(row + tolerance, modulo)
    order = np.argsort(row, kind="stable")
    steps = np.diff(row[order]) > tolerance
    groups = np.empty(row.size, dtype=np.intp)
    groups[order] = np.concatenate([[0], np.cumsum(steps)]) if row.size else 0
    return groups


@dataclass(frozen=True, slots=True)
class PoseSet:
    """N poses.

    `a` (3, N): raw means in nominal g. `n` (N,): readings averaged. `std` (3, N): standard deviation of one reading in
    g, `std_known` whether it was measured (else `DEFAULT_NOISE_G` stands in and the solver scales it). `inc_ref_rad`,
    `tf_ref_rad` (N,): the bench's settings, None in a session where only |g| is known; inclination may be negative
    (the table turned the other way) or beyond 90 deg. `temp_c` (N,), `direction` (N,; +1 or -1, the side from which the
    pose was approached): None where not recorded. `ids`: one name a pose, for messages.
    """

    a: Array
    n: Array
    std: Array
    ids: tuple[str, ...]
    inc_ref_rad: Array | None = None
    tf_ref_rad: Array | None = None
    temp_c: Array | None = None
    direction: Array | None = None
    std_known: bool = True

    @classmethod
    def build(
        cls,
        a: Array,
        *,
        inc_ref_rad: Array | None = None,
        tf_ref_rad: Array | None = None,
        n: Array | float | None = None,
        std: Array | float | None = None,
        temp_c: Array | None = None,
        direction: Array | None = None,
        ids: Sequence[str] | None = None,
        where: str | None = None,
    ) -> PoseSet:
        """Check and collect. `std` may be one number, (3,) or (3, N). Raises InputError, naming what is wrong.

        `where` names the file for messages.
        """
        a = np.ascontiguousarray(np.asarray(a, dtype=float))
        if a.ndim != 2 or a.shape[0] != 3:
            raise InputError(f"raw means must have the shape (3, N), not {a.shape}", where=where)
        count = a.shape[1]
        if count == 0:
            raise InputError("no poses", where=where, remedy="give one row a pose")
        names = tuple(str(i) for i in ids) if ids is not None else tuple(str(i + 1) for i in range(count))
        if len(names) != count:
            raise InputError(f"{len(names)} names for {count} poses", where=where)
        for axis, row in zip("xyz", a, strict=True):
            _require_finite(row, f"a{axis}", names, where)
        _require_plausible_g(a, names, where)
        if (inc_ref_rad is None) != (tf_ref_rad is None):
            raise InputError(
                "only one of inc_ref_deg and tf_ref_deg is given",
                where=where,
                remedy="give both, or neither for |g| alone",
            )
        inc = _vector(inc_ref_rad, count, "inc_ref_deg", names, where)
        tf = _vector(tf_ref_rad, count, "tf_ref_deg", names, where)
        if inc is not None:
            _require_inclination(inc, names, where)
        counts = _vector(np.full(count, float(n)) if np.isscalar(n) else n, count, "n", names, where)  # type: ignore[arg-type]
        if counts is None:
            counts = np.ones(count)
        if np.any(counts < 1):
            bad = int(np.argmin(counts))
            raise InputError(
                f"{counts[bad]:g} readings in pose {names[bad]}", where=where, field="n", remedy="n is at least 1"
            )
        return cls(
            a=a,
            n=counts,
            std=_scatter(std, count, names, where),
            ids=names,
            inc_ref_rad=inc,
            tf_ref_rad=tf,
            temp_c=_vector(temp_c, count, "temp_c", names, where),
            direction=_vector(direction, count, "direction", names, where),
            std_known=std is not None,
        )

    @classmethod
    def from_columns(
        cls, columns: Mapping[str, Array | Sequence[str]], *, where: str | None = None, reference: str = "pose"
    ) -> PoseSet:
        """From the columns of a pose table (degrees, g). Raises InputError naming the column that lacks or is wrong.

        `reference` "pose" requires `inc_ref_deg, tf_ref_deg`; "magnitude" leaves them aside.
        """
        needed = ["ax", "ay", "az"] + (["inc_ref_deg", "tf_ref_deg"] if reference == "pose" else [])
        missing = [name for name in needed if name not in columns]
        if missing:
            raise InputError(
                f"missing column{'s' if len(missing) > 1 else ''} {', '.join(missing)}",
                where=where,
                remedy='a pose table has inc_ref_deg, tf_ref_deg, ax, ay, az (or use reference="magnitude")'
                if reference == "pose"
                else "a pose table has ax, ay, az",
            )
        stds = [name for name in ("std_ax", "std_ay", "std_az") if name in columns]
        if stds and len(stds) < 3:
            raise InputError(
                f"only {', '.join(stds)} of std_ax, std_ay, std_az given", where=where, remedy="give all three, or none"
            )

        def numbers(name: str) -> Array | None:
            return np.asarray(columns[name], dtype=float) if name in columns else None

        def radians(name: str) -> Array | None:
            values = numbers(name) if reference == "pose" else None
            return None if values is None else np.deg2rad(values)

        poses = cls.build(
            np.stack([np.asarray(columns[name], dtype=float) for name in ("ax", "ay", "az")]),
            inc_ref_rad=radians("inc_ref_deg"),
            tf_ref_rad=radians("tf_ref_deg"),
            n=numbers("n"),
            std=np.stack([np.asarray(columns[name], dtype=float) for name in stds]) if stds else None,
            temp_c=numbers("temp_c"),
            direction=numbers("direction"),
            ids=[str(name) for name in columns["pose"]] if "pose" in columns else None,
            where=where,
        )
        poses.require_distinct(where)
        return poses

    def __len__(self) -> int:
        return int(self.a.shape[1])

    @property
    def has_reference(self) -> bool:
        """Whether the bench said where the tool was."""
        return self.inc_ref_rad is not None

    def reference(self) -> tuple[Array, Array]:
        """Inclination and toolface (N,) set by the bench. Raises InputError in a session without."""
        if self.inc_ref_rad is None or self.tf_ref_rad is None:
            raise InputError("the poses have no reference attitude", remedy='use reference="magnitude"')
        return self.inc_ref_rad, self.tf_ref_rad

    def noise_of_one(self) -> Array:
        """Standard deviation of one reading (3, N), pooled over the session.

        The scatter of ten readings is itself uncertain by a quarter, so each axis takes the pooled value; a pose that
        is clearly rougher than the pool (vibration, a bumped table) keeps its own.
        """
        dof = np.maximum(self.n - 1.0, 0.25)
        # median first, so that one rough pose does not raise the pool it is compared with
        typical = np.median(self.std, axis=1, keepdims=True)
        calm = self.std <= typical * (1.0 + 5.0 / np.sqrt(2.0 * np.maximum(dof, 1.0)))
        weights = np.where(calm, dof, 0.0)
        pooled = np.sqrt((weights * self.std**2).sum(axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True))
        floor = np.where(pooled > 0, pooled, 1e-9)
        return np.where(calm, floor, self.std)

    def noise_of_mean(self) -> Array:
        """Standard deviation (3, N) of the mean of each pose by reading noise alone."""
        return np.asarray(self.noise_of_one() / np.sqrt(self.n))

    def subset(self, keep: NDArray[np.bool_] | Indices) -> PoseSet:
        """The poses selected by a mask or by indices."""
        index = np.flatnonzero(keep) if np.asarray(keep).dtype == bool else np.asarray(keep, dtype=np.intp)

        def cut(values: Array | None) -> Array | None:
            return None if values is None else values[index]

        return replace(
            self,
            a=np.ascontiguousarray(self.a[:, index]),
            n=self.n[index],
            std=self.std[:, index],
            ids=tuple(self.ids[i] for i in index),
            inc_ref_rad=cut(self.inc_ref_rad),
            tf_ref_rad=cut(self.tf_ref_rad),
            temp_c=cut(self.temp_c),
            direction=cut(self.direction),
        )

    def inclination_stations(self) -> Indices:
        """Which inclination setting each pose belongs to (N,)."""
        return group_settings(self.reference()[0])

    def toolface_stations(self) -> Indices:
        """Which toolface setting each pose belongs to (N,)."""
        return group_settings(self.reference()[1], modulo=2 * np.pi)

    def _vertical(self, index: int) -> bool:
        return self.inc_ref_rad is not None and abs(float(np.sin(self.inc_ref_rad[index]))) < 1e-9

    def label(self, index: int) -> str:
        """How a message names a pose."""
        if self.inc_ref_rad is None or self.tf_ref_rad is None:
            return f"pose {self.ids[index]}"
        inc, tf = np.rad2deg(self.inc_ref_rad[index]), np.rad2deg(self.tf_ref_rad[index])
        return f"pose {self.ids[index]} (inclination {inc:.3f}, toolface {tf:.3f} deg)"

    def require_distinct(self, where: str | None = None) -> None:
        """Raise InputError if two poses have the very same readings: a row copied, not a pose repeated.

        (A vertical tool without noise, as simulated, does read the same at every toolface.)"""
        first_of: dict[tuple[float, float, float], int] = {}
        for i, (x, y, z) in enumerate(self.a.T.tolist()):
            j = first_of.setdefault((x, y, z), i)
            if j != i and not (self._vertical(i) and self._vertical(j)):
                raise InputError(
                    f"{self.label(j)} and {self.label(i)} are the same reading",
                    where=where,
                    remedy="remove one, or measure again",
                )


def _vector(values: Array | None, count: int, field: str, names: tuple[str, ...], where: str | None) -> Array | None:
    if values is None:
        return None
    row = np.asarray(values, dtype=float)
    if row.shape != (count,):
        raise InputError(f"shape {row.shape} for {count} poses", where=where, field=field)
    _require_finite(row, field, names, where)
    return row


def _scatter(std: Array | float | None, count: int, names: tuple[str, ...], where: str | None) -> Array:
    """Standard deviation (3, N) of one reading, from one number, (3,) or (3, N); as assumed where None."""
    if std is None:
        return np.full((3, count), DEFAULT_NOISE_G)
    given = np.asarray(std, dtype=float)
    scatter = np.array(np.broadcast_to(given[:, None] if given.shape == (3,) else given, (3, count)))
    for axis, row in zip("xyz", scatter, strict=True):
        _require_finite(row, f"std_a{axis}", names, where)
    if np.any(scatter < 0) or np.any(np.mean(scatter, axis=1) <= 0):
        raise InputError(
            "standard deviations must be positive",
            where=where,
            field="std_ax, std_ay, std_az",
            remedy="leave the columns out if they were not measured",
        )
    return scatter


def _require_inclination(inc: Array, names: tuple[str, ...], where: str | None) -> None:
    if np.any(np.abs(inc) > np.pi + 1e-9):
        bad = int(np.argmax(np.abs(inc)))
        raise InputError(
            f"{np.rad2deg(inc[bad]):g} is outside of -180 to 180 deg (pose {names[bad]})",
            where=where,
            field="inc_ref_deg",
        )


def _require_finite(row: Array, field: str, names: tuple[str, ...], where: str | None) -> None:
    bad = np.flatnonzero(~np.isfinite(row))
    if bad.size:
        raise InputError(
            f"not a number in pose {names[int(bad[0])]}", where=where, field=field, remedy="remove or repeat that pose"
        )


def _require_plausible_g(a: Array, names: tuple[str, ...], where: str | None) -> None:
    size = np.linalg.norm(a, axis=0)
    typical = float(np.median(size))
    if 0.5 < typical < 1.5:
        return
    guesses = {"m/s2": STANDARD_GRAVITY_MPS2, "mg": 1e3, "ug": 1e6}
    unit = next((name for name, one in guesses.items() if 0.9 < typical / one < 1.1), None)
    hint = f"looks like {unit}; divide by {guesses[unit]:g}" if unit else "raw counts must be scaled to nominal g first"
    raise InputError(
        f"the magnitude of a still reading is {typical:.6g}, which cannot be g",
        where=where,
        field="ax, ay, az",
        remedy=hint,
    )
