"""Samples gathered into blocks of a second: the relative rotation, what a bias does to it, and the mean gravity.

Within a block the gyro rates are composed exactly, d = exp(w dt) for each sample. Three things are carried into the
newest body frame as the block grows:

    q  relative rotation from the start of the block
    J  (3 x 3) the angle by which a unit bias turns the end of the block:  J <- D (J + dt/2 I) + dt/2 I
    S  (3)     the same for a unit scale-factor error of the gyro along the tool axis
    A  (3)     the sum of the accelerometer readings, so that a turning tool does not smear gravity

with D = Cnb(d). A bias b, a scale error s and the Earth's rotation then act on the finished block at once, to second
order in (b * 1 s): q_end = exp(-w_ie t) (x) q_start (x) q (x) exp(-J b - S s). For a constant rate J is the closed
(Rodrigues) transition matrix of the error state; here it follows any motion.

`advance` is plain arithmetic and nothing else. Given floats it is the online form (one sample of one block), given
arrays it works on one sample of *all* blocks at once: the batch form. IEEE arithmetic makes both give the same bits.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array

Sums = tuple[Any, ...]
"""q (4), J (9, by rows), S (3), A (3), then: dt, n, |a|-1, (|a|-1)^2, |a|^2, w (3), w^2 (3), squared steps of w, the
largest of them"""

EMPTY: Sums = (1.0,) + (0.0,) * 31
SUMS = 32
MAX_GAP_S = 0.5
"""A longer hole between two rows is not integrated over: what the tool did in it is not known."""


def advance(
    sums: Sums, dt: Any, w: tuple[Any, Any, Any], a: tuple[Any, Any, Any], norm: Any, rough: Any, one: Any
) -> Sums:
    """One more sample: rate w (rad/s) held over the dt (s) that end with it, reading a (g) of length `norm`.

    `rough` is the squared difference of w from the sample before; `one` is 1, or 0 where the block has no such sample.
    """
    (q0, q1, q2, q3, j00, j01, j02, j10, j11, j12, j20, j21, j22, s0, s1, s2, a0, a1, a2,
     time, n, e1, e2, f2, w0, w1, w2, v0, v1, v2, r, top) = sums  # fmt: skip
    x, y, z = w
    k = 0.5 * dt
    hx, hy, hz = k * x, k * y, k * z
    c, s = cos_and_sinc(hx * hx + hy * hy + hz * hz)
    ux, uy, uz = s * hx, s * hy, s * hz
    xx, yy, zz = ux * ux, uy * uy, uz * uz
    xy, xz, yz = ux * uy, ux * uz, uy * uz
    cx, cy, cz = c * ux, c * uy, c * uz
    d00, d01, d02 = 1.0 - 2.0 * (yy + zz), 2.0 * (xy + cz), 2.0 * (xz - cy)
    d10, d11, d12 = 2.0 * (xy - cz), 1.0 - 2.0 * (xx + zz), 2.0 * (yz + cx)
    d20, d21, d22 = 2.0 * (xz + cy), 2.0 * (yz - cx), 1.0 - 2.0 * (xx + yy)
    b00, b11, b22 = j00 + k, j11 + k, j22 + k
    t1 = s1 + hy
    ax, ay, az = a
    e = one * (norm - 1.0)
    return (
        q0 * c - q1 * ux - q2 * uy - q3 * uz,
        q0 * ux + q1 * c + q2 * uz - q3 * uy,
        q0 * uy - q1 * uz + q2 * c + q3 * ux,
        q0 * uz + q1 * uy - q2 * ux + q3 * c,
        d00 * b00 + d01 * j10 + d02 * j20 + k,
        d00 * j01 + d01 * b11 + d02 * j21,
        d00 * j02 + d01 * j12 + d02 * b22,
        d10 * b00 + d11 * j10 + d12 * j20,
        d10 * j01 + d11 * b11 + d12 * j21 + k,
        d10 * j02 + d11 * j12 + d12 * b22,
        d20 * b00 + d21 * j10 + d22 * j20,
        d20 * j01 + d21 * b11 + d22 * j21,
        d20 * j02 + d21 * j12 + d22 * b22 + k,
        d00 * s0 + d01 * t1 + d02 * s2,
        d10 * s0 + d11 * t1 + d12 * s2 + hy,
        d20 * s0 + d21 * t1 + d22 * s2,
        d00 * a0 + d01 * a1 + d02 * a2 + one * ax,
        d10 * a0 + d11 * a1 + d12 * a2 + one * ay,
        d20 * a0 + d21 * a1 + d22 * a2 + one * az,
        time + dt,
        n + one,
        e1 + e,
        e2 + e * e,
        f2 + one * (norm * norm),
        w0 + one * x,
        w1 + one * y,
        w2 + one * z,
        v0 + one * (x * x),
        v1 + one * (y * y),
        v2 + one * (z * z),
        r + one * rough,
        # the larger of the two, for numbers and arrays alike
        0.5 * (top + rough + abs(top - rough)),
    )  # fmt: skip


def cos_and_sinc(h: Any) -> tuple[Any, Any]:
    """cos and sin(x) / x as series in h = x^2: the half angle of one sample is small."""
    c = 1.0 - h * (1 / 2 - h * (1 / 24 - h * (1 / 720 - h * (1 / 40320 - h * (1 / 3628800)))))
    s = 1.0 - h * (1 / 6 - h * (1 / 120 - h * (1 / 5040 - h * (1 / 362880 - h * (1 / 39916800)))))
    return c, s


@dataclass(frozen=True, slots=True)
class Block:
    """One finished block in the body frame: (34,) as `finished` lays it out, by name."""

    vector: Array

    @property
    def q(self) -> Array:
        """(4,) relative rotation"""
        return self.vector[:4]

    @property
    def J(self) -> Array:  # noqa: N802 - the letter of the formula
        """(3, 3) what a unit bias turns its end by"""
        return self.vector[4:13].reshape(3, 3)

    @property
    def S(self) -> Array:  # noqa: N802
        """(3,) the same for a unit scale error along the tool axis"""
        return self.vector[13:16]

    @property
    def accel(self) -> Array:
        """(3,) mean reading in the body frame of the end, g"""
        return self.vector[16:19]

    @property
    def seconds(self) -> float:
        return float(self.vector[19])

    @property
    def n(self) -> int:
        return int(self.vector[20])

    @property
    def norm_error(self) -> float:
        """mean of |a| - 1, g"""
        return float(self.vector[21])

    @property
    def norm_std(self) -> float:
        """standard deviation of |a|, g"""
        return float(self.vector[22])

    @property
    def accel_std(self) -> float:
        """standard deviation of one axis of one reading about the (turning) mean, g"""
        return float(self.vector[23])

    @property
    def rate(self) -> Array:
        """(3,) mean rate, rad/s"""
        return self.vector[24:27]

    @property
    def rate_std(self) -> Array:
        """(3,) standard deviation of the rates, motion included, rad/s"""
        return self.vector[27:30]

    @property
    def rate_noise(self) -> float:
        """standard deviation of one rate reading from the differences of neighbours but the largest, so without slow
        motion and a sudden start, rad/s"""
        return float(self.vector[30])

    @property
    def gap_s(self) -> float:
        """unrecorded time that was not integrated"""
        return float(self.vector[31])

    @property
    def start_s(self) -> float:
        return float(self.vector[32])

    @property
    def end_s(self) -> float:
        return float(self.vector[33])


def finished(sums: Array, gap_s: Any, start_s: Any, end_s: Any) -> Array:
    """What the sums (32,) or (32, M) of finished blocks say: (34,) or (34, M), laid out as `Block` names it."""
    n = np.maximum(sums[20], 1.0)
    out = np.empty((34, *sums.shape[1:]))
    out[:16], out[19:21] = sums[:16], sums[19:21]
    accel, rate, mean = sums[16:19] / n, sums[24:27] / n, sums[21] / n
    out[16:19], out[24:27], out[21] = accel, rate, mean
    out[22] = np.sqrt(np.maximum(sums[22] / n - mean * mean, 0.0))
    size2 = accel[0] * accel[0] + accel[1] * accel[1] + accel[2] * accel[2]
    out[23] = np.sqrt(np.maximum(sums[23] / n - size2, 0.0) / 3.0)
    out[27:30] = np.sqrt(np.maximum(sums[27:30] / n - rate * rate, 0.0))
    # a motor that starts is one step, and no noise; 2.2 (1 + ln n) is what the largest of n such squares has on average
    own = np.maximum(n - 2.2 / 3.0 * (1.0 + np.log(n)), 0.5)
    out[30] = np.sqrt(np.maximum(sums[30] - sums[31], 0.0) / own / 6.0)
    out[31], out[32], out[33] = gap_s, start_s, end_s
    return out


class Gatherer:
    """The online form: samples one by one, a `Block` whenever one is finished."""

    def __init__(self, block_s: float = 1.0) -> None:
        self._block_s = block_s
        self._first = math.nan
        self._number = 0
        self._before: tuple[float, float, float, float] | None = None
        self.sums: Sums = EMPTY
        self.gap_s = 0.0
        self._start = self._last = math.nan

    def add(self, t_s: float, w: tuple[float, float, float], a: tuple[float, float, float]) -> Block | None:
        """Take a sample of the body frame (rad/s, g); the block that it closes (itself not in it), if any."""
        done = None
        if self._before is None:
            self._first = self._start = t_s
            before = (t_s, *w)
        else:
            before = self._before
        number = math.floor((t_s - self._first) / self._block_s + 1e-6)
        if number != self._number:
            done = self.finish()
            self._number = number
        dt = t_s - before[0]
        if dt > MAX_GAP_S or dt < 0.0:
            self.gap_s += abs(dt)
            dt = 0.0
        dx, dy, dz = w[0] - before[1], w[1] - before[2], w[2] - before[3]
        norm = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
        self.sums = advance(self.sums, dt, w, a, norm, dx * dx + dy * dy + dz * dz, 1.0)
        self._before = (t_s, *w)
        self._last = t_s
        return done

    def finish(self) -> Block | None:
        """Close the block under way."""
        if self.sums is EMPTY:
            return None
        done = Block(finished(np.array(self.sums), self.gap_s, self._start, self._last))
        self.sums, self.gap_s, self._start = EMPTY, 0.0, self._last
        return done


@dataclass(frozen=True, slots=True)
class Batch:
    """All samples laid out by block: (places, blocks) arrays, `one` 0 where a block has no such sample."""

    dt: Array
    w: tuple[Array, Array, Array]
    a: tuple[Array, Array, Array]
    norm: Array
    rough: Array
    one: Array
    gap: Array
    starts: Array
    ends: Array
    place: NDArray[np.intp]
    """(N,) place of a sample in its block"""
    number: NDArray[np.intp]
    """(N,) block of a sample"""

    @classmethod
    def of(cls, t_s: Array, w: Array, a: Array, block_s: float = 1.0) -> Batch:
        """Lay out samples of the body frame: t_s (N,), w (3, N) rad/s, a (3, N) g."""
        labels = np.floor((t_s - t_s[0]) / block_s + 1e-6)
        new = np.flatnonzero(np.diff(labels, prepend=labels[:1] - 1.0) != 0.0)
        number = np.searchsorted(new, np.arange(t_s.size), side="right") - 1
        place = np.arange(t_s.size) - new[number]
        shape = (int(place.max()) + 1, new.size)

        def laid(values: Array) -> Array:
            out = np.zeros(shape)
            out[place, number] = values
            return out

        dt = np.diff(t_s, prepend=t_s[:1])
        hole = (dt > MAX_GAP_S) | (dt < 0.0)
        gap = np.zeros(new.size)
        np.add.at(gap, number[hole], np.abs(dt[hole]))
        dx, dy, dz = np.diff(w, axis=1, prepend=w[:, :1])
        last = np.append(new[1:], t_s.size) - 1
        return cls(
            dt=laid(np.where(hole, 0.0, dt)),
            w=(laid(w[0]), laid(w[1]), laid(w[2])),
            a=(laid(a[0]), laid(a[1]), laid(a[2])),
            norm=laid(np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])),
            rough=laid(dx * dx + dy * dy + dz * dz),
            one=laid(np.ones(t_s.size)),
            gap=gap,
            starts=np.append(t_s[:1], t_s[last[:-1]]),
            ends=t_s[last],
            place=place,
            number=number,
        )

    def steps(self) -> Iterator[Sums]:
        """The sums of all blocks after each place in turn."""
        count = self.gap.size
        sums: Sums = (np.ones(count), *(np.zeros(count) for _ in EMPTY[1:]))
        for j in range(self.dt.shape[0]):
            sums = advance(
                sums,
                self.dt[j],
                (self.w[0][j], self.w[1][j], self.w[2][j]),
                (self.a[0][j], self.a[1][j], self.a[2][j]),
                self.norm[j],
                self.rough[j],
                self.one[j],
            )
            yield sums

    def table(self) -> Array:
        """All blocks, (34, M) as of `finished`."""
        sums = np.array(deque(self.steps(), maxlen=1)[0])
        return finished(sums, self.gap, self.starts, self.ends)

    def blocks(self) -> list[Block]:
        """All blocks."""
        return [Block(row) for row in np.ascontiguousarray(self.table().T)]
