"""Multi-station analysis: what a set of surveys, all at rest, can show of the calibration they were made under.

`Watch` takes the surveys one after the other; this module says beforehand, from their attitudes, times and temperatures
alone, which departure they could have shown at all, and which ones look alike in them. Each survey measures one number,
`y_k = H_k x + e_k` (`measurement.linear_still`), of a state with covariance P that walks by W an hour; together they
have the covariance

    V_jk = H_j (P + W min(t_j, t_k)) H_k' + delta_jk.

A departure d that was there from the first survey adds `size x H d` to their mean: its Fisher information is
`d'H' V^-1 H d`, the Cramer-Rao bound of its size the root of the inverse, everything else being unknown within P and W.
Two departures look alike where their whitened signatures are nearly parallel: of twice the log-likelihood ratio
`lambda` of the true one a rival keeps `rho^2 lambda`. At the size that is found with 95 % probability those which
keep all but `WatchPolicy.same_class` are one class.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.errors import InputError
from highside.watch.bank import HYPOTHESES
from highside.watch.measurement import Still, Surroundings, linear_still
from highside.watch.parameters import CALIBRATION, GROWTH, Prior, prior
from highside.watch.policy import POLICY, STATED, StatedNoise, WatchPolicy

__all__ = ["ISCWSA_BIAS_G", "ISCWSA_SCALE", "Detectable", "detectable", "iscwsa_prior"]

ISCWSA_BIAS_G = 0.004 / 9.80665
"""standard deviation of an accelerometer's bias in the ISCWSA MWD model (ABXY, ABZ: 0.004 m/s2)"""
ISCWSA_SCALE = 5e-4
"""of its scale factor (ASXY, ASZ). The model has no misalignment within the triad; it is taken as large as this"""
ISCWSA_PER_C = 4e-6
"""g/degC: that bias over 100 degC. The model's biases are those left at any temperature of a tool in use"""
DRIFT = ("drift_x", "drift_y", "drift_z")


def iscwsa_prior(noise: StatedNoise = STATED, policy: WatchPolicy = POLICY) -> Prior:
    """Of a tool whose certificate is not at hand: one that keeps the accelerometer terms of the ISCWSA MWD model."""
    sigmas = np.array([ISCWSA_BIAS_G] * 3 + [ISCWSA_SCALE] * (CALIBRATION - 3))
    return prior(np.diag(sigmas**2), ISCWSA_PER_C, None, noise, policy)


@dataclass(frozen=True, slots=True)
class Detectable:
    """Of one departure that was there from the first survey on."""

    name: str
    unit: str
    std: float | None
    """Cramer-Rao bound of its size; None: these surveys cannot show it at all"""
    found_from: float | None
    """size that is found with 95 % probability; None where it is not or larger than any departure that is looked for"""
    alike: tuple[str, ...]
    """other departures that could not be told from it at that size"""


def detectable(stills: Sequence[Still], prior: Prior, policy: WatchPolicy = POLICY) -> tuple[Detectable, ...]:
    """What surveys at these attitudes, times, temperatures and depths could show. Raises InputError for none."""
    if not stills:
        raise InputError("no survey can be used", remedy="give surveys of a tool at rest under a calibration")
    P, H, hours = _linear(stills, prior)
    root = np.linalg.cholesky(
        H @ P @ H.T + (H @ prior.process_noise @ H.T) * np.minimum.outer(hours, hours) + np.eye(hours.size)
    )
    columns = np.array([h.direction for h in HYPOTHESES]).T
    seen = H @ columns
    seen[:, [h.name in DRIFT for h in HYPOTHESES]] *= hours[:, None]
    signatures = np.linalg.solve(root, seen)
    information = np.einsum("kh,kh->h", signatures, signatures)
    cross = signatures.T @ signatures
    need = np.sqrt(policy.threshold) + policy.power
    out = []
    for k, hypothesis in enumerate(HYPOTHESES):
        largest = information[k] * policy.largest**2
        if largest < need**2:
            std = None if information[k] * policy.largest**2 < 1.0 else float(information[k] ** -0.5)
            out.append(Detectable(hypothesis.name, hypothesis.unit, std, None, ()))
            continue
        kept = np.divide(
            cross[k] ** 2, information * information[k], out=np.zeros_like(information), where=information > 0
        )
        alike = tuple(
            other.name for j, other in enumerate(HYPOTHESES) if j != k and need**2 * (1.0 - kept[j]) < policy.same_class
        )
        std = float(information[k] ** -0.5)
        out.append(Detectable(hypothesis.name, hypothesis.unit, std, need * std, alike))
    return tuple(out)


def _linear(stills: Sequence[Still], prior: Prior) -> tuple[Array, Array, Array]:
    """P (N, N), H (K, N) whitened and the hours (K,) since the first survey."""
    hours = np.array([(one.t_s - stills[0].t_s) / 3600.0 for one in stills])
    covariance = prior.covariance.copy()
    ref_c = prior.ref_c
    if ref_c is None:
        ref_c = next((one.temp_c for one in stills if one.temp_c is not None), None)
    first_km = next((one.depth_km for one in stills if one.depth_km is not None), None)
    if first_km is not None:
        covariance[GROWTH, GROWTH] = prior.noise.gravity_per_km_std**2
    rows = []
    for one, since in zip(stills, hours, strict=True):
        warmer = 0.0 if one.temp_c is None or ref_c is None else one.temp_c - ref_c
        deeper = since if first_km is None or one.depth_km is None else one.depth_km - first_km
        rows.append(linear_still(one, Surroundings(warmer, float(deeper), 0.0), prior.noise).H[0])
    return covariance, np.array(rows), hours
