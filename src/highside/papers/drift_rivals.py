"""Well-kept attitude filters of others (extra `rivals`) on the same readings: vqf, ahrs, imufusion.

They know neither the Earth's rotation nor an azimuth at the start; readings are given in the body frame and in the
units that each requires. All take +1 g as up. What is not installed is omitted.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.units import STANDARD_GRAVITY_MPS2

Rival = Callable[[float, Array, Array], Array]
"""(rate in Hz, rates (3, N) rad/s, readings (3, N) g) -> quaternions (4, N), sensor to a frame with z up"""


def vqf(rate_hz: float, rates: Array, accel: Array, **parameters: Any) -> Array:
    """VQF (Laidig and Seel 2023), online, without magnetometer."""
    engine = importlib.import_module("vqf").VQF(1.0 / rate_hz, **parameters)
    found = engine.updateBatch(np.ascontiguousarray(rates.T), np.ascontiguousarray(accel.T * STANDARD_GRAVITY_MPS2))
    return np.asarray(found["quat6D"]).T


def vqf_offline(rate_hz: float, rates: Array, accel: Array) -> Array:
    """VQF forwards and backwards."""
    module = importlib.import_module("vqf")
    gyro, readings = np.ascontiguousarray(rates.T), np.ascontiguousarray(accel.T * STANDARD_GRAVITY_MPS2)
    return np.asarray(module.offlineVQF(gyro, readings, None, 1.0 / rate_hz)["quat6D"]).T


def imufusion(rate_hz: float, rates: Array, accel: Array, *, gain: float | None = None) -> Array:
    """x-io's Fusion with its gyro bias correction at rest."""
    module = importlib.import_module("imufusion")
    engine = module.Ahrs()
    if gain is not None:
        settings = module.AhrsSettings()
        settings.gain = gain
        engine.set_settings(settings)
    engine.set_sample_period(1.0 / rate_hz)
    bias = module.Bias()
    degrees, readings = np.degrees(rates.T), np.ascontiguousarray(accel.T)
    q = np.empty((degrees.shape[0], 4))
    for i in range(degrees.shape[0]):
        engine.update_no_magnetometer(bias.update(degrees[i]), readings[i])
        q[i] = np.asarray(engine.get_quaternion())
    return q.T


def ahrs(name: str, rate_hz: float, rates: Array, accel: Array, **parameters: float) -> Array:
    """`Mahony` or `Madgwick` of the package ahrs."""
    filters = importlib.import_module("ahrs").filters
    engine = getattr(filters, name)(gyr=rates.T, acc=accel.T * STANDARD_GRAVITY_MPS2, frequency=rate_hz, **parameters)
    return np.asarray(engine.Q).T


_ALL: dict[str, tuple[str, Rival]] = {
    "vqf, defaults": ("vqf", vqf),
    "vqf, tuned for turning": (
        "vqf",
        partial(vqf, biasSigmaInit=0.01, biasSigmaRest=0.003, biasForgettingTime=1000.0, biasSigmaMotion=0.01),
    ),
    "vqf, tauAcc 100, rest bias only": ("vqf", partial(vqf, tauAcc=100.0, motionBiasEstEnabled=False)),
    "imufusion with Bias": ("imufusion", imufusion),
    "ahrs Mahony, defaults": ("ahrs", partial(ahrs, "Mahony")),
    "ahrs Mahony 0.3, 1e-4": ("ahrs", partial(ahrs, "Mahony", k_P=0.3, k_I=1e-4)),
    "ahrs Madgwick, defaults": ("ahrs", partial(ahrs, "Madgwick")),
}


def installed() -> dict[str, Rival]:
    """Those that can be run here, by name."""
    return {name: run for name, (package, run) in _ALL.items() if importlib.util.find_spec(package) is not None}


def missing() -> tuple[str, ...]:
    """Packages that are not installed."""
    return tuple(sorted({package for package, _ in _ALL.values() if importlib.util.find_spec(package) is None}))
