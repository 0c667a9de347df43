"""Corrections by inclination, blended so that inclination and toolface never jump.

A balance correction holds only near its own inclination. The schedule puts several of them side by side, each with a
weight that is one at its own inclination and falls smoothly to zero at that of its neighbour or, if that is nearer,
at the edge of its zone, and fills what is left of the weight with a global correction. Where there is no global one
and no zone holds, there is no answer: a local matrix taken at 0.6 deg multiplies noise by 94 when it is used at
90 deg.

The weights depend on the inclination that *one* correction, the guide, gives to the raw reading (the global one where
there is one). It is continuous in the reading, so are the weights, and so is the blended vector; there is no memory and
hence no hysteresis.

Covariance of the blend of local corrections `z_i` (weights w_i) and the fallback f, all solved from one session:

- what was taken for known in all of them moves them together, each by its own lever: the tilt of a bench taken for
  level, the sensor's offset where it was not observed (between two balance zones it acts with opposite signs). These
  errors add with their signs, `E = sum w e`;
- apart from these the zones share no reading (each is of its own inclination) and are independent of one another, while
  the global solution makes the best of all poses, so that any other solution errs by what f errs by and by something
  uncorrelated with it (Gauss and Markov: `Cov(z, f) = Cov(f)`). Hence `sum w_i^2 R_i + (1 - (sum w_i)^2) R_f` with R
  the covariance without what is shared, sums over the zones;
- without a fallback, `sum w_i^2 R_i`;
- the reading's noise is one and the same in all;
- where the variances behind R_i are estimated, the sum is widened by what they make of it
  (`highside.calibration.student`).

A zone that does not say what it has in common with the others (`SHARED_NAMES` or `TILT_NAMES` among its parameters) may
be correlated with them in any way. Whatever it is, `Cov(sum w x) <= sum w Cov(x)` (as matrices, for weights that sum to
one): then the right side is stated.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude import compiled
from highside.attitude.block import attitude_by, checked, share_out
from highside.calibration.correction import ZERO_COVARIANCE, BlockCorrected, Corrected, Covariance, Vector, refused
from highside.calibration.inclination_windows import InclinationWindow, windows
from highside.calibration.linear_correction import LinearCorrection, carry
from highside.calibration.schedule_blocks import AffineBlocks, affine_matrix, keys_into
from highside.calibration.schedule_loop import WHOLE, key_of, scheduled_loop, window_weight
from highside.calibration.student import UPPER, widening, widening_block
from highside.calibration.zone import SHARED_NAMES, TILT_NAMES
from highside.errors import InputError

Value = TypeVar("Value", Array, float, Array | float, Array | float | None)


@dataclass(frozen=True, slots=True)
class ScheduledCorrection:
    """Local corrections `zones`, a correction `fallback` for everywhere else (None: nothing else), blended.

    `guide` gives the inclination by which the weights are chosen; the fallback where None, else the raw reading.
    """

    zones: tuple[LinearCorrection, ...]
    fallback: LinearCorrection | None = None
    cal_id: str = "none"
    guide: LinearCorrection | None = None
    _guide: LinearCorrection | None = field(init=False, repr=False, compare=False)
    _windows: tuple[InclinationWindow, ...] = field(init=False, repr=False, compare=False)
    _edges: tuple[tuple[float, float, float, float], ...] = field(init=False, repr=False, compare=False)
    _unknown: bool = field(init=False, repr=False, compare=False)
    """whether a part does not say what it has in common with the others"""

    def __post_init__(self) -> None:
        if not self.zones and self.fallback is None:
            raise InputError("a schedule needs at least one correction")
        for part in self.zones:
            zone = part.zone
            if zone.inc_center_rad is None:
                raise InputError(f"zone {zone.name} of a schedule has no inclination of its own")
            if part.guarded or not zone.inc_min_rad <= abs(zone.inc_center_rad) <= zone.inc_max_rad:
                raise InputError(f"zone {zone.name} of a schedule is guarded or does not contain its own inclination")
        ordered = tuple(sorted(self.zones, key=lambda part: abs(part.zone.inc_center_rad or 0.0)))
        object.__setattr__(self, "zones", ordered)
        object.__setattr__(self, "_guide", self.guide or self.fallback)
        object.__setattr__(self, "_windows", windows([part.zone for part in ordered]))
        object.__setattr__(self, "_edges", tuple(window.edges for window in self._windows))
        names = SHARED_NAMES + TILT_NAMES if self.fallback is not None else SHARED_NAMES
        parts = (*ordered, self.fallback) if self.fallback is not None else ordered
        object.__setattr__(self, "_unknown", any(not set(names) & set(part.zone.parameters.names) for part in parts))

    def weights(self, a: Vector, temp_c: float | None = None) -> list[tuple[LinearCorrection, float]]:
        """The corrections that take part at a raw reading, with weights that sum to one; empty where none holds."""
        if self._guide is not None:
            k = self._guide.coefficients(temp_c)
            c, o = k.c, k.o
            x = c[0] * a[0] + c[1] * a[1] + c[2] * a[2] - o[0]
            y = c[3] * a[0] + c[4] * a[1] + c[5] * a[2] - o[1]
            z = c[6] * a[0] + c[7] * a[1] + c[8] * a[2] - o[2]
        else:
            x, y, z = a
        key = key_of(x, y, z)
        pairs = zip(self.zones, self._edges, strict=True)
        parts = [(part, w) for part, edges in pairs if (w := window_weight(key, *edges)) > 0.0]
        total = sum(w for _, w in parts)
        if self.fallback is not None and total < WHOLE:
            return [*parts, (self.fallback, 1.0 - total)]
        return [(part, w / total) for part, w in parts]

    def correct(self, a: Vector, cov: Covariance = ZERO_COVARIANCE, temp_c: float | None = None) -> Corrected:
        parts = self.weights(a, temp_c)
        if len(parts) == 1:
            return parts[0][0].correct(a, cov, temp_c)
        if not parts:
            return refused()
        ones = []
        for part, w in parts:
            one = part.evaluate(a, temp_c)
            if one is None:
                return refused()
            ones.append((part, w, one))
        x = y = z = 0.0
        total = [0.0] * 6
        shared = np.zeros((len(SHARED_NAMES), 3))
        flags: dict[str, None] = {}
        widened = []
        for part, w, one in ones:
            x, y, z = x + w * one.gx, y + w * one.gy, z + w * one.gz
            flags.update(dict.fromkeys(one.flags))
            own = w if self._unknown else 1.0 - (1.0 - w) ** 2 if part is self.fallback else w * w
            calibration = one.calibration
            levers = None if self._unknown else part.coefficients(None).shared
            if levers is not None:
                e = levers @ (one.gx, one.gy, one.gz, 1.0)
                shared += w * e
                both = (e.T @ e).tolist()
                c0, c1, c2, c3, c4, c5 = (value - both[i][j] for value, (i, j) in zip(calibration, UPPER, strict=True))
                calibration = c0, c1, c2, c3, c4, c5
            for i, (value, noise) in enumerate(zip(calibration, carry(part.coefficients(temp_c).c, cov), strict=True)):
                total[i] += own * value + w * noise
            if one.student is not None:
                widened.append((own, one.student, one.calibration))
        both = (shared.T @ shared).tolist()
        t0, t1, t2, t3, t4, t5 = (value + both[i][j] for value, (i, j) in zip(total, UPPER, strict=True))
        stated = t0, t1, t2, t3, t4, t5
        for own, student, calibration in widened:
            more = widening(student, calibration, (t0, t1, t2, t3, t4, t5))
            s0, s1, s2, s3, s4, s5 = (value + own * own * extra for value, extra in zip(stated, more, strict=True))
            stated = s0, s1, s2, s3, s4, s5
        name = " + ".join(part.name for part, _ in parts)
        return Corrected(x, y, z, stated, name, tuple(flags))

    def correct_block(self, a: Array, temp_c: Array | float | None = None) -> Array:
        """Corrected vectors (3, N) from raw readings (3, N); NaN where no correction holds.

        `temp_c`: one temperature, or one a reading (N,).
        """
        out = np.zeros_like(a)
        held = np.zeros(a.shape[1], dtype=bool)
        for part, rows, w in self._shares(a, temp_c):
            out[:, rows] += part.correct_block(a[:, rows], _of_rows(temp_c, rows)) * w
            held[rows] = True
        out[:, ~held] = np.nan
        return out

    def corrected_block(
        self, a: Array, noise_g: Array | float, temp_c: Array | float | None = None, more: Array | None = None
    ) -> BlockCorrected:
        """Correct readings `a` (3, N) whose own standard deviation is `noise_g` (one, or (N,)) in each axis.

        `more` (6, N) g^2: covariance of what was taken off them before.
        """
        count = a.shape[1]
        g, cov, reading = np.zeros_like(a), np.zeros((6, count)), np.zeros((6, count))
        shared = np.zeros((len(SHARED_NAMES), 3, count))
        zone, most = np.full(count, -1, dtype=np.intp), np.zeros(count)
        outside = np.zeros(count, dtype=bool)
        shares = self._shares(a, temp_c)
        widened = []
        for k, (part, rows, w) in enumerate(shares):
            temps = _of_rows(temp_c, rows)
            one = part.correct_block(a[:, rows], temps)
            g[:, rows] += one * w
            reading[:, rows] += part.reading_covariance(temps) * np.square(_of_rows(noise_g, rows)) * w
            if more is not None:
                cov[:, rows] += part.carried_block(more[:, rows], temps) * w
            outside[rows] |= part.temperature_outside(temps, rows.size)
            ahead = w > most[rows]
            zone[rows[ahead]], most[rows[ahead]] = k, w[ahead]
            own = w if self._unknown else 1.0 - (1.0 - w) ** 2 if part is self.fallback else w**2
            calibration, student = part.covariances_block(one, temps)
            levers = None if self._unknown else part.coefficients(None).shared
            if levers is not None:
                e = levers[:, :, :3] @ one + levers[:, :, 3:]
                shared[:, :, rows] += e * w
                cov[:, rows] -= _outer(e) * own
            cov[:, rows] += calibration * own
            if student is not None:
                widened.append((rows, own, student, calibration))
        cov += _outer(shared) + reading
        total = cov.copy()
        for rows, own, student, calibration in widened:
            cov[:, rows] += own**2 * widening_block(student, calibration, total[:, rows])
        g[:, zone < 0] = np.nan
        cov[:, zone < 0] = np.nan
        return BlockCorrected(g, cov, reading, zone, tuple(part.name for part, _, _ in shares), outside)

    def _shares(self, a: Array, temp_c: Array | float | None) -> list[tuple[LinearCorrection, NDArray[np.intp], Array]]:
        """Each correction with the readings (rows) that it takes part in, and its weight there."""
        guided = a if self._guide is None else self._guide.correct_block(a, temp_c)
        key = np.empty(a.shape[1])
        keys_into(guided, key, np.empty_like(key))
        parts: list[LinearCorrection] = list(self.zones)
        weights = [window.weights(key) for window in self._windows]
        total = np.sum(weights, axis=0) if weights else np.zeros_like(key)
        if self.fallback is not None:
            parts.append(self.fallback)
            weights.append(np.where(total < WHOLE, 1.0 - total, 0.0))
            total = np.maximum(total, 1.0)
        out = []
        for part, w in zip(parts, weights, strict=True):
            rows = np.flatnonzero(w > 0.0)
            if rows.size:
                out.append((part, rows, w[rows] / total[rows]))
        return out

    def attitude(
        self,
        a: Array,
        temp_c: Array | float | None = None,
        out_inc: Array | None = None,
        out_tf: Array | None = None,
        *,
        degrees: bool = False,
        threads: int | None = None,
    ) -> tuple[Array, Array]:
        """Inclination and toolface (N,) of raw readings `a` (3, N) in bulk, in rad or degrees; NaN where no correction
        holds.

        Readings are taken in blocks that stay in the cache; a block asks only for the corrections that its range of
        inclination needs, so that a log (whose inclination changes slowly) costs little more than one correction. Where
        numba is installed, millions of readings through affine corrections are done by `scheduled_loop`, compiled.
        """
        a, (inc, tf) = checked(a, (out_inc, out_tf))
        if self._is_affine and compiled.wanted(a.shape[1]):
            loop = compiled.compiled(scheduled_loop)
            rows, tables, unit = tuple(a), self._tables(), 180.0 / math.pi if degrees else 1.0
            share_out(lambda start, stop: loop(rows, *tables, unit, start, stop, inc, tf), a.shape[1], threads)
            return inc, tf

        def prepare() -> Callable[[int, int, Array], None]:
            if self._is_affine:
                filler = AffineBlocks(a, self._windows, self.zones, self.fallback, self._guide)
                return filler.fill

            def fill(low: int, high: int, out: Array) -> None:
                out[:] = self.correct_block(a[:, low:high], _of_rows(temp_c, np.arange(low, high)))

            return fill

        return attitude_by(prepare, a.shape[1], inc, tf, degrees=degrees, threads=threads)

    @property
    def _is_affine(self) -> bool:
        """Whether vectors depend on nothing but the reading, in first order: no temperature, no nonlinear terms."""
        parts = [part for part in (*self.zones, self.fallback, self._guide) if part is not None]
        return all(part.is_affine for part in parts)

    def _tables(self) -> tuple[Array, Array, Array, Array, Array, bool]:
        """What `scheduled_loop` wants: matrices, windows, centres, guide, fallback, and whether there is one."""
        none, never = np.zeros((3, 4)), (math.inf, -math.inf, 1.0, 1.0)
        return (
            np.vstack([none, *(affine_matrix(part) for part in self.zones), none]),
            np.array([never, *self._edges, never]),
            np.array([w.center for w in self._windows]),
            np.eye(3, 4) if self._guide is None else affine_matrix(self._guide),
            none if self.fallback is None else affine_matrix(self.fallback),
            self.fallback is not None,
        )


def _outer(e: Array) -> Array:
    """Covariance (6, N) of errors `e` (K, 3, N) of K independent sources."""
    return np.stack([np.sum(e[:, j] * e[:, k], axis=0) for j, k in UPPER])


def _of_rows(value: Value, rows: NDArray[np.intp]) -> Value:
    """A value a reading, of some readings; one value for all stays as it is."""
    return value[rows] if isinstance(value, np.ndarray) and value.ndim else value
