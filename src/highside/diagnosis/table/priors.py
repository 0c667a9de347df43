"""What is taken for likely of an instrument before its table is observed: which effects are there, and the scatter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import Array
from highside.diagnosis.table.fit import ErrorTable, Fitted, Option
from highside.diagnosis.table.policy import EXPLAINING, POSTERIOR, TABLE_FITS


def log_prior_of_scatter(tau: Array) -> Array:
    """Logarithm of the density by log tau: of the size of a bench step, or none."""
    return np.asarray(np.log(tau / EXPLAINING.step_rad) - np.log1p((tau / EXPLAINING.step_rad) ** 2))


def log_prior_of_set(options: Sequence[Option], fitted: Fitted) -> float:
    """Each effect is there with probability `POSTERIOR.there`; one of its shapes, all of its amplitudes or some."""
    odds = float(np.log(POSTERIOR.there / (1 - POSTERIOR.there)))
    return sum(odds + log_share(options, own) for own in fitted.options)


def log_share(options: Sequence[Option], own: Option) -> float:
    """Logarithm of the probability of this variant, where its effect is there."""
    same = [option for option in options if option.effect == own.effect]
    shapes = {option.shape for option in same}
    variants = [option for option in same if option.shape == own.shape]
    largest = max(len(option.amplitudes) for option in variants)
    share = 1.0
    if len(variants) > 1:
        share = POSTERIOR.whole if len(own.amplitudes) == largest else (1 - POSTERIOR.whole) / (len(variants) - 1)
    return float(np.log(share / len(shapes)))


def covariance_with_priors(table: ErrorTable, fitted: Fitted) -> Array:
    """(P + 1, P + 1) of the values and the logarithm of the noise, with their priors."""
    mask = table.mask
    cov = fitted.covariance(table)[np.ix_(mask, mask)]
    slope = fitted.jacobian[:, mask]
    precision = table.precision(len(slope))
    precision[table.known.size : -1] = 2.0 / (POSTERIOR.size**2 + fitted.values[table.known.size :] ** 2)
    precision[-1] = TABLE_FITS.noise_log_std**-2 if table.noise_g is None else POSTERIOR.known
    return np.asarray(np.linalg.inv(slope @ np.linalg.solve(cov, slope.T) + np.diag(precision)))
