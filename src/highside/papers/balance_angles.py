"""The arccos / arcsin / arccot forms printed in the paper: a named comparison, never used for a result.

`I = arccos(gz)` and `T` by branches of arcsin and arccot are the textbook inverse of equation 1, and unfit for a
measurement: near I = 0 and 180 deg the derivative of the arccosine is infinite, so an error e of gz becomes
`sqrt(2 e)` of angle and half of the digits are lost (1e-16 in gz is 1e-8 rad, and at I = 0.612 deg the noise of gz
counts a hundred times as much as that of gx and gy in the atan2 form). The arcsine is as bad at T = 90 and 270 deg.
The vector must be of unit length, and rounding alone can push the arguments out of [-1, 1]; they are clamped here.

The arccotangent of the paper must read gx/gy; as printed it reads gy/gx, which mirrors the angle about 45 deg.
"""

from __future__ import annotations

import math

from highside.attitude.angles import TURN


def _clamped(value: float) -> float:
    return max(-1.0, min(1.0, value))


def inclination_arccos(gz: float) -> float:
    """Inclination (rad) as `arccos(gz)` for |g| = 1."""
    return math.acos(_clamped(gz))


def toolface_arccot(gx: float, gy: float) -> float:
    """Toolface (rad, [0, 2 pi)) by the arccotangent of gx/gy, the branch by the sign of gy; singular at gy = 0.

    At gy = 0 the branch is that of gx: 0 or pi.
    """
    if gy == 0.0:
        return math.pi if gx < 0.0 else 0.0
    arccot = 0.5 * math.pi - math.atan(gx / gy)  # in (0, pi)
    return arccot if gy > 0.0 else arccot + math.pi


def toolface_arcsin(gx: float, gy: float, gz: float) -> float:
    """Toolface (rad, [0, 2 pi)) as `arcsin(gy / sin I)` with `I = arccos(gz)`, the branch by the sign of gx.

    At I = 0 the quotient does not exist: ZeroDivisionError.
    """
    half = math.asin(_clamped(gy / math.sin(inclination_arccos(gz))))
    return (half if gx >= 0.0 else math.pi - half) % TURN
