"""Parts of an answer in which names and laws meet: shares, the remainder, where a law acts, names that are not told."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import Claim, DiagnosisResult, Fit, Location, Remainder
from highside.diagnosis.core.unexplained import hinted, unimproved
from highside.diagnosis.laws.claims import heldout_of
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.policy import LAW_VERDICT
from highside.physics import effects as library
from highside.physics.effects import title_of
from highside.physics.law import PREFIX, Law

COLUMNS = {
    "tf": "tf_ref_deg",
    "inc": "inc_ref_deg",
    "temp": "temp_c",
    "time": "t_s",
    "rate": "rotor_rate_dps",
    "vibration": "vibration_rms_g",
}
"""columns of a recording that covariates of laws are"""


def with_shares(
    names: Sequence[Claim], of_names: float, laws: Sequence[Claim]
) -> tuple[tuple[Claim, ...], tuple[Claim, ...]]:
    """Two sets of claims, found one after the other, with shares of all that is explained: the first have shares of
    `of_names`, what they take together; those of the second are amounts in its unit."""
    total = of_names + sum(claim.share or 0.0 for claim in laws)
    named = tuple(replace(c, share=None if c.share is None else c.share * of_names / total) for c in names)
    return named, tuple(replace(claim, share=(claim.share or 0.0) / total) for claim in laws)


def beside_laws(remainder: Remainder, claimed: Collection[str] = ()) -> Remainder:
    """What is told where laws are claimed: what they resemble, and which names have no constant size. Of names that are
    `claimed` since neither is told: beside the others their size is a constant."""
    return Remainder(
        hints=tuple(h for n, h in zip(remainder.changing, remainder.hints, strict=False) if n not in claimed),
        resembles=tuple(n for n in remainder.resembles if n in library.registry() and n not in claimed),
        changing=tuple(n for n in remainder.changing if n not in claimed),
    )


def location_of(law: Claim) -> Location:
    """Where a law acts, by the columns of a recording: along its first covariate where its curve is large."""
    along = " x ".join(COLUMNS.get(name, name) for name in law.depends_on)
    intervals: tuple[tuple[float, float], ...] = law.range[:1]
    if law.curve is not None and len(law.depends_on) == 1:
        value = np.asarray(law.curve.value) - np.median(law.curve.value)
        large = np.abs(value) >= LAW_VERDICT.large * np.abs(value).max(initial=0.0)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], large, [False]]).astype(int)))
        grid = law.curve.grid
        intervals = tuple((grid[a], grid[b - 1]) for a, b in zip(edges[::2], edges[1::2], strict=True))
    return Location(law.channels, along, intervals, None, law.share or 0.0, law.p_familywise)


def told_implausible(diagnosis: DiagnosisResult, claims: Sequence[Claim]) -> DiagnosisResult:
    """What names explain at sizes that no instrument has, with these names."""
    if len(claims) == 1:
        alike = claims[0].equivalence_class
        names = tuple(dict.fromkeys((claims[0].effect, *(n for n in alike if not n.startswith(PREFIX)))))
    else:
        names = tuple(claim.effect for claim in claims)
    others = tuple(name for name in diagnosis.remainder.resembles if name not in names)
    remainder = replace(diagnosis.remainder, resembles=(*names, *others))
    told = (" or " if len(claims) == 1 else " and ").join(map(title_of, names))
    words = f"only {told} would explain it, of a size that no instrument has"
    return hinted(replace(diagnosis, verdict="implausible_fit", remainder=remainder), words)


def told_unnamed(
    diagnosis: DiagnosisResult, report: ReportData, doubted: frozenset[str], *, left: bool = False
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis without names that a law would beat, where no law is worth its claim either, or beside which most
    of it is `left`."""
    names = sorted(doubted)
    remainder = replace(diagnosis.remainder, resembles=tuple(dict.fromkeys((*names, *diagnosis.remainder.resembles))))
    alike = " and ".join(map(title_of, names))
    words = f"it resembles {alike}, but a smooth law would explain more of it"
    if left:
        words = f"it resembles {alike}, but most of it is left"
    found = replace(diagnosis, verdict="unknown", claims=(), remainder=remainder, fit=unimproved(diagnosis.fit))
    return hinted(found, words), replace(report, after=report.before, parts={})


def explained(diagnosis: DiagnosisResult, report: ReportData) -> bool:
    """Whether no law of what the claims leave could have the least share."""
    left, given = float(np.sum(report.after**2)), float(np.sum(report.before**2))
    return bool(diagnosis.claims) and left < LAW_VERDICT.least_share * given


def fit_beside(floor_g: Array, found: Found, report: ReportData, after: Array, before: Fit | None) -> Fit:
    """What is left in g before and `after` the claims, `floor_g` (C, n) being the standard deviation of each value."""
    held = heldout_of(found)
    floor = float(np.sqrt(np.mean((found.noise.factor[:, None] * floor_g)[:3] ** 2)))
    return Fit(
        unit="g",
        rmse_before=float(np.sqrt(np.mean(report.before[:3] ** 2))),
        rmse_after=float(np.sqrt(np.mean(after[:3] ** 2))),
        heldout_rmse_before=floor * held.before,
        heldout_rmse_after=floor * held.after,
        heldout_gain_low=held.low,
        heldout_gain_high=held.high,
        noise_floor=floor,
        how_held_out=held.words,
        row_noise=None if before is None else before.row_noise,
    )


def laws_of(diagnosis: DiagnosisResult) -> tuple[Law, ...]:
    """The laws that a diagnosis claims."""
    return tuple(Law.from_dict(c.law) for c in diagnosis.claims if c.law is not None and c.effect.startswith(PREFIX))
