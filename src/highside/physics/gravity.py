"""Gravity as the tool feels it: directions on the bench, rotations, and the size of g on the Earth.

The tool frame is right-handed with z up-hole; what a triad reports at rest is the direction of the upward reaction
to gravity in units of local g, so a vertical tool reads (0, 0, 1). On a bench whose inclination stage turns by I about
the lab's y axis and whose spindle turns by T about the tool's z axis,

    G(I, T) = Rz(T) Ry(I) (0, 0, 1) = [sin I cos T, sin I sin T, cos I]                                       (eq. 1)

T, the gravity toolface, is 0 with +x at the high side and increases clockwise looking down-hole. Real benches have a
third small rotation E between the two (the spindle is not square to the stage, or wobbles) and a base that is not
level (the vertical in the lab is (tx, ty, 1)); all are kept exact: w = Rz(T) Rx(E) Ry(I) v / |v|.

Everything is vectorised: angles (N,) in rad, vectors (3, N).
"""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray

EARTH_RATE_RADPS = 7.292115e-5
GRAVITATION = 6.6743e-11
"""m3/(kg s2), CODATA 2018"""

# WGS84 (NIMA TR8350.2): equatorial gravity, Somigliana's constant, first eccentricity squared, and for the height
# the semi-major axis, flattening and the ratio of centrifugal to gravitational force at the equator
_GAMMA_E, _SOMIGLIANA_K, _ECC2 = 9.7803253359, 0.00193185265241, 0.00669437999014
_SEMI_MAJOR_M, _FLATTENING, _CENTRIFUGAL = 6378137.0, 1 / 298.257223563, 0.00344978650684


def gravity_direction(inc_rad: AnyArray, tf_rad: AnyArray) -> AnyArray:
    """G(I, T) of equation (1): (3, N) in g for angles (N,) in rad."""
    inc, tf = np.broadcast_arrays(np.asarray(inc_rad), np.asarray(tf_rad))
    s = np.sin(inc)
    return np.stack([s * np.cos(tf), s * np.sin(tf), np.cos(inc)])


def attitude_of(vector: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Inclination in [0, pi] and toolface in [0, 2 pi), both (N,) rad, of vectors (3, N): equation (2) by atan2."""
    gx, gy, gz = vector
    # 0.0 stands for an angle that rounding put at 2 pi
    tf = np.mod(np.arctan2(gy, gx), 2 * np.pi)
    return np.arctan2(np.hypot(gx, gy), gz), np.where(tf >= 2 * np.pi, 0.0, tf)


def rotate_x(angle: AnyArray, v: AnyArray) -> AnyArray:
    """Rx(angle) v, actively, right-handed; angle (N,) or scalar rad, v (3, ..., N)."""
    c, s = np.cos(angle), np.sin(angle)
    return _stacked(v[0], c * v[1] - s * v[2], s * v[1] + c * v[2])


def rotate_y(angle: AnyArray, v: AnyArray) -> AnyArray:
    """Ry(angle) v."""
    c, s = np.cos(angle), np.sin(angle)
    return _stacked(c * v[0] + s * v[2], v[1], c * v[2] - s * v[0])


def rotate_z(angle: AnyArray, v: AnyArray) -> AnyArray:
    """Rz(angle) v."""
    c, s = np.cos(angle), np.sin(angle)
    return _stacked(c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])


def _stacked(x: AnyArray, y: AnyArray, z: AnyArray) -> AnyArray:
    out = np.empty((3, *np.broadcast(x, y, z).shape), dtype=np.result_type(x, y, z))
    out[0], out[1], out[2] = x, y, z
    return out


def rotation_matrix(rotation_vector: AnyArray) -> AnyArray:
    """exp([r]x), (3, 3), of a rotation vector (3,) in rad by Rodrigues' formula; r may be complex."""
    r = np.asarray(rotation_vector)
    skew = np.array([[0 * r[0], -r[2], r[1]], [r[2], 0 * r[0], -r[0]], [-r[1], r[0], 0 * r[0]]])
    square = r[0] ** 2 + r[1] ** 2 + r[2] ** 2
    if abs(square) < 1e-8:
        # series of sin(a)/a and (1-cos a)/a^2; their next terms are below 1e-19
        first, second = 1 - square / 6 + square**2 / 120, 0.5 - square / 24 + square**2 / 720
    else:
        angle = np.sqrt(square)
        first, second = np.sin(angle) / angle, (1 - np.cos(angle)) / square
    return np.eye(3) + first * skew + second * (skew @ skew)


def unit(v: AnyArray) -> AnyArray:
    """v / |v| for (3, N), analytic (no conjugates), so that a complex step passes through."""
    return v / np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)


