"""One entry point to all methods, and the honest score: errors on whole turns that the fit did not use.

Rows of one turn are not independent of each other (wobble that does not repeat, drift, temperature), so leaving out
random rows flatters; whole turns are omitted instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from highside.errors import InputError
from highside.rotation.curve import CrossValidation, CurveMethod, ErrorCurve, NetworkInput
from highside.rotation.fourier import LARGEST_ORDER, UTMOST_ORDER, auto
from highside.rotation.linear import harmonics2, polynomial9, sine
from highside.rotation.network import network
from highside.rotation.samples import Samples

FOLDS = 5
"""turns are dealt into at most so many folds"""


@dataclass(frozen=True, slots=True)
class FitOptions:
    """Options of the methods that have them."""

    rate_terms: int = 0
    network_input: NetworkInput = NetworkInput.SCALED
    seed: int = 0


DEFAULTS = FitOptions()


def fit(samples: Samples, method: CurveMethod, options: FitOptions = DEFAULTS, *, held_out: bool = True) -> ErrorCurve:
    """The curve of `method`, with its held-out error where there are two whole turns or more.

    Raises InputError for an option the method does not have and Refused where the samples cannot carry the method.
    """
    if options.rate_terms and method not in (CurveMethod.POLYNOMIAL9, CurveMethod.AUTO):
        raise InputError(f"{method.value} has no rate terms", field="rate_terms", remedy="use polynomial9 or auto")
    if method is CurveMethod.AUTO:
        return _auto(samples, options, held_out=held_out)
    curve = _fit(samples, method, options)
    return replace(curve, held_out=held_out_error(samples, method, options)) if held_out else curve


def _fit(samples: Samples, method: CurveMethod, options: FitOptions) -> ErrorCurve:
    if method is CurveMethod.SINE:
        return sine(samples)
    if method is CurveMethod.HARMONICS2:
        return harmonics2(samples)
    if method is CurveMethod.POLYNOMIAL9:
        return polynomial9(samples, options.rate_terms)
    if method is CurveMethod.NETWORK:
        return network(samples, network_input=options.network_input, seed=options.seed)
    if method is CurveMethod.AUTO:
        return auto(samples, rate_terms=options.rate_terms)
    raise InputError(f"{method.value} is not fitted to a recording", remedy="use OnlineFit")


def _auto(samples: Samples, options: FitOptions, *, held_out: bool) -> ErrorCurve:
    """`auto` with as high an order as the errors support.

    An order at the top of its range says that there is more: higher ones are tried, and kept where whole turns that the
    fit did not use are predicted better by them (without two whole turns: where BIC prefers them). Otherwise the higher
    harmonics do not come back from turn to turn, and the remark says so.
    """

    def fitted(part: Samples, largest_order: int) -> ErrorCurve:
        return auto(part, rate_terms=options.rate_terms, largest_order=largest_order)

    def unseen(largest_order: int) -> CrossValidation | None:
        return _cross_validated(samples, lambda part: fitted(part, largest_order))

    curve = fitted(samples, LARGEST_ORDER)
    at_top = curve.order == LARGEST_ORDER and not samples.coverage.has_gap
    usual = unseen(LARGEST_ORDER) if held_out or at_top else None
    higher = fitted(samples, UTMOST_ORDER) if at_top else curve
    if higher.order == curve.order:
        return replace(curve, held_out=usual)
    raised = unseen(UTMOST_ORDER)
    if usual is not None and raised is not None and raised.rms >= usual.rms:
        remark = (
            f"the highest order of the usual range ({curve.order}) was taken; orders to {higher.order} fit these rows"
            f" better, but not turns that the fit did not use ({raised.rms:.4g} against {usual.rms:.4g} rms): what is"
            " left does not come back from turn to turn"
        )
        return replace(curve, held_out=usual, remarks=(*curve.remarks, remark))
    top = " and is the highest that can be tried: finer structure may be left" if higher.order == UTMOST_ORDER else ""
    remark = f"order {higher.order} was taken, beyond the usual range of {LARGEST_ORDER}{top}"
    if usual is not None and raised is not None:
        remark += f"; turns not used by the fit: {raised.rms:.4g} rms against {usual.rms:.4g}"
    return replace(higher, held_out=raised, remarks=(*higher.remarks, remark))


def held_out_error(samples: Samples, method: CurveMethod, options: FitOptions = DEFAULTS) -> CrossValidation | None:
    """Fit without each fold of whole turns in turn and score on it; None with fewer than two whole turns."""
    return _cross_validated(samples, lambda part: _fit(part, method, options))


def _cross_validated(samples: Samples, make: Callable[[Samples], ErrorCurve]) -> CrossValidation | None:
    whole = samples.whole_revolutions
    if len(whole) < 2:
        return None
    folds = min(FOLDS, len(whole))
    turn = samples.revolution
    squares, rows, worst = 0.0, 0, 0.0
    for fold in range(folds):
        out = (turn % folds == fold) & (turn <= whole[-1])
        if not out.any():
            continue
        curve = make(samples.select(~out))
        unseen = samples.select(out)
        left = unseen.error - curve(unseen.theta_rad, unseen.rate_radps)
        squares += float(left @ left)
        rows += left.size
        worst = max(worst, float(np.abs(left).max()))
    return CrossValidation(len(whole), float(np.sqrt(squares / rows)), worst)
