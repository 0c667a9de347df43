"""A zone of a calibration at one temperature, as plain floats for the correction of single readings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.calibration.correction import TEMPERATURE_OUTSIDE, TEMPERATURE_UNKNOWN, TemperatureTrust, Vector
from highside.calibration.nonlinear_terms import PolynomialTerms, StructureTerms, nonlinear_terms
from highside.calibration.sensor import (
    MATRIX_NAMES,
    OFFSET_NAMES,
    SensorModel,
    is_sensor_parameter,
)
from highside.calibration.student import UPPER
from highside.calibration.zone import SHARED_NAMES, Zone

CoefficientForm = tuple[float, float, float, float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Coefficients:
    """A zone at one temperature, as plain floats."""

    c: tuple[float, ...]
    """C row by row"""
    o: Vector
    """C b"""
    form: tuple[CoefficientForm, ...]
    """for each element of the covariance the factors of xx, xy, xz, yy, yz, zz, x, y, z, 1"""
    student: tuple[CoefficientForm, ...] | None
    """the same for its widening; None where there is none"""
    shared: Array | None
    """(K, 3, 4): error of the vector, by (gx, gy, gz, 1), that one standard deviation of each of `SHARED_NAMES` makes
    and that all corrections of a session have in common; None where the zone does not say"""
    nonlinear: PolynomialTerms | StructureTerms | None
    flags: tuple[str, ...]


def _quadratic_forms(C: Array, covariance: Array, beyond: Array, extra_variance: float) -> Array:
    """Factors (6, 10) of `Coefficients.form` from the covariance (12, 12) of (A row by row, b).

    `beyond` (3, 4): an error of the corrected vector, linear in (gx, gy, gz, 1), that counts as one standard deviation;
    `extra_variance`: of each axis.
    """
    order = [3 * i + j if j < 3 else 9 + i for i in range(3) for j in range(4)]
    raw = covariance[np.ix_(order, order)].reshape(3, 4, 3, 4)
    by_g = np.einsum("pi,ijkl,qk->pqjl", C, raw, C) + np.einsum("pj,ql->pqjl", beyond, beyond)
    for i in range(3):
        by_g[i, i, 3, 3] += extra_variance
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2), (0, 3), (1, 3), (2, 3), (3, 3)]
    return np.array([[by_g[p, q, j, m] + (by_g[p, q, m, j] if j != m else 0.0) for j, m in pairs] for p, q in UPPER])


def coefficients_at(zone: Zone, trust: TemperatureTrust | None, temp_c: float | None) -> Coefficients:
    """The coefficients of a zone at a temperature; where None, at the reference temperature."""
    model = zone.model(temp_c)
    C = model.C
    flags: tuple[str, ...] = ()
    grown = 0.0
    if temp_c is None:
        if zone.temperature is not None and zone.max_power():
            flags = (TEMPERATURE_UNKNOWN,)
    elif trust is not None:
        beyond = trust.beyond_c(temp_c)
        if beyond > 0.0:
            flags = (TEMPERATURE_OUTSIDE,)
            grown = (beyond * trust.growth_g_per_c) ** 2
    covariances, bases = _at_temperature(zone, temp_c)
    linear = [i for i, name in enumerate(MATRIX_NAMES + OFFSET_NAMES) if name in bases]
    affine = np.zeros((len(covariances), 12, 12))
    nonlinear: PolynomialTerms | StructureTerms | None = None
    if model.is_linear:
        index = [bases.index((MATRIX_NAMES + OFFSET_NAMES)[i]) for i in linear]
        for whole, part in zip(affine, covariances, strict=True):
            whole[np.ix_(linear, linear)] = part[np.ix_(index, index)]
    else:
        nonlinear = nonlinear_terms(model, C, bases, covariances)
    form = _quadratic_forms(C, affine[0], _beyond_temperature(zone, model, temp_c), grown)
    student = None if len(affine) == 1 else _quadratic_forms(C, affine[1], np.zeros((3, 4)), 0.0)
    o = C @ model.b
    return Coefficients(
        c=tuple(C.ravel().tolist()),
        o=(float(o[0]), float(o[1]), float(o[2])),
        form=tuple(tuple(row) for row in form.tolist()),
        student=None if student is None else tuple(tuple(row) for row in student.tolist()),
        shared=_shared(zone),
        nonlinear=nonlinear,
        flags=flags,
    )


def _at_temperature(zone: Zone, temp_c: float | None) -> tuple[Array, tuple[str, ...]]:
    """Covariance of the sensor's parameters at one temperature, polynomial coefficients summed up, with its widening if
    there is one (K, P, P), and their names."""
    names = tuple(name for name in zone.parameters.names if is_sensor_parameter(name))
    bases = tuple(dict.fromkeys(name.partition("@")[0] for name in names))
    by_power = dict(zone.temperature_weights(temp_c))
    index = [zone.parameters.names.index(name) for name in names]
    B = np.zeros((len(bases), len(names)))
    for j, name in enumerate(names):
        base, _, power = name.partition("@")
        B[bases.index(base), j] = by_power.get(int(power), 0.0) if power else 1.0
    p = zone.parameters
    parts = [p.covariance] if p.student is None else [p.covariance, p.student]
    return np.stack([B @ part[np.ix_(index, index)] @ B.T for part in parts]), bases


def _shared(zone: Zone) -> Array | None:
    """`Coefficients.shared`: regression of the parameters' errors on what was taken for known (at the reference
    temperature: a matrix near unity does not care); zero for what did not move this zone."""
    p, C = zone.parameters, zone.model().C
    if not set(SHARED_NAMES) & set(p.names) or not all(name in p for name in MATRIX_NAMES + OFFSET_NAMES):
        return None
    index = [p.names.index(name) for name in MATRIX_NAMES + OFFSET_NAMES]
    levers = np.zeros((len(SHARED_NAMES), 3, 4))
    for lever, name in zip(levers, SHARED_NAMES, strict=True):
        place = p.names.index(name) if name in p else -1
        if place >= 0 and p.covariance[place, place] > 0.0:
            moved = p.covariance[index, place] / math.sqrt(p.covariance[place, place])
            lever[:] = C @ np.column_stack([moved[:9].reshape(3, 3), moved[9:]])
    return levers


def _beyond_temperature(zone: Zone, model: SensorModel, temp_c: float | None) -> Array:
    """What the polynomials change beyond the temperatures visited, as an error (3, 4) by (gx, gy, gz, 1)."""
    t = zone.temperature
    if t is None or temp_c is None or t.inside(temp_c) or not zone.max_power():
        return np.zeros((3, 4))
    edge = zone.model(min(max(temp_c, t.min_c), t.max_c))
    return np.asarray(edge.C @ np.column_stack([model.A - edge.A, model.b - edge.b]))
