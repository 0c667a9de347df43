"""Attitude quaternions of the gravity-quaternion paper: scalar first, Hamilton product, arrays (4,) or (4, N).

`q` turns the tool's body frame b (y down-hole, z towards the high side at toolface 0, x to its right) into the
navigation frame n (East, North, Up). `direction_cosines(q)` maps n-vectors to b-vectors, so its last column is the
direction of Up (what an accelerometer at rest reports, in g) resolved in the tool frame. Three angles describe q:

    theta  elevation of the tool's down-hole axis above the horizontal, [-90, 90] deg (I = 90 deg + theta)
    phi    toolface, rotation about the tool axis
    psi    azimuth of the down-hole axis, clockwise from North
    q = q_z(-psi) (x) q_x(theta) (x) q_y(phi)

The tool frame of the product (z up-hole, x at the high side) is (x, y, z)_tool = (z, -x, -y)_body: `to_tool`,
`to_body`.

Equation numbers are those of Yang and Yang, Chinese Journal of Sensors and Actuators 30(8), 2017, 1187-1192.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from highside.arrays import Array

IDENTITY: Array = np.array([1.0, 0.0, 0.0, 0.0])


def multiply(p: Array, q: Array) -> Array:
    """Hamilton product p (x) q; (4,) and (4, N) mix."""
    return np.stack(
        np.broadcast_arrays(
            p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
            p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
            p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
            p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
        )
    )


def conjugate(q: Array) -> Array:
    """The inverse of a unit quaternion."""
    return np.stack([q[0], -q[1], -q[2], -q[3]])


def normalised(q: Array) -> Array:
    """q / |q|."""
    return np.asarray(q / np.sqrt((q * q).sum(axis=0)))


def from_rotation_vector(r: Array) -> Array:
    """exp(r): rotation by |r| rad about r, for r (3,) or (3, N)."""
    angle = np.sqrt((r * r).sum(axis=0))
    return np.concatenate([np.cos(0.5 * angle)[None], 0.5 * np.sinc(0.5 * angle / np.pi) * r])


def to_rotation_vector(q: Array) -> Array:
    """The shortest rotation vector of q in rad, (3,) or (3, N)."""
    q = np.where(q[0] < 0.0, -q, q)
    sine = np.sqrt((q[1:] * q[1:]).sum(axis=0))
    angle = 2.0 * np.arctan2(sine, q[0])
    return np.asarray(np.where(sine > 1e-12, angle / np.where(sine > 1e-12, sine, 1.0), 2.0) * q[1:])


def direction_cosines(q: Array | tuple[float, float, float, float]) -> Array:
    """Equation (2): Cnb, (3, 3) or (3, 3, N), maps n-vectors to b-vectors; its last column is Up."""
    a, b, c, d = q
    return np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c + a * d), 2 * (b * d - a * c)],
            [2 * (b * c - a * d), a * a - b * b + c * c - d * d, 2 * (c * d + a * b)],
            [2 * (b * d + a * c), 2 * (c * d - a * b), a * a - b * b - c * c + d * d],
        ]
    )


def up_direction(q: Array) -> Array:
    """Equation (4): Up (gravity's reaction) in the body frame, (3,) or (3, N)."""
    a, b, c, d = q
    return np.stack([2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d])


def omega(rate: Array) -> Array:
    """Equation (6): Omega(w), (4, 4), so that q' = Omega(w) q / 2 for a body rate w (3,)."""
    x, y, z = rate
    return np.array([[0.0, -x, -y, -z], [x, 0.0, z, -y], [y, -z, 0.0, x], [z, y, -x, 0.0]])


def xi(q: Array) -> Array:
    """Equation (6): Xi(q), (4, 3), so that q' = Xi(q) w / 2; its columns are orthonormal and normal to q."""
    a, b, c, d = q
    return np.array([[-b, -c, -d], [a, -d, c], [d, a, -b], [-c, b, a]])


def from_angles(theta: ArrayLike, phi: ArrayLike, psi: ArrayLike) -> Array:
    """Quaternion (4,) or (4, N) of elevation, toolface and azimuth in rad: the inverse of equation (3)."""
    t, f, p = np.broadcast_arrays(*(0.5 * np.asarray(angle, dtype=float) for angle in (theta, phi, psi)))
    zero = np.zeros_like(t)
    about_up = np.stack([np.cos(p), zero, zero, -np.sin(p)])
    about_x = np.stack([np.cos(t), np.sin(t), zero, zero])
    about_axis = np.stack([np.cos(f), zero, np.sin(f), zero])
    return multiply(multiply(about_up, about_x), about_axis)


def to_angles(q: Array) -> tuple[Array, Array, Array]:
    """Equation (3): elevation in [-pi/2, pi/2], toolface and azimuth in (-pi, pi], rad.

    At the vertical toolface and azimuth are degenerate: only their sum or difference means anything.
    """
    a, b, c, d = q
    theta = np.arcsin(np.clip(2 * (c * d + a * b), -1.0, 1.0))
    phi = np.arctan2(-2 * (b * d - a * c), a * a - b * b - c * c + d * d)
    psi = np.arctan2(2 * (b * c - a * d), a * a - b * b + c * c - d * d)
    return np.asarray(theta), np.asarray(phi), np.asarray(psi)


def level(q: Array, up: Array) -> Array:
    """The quaternion nearest to q (smallest rotation) whose Up is `up`, a unit vector (3,) in the body frame."""
    p = up_direction(q)
    c = np.cross(up, p)
    sine = float(np.sqrt(c @ c))
    if sine < 1e-300:
        return q
    angle = float(np.arctan2(sine, up @ p))
    return multiply(q, from_rotation_vector(c / sine * angle))


def to_body(tool: Array) -> Array:
    """Vectors (3, ...) of the tool frame in the body frame."""
    return np.stack([-tool[1], -tool[2], tool[0]])


def to_tool(body: Array) -> Array:
    """Vectors (3, ...) of the body frame in the tool frame."""
    return np.stack([body[2], -body[0], -body[1]])
