"""What the balance-correction paper predicts, as printed and as it should read.

Equation numbers are those of Cheng et al., "Balance correction and verification of IMU posture error". The paper asks
what an error dS of the calibration readings S does to a later inclination and toolface through the correction matrix
`C = W S^-1`. Exactly to first order

    dC = -C dS C          (W = I3; in general -C dS S^-1),       dG = dC M,

and equation 3 turns dG into dI and dT. The paper differentiates the cofactors of S but not its determinant, and loses
signs. The functions `printed_*` are what is printed, kept so that both can be held against a simulation; the
functions `corrected_*` are what follows. Errata:

1. The matrix printed as (14) has the magnitudes of the inverse of (10), but the elements 12, 21, 23 and 32 with the
   opposite sign.
2. With the determinant, the diagonal of dC in the conventional correction is -dSr, not +2 dSr. An equal relative error
   of the three axes turns nothing: dSr vanishes from dI and dT, and both means over a turn are zero. Even on the
   paper's own premises the factor -4 in (13) must be -2.
3. W of (17), and S of (21) and (22), have lost their minus signs. With the paper's premises (dSm common to x and y of
   all poses of the inclination, dSz common to z) `dC = -[0 0 dSm; 0 0 dSm; 0 0 dSz] / cos Ic`. That dI = 0 in (19) is
   no property of dC: the error cancels that of the reading itself (`C dM`), and only at I = Ic.
4. and 5. concern the ratios and statements drawn from the tables: see `papers.reproduce_balance`.

Angles in rad, errors of readings in g; arrays of any one shape.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from highside.arrays import Array

EXAMPLE_READINGS = np.array(
    [
        [0.9991259, 0.0038336, -0.0006875],
        [-0.0018858, 0.9988513, 0.0001215],
        [0.0008911, 0.0002816, 0.9981544],
    ]
)
"""S of (10): three normalised readings (columns) of a real high-temperature MWD accelerometer."""

PRINTED_SIGN_ERRORS = ((0, 1), (1, 0), (1, 2), (2, 1))
"""Elements (row, column) of the matrix printed as (14) that carry the wrong sign (erratum 1)."""


class AngleError(NamedTuple):
    """Errors of inclination and toolface (rad)."""

    inc_rad: Array
    tf_rad: Array


class TurnStatistics(NamedTuple):
    """Mean and peak-to-peak of an error over a full turn of toolface (rad)."""

    mean_rad: Array
    peak_to_peak_rad: Array


def matrix_error(C: Array, dS: Array, S: Array) -> Array:
    """`dC = -C dS S^-1` (3, 3): first-order error of `C = W S^-1` by errors dS of the readings S."""
    return np.asarray(-C @ dS @ np.linalg.inv(S))


def angle_error(inc: Array, tf: Array, dG: Array) -> AngleError:
    """Equation 3: errors of I and T by a small error `dG` (3, ...) of the unit gravity vector at (I, T)."""
    radial = dG[0] * np.cos(tf) + dG[1] * np.sin(tf)
    tangential = dG[1] * np.cos(tf) - dG[0] * np.sin(tf)
    return AngleError(radial * np.cos(inc) - dG[2] * np.sin(inc), tangential / np.sin(inc))


# --- conventional correction: dSr where the axis is along gravity (diagonal of dS), dS0 where it is level (elsewhere)


def printed_conventional_error(inc: Array, tf: Array, dSr: Array | float, dS0: Array | float) -> AngleError:
    """(13) as printed. Singular at T = 0 and 180 deg."""
    si, ci, st, ct = np.sin(inc), np.cos(inc), np.sin(tf), np.cos(tf)
    d_inc = (2.0 * ci * dSr - si * (ct + st) * dS0) / -si
    d_tf = -4.0 * ct / (si**2 * st) * dSr + dS0 + si * ci * (1.0 + ct**2 + st * ct) / (si**2 * st) * dS0
    return AngleError(d_inc, d_tf)


def printed_conventional_inclination(inc: Array, dSr: Array | float, dS0: Array | float) -> TurnStatistics:
    """What (13) is said to give over a turn: mean `-2 cot I dSr`, peak-to-peak `2 sqrt(2) dS0`."""
    return TurnStatistics(-2.0 / np.tan(inc) * dSr, np.abs(2.0 * np.sqrt(2.0) * dS0 * np.ones_like(inc)))


def printed_conventional_toolface_mean(inc: Array, dS0: Array | float) -> Array:
    """What (13) is said to give as the mean toolface error over a turn: `dS0`."""
    return np.asarray(dS0 * np.ones_like(inc))


def corrected_conventional_error(inc: Array, tf: Array, dS0: Array | float) -> AngleError:
    """(13) from `dC = -C dS C` with C = I3 and equation 3:

    dI = -dS0 (sin 2I sin 2T / 2 + cos 2I (cos T + sin T)),   dT = -dS0 (cos 2T + cot I (cos T - sin T)).

    Their means over a turn are zero, and dSr does not appear.
    """
    st, ct = np.sin(tf), np.cos(tf)
    d_inc = -dS0 * (0.5 * np.sin(2.0 * inc) * np.sin(2.0 * tf) + np.cos(2.0 * inc) * (ct + st))
    d_tf = -dS0 * (np.cos(2.0 * tf) + (ct - st) / np.tan(inc))
    return AngleError(d_inc, d_tf)


# --- balance correction: dSm common to x and y of the four poses, dSz common to z, taken at inclination `center`


def printed_balance_vector_error(inc: Array, tf: Array, center: float, dSm: Array | float, dSz: Array | float) -> Array:
    """(18) as printed: dG (3, ...) in g."""
    x = np.sin(inc) * np.cos(tf) * dSz - np.cos(inc) * dSm
    y = np.sin(inc) * np.sin(tf) * dSz - np.cos(inc) * dSm
    return np.asarray(2.0 * np.sin(center) ** 2 * np.stack([x, y, np.zeros_like(x)]))


def printed_balance_error(inc: Array, tf: Array, center: float, dSm: Array | float, dSz: Array | float) -> AngleError:
    """(19) as printed: dI = 0, and a toolface error said to have the mean 0. Singular at T = 0 and 180 deg."""
    si, st = np.sin(inc), np.sin(tf)
    x = si * np.cos(tf) * dSz - np.cos(inc) * dSm
    return AngleError(np.zeros_like(x), -2.0 * np.sin(center) ** 2 * x / (si * st))


def corrected_balance_matrix_error(center: float, dSm: float, dSz: float) -> Array:
    """`dC = -[0 0 dSm; 0 0 dSm; 0 0 dSz] / cos Ic` (3, 3): an error common to the four poses, in the matrix."""
    return np.outer([dSm, dSm, dSz], [0.0, 0.0, -1.0 / np.cos(center)])


def corrected_balance_vector_error(
    inc: Array, center: float, dSm: float, dSz: float, *, in_reading: bool = True
) -> Array:
    """dG (3, ...) at inclination `inc`: `d (1 - cos I / cos Ic)` with `d = [dSm, dSm, dSz]`.

    So it is for an error that the later readings have too (an offset of the sensor): zero at I = Ic, and there only.
    With `in_reading` False the calibration alone was wrong, and the error is `-d cos I / cos Ic`.
    """
    share = float(in_reading) - np.cos(inc) / np.cos(center)
    return np.asarray(np.multiply.outer(np.array([dSm, dSm, dSz]), share))


def corrected_balance_error(
    inc: Array, tf: Array, center: float, dSm: float, dSz: float, *, in_reading: bool = True
) -> AngleError:
    """(19) as it follows from `corrected_balance_vector_error` and equation 3.

    The means over a turn are `-sin I (1 - cos I / cos Ic) dSz` for I, 0 for T.
    """
    inc, tf = np.broadcast_arrays(inc, tf)
    return angle_error(inc, tf, corrected_balance_vector_error(inc, center, dSm, dSz, in_reading=in_reading))
