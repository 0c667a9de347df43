"""What faults of a rotor do to roll, pitch, heading, I and T: the exact chain, small-angle figures, the bench."""

from __future__ import annotations

import numpy as np
import pytest

from highside.arrays import AnyArray
from highside.attitude.angles import wrap_signed
from highside.attitude.quaternion import direction_cosines, to_body
from highside.errors import InputError
from highside.gyro.frames import quaternion
from highside.physics.forward import ForwardModel
from highside.physics.gravity import attitude_of, gravity_direction, rotate_x, rotate_y, rotate_z, rotation_matrix
from highside.physics.rotation_chain import (
    Faults,
    azimuth_errors,
    inclination_toolface_errors,
    package_turn,
    rotor_faults,
)
from highside.physics.state import ChainState

MINUTE = np.radians(1.0 / 60.0)
THETA = np.arange(720) * (2 * np.pi / 720)


def attitude_errors(
    theta_rad: AnyArray,
    faults: Faults = (),
    *,
    axis_tilt_rad: tuple[float, float] = (0.0, 0.0),
    roll_rad: float = 0.0,
    pitch_rad: float = 0.0,
    heading_rad: float = 0.0,
) -> AnyArray:
    """Errors of roll, pitch and heading, (3, N) rad, decoded - true, at rotor angles (N,) as the encoder reads them.

    `axis_tilt_rad`: rotation of the rotor's axis about the case's x and y. Raises InputError for an effect that does
    not act on a rotor.
    """
    theta = np.asarray(theta_rad, dtype=float)
    pose, _, mounting = rotor_faults(theta, np.zeros_like(theta), faults)
    tilt = rotation_matrix(np.array([*axis_tilt_rad, 0.0]))
    case = _from_angles(roll_rad, pitch_rad, heading_rad)
    # columns of D(t)^T M^T D0(t): what the unit vectors of the case become
    columns = []
    for axis in np.eye(3):
        rotor = mounting.T @ rotate_z(theta, axis[:, None])
        turned = rotate_y(-pose[0], rotate_x(-pose[1], rotate_z(-theta - pose[2], rotor)))
        columns.append(case @ tilt @ turned)
    decoded = _angles(np.stack(columns, axis=1))
    true = np.array([roll_rad, pitch_rad, heading_rad])[:, None]
    return np.asarray(wrap_signed(decoded - true))


def _from_angles(roll_rad: float, pitch_rad: float, heading_rad: float) -> AnyArray:
    """C = Rz(heading) Ry(pitch) Rx(roll), (3, 3)."""
    identity = np.eye(3)
    return rotate_z(np.asarray(heading_rad), rotate_y(np.asarray(pitch_rad), rotate_x(np.asarray(roll_rad), identity)))


def _angles(C: AnyArray) -> AnyArray:
    """Roll, pitch, heading (3, N) of matrices (3, 3, N)."""
    roll = np.arctan2(C[2, 1], C[2, 2])
    pitch = np.arctan2(-C[2, 0], np.hypot(C[2, 1], C[2, 2]))
    heading = np.arctan2(C[1, 0], C[0, 0])
    return np.stack([roll, pitch, heading])


def harmonics(error: np.ndarray) -> np.ndarray:
    """Mean and amplitudes of harmonics 1 to 3, (3, 4), in arcminutes."""
    spectrum = np.fft.rfft(error / MINUTE, axis=-1) / error.shape[-1]
    return np.column_stack([spectrum[:, 0].real, *(2 * np.abs(spectrum[:, k]) for k in (1, 2, 3))])


def test_an_axis_tilted_in_the_case_is_a_constant() -> None:
    found = harmonics(attitude_errors(THETA, axis_tilt_rad=(MINUTE, -MINUTE)))
    assert np.allclose(found[:2, 0], [1.0, -1.0], atol=1e-3)
    assert np.allclose(found[2], 0.0, atol=1e-3)
    assert np.allclose(found[:, 1:], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    "fault",
    [("mounting", {"tilt_x": MINUTE}), ("wobble", {"ck": MINUTE, "tk": MINUTE, "k": 1.0})],
    ids=["non-orthogonal", "regular wobble"],
)
def test_a_tilt_that_turns_with_the_rotor_is_a_first_harmonic_of_roll_and_pitch(
    fault: tuple[str, dict[str, float]],
) -> None:
    found = harmonics(attitude_errors(THETA, [fault]))
    assert np.allclose(found[:2, 1], 1.0, atol=1e-3)
    assert np.all(np.abs(found[2]) < 3e-4)


def test_of_heading_it_is_a_second_harmonic_of_second_order_only() -> None:
    small = harmonics(attitude_errors(THETA, [("mounting", {"tilt_x": MINUTE})]))
    large = harmonics(attitude_errors(THETA, [("mounting", {"tilt_x": 60 * MINUTE})]))
    assert small[2, 2] == pytest.approx(7.3e-5, rel=0.02)
    assert large[2, 2] == pytest.approx(0.262, rel=0.005)
    assert large[2, 1] < 1e-6


