"""Laws beside another program's output: of each channel an offset, a factor or a delay that follows something.

No chain is known, so each channel is a search of its own. Its rows are averaged in cells: stretches of time, within
them like predictions that rise or fall, so that what a factor or a delay does keeps its shape in the means.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import Claim, DiagnosisResult, Location, Verdict
from highside.diagnosis.core.unexplained import hinted
from highside.diagnosis.law_answers import beside_laws, with_shares
from highside.diagnosis.laws.claims import ReportedLaw, reported_laws
from highside.diagnosis.laws.policy import LAW_CELLS, LAW_FLOOR
from highside.diagnosis.laws.problem import LawProblem, PlaceField
from highside.diagnosis.laws.search import Search
from highside.diagnosis.simulation.motion import MissingMotion, missing_motion, with_missing_motion
from highside.diagnosis.simulation.noise_of_sensors import white_of
from highside.diagnosis.simulation.policy import MOTION, SIMULATION_CHOICE
from highside.diagnosis.simulation.problem import SimulationProblem
from highside.diagnosis.simulation.session import RATES

UNTOUCHED = frozenset({"bad_data", "not_testable"})
SMALL = (
    "{} more that follow something are not claimed: each explains less of its channel than a prediction beside strong "
    "effects is exact to"
)
PLACES_OF_A_CHANNEL = ("channel_offset", "channel_factor", "channel_delay")


@dataclass(frozen=True)
class _ChannelLaw:
    """A law that is told of a channel: its claim with the energy that it explains, where it acts, its values (n,)."""

    channel: int
    claim: Claim
    place: Location
    part: Array


def with_channel_laws(
    problem: SimulationProblem, diagnosis: DiagnosisResult, report: ReportData
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis with the laws that the channels support beside its names."""
    if diagnosis.verdict in UNTOUCHED:
        return diagnosis, report
    left = report.after if diagnosis.claims else report.before
    names = diagnosis.claims
    given, beside = (_energy(problem, values) for values in (report.before, left))
    least = SIMULATION_CHOICE.least_product * given if names else np.zeros(given.size)
    found, few = _told(problem, left, names, beside, least)
    told, motion = _without_motion(problem, left, found)
    if few:
        diagnosis = hinted(diagnosis, SMALL.format(few))
    if not told:
        return with_missing_motion(diagnosis, motion), report
    after, parts = left.copy(), dict(report.parts)
    for one in told:
        parts[one.claim.effect] = np.zeros_like(left)
        parts[one.claim.effect][one.channel] = one.part
        after[one.channel] -= one.part
    verdict: Verdict = "named_plus" if diagnosis.claims else "law"
    fit = diagnosis.fit
    if fit is not None:
        kept = _kept(problem)
        shown = [told[0].channel]
        fit = replace(
            fit,
            unit=problem.session.units[shown[0]],
            rmse_before=float(np.sqrt(np.mean(report.before[shown][:, kept] ** 2))),
            rmse_after=float(np.sqrt(np.mean(after[shown][:, kept] ** 2))),
        )
    claims = [one.claim for one in told]
    named, laws = with_shares(names, max(float(np.sum(given - beside)), 0.0), claims)
    placed = tuple(replace(one.place, share_of_misfit=c.share or 0.0) for one, c in zip(told, laws, strict=True))
    made = replace(
        diagnosis,
        verdict=verdict,
        location=(*(diagnosis.location if names else ()), *placed),
        claims=(*named, *laws),
        fit=fit,
        remainder=beside_laws(diagnosis.remainder),
    )
    return with_missing_motion(made, motion), replace(report, after=after, parts=parts)


def _told(
    problem: SimulationProblem, left: Array, names: tuple[Claim, ...], beside: Array, least: Array
) -> tuple[list[_ChannelLaw], int]:
    """The laws of what names leave (C, n), energy `beside` (C,), that explain the least of it that counts (C,), and how
    many explain less."""
    rows, kept, found, few = _covariates(problem), _kept(problem), list[_ChannelLaw](), 0
    for c, name in enumerate(problem.session.names):
        if beside[c] - np.count_nonzero(kept) < least[c]:
            # no law of what is left could be large enough
            continue
        for one in _of_channel(problem, c, left[c], _free(problem, c, names), rows):
            law = one.law
            values = law.value([rows[covariate] for covariate in law.depends_on])
            part = values * _field(problem, c, law.place)
            energy = float(np.sum((part[kept] / problem.noise.sigma[c]) ** 2))
            if energy < least[c]:
                few += 1
                continue
            place = Location(
                (name,), " x ".join(law.depends_on), one.claim.range[:1], None, 0.0, one.claim.p_familywise
            )
            found.append(_ChannelLaw(c, replace(one.claim, share=energy), place, part))
    return found, few


