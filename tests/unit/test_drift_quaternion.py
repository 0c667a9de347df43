"""The attitude quaternions of the gravity-quaternion paper: identities of equations (1) to (6), angles, the frames."""

from __future__ import annotations

import numpy as np
import pytest

from highside.attitude import attitude_block
from highside.attitude import quaternion as quat
from highside.gyro import frames
from highside.gyro.frames import DEG_PER_HOUR
from highside.physics.effects.earth_rotation import EFFECT as EARTH_ROTATION
from highside.physics.gravity import EARTH_RATE_RADPS
from highside.physics.state import ChainState

RNG = np.random.default_rng(5)
MANY = quat.normalised(RNG.standard_normal((4, 200)))


def test_xi_is_orthonormal_and_normal_to_the_quaternion() -> None:
    for q in MANY.T[:20]:
        X = quat.xi(q)
        assert np.abs(X.T @ X - np.eye(3)).max() < 1e-12
        assert np.abs(X @ X.T - (np.eye(4) - np.outer(q, q))).max() < 1e-12
        assert np.abs(X.T @ q).max() < 1e-12


def test_omega_and_xi_say_the_same_as_the_product_with_a_rate() -> None:
    for q, w in zip(MANY.T[:20], RNG.standard_normal((20, 3)), strict=True):
        product = quat.multiply(q, np.concatenate([[0.0], w]))
        assert np.abs(quat.omega(w) @ q - product).max() < 1e-12
        assert np.abs(quat.xi(q) @ w - product).max() < 1e-12


def test_direction_cosines_turn_vectors_as_the_sandwich_does() -> None:
    v = RNG.standard_normal((3, MANY.shape[1]))
    pure = np.concatenate([np.zeros((1, v.shape[1])), v])
    turned = quat.multiply(quat.conjugate(MANY), quat.multiply(pure, MANY))[1:]
    assert np.abs(np.einsum("ijn,jn->in", quat.direction_cosines(MANY), v) - turned).max() < 1e-12
    assert np.abs(quat.direction_cosines(MANY)[:, 2] - quat.up_direction(MANY)).max() < 1e-12


def test_angles_come_back_from_their_quaternion() -> None:
    theta = np.radians(RNG.uniform(-89.9, 89.9, 500))
    phi, psi = np.radians(RNG.uniform(-179.9, 179.9, (2, 500)))
    back = quat.to_angles(quat.from_angles(theta, phi, psi))
    # near the vertical the arcsine loses digits as 1/cos(theta)
    loss = 1e-15 / np.cos(theta) + 1e-12
    for ours, given in zip(back, (theta, phi, psi), strict=True):
        assert np.all(np.abs(np.angle(np.exp(1j * (ours - given)))) < 10 * loss)


def test_a_turn_about_up_lowers_the_azimuth_and_nothing_else() -> None:
    q = quat.from_angles(0.4, -0.7, 1.1)
    turned = quat.multiply(quat.from_rotation_vector(np.array([0.0, 0.0, 0.3])), q)
    assert np.allclose(quat.to_angles(turned), (0.4, -0.7, 0.8), atol=1e-12)


def test_levelling_fits_gravity_with_the_smallest_rotation() -> None:
    up = np.array([0.3, -0.5, 0.8]) / np.sqrt(0.98)
    q = MANY[:, 0]
    levelled = quat.level(q, up)
    assert np.abs(quat.up_direction(levelled) - up).max() < 1e-12
    turn = quat.to_rotation_vector(quat.multiply(quat.conjugate(q), levelled))
    assert abs(turn @ up) < 1e-12


def test_rotation_vectors_come_back() -> None:
    r = RNG.standard_normal((3, 50))
    # a vector longer than half a turn comes back as the shorter way round
    r *= np.minimum(1.0, 3.0 / np.linalg.norm(r, axis=0))
    assert np.abs(quat.to_rotation_vector(quat.from_rotation_vector(r)) - r).max() < 1e-12
    assert np.abs(quat.to_rotation_vector(quat.IDENTITY)).max() == 0.0


def test_the_tool_frame_sees_the_inclination_and_toolface_of_the_rest_of_the_product() -> None:
    inc, tf, azi = RNG.uniform(0.1, 3.0, 50), RNG.uniform(0.0, 6.28, 50), RNG.uniform(0.0, 6.28, 50)
    q = frames.quaternion(inc, tf, azi)
    ours = attitude_block(frames.to_tool(quat.up_direction(q)))
    assert np.abs(ours[0] - inc).max() < 1e-12
    assert np.abs(ours[1] - tf).max() < 1e-12
    for back, given in zip(frames.attitude(q), (inc, tf, azi), strict=True):
        assert np.abs(back - given).max() < 1e-12
    v = RNG.standard_normal((3, 4))
    assert np.array_equal(frames.to_body(frames.to_tool(v)), v)


def test_the_earth_rate_is_that_of_the_effect_library() -> None:
    latitude, azimuth = 0.6, 2.0
    inc, tf = np.array([0.7, 1.3]), np.array([0.2, 4.0])
    state = ChainState.build(inc, tf, latitude_rad=latitude, azimuth_rad=azimuth)
    library = EARTH_ROTATION.basis(state, np.zeros((3, 2)))[0]
    C = quat.direction_cosines(frames.quaternion(inc, tf, np.full(2, azimuth)))
    ours = frames.to_tool(np.einsum("ijn,j->in", C, frames.earth_rate(latitude)))
    assert np.abs(library - ours).max() < 1e-18
    assert frames.EARTH_RATE_RADPS == EARTH_RATE_RADPS
    assert pytest.approx(15.041067, rel=1e-6) == EARTH_RATE_RADPS / DEG_PER_HOUR
    assert not frames.earth_rate(None).any()
