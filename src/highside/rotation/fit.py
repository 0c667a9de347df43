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
from highside.rotation.fourier import BEYOND_ORDER, LARGEST_ORDER, UTMOST_ORDER, auto
from highside.rotation.linear import harmonics2, polynomial9, sine
from highside.rotation.network import network
from highside.rotation.samples import Samples
from highside.rotation.unfitted_orders import RepeatedOrder, repeated_orders

FOLDS = 5
"""turns are dealt into at most so many folds"""
HELD_OUT_ROUNDING = 1.01
"""Held-out error, in that of the lower order, up to which an order that is proved otherwise is no worse. Source: of two
turns of 360 rows an order of 52 is fitted to neither half, and the errors differ by up to 0.1 %."""

GAIN = 0.98
"""Held-out error, in that of the usual range, from which orders beyond it are believed that are not proved otherwise.
Source: in 12 of 2,400 recordings of noise alone that is coloured (a first-order recursion, 0.9 from row to row), of
four and twelve turns, it fell by up to 1.1 %."""


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

    An order at the top of its range says that there is more, and so does a higher one that comes back in every turn
    (`unfitted_orders`): higher ones are tried, and kept where whole turns that the fit did not use are predicted better
    by them. BIC alone does not raise them: it takes noise that is slower than the rows for structure. Otherwise the
    remark says what is left, and why.
    """

    def fitted(part: Samples, largest_order: int) -> ErrorCurve:
        return auto(part, rate_terms=options.rate_terms, largest_order=largest_order)

    def unseen(largest_order: int) -> CrossValidation | None:
        return _cross_validated(samples, lambda part: fitted(part, largest_order))

    curve = fitted(samples, LARGEST_ORDER)
    left = _left_above(samples, curve)
    at_top = curve.order == LARGEST_ORDER and not samples.coverage.has_gap
    wanted = max((one.order for one in left if one.order <= UTMOST_ORDER), default=0)
    usual = unseen(LARGEST_ORDER) if held_out or at_top or wanted else None
    if not (at_top or wanted):
        return replace(curve, held_out=usual, remarks=(*curve.remarks, *_words_of(left)))
    if usual is None and not wanted:
        remark = (
            f"order {curve.order} is the highest of the usual range; of less than two whole turns finer structure"
            " cannot be told from noise that is slower than the rows: record more turns"
        )
        return replace(curve, remarks=(*curve.remarks, remark, *_words_of(left)))
    beyond = max(BEYOND_ORDER, wanted) if at_top else wanted
    higher = fitted(samples, beyond)
    if higher.order == curve.order:
        return replace(curve, held_out=usual, remarks=(*curve.remarks, *_words_of(left)))
    raised = unseen(beyond)
    # an order that comes back in every turn is beyond chance already: folds too short for it must not lose by it
    allowed = HELD_OUT_ROUNDING if wanted else GAIN
    if usual is not None and raised is not None and raised.rms >= allowed * usual.rms:
        taken = "the highest order of the usual range" if at_top else "order"
        why = "these rows are too few to predict it" if wanted else "what is left does not come back from turn to turn"
        remark = (
            f"{taken} ({curve.order}) was taken; orders to {higher.order} fit these rows better, but not turns that the"
            f" fit did not use ({raised.rms:.4g} against {usual.rms:.4g} rms): {why}"
        )
        return replace(curve, held_out=usual, remarks=(*curve.remarks, remark, *_words_of(left)))
    words = _words_of(_left_above(samples, higher))
    highest = higher.order == UTMOST_ORDER or (higher.order == beyond and not wanted)
    top = " and is the highest that can be tried: finer structure may be left" if highest else ""
    remark = f"order {higher.order} was taken, beyond the usual range of {LARGEST_ORDER}{top}"
    if usual is not None and raised is not None:
        remark += f"; turns not used by the fit: {raised.rms:.4g} rms against {usual.rms:.4g}"
    return replace(higher, held_out=raised, remarks=(*higher.remarks, remark, *words))


def _left_above(samples: Samples, curve: ErrorCurve) -> list[RepeatedOrder]:
    """Orders above a curve's own that come back in every turn of what it leaves."""
    return repeated_orders(samples, samples.error - curve(samples.theta_rad, samples.rate_radps), curve.order)


def _words_of(left: list[RepeatedOrder]) -> tuple[str, ...]:
    """What is left at orders above those fitted, and what to do."""
    if not left:
        return ()
    first = left[0]
    others = f" (and of {', '.join(str(one.order) for one in left[1:4])})" if len(left) > 1 else ""
    seen = f"comes back in all {first.turns} turns" if first.turns > 1 else "stands above the orders near it"
    if first.order > UTMOST_ORDER:
        advice = f"orders above {UTMOST_ORDER} are not fitted: such fine teeth belong to the encoder or the coupling"
    else:
        advice = "record more turns, with more rows a turn, for the order to be fitted"
    return (f"an error of order {first.order}, amplitude {first.amplitude:.3g}, {seen} and is left{others}: {advice}",)


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