def bench_gravity(
    inc_rad: AnyArray, tf_rad: AnyArray, tilt_x: float = 0.0, tilt_y: float = 0.0, cross_rad: AnyArray | float = 0.0
) -> AnyArray:
    """Gravity in the tool frame, (3, N) in g, on a bench with this tilt and spindle angle error (rad).

    To first order the tilt gives I + tilt_x and T + tilt_y / sin I.
    """
    inc, tf = np.broadcast_arrays(np.asarray(inc_rad), np.asarray(tf_rad))
    vertical = unit(np.array([[tilt_x], [tilt_y], [1.0]]))
    return rotate_z(tf, rotate_x(np.asarray(cross_rad), rotate_y(inc, vertical)))


def gravity_jacobians(inc_rad: AnyArray, tf_rad: AnyArray) -> tuple[AnyArray, AnyArray]:
    """J_I = dG/dI and J_T = dG/dT of equation (1), each (3, N) in g/rad."""
    inc, tf = np.broadcast_arrays(np.asarray(inc_rad), np.asarray(tf_rad))
    si, ci, st, ct = np.sin(inc), np.cos(inc), np.sin(tf), np.cos(tf)
    return np.stack([ci * ct, ci * st, -si]), np.stack([-si * st, si * ct, np.zeros_like(si)])


def normal_gravity_mps2(latitude_rad: float, height_m: float = 0.0) -> float:
    """Gravity of the WGS84 ellipsoid: Somigliana's closed formula, height to second order (TR8350.2, eq. 4-3).

    What it omits (anomalies of rock and relief) is typically 0.3 mm/s2 (30 mGal) one sigma: see
    `normal_gravity_std_mps2`.
    """
    s2 = np.sin(latitude_rad) ** 2
    surface = _GAMMA_E * (1 + _SOMIGLIANA_K * s2) / np.sqrt(1 - _ECC2 * s2)
    along = 1 - 2 / _SEMI_MAJOR_M * (1 + _FLATTENING + _CENTRIFUGAL - 2 * _FLATTENING * s2) * height_m
    return float(surface * (along + 3 * height_m**2 / _SEMI_MAJOR_M**2))


def gravity_below_mps2(
    surface_mps2: float, latitude_rad: float, height_m: float, depth_m: float, density: float
) -> float:
    """Gravity at a depth below the ground in rock of that mean `density`, kg/m3; `height_m` of the ground.

    Poincare and Prey: the free-air growth of the way down (that of normal gravity, 3.086e-6 per s2), less twice the
    attraction of the layer that is above now instead of below, 4 pi G rho (Heiskanen and Moritz, Physical Geodesy,
    1967, section 4-3): 0.25 mg in 3 km for 2,700, 0.38 mg for 2,200 kg/m3.
    """
    free_air = normal_gravity_mps2(latitude_rad, height_m - depth_m) - normal_gravity_mps2(latitude_rad, height_m)
    return surface_mps2 + free_air - 4.0 * np.pi * GRAVITATION * density * depth_m


def normal_gravity_std_mps2(
    latitude_std_rad: float = 0.0, height_std_m: float = 0.0, latitude_rad: float = 0.0
) -> float:
    """Standard uncertainty of `normal_gravity_mps2` as local g, in m/s2: anomalies, latitude and height."""
    anomaly = 3e-4
    by_latitude = 0.0518 * abs(np.sin(2 * latitude_rad)) * latitude_std_rad
    by_height = 3.086e-6 * height_std_m
    return float(np.sqrt(anomaly**2 + by_latitude**2 + by_height**2))
