"""What the watch takes for unknown, in which order, and what the record says of it beforehand.

The state is the deviation of a tool from its calibration, in the frame of corrected readings: `c = (1 + S) f + b`. A
record states the sensor `m = A f + b`; with `C` its inverse, `S = C dA` and `b = C db`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.calibration.record import CalibrationRecord, temperature_trust
from highside.calibration.sensor import MATRIX_NAMES, OFFSET_NAMES
from highside.calibration.zone import Zone
from highside.errors import InputError
from highside.watch.policy import POLICY, STATED, StatedNoise, WatchPolicy

AXES = "xyz"
OFFSETS = tuple(f"b_{i}" for i in AXES)
MATRIX = tuple(f"S_{i}{j}" for i in AXES for j in AXES)
TEMPERATURE = tuple(f"kT_{i}" for i in AXES)
RECTIFICATION = tuple(f"kV_{i}" for i in AXES)
NAMES = (*OFFSETS, *MATRIX, *TEMPERATURE, *RECTIFICATION, "arm_x", "arm_y", "gravity", "growth", "tilt_x", "tilt_y")
"""in the order of the state"""
INDEX: Mapping[str, int] = {name: i for i, name in enumerate(NAMES)}
SIZE = len(NAMES)
B, S, KT, KV, ARM, GRAVITY, GROWTH, TILT = 0, 3, 12, 15, 18, 20, 21, 22
"""where each block begins"""
CALIBRATION = 12
"""the first so many are the calibration's own"""
UNITS: Mapping[str, str] = (
    dict.fromkeys(OFFSETS, "g")
    | dict.fromkeys(MATRIX, "g/g")
    | dict.fromkeys(TEMPERATURE, "g/degC")
    | dict.fromkeys(RECTIFICATION, "g/g^2")
    | {"arm_x": "m", "arm_y": "m", "gravity": "g/g", "growth": "g/g per km or h", "tilt_x": "rad", "tilt_y": "rad"}
)


@dataclass(frozen=True, slots=True)
class Prior:
    """Before the first measurement: covariance (N, N), its growth per hour (N, N), and the same covariance with the
    calibration's own parameters nearly unknown; all in the order of `NAMES`. `ref_c`: where the coefficients of
    temperature are zero; None: at the first temperature seen. `stated` (12, 12): of the calibration's parameters by
    the record alone."""

    covariance: Array
    process_noise: Array
    wide: Array
    stated: Array
    ref_c: float | None
    noise: StatedNoise


def prior_of_record(record: CalibrationRecord, noise: StatedNoise = STATED, policy: WatchPolicy = POLICY) -> Prior:
    """What a record says before the tool goes down. Raises InputError for one without a correction of all attitudes
    (zones of inclination alone)."""
    zone = global_zone(record)
    trust = temperature_trust(record)
    per_c = _temperature_std(zone, 0.0 if trust is None else trust.growth_g_per_c, noise)
    reference = zone.temperature.ref_c if zone.temperature is not None else None
    if reference is None and trust is not None:
        reference = 0.5 * (trust.min_c + trust.max_c)
    return prior(_calibration_covariance(zone), per_c, reference, noise, policy)


def prior(
    calibration: Array, temperature_g_per_c: float, ref_c: float | None, noise: StatedNoise, policy: WatchPolicy
) -> Prior:
    """From the covariance (12, 12) of b and S (row by row), g^2, and the standard deviation of the coefficients."""
    own = calibration + np.diag([noise.repeat_g**2] * 3 + [noise.repeat**2] * 9)
    beside = np.array(
        [temperature_g_per_c] * 3
        + [noise.rectification_per_g] * 3
        + [noise.arm_m] * 2
        + [noise.gravity_g, noise.gravity_per_h]
        + [noise.tilt_rad] * 2
    )
    covariance = np.zeros((SIZE, SIZE))
    covariance[:CALIBRATION, :CALIBRATION] = own
    covariance[range(CALIBRATION, SIZE), range(CALIBRATION, SIZE)] = beside**2
    wide = covariance.copy()
    wide[:CALIBRATION, :CALIBRATION] = _wide(policy.wide) + 1e-12 * np.eye(CALIBRATION)
    process_noise = np.zeros((SIZE, SIZE))
    rates = [noise.offset_random_walk**2] * 3 + [noise.matrix_random_walk**2] * 9
    process_noise[range(CALIBRATION), range(CALIBRATION)] = rates
    return Prior(covariance, process_noise, wide, calibration, ref_c, noise)


def _wide(size: float) -> Array:
    """(12, 12): offsets and the symmetric part of S free within `size`. The antisymmetric part stays at zero: a hole
    cannot tell it from a toolface offset and from a bent collar."""
    out = np.zeros((CALIBRATION, CALIBRATION))
    out[:3, :3] = size**2 * np.eye(3)
    for i in range(3):
        for j in range(3):
            out[3 + 3 * i + j, 3 + 3 * i + j] += 0.5 * size**2
            out[3 + 3 * i + j, 3 + 3 * j + i] += 0.5 * size**2
    return out


def global_zone(record: CalibrationRecord) -> Zone:
    """The correction that holds at all inclinations. Raises InputError where there is none."""
    found = [zone for zone in record.result.zones if not zone.is_local]
    if found and len(record.result.zones) == 1:
        return found[0]
    raise InputError(
        f"record {record.id[:12]} corrects by zones of inclination, which the watch does not follow",
        remedy="solve the same poses with --method joint, and watch with that record",
    )


def _calibration_covariance(zone: Zone) -> Array:
    """(12, 12) of (b, S row by row) from that of (A, b) of the sensor, widening included."""
    p = zone.parameters
    whole = p.covariance if p.student is None else p.covariance + p.student
    C = zone.model().C
    names = (*OFFSET_NAMES, *MATRIX_NAMES)
    present = [name for name in names if name in p.names]
    rows = [p.names.index(name) for name in present]
    raw = np.zeros((CALIBRATION, CALIBRATION))
    to = [names.index(name) for name in present]
    raw[np.ix_(to, to)] = whole[np.ix_(rows, rows)]
    turn = np.zeros((CALIBRATION, CALIBRATION))
    turn[:3, :3] = C
    turn[3:, 3:] = np.kron(C, np.eye(3))
    return np.asarray(turn @ raw @ turn.T)


def _temperature_std(zone: Zone, growth_g_per_c: float, noise: StatedNoise) -> float:
    """Standard deviation of the offsets' coefficients, g/degC: stated where temperatures were visited, else what an
    offset is expected to drift."""
    if zone.temperature is None or not zone.max_power():
        return growth_g_per_c or 50e-6
    found = [zone.parameters.std(f"{name}@1") / zone.temperature.scale_c for name in OFFSET_NAMES]
    return float(np.hypot(max(found), noise.temperature_g_per_c))
