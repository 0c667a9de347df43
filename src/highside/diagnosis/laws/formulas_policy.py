"""Thresholds of what a curve or a surface may be: its band, formulas, and products of one function of each quantity."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LawFormulasPolicy:
    """The closed forms that are tried."""

    margin: float = 6.0
    """Nats of held-out likelihood by which a formula must be ahead to be reported alone. Source: 63 of 64 that were
    so reported were right in the trial that set the method."""
    most: int = 3
    """Formulas reported side by side, at most. Source: chosen; a reader wants few."""
    places: int = 17
    """Places along a covariate at which a form may have its middle. Source: chosen; a sixteenth of the range."""
    powers: tuple[float, ...] = (1.5, 2.0, 3.0, 4.0, 5.0)
    """Powers tried. Source: those that textbooks have."""
    odd_powers: tuple[float, ...] = (0.5, 1.5, 2.0, 3.0)
    """Powers tried with the sign kept. Source: square roots of flow and friction, f|f|, cubes."""
    widths: tuple[float, ...] = (0.03, 0.06, 0.12, 0.25, 0.5, 1.0)
    """Widths and time constants tried, shares of the range. Source: chosen; steps of two."""
    narrow: int = 4
    """Of these the ones that a bump may have. Source: a wider one is a power."""
    waves: tuple[float, ...] = (1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0)
    """Waves over the range that a sine may have. Source: chosen; half a wave apart at first."""
    sampled: float = 3.0
    """Values visited over a period of a sine that is tried, at least. Source: two show no wave; one inclination of
    seven that was off was told as a sine of 2.9 values over its period."""
    unseen: float = 2.0
    """Period of a sine that is tried, in units of the widest stretch without a value, at least. Source: two values a
    period are the least that show it (Nyquist); of rates of the temperature of which none lay between -0.008 and
    +0.016 C/s a sine of a period of 0.022 C/s was told, and another session predicted worse than by nothing (law/122
    of the open world of seed bf90003a)."""
    orders: int = 12
    """Whole orders of toolface. Source: as many as groups have."""
    alike: int = 6
    """Decimals of a loss, in units of the noise's square, beyond which two forms predict alike; the lower order stands
    first then. Source: rounding, of orders that are the same readings on a grid of toolfaces."""
    centres: int = 72
    """Toolfaces of a dent. Source: chosen; half its least width apart."""
    dent_widths_deg: tuple[float, ...] = (5.0, 10.0, 20.0, 30.0)
    """Widths of a dent, deg. Source: chosen; wider ones are the sum of few orders."""
    finer: tuple[float, ...] = (-0.9, -0.7, -0.5, -0.3, -0.15, 0.0, 0.15, 0.3, 0.5, 0.7, 0.9)
    """Places tried around the best, in units of the step between places. Source: chosen."""
    closer: tuple[float, ...] = (0.65, 0.8, 0.9, 1.0, 1.15, 1.35, 1.6)
    """Factors of the best width tried around it. Source: chosen; they reach to the next width."""
    refuted: float = 1e-4
    """Chance from which a formula that leaves more than the curve is refuted: the curve follows what the formula does
    not have. Source: chosen; of a true formula one in ten thousand is left a curve, which predicts nearly as well."""
    step: float = 0.02
    """Share of the range, or of a width or period, by which a number is moved at first from the best that was tried.
    Source: chosen; half the distance between those that are tried."""
    still: float = 1e-2
    """Difference of a misfit, in units of the noise's square, from which the numbers are moved no more. Source: a
    hundredth of what a number costs."""
    moves: int = 120
    """Fits of a formula with its numbers moved, at most. Source: chosen; two numbers settle in forty to eighty."""
    between: float = 2.0
    """Times what a formula does at the values visited that it may do between them. Source: chosen; a bump midway
    between two values, its width half their distance, does 1.6. One that was touched at its foot alone had a height
    of 2.5e16 (law/036 of 66ff7ef1)."""
    between_values: int = 2000
    """Values at which that is looked at. Source: a sixtieth of the least width of a bump."""
    apart: float = 0.2
    """Share of a covariate's range without any value, from which a step within it is no formula to predict with.
    Source: chosen; a step between rates of -0.010 and +0.019 C/s, 0.62 of the range, predicted another session worse
    than nothing (law/016 of the open world of seed 8dc7ed3d)."""
    edges: int = 128
    """Places of a step. Source: chosen; about as many as a session has stretches."""


LAW_FORMULAS = LawFormulasPolicy()


@dataclass(frozen=True)
class SeparablePolicy:
    """A surface as a product of one function of each quantity."""

    turns: int = 40
    """Fits of each function in turn, at most. Source: chosen; most settle in ten."""
    settled: float = 1e-5
    """Change of the second function, as a share of it, from which the two are settled. Source: chosen; far below the
    noise of a coefficient."""


LAW_SEPARABLE = SeparablePolicy()


@dataclass(frozen=True)
class LawCurvesPolicy:
    """Its band, and where nothing was read."""

    sizes: tuple[float, ...] = (0.1, 1.0, 10.0, 100.0)
    """Sizes of the prior over which the band is taken, in units of the likeliest. Source: chosen; three values tell it
    within a factor of ten, and the largest widens the band the most."""
    unread: float = 0.2
    """Share of a covariate's range without a reading from which the report says so. Source: chosen, as
    `LawFormulasPolicy.apart`; of twelve values drawn at random the widest stretch is a quarter."""


LAW_CURVES = LawCurvesPolicy()
