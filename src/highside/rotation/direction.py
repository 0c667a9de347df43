"""Which way the rotor turned, how fast, and whether the error differs by the direction (backlash, hysteresis, a lag).

A curve over the rotor angle is one value an angle. Play in a gear, friction of a bearing or a late time stamp make it
two: e(theta, d) = f(theta) + d D(theta) / 2 with d = +1 or -1, the direction of rotation. A fit over both directions
gives the mean f and leaves D / 2 as what looks like noise.

D is judged by whole turns, not by rows, since what belongs to a turn (wobble that does not repeat, drift) is common to
its rows. Every turn in one direction gives the coefficients of a constant and two harmonics of what f leaves; each
coefficient is regressed over the turns on 1, the turn's place in time, and its direction, and the direction's part is
tested against zero by Student's t. Where direction and time run together (all turns forwards first, then all
backwards), a drift would look the same: that is said.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude.angles import TURN, wrap_signed
from highside.rotation.bases import fourier_rows
from highside.rotation.curve import ErrorCurve
from highside.rotation.samples import Samples
from highside.special import stdtr, stdtrit

Signs = NDArray[np.int8]

HARMONICS = 2
"""of the difference; a lag of a curve with many waves shows in its first ones too"""
FOUND_P = 0.003
"""Probability, over all coefficients, below which a difference is believed: 1 of 300 recordings without one."""
FEWEST_TURNS = 2
"""Whole turns in each direction below which a scatter between turns cannot be estimated."""
RUNS_TOGETHER = 0.8
"""Correlation of direction with time from which the two are not separated; all turns forwards first, then all
backwards, have 0.87, turns in alternation 0.4 at most."""
OBSERVED_TURNS = 0.25
"""Travel in a direction, in turns, from which it counts as covered."""
RATE_MARGIN = 1.5
"""A rate counts as covered up to so many times the fastest of the fit, and down to the slowest divided by it."""
STILL_SHARE = 0.02
"""Share of the typical rate below which the rotor counts as standing."""
WHOLE_TURN = 0.02
"""A turn may lack this share: rows beside a reversal or a stand belong to no direction."""


@dataclass(frozen=True, slots=True)
class RotorMotion:
    """How the rotor moved in a recording: travel each way in turns, and the rates between which 98 % of the rows lie
    (deg/s, without sign, rows at rest omitted; None where no time was given)."""

    forward_turns: float
    backward_turns: float
    least_dps: float | None = None
    greatest_dps: float | None = None

    @classmethod
    def of(cls, t_s: Array, theta_rad: Array) -> Self:
        """From times (N,) s and rotor angles (N,) rad, wrapped or not, in order."""
        steps = wrap_signed(np.diff(theta_rad))
        # an encoder that flickers while the rotor stands has not turned it
        steps = np.where(_moves(steps), steps, 0.0)
        forward = float(steps[steps > 0].sum()) / TURN
        backward = -float(steps[steps < 0].sum()) / TURN
        apart = np.diff(t_s)
        rates = np.degrees(np.abs(steps[apart > 0] / apart[apart > 0]))
        moving = rates[rates > 0.0]
        if not moving.size:
            return cls(forward, backward)
        least, greatest = np.quantile(moving, (0.01, 0.99))
        return cls(forward, backward, float(least), float(greatest))

    def to_dict(self) -> dict[str, float | None]:
        return {
            "forward_turns": self.forward_turns,
            "backward_turns": self.backward_turns,
            "least_dps": self.least_dps,
            "greatest_dps": self.greatest_dps,
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Self:
        """Raises KeyError, TypeError or ValueError for data that `to_dict` did not make."""

        def rate(name: str) -> float | None:
            return None if data[name] is None else float(data[name])

        return cls(float(data["forward_turns"]), float(data["backward_turns"]), rate("least_dps"), rate("greatest_dps"))

    def unobserved(self, other: RotorMotion) -> list[str]:
        """What `other` did that this never saw, as sentences for a user."""
        out = []
        for name, mine, theirs in (
            ("forwards (growing angle)", self.forward_turns, other.forward_turns),
            ("backwards (falling angle)", self.backward_turns, other.backward_turns),
        ):
            if theirs >= OBSERVED_TURNS > mine:
                out.append(f"the rotor turns {name} for {theirs:.1f} turns; the fit never saw that direction")
        if None not in (self.least_dps, self.greatest_dps, other.least_dps, other.greatest_dps):
            assert self.least_dps and self.greatest_dps and other.least_dps and other.greatest_dps
            slow, fast = self.least_dps / RATE_MARGIN, self.greatest_dps * RATE_MARGIN
            if other.least_dps < slow or other.greatest_dps > fast:
                out.append(
                    f"the rotor turns at {other.least_dps:.3g} to {other.greatest_dps:.3g} deg/s; the fit saw"
                    f" {self.least_dps:.3g} to {self.greatest_dps:.3g}: what depends on the rate is not in it"
                )
        return out


@dataclass(frozen=True, slots=True)
class DirectionDifference:
    """How much the error forwards differs from that backwards, in the unit of the samples.

    `constant` with its 95 % half-width `constant_u`: the mean over the turn (play); `largest`: the greatest value of
    |D| over the turn; `p`: probability of what was observed without a difference, over all coefficients; `with_time`:
    whether direction and time run together, so that a drift would look the same.
    """

    constant: float
    constant_u: float
    largest: float
    p: float
    forward_turns: int
    backward_turns: int
    with_time: bool

    @property
    def found(self) -> bool:
        return self.p < FOUND_P

    def to_dict(self) -> dict[str, Any]:
        return {
            "found": self.found,
            "constant_arcmin": self.constant,
            "constant_u_arcmin": self.constant_u,
            "largest_arcmin": self.largest,
            "p": self.p,
            "forward_turns": self.forward_turns,
            "backward_turns": self.backward_turns,
            "runs_with_time": self.with_time,
        }

    @property
    def sentence(self) -> str:
        """For a user; the unit is the arcminute."""
        if not self.found:
            return (
                f"no difference by direction is detected: {self.constant:+.4f}' +- {self.constant_u:.4f}' (95 %) over"
                f" {self.forward_turns} turns forwards and {self.backward_turns} backwards"
            )
        time = "; direction and time run together, so that a drift would look the same" if self.with_time else ""
        return (
            f"the error differs by the direction of rotation: forwards minus backwards {self.constant:+.4f}' +-"
            f" {self.constant_u:.4f}' (95 %) on average, up to {self.largest:.4f}' at some angles (play, friction or a"
            f" late angle){time}; the curve is their mean: fit the directions apart, or take the play away"
        )


def _moves(steps: Array) -> NDArray[np.bool_]:
    """Which steps the rotor turned by, and did not stand. Typical is the size of step by which half of the way is made:
    neither stands nor angles that are read more often than they change are counted."""
    sizes = np.abs(steps)
    if not sizes.size:
        return np.zeros(0, dtype=bool)
    ordered = np.sort(sizes)
    way = np.cumsum(ordered)
    typical = ordered[min(int(np.searchsorted(way, 0.5 * way[-1])), ordered.size - 1)]
    return np.asarray(sizes > STILL_SHARE * typical)


def directions(theta_rad: Array) -> Signs:
    """(N,) +1 where the angle grows, -1 where it falls, of a rotor that is read often enough; 0 at a reversal.

    A row belongs to a direction where the rotor turned that way before and after it, however long it stood there: play
    is taken up by the last motion.
    """
    steps = wrap_signed(np.diff(theta_rad))
    moved = _moves(steps)
    turned = np.flatnonzero(moved)
    out = np.zeros(theta_rad.size, dtype=np.int8)
    if not turned.size:
        return out
    signs = np.concatenate([[0], np.sign(steps[turned]).astype(np.int8), [0]])
    count = np.concatenate([[0], np.cumsum(moved)])  # of moving steps before each row
    before, after = signs[count], signs[count + 1]
    out[:] = np.where(before == after, before, 0)
    # before the first step and after the last there is one side only
    out[0] = np.sign(steps[0]) if moved[0] else 0
    out[-1] = np.sign(steps[-1]) if moved[-1] else 0
    return out


def direction_difference(samples: Samples, curve: ErrorCurve) -> DirectionDifference | None:
    """Whether the error differs by the direction of rotation; None without two whole turns each way.

    `curve`: the fit over all samples. Rows are in time order.
    """
    if not samples.in_order:
        return None
    way = directions(samples.theta_rad)
    turns = _whole_turns(samples.theta_rad, way)
    signs = np.array([sign for sign, _ in turns])
    counts = int(np.sum(signs > 0)), int(np.sum(signs < 0))
    if min(counts) < FEWEST_TURNS:
        return None
    left = samples.error - curve(samples.theta_rad, samples.rate_radps)
    # a few wild rows must not stand for their turn
    left = np.clip(left, -4.0 * curve.noise, 4.0 * curve.noise) if curve.noise > 0 else left
    coefficients, places = [], []
    for _, rows in turns:
        basis = fourier_rows(samples.theta_rad[rows], HARMONICS)
        coefficients.append(np.linalg.lstsq(basis.T, left[rows], rcond=None)[0])
        places.append(0.5 * (rows.start + rows.stop))
    observed = np.array(coefficients)
    place = np.array(places) - np.mean(places)
    together = abs(float(np.corrcoef(place, signs)[0, 1])) > RUNS_TOGETHER
    columns = [np.ones(signs.size), 0.5 * signs]
    if not together and signs.size > 2 * FEWEST_TURNS:
        columns.append(place / max(float(np.abs(place).max()), 1e-300))
    design = np.array(columns).T
    freedom = signs.size - design.shape[1]
    part, *_ = np.linalg.lstsq(design, observed, rcond=None)
    scatter = np.sqrt(np.sum((observed - design @ part) ** 2, axis=0) / freedom)
    rows_a_turn = float(np.mean([rows.stop - rows.start for _, rows in turns]))
    # turns that agree by chance, or to rounding, are no better known than their rows' noise
    least = curve.noise / np.sqrt(rows_a_turn) * np.where(np.arange(observed.shape[1]) == 0, 1.0, np.sqrt(2.0))
    spread = np.maximum(scatter, np.maximum(least, 1e-12 * float(np.abs(samples.error).max()) or 1e-300))
    unit = float(np.sqrt(np.linalg.inv(design.T @ design)[1, 1]))
    difference = part[1]
    t = np.abs(difference) / (spread * unit)
    p = min(1.0, float(2.0 * stdtr(freedom, -t.max())) * t.size)
    grid = np.linspace(0.0, TURN, 360, endpoint=False)
    shape = difference @ fourier_rows(grid, HARMONICS)
    half_width = float(stdtrit(freedom, 0.975) * spread[0] * unit)
    return DirectionDifference(
        float(difference[0]), half_width, float(np.abs(shape).max()), p, counts[0], counts[1], together
    )


def _whole_turns(theta_rad: Array, way: Signs) -> list[tuple[int, slice]]:
    """The whole turns that were made without changing direction: its sign, and its rows."""
    steps = np.concatenate([[0.0], wrap_signed(np.diff(theta_rad))])
    out: list[tuple[int, slice]] = []
    edges = np.flatnonzero(np.diff(way)) + 1
    for begin, end in zip([0, *edges], [*edges, theta_rad.size], strict=True):
        sign = int(way[begin])
        if not sign or end - begin < 8:
            continue
        travel = np.abs(np.cumsum(steps[begin:end]) - steps[begin])
        step = travel[-1] / max(np.count_nonzero(steps[begin + 1 : end]), 1)
        # a turn is whole to two steps of a coarse reading
        for number in range(int((travel[-1] + max(2.0 * step, WHOLE_TURN * TURN)) // TURN)):
            rows = np.flatnonzero((travel >= number * TURN - 1e-9) & (travel < (number + 1) * TURN - 1e-9))
            out.append((sign, slice(int(begin + rows[0]), int(begin + rows[-1] + 1))))
    return out
