"""What a calibration method is: its request, its solution, and its description.

A method is one file, in `calibration/methods` or in another installed package, that holds one `Method`. Records, the
command, comparisons, certificates and figures take its name, its words and its colour from there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.poses import PoseSet
from highside.calibration.result import CalibrationResult

NO_FALLBACK = "none"
"""`SolveRequest.fallback`: nothing corrects between and beyond the zones."""


@dataclass(frozen=True, slots=True)
class SolveRequest:
    """The request to the solver: all that decides its solution beside the poses."""

    method: str
    triples: str = "average"
    reference: str = "pose"
    pose_sigma_deg: float = 0.0052
    fallback: str = NO_FALLBACK
    """for a method that solves by inclination: the method of the global correction between and beyond the zones, or
    "none" """

    def to_dict(self) -> dict[str, Any]:
        return {
            "method": self.method,
            "triples": self.triples,
            "reference": self.reference,
            "pose_sigma_deg": self.pose_sigma_deg,
            "fallback": self.fallback,
        }


@dataclass(frozen=True, slots=True)
class Solution:
    """What `solve` found: the calibration, and beside the zones of a method that solves by inclination, a fallback or a
    guide."""

    result: CalibrationResult
    fallback: CalibrationResult | None = None
    guide: CalibrationResult | None = None


@dataclass(frozen=True, slots=True)
class Method:
    """One calibration method."""

    name: str
    """as records and commands call it; `CalibrationResult.method` says the same"""
    described: str
    """in a certificate: "conventional positions"; `{triples}` stands for the poses of an inclination that were
    requested"""
    colour: str
    """in figures that show several methods, `#rrggbb`"""
    solve: Callable[[PoseSet, SolveRequest, BenchAccuracy], Solution]
    """from poses whose attitudes the bench gives. Raises CalibrationRefused where they give no calibration."""
    by_magnitude: Callable[[PoseSet], Solution] | None = None
    """from poses of which |g| alone is known; None: it needs their attitudes"""
    by_inclination: bool = False
    """it solves each inclination alone and holds near these; else it holds everywhere, so that it may serve as
    the fallback of one that does not"""
    order: int = 100
    """its place where several are shown, from the simplest on"""
