"""Calibration over an oven cycle: offset and matrix as polynomials in temperature.

A session with `temp_c` at several temperatures, up and down again, is solved by the joint estimator with the terms
`b_i@k` and `A_ij@k`: coefficients of the k-th power of the reduced temperature `u = (T - ref) / scale`, -1 to 1 over
the range visited. The order of each is raised while the evidence (marginal likelihood, priors included) gains by more
than e^5, never beyond what the number of temperatures can bear. The bench's tilt is the same at all temperatures.

Offset that differs between the way up and the way down (hysteresis) is estimated beside; half of it enters the
uncertainty of the offset, for in the hole nobody knows the leg. Outside of the range the polynomials go on along their
tangent, and the change beyond the edge is itself taken as one standard deviation (see `Zone`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.calibration.forward import HYSTERESIS_NAMES
from highside.calibration.joint import Selection, deviance_of, joint
from highside.calibration.linear_errors import NOMINAL_BENCH, BenchAccuracy
from highside.calibration.mixed_model import ThermalTerms
from highside.calibration.poses import SAME_TEMPERATURE_C, PoseSet, group_settings
from highside.calibration.remark import Reason, Remark
from highside.calibration.result import CalibrationResult
from highside.calibration.sensor import MATRIX_NAMES, OFFSET_NAMES
from highside.calibration.zone import TemperatureRange, Zone
from highside.errors import InputError

MIN_SPAN_C = 10.0
"""Below this a session counts as made at one temperature."""
MAX_ORDER = 3
ADMIT_LOG_BAYES = 5.0
HYSTERESIS_SIGMA = 3.0


def joint_over_temperature(
    poses: PoseSet,
    *,
    bench: BenchAccuracy = NOMINAL_BENCH,
    nonlinear: Selection = "auto",
    encoder: Selection = "auto",
    toolface_zero_rad: float = 0.0,
    toolface_zero_std_rad: float = 0.0,
    max_order: int = MAX_ORDER,
) -> CalibrationResult:
    """The joint estimator with as much of temperature as the evidence admits; poses (N,) in the order of measurement.

    Without several temperatures this is `joint`, with a remark on the narrow range. Raises InputError where `temp_c`
    lacks, and what `joint` raises.
    """
    if poses.temp_c is None:
        raise InputError("the poses have no temperature", field="temp_c", remedy="add the column, or solve without")
    temp = poses.temp_c
    low, high = float(temp.min()), float(temp.max())
    window = TemperatureRange(0.5 * (low + high), max(0.5 * (high - low), 1.0), low, high)
    u = (temp - window.ref_c) / window.scale_c
    leg = legs(temp)
    both_legs = high - low >= MIN_SPAN_C and bool(np.any(leg > 0) and np.any(leg < 0))
    loop = HYSTERESIS_NAMES if both_legs else ()
    offset_order, matrix_order = 0, 0
    if high - low >= MIN_SPAN_C:
        steps = int(group_settings(temp, tolerance=SAME_TEMPERATURE_C).max())
        offset_order, matrix_order = _choose_orders(poses, u, leg, loop, bench, min(max_order, steps))
    names = _terms(offset_order, matrix_order) + loop
    result = joint(
        poses,
        bench=bench,
        nonlinear=nonlinear,
        encoder=encoder,
        toolface_zero_rad=toolface_zero_rad,
        toolface_zero_std_rad=toolface_zero_std_rad,
        thermal=ThermalTerms(names, u, leg),
    )
    return _with_temperature(result, window, offset_order, matrix_order, both_legs)


def legs(temp_c: Array) -> Array:
    """+1 for poses reached on the way up in temperature, -1 on the way down (N,), from their order.

    Readings within `SAME_TEMPERATURE_C` of the running step belong to it; the first step takes the sign of what
    follows.
    """
    out = np.zeros(temp_c.size)
    level = float(temp_c[0])
    sign = 0.0
    for i, value in enumerate(temp_c.tolist()):
        if abs(value - level) > SAME_TEMPERATURE_C:
            sign = 1.0 if value > level else -1.0
            level = value
        out[i] = sign
    first = out[np.flatnonzero(out)[0]] if np.any(out) else 1.0
    return np.where(out == 0.0, first, out)


def _terms(offset_order: int, matrix_order: int) -> tuple[str, ...]:
    offsets = tuple(f"{name}@{k}" for k in range(1, offset_order + 1) for name in OFFSET_NAMES)
    matrix = tuple(f"{name}@{k}" for k in range(1, matrix_order + 1) for name in MATRIX_NAMES)
    return offsets + matrix


def _choose_orders(
    poses: PoseSet, u: Array, leg: Array, loop: tuple[str, ...], bench: BenchAccuracy, limit: int
) -> tuple[int, int]:
    """Raise the order of offset or matrix, whichever gains more evidence, while either gains enough.

    Two steps are looked at in each direction, lest a missing linear term of one kind hide behind the other's."""

    def deviance(orders: tuple[int, int]) -> float:
        return deviance_of(poses, ThermalTerms(_terms(*orders) + loop, u, leg), bench)

    orders = (0, 0)
    current = deviance(orders)
    while True:
        nearby = [
            (orders[0] + i, orders[1] + j)
            for i, j in ((1, 0), (0, 1), (1, 1), (2, 0), (0, 2))
            if orders[0] + i <= limit and orders[1] + j <= limit
        ]
        if not nearby:
            return orders
        lowest, best = min((deviance(candidate), candidate) for candidate in nearby)
        if current - lowest < 2.0 * ADMIT_LOG_BAYES:
            return orders
        orders, current = best, lowest


def _with_temperature(
    result: CalibrationResult, window: TemperatureRange, offset_order: int, matrix_order: int, both_legs: bool
) -> CalibrationResult:
    zone = result.main
    p = zone.parameters
    remarks = list(result.remarks)
    options = dict(result.options) | {"offset_order": float(offset_order), "matrix_order": float(matrix_order)}
    covariance = p.covariance.copy()
    if both_legs:
        sizes = []
        for axis, name in zip(OFFSET_NAMES, HYSTERESIS_NAMES, strict=True):
            value, std = p.get(name), p.std(name)
            options[name] = value
            options[f"{name}_std"] = std
            i = p.names.index(axis)
            # half of the loop, or half of what it could be: the leg is not known in use
            covariance[i, i] += 0.25 * (value**2 + std**2)
            if abs(value) > HYSTERESIS_SIGMA * std:
                sizes.append(f"{axis[-1]} {value * 1e3:+.3f} +- {std * 1e3:.3f} mg")
        if sizes:
            remarks.append(
                Remark(
                    Reason.TEMPERATURE_HYSTERESIS,
                    f"the offset differs between the way up and the way down ({', '.join(sizes)}); "
                    "half of it is in the stated uncertainty",
                )
            )
    if window.max_c - window.min_c < MIN_SPAN_C:
        ends = dict.fromkeys(f"{end:.1f}" for end in (window.min_c, window.max_c))
        made = f"made at {' to '.join(ends)} C only: nothing is known of other temperatures"
        remarks.append(Remark(Reason.TEMPERATURE_SPAN, made))
    local: tuple[Zone, ...] = tuple(z for z in result.zones if z is not zone)
    main = replace(zone, parameters=replace(p, covariance=covariance), temperature=window)
    return replace(result, zones=(main, *local), remarks=tuple(remarks), options=options)
