"""The misfit of a recording step by step, in numbers: what each claim takes, what is left, the noise; and shares.

One unit for all: the rms of what is systematic, so that steps subtract. Of a channel with misfit d and noise sigma of a
row this is sqrt(mean(d^2) - sigma^2): noise alone leaves none, however many rows there are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import DiagnosisResult
from highside.report.diagnosis_claims import shares_of_fit
from highside.words import _, said_later

CHANCE_95 = 1.645
"""One-sided 95 % quantile of the normal distribution: what noise alone exceeds in one of 20 recordings."""
ALL_FOUND = said_later("all that was found")
"""Name of the one step where it is not known what each claim does by itself."""
PREFIXES = ((1.0, "g"), (1e3, "mg"), (1e6, "ug"))


@dataclass(frozen=True, slots=True)
class Steps:
    """Systematic misfit (rms over rows and channels) with ever more claims taken in.

    `levels` has K + 1 values for K `names`: the simulation as given, then with the first claim, the first two, ...
    `shares` (K,) are the parts of the mean square that each takes; `floor` is what noise alone exceeds in 5 % of
    recordings of this length.
    """

    names: tuple[str, ...]
    levels: tuple[float, ...]
    shares: tuple[float, ...]
    floor: float
    unit: str

    @property
    def left(self) -> float:
        """What all claims together leave."""
        return self.levels[-1]


def steps_of(data: ReportData) -> Steps:
    """The steps of what a report draws; claims in the order of what they take. Without parts only the misfit itself."""
    channels = range(len(data.channels))
    units = {unit_of(data, k)[1] for k in channels}
    sigmas = np.array([[sigma_of(data, k)] for k in channels])
    alike = len(units) == 1
    weights = np.ones_like(sigmas) if alike else 1.0 / sigmas
    noise = float(np.mean((weights * sigmas) ** 2))

    def excess(values: Array) -> float:
        return max(float(np.mean((weights * values) ** 2)) - noise, 0.0)

    power = {name: float(np.mean((weights * part) ** 2)) for name, part in data.parts.items()}
    if not power and not np.array_equal(data.before, data.after):
        # what each does by itself is not known
        power = {ALL_FOUND: 1.0}
    power |= data.within
    order = sorted(power, key=lambda name: -power[name])
    total = sum(power.values()) or 1.0
    shares = tuple(power[name] / total for name in order)
    # what rows do about the mean of their pose adds to what that is off by
    first, last = excess(data.before) + sum(data.within.values()), excess(data.after)
    # parts that run together do not add up in squares: what all explain is shared out by what each does alone
    taken = np.cumsum((0.0, *shares))
    squares = [first - done * max(first - last, 0.0) for done in taken]
    size = data.before.size / data.rows_per_independent
    floor = float(np.sqrt(noise * CHANCE_95 * np.sqrt(2.0 / size)))
    factor, unit = (1.0, _("times the noise of one row")) if not alike else unit_of(data, 0)
    if unit == "ug":
        top = max(np.sqrt(first), floor)
        factor, unit = next(((f, u) for f, u in PREFIXES if f * top >= 1.0), PREFIXES[-1])
    levels = tuple(factor * float(np.sqrt(max(square, 0.0))) for square in squares)
    return Steps(tuple(order), levels, shares, factor * floor, unit)


def unit_of(report_data: ReportData, channel: int) -> tuple[float, str]:
    """Factor and unit in which a channel is drawn."""
    name = report_data.channels[channel]
    if report_data.units:
        return 1.0, report_data.units[channel]
    if name in ("gx", "gy", "gz"):
        return float(np.degrees(1)), "deg/s"
    return (1e6, "ug") if name in ("ax", "ay", "az", "g_total") else (1.0, "")


def sigma_of(report_data: ReportData, channel: int) -> float:
    """The noise of one row of a channel; where none is known, the rms of what is left."""
    known = report_data.sigma[channel] if channel < len(report_data.sigma) else 0.0
    return known or float(np.sqrt(np.mean(report_data.after[channel] ** 2))) or 1.0


def shares_of_misfit(diagnosis: DiagnosisResult, steps: Steps) -> dict[str, float]:
    """Share of the whole misfit of each claim: its share of what is explained, times how much that is of all."""
    whole, left = steps.levels[0] ** 2, steps.left**2 if steps.left > steps.floor else 0.0
    explained = 1.0 - left / whole if whole > 0.0 else 0.0
    own = dict(zip(steps.names, steps.shares, strict=True))
    if len(diagnosis.claims) == 1:
        own.setdefault(diagnosis.claims[0].effect, own.get(ALL_FOUND, 0.0))
    return {
        claim.effect: explained * (own.get(claim.effect, 0.0) if claim.share is None else claim.share)
        for claim in diagnosis.claims
    }


def shares_of(diagnosis: DiagnosisResult, report_data: object) -> dict[str, float]:
    """Share of the whole misfit of each claim: of the rows where they are at hand, else of the sizes of the fit."""
    if isinstance(report_data, ReportData):
        return shares_of_misfit(diagnosis, steps_of(report_data))
    return shares_of_fit(diagnosis)