def _without_motion(
    problem: SimulationProblem, left: Array, told: list[_ChannelLaw]
) -> tuple[list[_ChannelLaw], MissingMotion | None]:
    """The laws without those of channels where what they leave of `left` (C, n) is no noise of sensors and the larger
    part: a motion that is missing is there, and curves of time follow some of it."""
    after = left.copy()
    for one in told:
        after[one.channel] -= one.part
    if not told or missing_motion(problem.session, after, white_of(problem, after)) is None:
        return told, None
    count = float(np.count_nonzero(_kept(problem)))
    before, rest = (np.maximum(_energy(problem, values) - count, 0.0) for values in (left, after))
    small = rest > MOTION.larger_part * before
    # a curve of time follows some of a motion; what follows the prediction is nothing that the prediction lacks
    given = set(problem.session.names)
    stays = [not small[one.channel] or bool(given & set(one.claim.depends_on)) for one in told]
    if all(stays):
        # what a law of the larger part leaves may be what its curve lacks
        return told, None
    for one, kept in zip(told, stays, strict=True):
        if not kept:
            after[one.channel] += one.part
    staying = [one for one, kept in zip(told, stays, strict=True) if kept]
    return staying, missing_motion(problem.session, after, white_of(problem, after))


def _kept(problem: SimulationProblem) -> NDArray[np.bool_]:
    """(n,) the rows that are not left out."""
    omitted = problem.session.omitted
    return np.ones(problem.session.n, dtype=bool) if omitted is None else ~omitted


def _energy(problem: SimulationProblem, values: Array) -> Array:
    """(C,) of values (C, n) in units of the noise."""
    scaled = values[:, _kept(problem)] / np.asarray(problem.noise.sigma)[:, None]
    return np.asarray(np.sum(scaled**2, axis=1))


def _of_channel(
    problem: SimulationProblem, c: int, left: Array, free: Array, rows: dict[str, Array]
) -> tuple[ReportedLaw, ...]:
    """The laws of one channel, whose rows (n,) are what base and names leave."""
    name = problem.session.names[c]
    number, count = _cells(problem, c)
    used = number >= 0

    def mean(values: Array) -> Array:
        return np.bincount(number[used], weights=values[used], minlength=count.size) / count

    residual = mean(left)
    order = np.argsort(time := mean(problem.session.state.t_s), kind="stable")
    least = LAW_FLOOR.least * float(np.sqrt(np.mean(problem.session.readings[c] ** 2)))
    floor = floor_of_cells(left, number, problem.noise.autocorrelation(c, left.size), least)
    fields = tuple(
        PlaceField(place, name, mean(_field(problem, c, place))[order][None]) for place in PLACES_OF_A_CHANNEL
    )
    covariates = {key: mean(values)[order] for key, values in rows.items()}
    columns = np.stack([mean(row)[order] for row in free])[:, None] if len(free) else np.empty((0, 1, count.size))
    posed = LawProblem(
        residual[order][None], columns, fields, covariates, floor[order][None], time[order], None, (name,)
    )
    return tuple(reported_laws(Search(posed).run()))


