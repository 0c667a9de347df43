"""A turntable's own errors without an outside reference: turns at several inclinations, each predicting itself.

`self_reference` gives for each recording what the bench reads wrongly, at that recording's inclination; `turntable`
tells the encoder (the same at every inclination) from the wobble across the tilt (as cot I) when there are two or more.
Joined they measure a bench with nothing but a tool on it, and the result is good at every inclination:

    fit-self, one recording        I and T of this tool on this rotor, at this inclination; for the live service
    fit-self, several              the rotor itself in its axis frame; for later calibrations (`--turntable`) and live
    turntable                      the same against an outside reference or a calibrated tool: constants too, and no
                                   doubt about the first harmonic

Constants stay unobservable and are zero. By the gyros (`rotor`) the first harmonic is as uncertain as their bias and
alignment make it; without them (`decoded`) what is left of the accelerometers' errors passes for the bench's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.errors import Refused
from highside.rotation.curve import CurveMethod, ErrorCurve
from highside.rotation.fit import FitOptions, fit
from highside.rotation.samples import Samples
from highside.rotation.self_reference import ErrorPart, GyroDoubt, SelfErrors, turn_to_turn
from highside.rotation.turntable import ARCMIN, AXIS_CHANNELS, fit_turntable


def self_turntable(recordings: Sequence[SelfErrors], doubt: GyroDoubt | None = None) -> dict[str, ErrorCurve]:
    """Curves `encoder`, `across`, `along` in arcminutes from two recordings or more of one part, `rotor` or `decoded`.

    Raises Refused for the part `sensor`, and where the inclinations do not differ enough.
    """
    if any(one.part is ErrorPart.SENSOR for one in recordings):
        raise Refused("the part 'sensor' is no error of a turntable: use 'rotor', or 'decoded' of a calibrated tool")
    found = fit_turntable(
        np.concatenate([one.theta_rad for one in recordings]),
        np.concatenate([np.full(one.theta_rad.size, one.mean_inclination_rad) for one in recordings]),
        np.concatenate([one.toolface_rad for one in recordings]),
        np.concatenate([one.inclination_rad for one in recordings]),
    )
    inc = np.array([one.mean_inclination_rad for one in recordings])
    # how the toolface coefficients of the recordings make encoder and wobble, and the inclination's the wobble along
    solve = np.linalg.pinv(np.column_stack([np.ones(inc.size), -1.0 / np.tan(inc)]))
    weights = dict(zip(AXIS_CHANNELS, (solve[0], solve[1], np.full(inc.size, 1.0 / inc.size)), strict=True))
    scatter = {
        name: np.stack([_scatter(one, name == "along", found.order) for one in recordings]) for name in AXIS_CHANNELS
    }
    # a vertical off by a circle moves I by its radius and T by that over sin I
    circles = np.array([one.circle_rad(doubt or GyroDoubt()) for one in recordings]) / ARCMIN
    made = found.compensation("", "").curves
    curves = {}
    for name in AXIS_CHANNELS:
        weight = weights[name]
        lever = np.ones(inc.size) if name == "along" else 1.0 / np.sin(inc)
        circle = abs(float(weight @ (circles * lever)))
        spread = np.sqrt(np.square(weight) @ np.square(scatter[name]))
        curves[name] = _stated(made[name], spread, circle)
    return curves


def _scatter(one: SelfErrors, along: bool, order: int) -> Array:
    """Standard deviation of each coefficient of a recording's I or T by its scatter over the turns, arcmin."""
    samples = Samples.build(one.theta_rad, (one.inclination_rad if along else one.toolface_rad) / ARCMIN)
    size = 2 * order + 1
    curve = replace(
        fit(samples, CurveMethod.SINE, FitOptions(), held_out=False),
        order=order,
        parameters=np.zeros(size),
        covariance=np.zeros((size, size)),
    )
    return turn_to_turn(samples, curve)


def _stated(curve: ErrorCurve, spread: Array, circle: float) -> ErrorCurve:
    parameters = curve.parameters.copy()
    parameters[0] = 0.0
    own = np.sqrt(np.maximum(np.diag(curve.covariance), 1e-300))
    grown = np.maximum(spread / own, 1.0)
    covariance = curve.covariance * np.outer(grown, grown)
    remarks = [*curve.remarks, "the constant is unobservable without an outside reference: it is zero here"]
    if circle > 0.0 and curve.order >= 1:
        covariance[1, 1] += circle**2
        covariance[2, 2] += circle**2
        remarks.append(f"the first harmonic is uncertain by {circle:.2g}': bias and misalignment of the gyros")
    return replace(curve, parameters=parameters, covariance=covariance, remarks=tuple(remarks))
