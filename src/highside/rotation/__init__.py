"""Compensation of errors that repeat with the angle of a rotor.

A rotation-modulated inertial unit, a turntable and a rotating sensor package have the same trouble: an eccentric
encoder, an oval disc, a tilted or wobbling axis put an error into roll, pitch and heading (or I and T) that is a
function of the rotor angle. Measured beside a reference, it is fitted once and subtracted ever after:

    compensated = decoded - curve(rotor angle)

Four methods are the paper's (one harmonic, two harmonics, a polynomial of degree nine, a small network); `auto` is a
Fourier series that chooses its own order, holds outliers down and shrinks where no row was; `OnlineFit` follows drift.

    samples = Samples.build(theta_rad, error)
    curve = fit(samples, Method.AUTO)
    left = error - curve(theta_rad)
"""

from highside.rotation.compensation import Compensation, Validity
from highside.rotation.curve import CrossValidation, CurveMethod, ErrorCurve, NetworkInput
from highside.rotation.fit import FitOptions, fit
from highside.rotation.fourier import auto
from highside.rotation.linear import four_positions, harmonics2, polynomial9, sine
from highside.rotation.network import network
from highside.rotation.online import OnlineFit
from highside.rotation.samples import AngleCoverage, Samples

__all__ = [
    "AngleCoverage",
    "Compensation",
    "CrossValidation",
    "CurveMethod",
    "ErrorCurve",
    "FitOptions",
    "NetworkInput",
    "OnlineFit",
    "Samples",
    "Validity",
    "auto",
    "fit",
    "four_positions",
    "harmonics2",
    "network",
    "polynomial9",
    "sine",
]