def test_in_a_pitched_vehicle_the_tilt_reaches_heading() -> None:
    attitude = {"pitch_rad": np.radians(30.0), "roll_rad": np.radians(20.0)}
    found = harmonics(attitude_errors(THETA, [("mounting", {"tilt_x": MINUTE})], **attitude))
    assert np.allclose(found[:, 1], [1.02, 0.94, 0.39], atol=0.006)


def test_a_bearing_that_wobbles_twice_a_turn_is_a_second_harmonic_of_roll_and_pitch() -> None:
    found = harmonics(attitude_errors(THETA, [("wobble", {"ck": 0.3 * MINUTE, "tk": 0.3 * MINUTE, "k": 2.0})]))
    assert np.allclose(found[:2, 2], 0.3, atol=1e-3)
    assert np.all(np.abs(found[2]) < 1e-3)


def test_an_eccentric_encoder_is_pure_heading_in_a_level_vehicle_and_shows_elsewhere_in_a_tilted_one() -> None:
    fault: Faults = [("encoder_first_harmonic", {"s1": MINUTE})]
    level = harmonics(attitude_errors(THETA, fault))
    assert level[2, 1] == pytest.approx(1.0, abs=1e-3)
    assert np.allclose(level[:2], 0.0, atol=1e-9)
    tilted = harmonics(attitude_errors(THETA, fault, pitch_rad=np.radians(5.0), roll_rad=np.radians(10.0)))
    assert np.allclose(tilted[:2, 1], [0.09, 0.17], atol=0.005)


def test_an_oval_disc_and_a_coarse_drive_are_their_harmonics_of_heading() -> None:
    found = harmonics(
        attitude_errors(THETA, [("encoder_second_harmonic", {"s2": MINUTE}), ("cogging", {"ck": 0.5 * MINUTE, "k": 3})])
    )
    assert np.allclose(found[2, 1:], [0.0, 1.0, 0.5], atol=1e-3)


def test_inclination_and_toolface_are_those_of_the_bench_model() -> None:
    faults: Faults = [
        ("encoder_first_harmonic", {"c1": 3e-4, "s1": -2e-4}),
        ("encoder_second_harmonic", {"c2": 1e-4}),
        ("wobble", {"ck": 1e-4, "sk": 5e-5, "dk": -8e-5, "tk": 1e-4, "k": 2.0}),
        ("axis_nonorthogonality", {"eps": 3e-4}),
        ("base_tilt", {"tilt_x": 2e-4, "tilt_y": -3e-4}),
        ("mounting", {"tilt_x": 1e-3, "tilt_y": -5e-4, "roll": 2e-4}),
    ]
    inc = np.radians(35.0)
    d_inc, d_tf = inclination_toolface_errors(THETA, inc, faults)
    model = ForwardModel.of(faults)
    felt = model.predict(ChainState.build(np.full(THETA.size, inc), THETA))
    felt_inc, felt_tf = attitude_of(np.asarray(felt))
    assert np.allclose(inc + d_inc, felt_inc, atol=1e-12)
    assert np.allclose(np.exp(1j * (THETA + d_tf)), np.exp(1j * felt_tf), atol=1e-12)


def test_the_azimuth_is_that_of_the_axis_of_the_turned_package() -> None:
    faults = [
        ("encoder_first_harmonic", {"c1": 6e-3, "s1": -4e-3}),
        ("wobble", {"ck": 3e-3, "sk": 1e-3, "dk": -2e-3, "tk": 2e-3, "k": 2.0}),
        ("mounting", {"tilt_x": 4e-3, "tilt_y": -2e-3}),
    ]
    theta, inc, azi = np.linspace(0.0, 6.2, 40), np.full(40, np.radians(35.0)), np.radians(200.0)
    turn = package_turn(theta, inc, faults)
    felt_inc, felt_tf = attitude_of(np.einsum("ijn,jn->in", turn, gravity_direction(inc, theta)))
    d_inc, d_tf = inclination_toolface_errors(theta, inc, faults)
    assert np.allclose(felt_inc, inc + d_inc, atol=1e-12)
    assert np.allclose(np.sin(felt_tf - theta - d_tf), 0.0, atol=1e-12)
    # by way of the navigation frame: East, North, Up
    to_body_frame = direction_cosines(quaternion(inc, theta, azi))
    east, north, _ = -np.einsum("ijn,in->jn", to_body_frame, to_body(turn[2]))
    found = azimuth_errors(theta, inc, faults)
    assert np.allclose(np.sin(np.arctan2(east, north) - azi - found), 0.0, atol=1e-12)
    # a mounting of 4.5 mrad is 4.5 / sin I of azimuth; the encoder does not move the axis
    only = azimuth_errors(theta, inc, faults[2:])
    assert np.abs(only).max() == pytest.approx(np.hypot(4e-3, 2e-3) / np.sin(inc[0]), rel=0.02)
    assert np.abs(azimuth_errors(theta, inc, faults[:1])).max() < 1e-12


def test_without_faults_there_is_no_error() -> None:
    assert np.allclose(attitude_errors(THETA, pitch_rad=0.4, roll_rad=-0.2, heading_rad=2.0), 0.0, atol=1e-12)


def test_an_effect_that_is_not_of_a_rotor_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="'scale' does not act on a rotor"):
        attitude_errors(THETA, [("scale", {"s_x": 1e-3})])
