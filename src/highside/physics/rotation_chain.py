"""The exact chain of a rotating sensor package, and what its faults do to roll, pitch and heading or to I and T.

A package turns on a rotor in a case (a vehicle, a turntable). The decoder takes the turn back out with the angle that
the encoder read, as if the axis were straight:

    C(case -> nav) decoded = C(case -> nav) D(t)^T M^T D0(t),        D0(t) = Rz(t),  D(t) = Rz(t + dT) Rx(dE) Ry(dI)

with D the true turn of the rotor (dI, dE, dT from the same effects that disturb a bench: wobble, encoder harmonics,
cogging, non-orthogonality, each by its `delta` at the stage POSE) and M the mounting of the package on the rotor (stage
MOUNTING). An axis tilt fixed in the case goes in between. Angles are those of aerospace, C = Rz(heading) Ry(pitch)
Rx(roll), errors are decoded - true. On a bench the vertical (base tilt, stage GRAVITY) comes before the turn.

To first order a rotation e = (ex, ey, ez) in the case's frame gives

    d roll = ex + tan(pitch) (sin(roll) ey + cos(roll) ez),   d pitch = cos(roll) ey - sin(roll) ez,
    d heading = (sin(roll) ey + cos(roll) ez) / cos(pitch):

an encoder error is pure heading in a level vehicle, and a tilted one sees part of it in roll and pitch. Fitted curves
therefore belong to the attitude at which they were fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.attitude.angles import wrap_signed
from highside.errors import InputError
from highside.physics.effect import Stage
from highside.physics.effects import get
from highside.physics.gravity import attitude_of, rotate_x, rotate_y, rotate_z, rotation_matrix, unit
from highside.physics.state import ChainState

Faults = Sequence[tuple[str, Mapping[str, float]]]
"""effects by id with their parameters; one id may come several times (wobble at several harmonics)"""


def inclination_toolface_errors(
    theta_rad: AnyArray, inc_rad: AnyArray | float, faults: Faults = ()
) -> tuple[AnyArray, AnyArray]:
    """Errors of I and T, each (N,) rad: what the package feels minus what the bench reads (I, T = theta).

    `inc_rad`: one inclination, or one an angle (N,).

    Raises InputError for an effect that does not act on a rotor.
    """
    theta = np.asarray(theta_rad, dtype=float)
    inc = np.full_like(theta, inc_rad)
    pose, vertical, mounting = rotor_faults(theta, inc, faults)
    in_rotor = rotate_z(theta + pose[2], rotate_x(pose[1], rotate_y(inc + pose[0], vertical)))
    felt_inc, felt_tf = attitude_of(mounting @ in_rotor)
    return felt_inc - inc, np.asarray(wrap_signed(felt_tf - theta))


def package_turn(theta_rad: AnyArray, inc_rad: AnyArray | float, faults: Faults = ()) -> AnyArray:
    """What a package on a rotor with faults is turned by against one on a perfect rotor: (3, 3, N).

    It maps vectors of the perfect package's frame, at rotor angles (N,) and inclination(s) as the bench reads them,
    into the real one's: gravity, the Earth's rotation, rates. A base that is not level (stage GRAVITY) tilts the
    vertical against the bench, not the package in it, and is omitted.
    """
    theta = np.asarray(theta_rad, dtype=float)
    inc = np.full_like(theta, inc_rad)
    pose, _, mounting = rotor_faults(theta, inc, faults)
    columns = []
    for axis in np.eye(3):
        in_bench = rotate_y(-inc, rotate_z(-theta, np.repeat(axis[:, None], theta.size, axis=1)))
        real = rotate_z(theta + pose[2], rotate_x(pose[1], rotate_y(inc + pose[0], in_bench)))
        columns.append(mounting @ real)
    return np.stack(columns, axis=1)


def azimuth_errors(theta_rad: AnyArray, inc_rad: AnyArray | float, faults: Faults = ()) -> AnyArray:
    """(N,) rad: azimuth of the package's axis minus that of the hole, at rotor angles (N,) and inclination(s)."""
    theta = np.asarray(theta_rad, dtype=float)
    inc = np.full_like(theta, inc_rad)
    # the package's axis in the perfect package's frame is the last row of the turn; counted from the hole's high side
    axis = rotate_z(-theta, package_turn(theta, inc, faults)[2])
    # y points to the left of the high side, looking along the hole's azimuth: an axis that leans there points down-hole
    # to the right
    level = np.sin(inc) * axis[2] - np.cos(inc) * axis[0]
    return np.asarray(np.arctan2(axis[1], level))


def rotor_faults(theta: AnyArray, inc: AnyArray, faults: Faults) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Pose increments (3, N), vertical in the bench's frame (3, 1), mounting (3, 3): the faults summed by stage."""
    state = ChainState.build(inc, theta)
    pose, vertical, mounting = np.zeros((3, theta.size)), np.array([[0.0], [0.0], [1.0]]), np.zeros(3)
    for name, values in faults:
        effect = get(name)
        p = effect.vector(values)
        if effect.stage is Stage.POSE and not effect.random:
            pose = pose + effect.delta(state, p, np.stack([inc, np.zeros_like(inc), theta]))
        elif effect.stage is Stage.GRAVITY:
            vertical = vertical + effect.delta(state, p, vertical)
        elif effect.stage is Stage.MOUNTING:
            mounting = mounting + effect.delta(state, p, np.zeros((3, 1)))[:, 0]
        else:
            raise InputError(
                f"effect '{name}' does not act on a rotor", remedy="use effects of the bench or of mounting"
            )
    return pose, unit(vertical), rotation_matrix(mounting)
