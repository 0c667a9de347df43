"""What a fit is made from: an error against the rotor angle, row by row, and how well it covers the turn."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude.angles import TURN, wrap_positive, wrap_signed
from highside.errors import InputError, Refused

Ints = NDArray[np.int64]

LEAST_ROWS = 8
WARN_GAP_RAD = np.radians(30.0)
"""a hole in the turn half a wave of the sixth harmonic long: higher orders are free to do anything in it"""
LEAST_COVERED_RAD = np.pi
"""over less than half a turn a constant and a first harmonic cannot be separated"""


@dataclass(frozen=True, slots=True)
class AngleCoverage:
    """Which part of the turn the rows saw."""

    samples: int
    turns: float
    """how far the rotor travelled, either way, in turns"""
    largest_gap_rad: float
    gap_start_rad: float
    """where the largest gap begins, [0, 2 pi)"""

    @property
    def has_gap(self) -> bool:
        return bool(self.largest_gap_rad > WARN_GAP_RAD)

    @property
    def warning(self) -> str | None:
        """One sentence if a part of the turn is not covered, else None."""
        if not self.has_gap:
            return None
        start = np.degrees(self.gap_start_rad)
        size = np.degrees(self.largest_gap_rad)
        return f"no rows from {start:.0f} deg over {size:.0f} deg of the turn: the compensation is a guess in there"

    def to_dict(self) -> dict[str, float | int]:
        return {
            "samples": self.samples,
            "turns": self.turns,
            "largest_gap_deg": float(np.degrees(self.largest_gap_rad)),
            "gap_start_deg": float(np.degrees(self.gap_start_rad)),
        }

    @classmethod
    def from_dict(cls, data: dict[str, float]) -> Self:
        return cls(
            int(data["samples"]),
            float(data["turns"]),
            float(np.radians(data["largest_gap_deg"])),
            float(np.radians(data["gap_start_deg"])),
        )


@dataclass(frozen=True)
class Samples:
    """Rows in time order: rotor angle (N,) rad (wrapped or not), error (N,) in any one unit, rotor rate (N,) rad/s.

    Build with `Samples.build`, which checks them.
    """

    theta_rad: Array
    error: Array
    rate_radps: Array | None = None

    @classmethod
    def build(cls, theta_rad: Array, error: Array, rate_radps: Array | None = None) -> Self:
        """Raises InputError for lengths that differ, values that are not finite, or fewer than eight rows."""
        theta, y = np.asarray(theta_rad, dtype=float), np.asarray(error, dtype=float)
        rate = None if rate_radps is None else np.asarray(rate_radps, dtype=float)
        given = [theta, y] if rate is None else [theta, y, rate]
        if any(a.ndim != 1 or a.size != theta.size for a in given):
            raise InputError("rotor angle, error and rate must be of one length")
        if theta.size < LEAST_ROWS:
            raise InputError(f"{theta.size} rows are too few for a curve over the turn", remedy="give at least 8")
        if not all(np.isfinite(a).all() for a in given):
            raise InputError("rotor angle, error and rate must be finite numbers")
        return cls(theta, y, rate)

    @property
    def n(self) -> int:
        return int(self.theta_rad.size)

    @cached_property
    def coverage(self) -> AngleCoverage:
        wrapped = np.sort(wrap_positive(self.theta_rad))
        gaps = np.empty(wrapped.size)
        np.subtract(wrapped[1:], wrapped[:-1], out=gaps[:-1])
        gaps[-1] = wrapped[0] + TURN - wrapped[-1]
        at = int(np.argmax(gaps))
        return AngleCoverage(self.n, self._travel_rad[-1] / TURN, float(gaps[at]), float(wrapped[at]))

    def require_coverage(self) -> None:
        """Raises Refused where less than half of the turn is covered."""
        covered = TURN - self.coverage.largest_gap_rad
        if covered < LEAST_COVERED_RAD:
            raise Refused(
                f"only {np.degrees(covered):.0f} deg of the turn are covered: a constant and a first harmonic"
                " cannot be separated; record at least half a turn, better two"
            )

    @cached_property
    def _travel_rad(self) -> Array:
        """(N,): the way since the first row, both directions counted up."""
        steps = np.abs(wrap_signed(np.diff(self.theta_rad)))
        travel = np.empty(self.n)
        travel[0] = 0.0
        np.cumsum(steps, out=travel[1:])
        return travel

    @cached_property
    def in_order(self) -> bool:
        """Whether neighbours are near enough (under a quarter turn) for turns to be counted."""
        return bool(np.median(np.abs(wrap_signed(np.diff(self.theta_rad)))) < TURN / 4)

    @cached_property
    def revolution(self) -> Ints:
        """(N,): which turn a row belongs to, counted by the way travelled; the last may be unfinished."""
        # rows that rounding put just before a full turn belong to the next
        return ((self._travel_rad + 1e-9) // TURN).astype(np.int64)

    @cached_property
    def whole_revolutions(self) -> tuple[int, ...]:
        """The numbers of the turns that are complete (to two steps)."""
        if not self.in_order:
            return ()
        step = self._travel_rad[-1] / (self.n - 1)
        whole = int((self._travel_rad[-1] + 2 * step) // TURN)
        return tuple(range(whole))

    def select(self, rows: NDArray[np.bool_]) -> Samples:
        """A copy with some rows."""
        return Samples(
            self.theta_rad[rows], self.error[rows], None if self.rate_radps is None else self.rate_radps[rows]
        )