def floor_of_cells(left: Array, number: NDArray[np.intp], autocorrelation: Array, least: float) -> Array:
    """(K,) standard deviation of the mean of each cell by noise of an autocorrelation (n,), 1 at no lag.

    `number` (n,) is each row's cell, -1 for none. How large the noise is say the rows (n,) of cells that have several,
    by how far they lie from the mean of theirs: in noise that is correlated they follow it, as a row follows the mean
    of few, and the mean of all is less certain than of as many that are independent. It is `least` at least.
    """
    rows = np.argsort(number, kind="stable")
    rows = rows[np.searchsorted(number[rows], 0) :]
    members = np.split(rows, np.flatnonzero(np.diff(number[rows])) + 1)
    # in variances of the noise: each row with the mean of its cell, that mean, and how far the row lies from it
    shared = [autocorrelation[np.abs(own[:, None] - own)].mean(axis=1) for own in members]
    share = np.array([float(one.mean()) for one in shared])
    away = [
        (left[own] - left[own].mean()) / np.sqrt(np.maximum(1.0 + of_mean - 2.0 * one, LAW_FLOOR.apart))
        for own, one, of_mean in zip(members, shared, share, strict=True)
        if own.size > 1
    ]
    sigma = float(np.median(np.abs(np.concatenate(away)))) / LAW_FLOOR.mad if away else float(np.std(left[rows]))
    return np.asarray(max(sigma, least) * np.sqrt(share))


def _cells(problem: SimulationProblem, c: int) -> tuple[NDArray[np.intp], Array]:
    """Number (n,) of each row's cell, -1 for a row that is left out, and the rows of each."""
    session = problem.session
    n = session.n
    kept = np.ones(n, dtype=bool) if session.omitted is None else ~session.omitted
    predicted, rising = session.predicted[c], session.slope[c] > 0
    edges = np.quantile(predicted[kept], np.linspace(0, 1, LAW_CELLS.bins + 1)[1:-1])
    level = np.searchsorted(edges, predicted)
    blocks = max(2, min(n // (2 * LAW_CELLS.bins), LAW_CELLS.most // (2 * LAW_CELLS.bins)))
    block = np.minimum(np.arange(n) * blocks // n, blocks - 1)
    key = np.where(kept, (block * LAW_CELLS.bins + level) * 2 + rising, -1)
    found, number = np.unique(key, return_inverse=True)
    number = number.reshape(-1) - int(found[0] < 0)
    return np.asarray(number, dtype=np.intp), np.bincount(number[number >= 0]).astype(float)


def _field(problem: SimulationProblem, c: int, place: str) -> Array:
    """(n,) what one unit of a law's value does to a channel."""
    session = problem.session
    if place == "channel_offset":
        return np.ones(session.n)
    return np.asarray(session.predicted[c] if place == "channel_factor" else -session.slope[c])


def _free(problem: SimulationProblem, c: int, claims: tuple[Claim, ...]) -> Array:
    """(P, n) columns on a channel of what is free and of the names.

    What of an offset, a factor and a delay follows nothing is always free: a constant is a name's to claim, and the
    mean of a law that follows something would be a second law. Beside a name the next order of the delay is free as
    well: what the linearised column of a long lag leaves would be a law of any covariate.
    """
    numbers = [int(k) for k in problem.design.base]
    claimed = {claim.effect for claim in claims}
    for candidate in problem.candidates:
        if candidate.id in claimed:
            numbers += [int(k) for variant in candidate.variants for k in variant.columns if variant.whole and k >= 0]
        numbers += [int(k) for k in problem.design.tangents.get(candidate.id, ()) if candidate.id in claimed and k >= 0]
    rows = [problem.design.column(k)[c] for k in dict.fromkeys(numbers)]
    session = problem.session
    rows += [session.predicted[c], session.slope[c]]
    if claims:
        curved = np.gradient(session.slope[c], session.state.t_s)
        rows.append(np.where(np.isfinite(curved), curved, 0.0))
    return np.stack([row for row in (np.ones(session.n), *rows) if np.any(row)])


def _covariates(problem: SimulationProblem) -> dict[str, Array]:
    """(n,) of what a law may follow: time, temperature, vibration, rates, speed and the predictions themselves."""
    session = problem.session
    found = {
        "time": session.elapsed_s,
        "temp": session.state.temp_c,
        "temp_rate": session.state.temp_rate_cps,
        "vibration": session.state.vibration_rms_g,
        **{f"rate_{axis}": np.degrees(rate) for axis, rate in session.rates.items()},
        **{
            name: row
            for name, row in zip(session.names, session.predicted, strict=True)
            # a rate that is a channel is among the rates already
            if not (name in RATES and name[1] in session.rates)
        },
    }
    if session.speed is not None:
        found["speed"] = session.speed
    return {name: np.asarray(values, dtype=float) for name, values in found.items() if np.all(np.isfinite(values))}
