"""The method `balance`: a matrix for each inclination, from poses in its four quadrants."""

from __future__ import annotations

from highside.calibration.balance import balance
from highside.calibration.conventional import conventional
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.method import NO_FALLBACK, Method, Solution, SolveRequest
from highside.calibration.methods import get
from highside.calibration.poses import PoseSet
from highside.calibration.remark import CalibrationRefused
from highside.errors import InputError
from highside.words import said_later


def _solve(poses: PoseSet, request: SolveRequest, bench: BenchAccuracy) -> Solution:
    """The zones, with the `fallback` that is requested; else, where the inclinations span enough to give one, with a
    rough global `guide` that only chooses the zone of a reading."""
    result = balance(poses, triples=request.triples, bench=bench)
    if request.fallback != NO_FALLBACK:
        beyond = get(request.fallback, field="fallback")
        if beyond.by_inclination:
            raise InputError(f"method {beyond.name!r} holds near its own inclinations only", field="fallback")
        alone = SolveRequest(beyond.name, pose_sigma_deg=request.pose_sigma_deg)
        return Solution(result, fallback=beyond.solve(poses, alone, bench).result)
    if len(result.zones) < 2:
        return Solution(result)
    try:
        return Solution(result, guide=conventional(poses, bench=bench))
    except CalibrationRefused:
        return Solution(result)


METHOD = Method(
    "balance",
    described=said_later("balance correction ({triples})"),
    colour="#3d8b40",
    solve=_solve,
    by_inclination=True,
    order=2,
)
