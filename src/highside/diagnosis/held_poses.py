"""What rows do while a pose is held, before the poses are diagnosed by their means.

Laws of the time since the last move are found in the rows, and what they do is taken out of these; the means of what
remains are diagnosed as ever, and the laws stand beside what is found there. Where a temperature, or another quantity
that is recorded, runs on while a pose is held, what the means follow may be all that the rows do: that is asked first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import DiagnosisResult, Fit, Remainder, Verdict
from highside.diagnosis.law_answers import beside_laws, with_shares
from highside.diagnosis.laws.claims import ReportedLaw, heldout_of
from highside.diagnosis.laws.course import HeldRows, less_mean
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.since_move import laws_since_move, whole_poses, without_laws
from highside.diagnosis.laws.since_move_policy import LAW_SINCE_MOVE
from highside.diagnosis.poses.session import PoseSession, rows_of_poses
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.law import Law
from highside.physics.state import KNOWN_COLUMNS, ChainState

Ints = NDArray[np.intp]
UNTOUCHED = frozenset({"bad_data"})
OPEN = frozenset({"unknown", "not_testable"})
"""verdicts of the means that say what is not known of them, which the laws of the rows do not answer"""


@dataclass(frozen=True)
class SinceMove:
    """Laws of the time since the last move, and the rms of the rows about the means of their poses, g."""

    laws: tuple[ReportedLaw, ...]
    found: Found
    before_g: float
    after_g: float


def without_since_move(
    session: PoseSession,
    columns: Mapping[str, Array],
    accel: Array,
    model: ForwardModel,
    again: Callable[[Array], PoseSession],
    diagnosed: Callable[[PoseSession], DiagnosisResult],
) -> tuple[PoseSession, SinceMove | None]:
    """The session of readings `accel` (3, N) without what follows the time since the last move; `again` makes one of
    other readings, `diagnosed` what is found in its means. The poses must be given by a column: else nothing says when
    a move ended."""
    if "pose" not in columns:
        return session, None
    rows = rows_of_poses(columns, accel)
    made = laws_since_move(HeldRows(accel, columns["t_s"], rows), session.state, model)
    if made is None:
        return session, None
    laws, found = made
    if not laws and not _runs_on(columns, rows):
        return session, None
    used = np.concatenate(rows)
    state = ChainState.from_columns({name: column[used] for name, column in columns.items()})
    if _runs_on(columns, rows):
        still = accel.copy()
        still[:, used] -= _within_poses(_claimed(diagnosed(session), model, state), rows)
        if laws_since_move(HeldRows(still, columns["t_s"], rows), session.state, model) is None:
            return again(still), None
    if not laws:
        return session, None
    held = HeldRows(accel, columns["t_s"], rows)
    left = accel.copy()
    left[:, used] = _less_laws(held, accel[:, used], state, model, laws)
    before, after = (_about_means(values, rows) for values in (accel, left))
    return again(left), SinceMove(tuple(laws), found, before, after)


def _less_laws(
    held: HeldRows, accel: Array, state: ChainState, model: ForwardModel, laws: Sequence[ReportedLaw]
) -> Array:
    """Readings (3, N) at the rows of all poses in turn, less what the laws do there.

    Of a pose that is cut short where most are held equally long the first rows may be lost: it began as many rows
    earlier as its readings say by these laws, if they say so.
    """
    lost, size, whole = np.zeros(len(held.rows), dtype=np.intp), _sizes(held), whole_poses(held)
    left = _begun_earlier(held, lost, accel, state, model, laws)
    cut = np.setdiff1d(np.arange(size.size), whole)
    if not (cut.size and whole.size):
        return left
    most = int(size[whole].max())
    tried = np.unique(np.linspace(0, max(most - int(size[cut].min()), 0), LAW_SINCE_MOVE.beginnings).astype(np.intp))
    squares = [_of_each(held, left)]
    for rows in tried[1:]:
        moved = np.where(np.isin(np.arange(size.size), cut), rows, 0)
        squares.append(_of_each(held, _begun_earlier(held, moved, accel, state, model, laws)))
    table = np.array(squares)
    chance = LAW_SINCE_MOVE.begun * float(np.mean(table[0, whole])) / (len(accel) * (most - 1))
    for k in cut:
        nearest = int(np.argmin(np.where(tried <= max(most - size[k], 0), table[:, k], np.inf)))
        lost[k] = tried[nearest] if table[0, k] - table[nearest, k] >= chance else 0
    return _begun_earlier(held, lost, accel, state, model, laws)


def _begun_earlier(
    held: HeldRows, lost: Ints, accel: Array, state: ChainState, model: ForwardModel, laws: Sequence[ReportedLaw]
) -> Array:
    """Readings (3, N) less the laws, where each pose has lost so many rows (P,) before its first."""
    first = np.cumsum(_sizes(held)) - _sizes(held)
    early = first[lost > 0]
    # a row before the first of such a pose says when that began
    order = np.sort(np.concatenate([np.arange(state.n), early]))
    begins = np.searchsorted(order, early)
    step = float(np.median(np.concatenate([np.diff(held.since(k)) for k in range(lost.size)])))
    t_s = state.t_s[order]
    t_s[begins] -= step * lost[lost > 0]
    left = without_laws(accel[:, order], replace(state.rows(order), t_s=t_s), model, laws)
    return np.delete(left, begins, axis=1)


def _sizes(held: HeldRows) -> Ints:
    return np.array([r.size for r in held.rows], dtype=np.intp)


def _of_each(held: HeldRows, values: Array) -> list[float]:
    """Sum of the squares of values (3, N) about the mean of each pose."""
    return [float(np.sum(less_mean(own) ** 2)) for own in np.split(values, np.cumsum(_sizes(held))[:-1], axis=1)]


def _runs_on(columns: Mapping[str, Array], rows: Sequence[Ints]) -> bool:
    """Whether a quantity that a law may follow changes while poses are held."""
    names = [name for name in columns if name == "temp_c" or name not in KNOWN_COLUMNS]
    return any(np.ptp(columns[name][r]) > 0.0 for name in names for r in rows)


def _claimed(diagnosis: DiagnosisResult, model: ForwardModel, state: ChainState) -> Array:
    """(3, N) g, what the names and laws of a diagnosis add to the readings at N rows."""
    names = {
        claim.effect: {name: p.value for name, p in claim.parameters.items()}
        for claim in diagnosis.claims
        if claim.law is None and not library.get(claim.effect).random
    }
    laws = [Law.from_dict(claim.law) for claim in diagnosis.claims if claim.law is not None]
    return np.asarray(model.with_effects(names).with_laws(laws).predict(state) - model.predict(state))


def _within_poses(values: Array, rows: Sequence[Ints]) -> Array:
    """Values (3, N) at the rows of all poses in turn, each pose's mean off."""
    ends = np.cumsum([r.size for r in rows])[:-1]
    return np.concatenate([less_mean(own) for own in np.split(values, ends, axis=1)], axis=1)


def _about_means(accel: Array, rows: Sequence[Ints]) -> float:
    square = sum(float(np.sum(less_mean(accel[:, r]) ** 2)) for r in rows)
    return float(np.sqrt(square / (len(accel) * sum(r.size for r in rows))))


def with_since_move(
    diagnosis: DiagnosisResult, report: ReportData, since: SinceMove | None
) -> tuple[DiagnosisResult, ReportData]:
    """A diagnosis of the means with these laws beside what it claims."""
    if since is None or diagnosis.verdict in UNTOUCHED:
        return diagnosis, report
    claims = tuple(one.claim for one in since.laws)
    names, fit = diagnosis.claims, diagnosis.fit
    # the means do not show what the laws explain: mean squares of both kinds, g^2
    of_rows = since.before_g**2 - since.after_g**2
    report = replace(report, within={c.effect: of_rows * (c.share or 0.0) for c in claims})
    if names and fit is not None:
        own_shares = [replace(c, share=(c.share or 0.0) * of_rows) for c in claims]
        names, claims = with_shares(names, max(fit.rmse_before**2 - fit.rmse_after**2, 0.0), own_shares)
    verdict: Verdict = "named_plus" if any(c.law is None for c in diagnosis.claims) else "law"
    held = heldout_of(since.found)
    floor = since.after_g
    own = Fit(
        unit="g",
        rmse_before=since.before_g,
        rmse_after=since.after_g,
        heldout_rmse_before=floor * held.before,
        heldout_rmse_after=floor * held.after,
        heldout_gain_low=held.low,
        heldout_gain_high=held.high,
        noise_floor=floor,
        how_held_out=held.words,
    )
    made = replace(
        diagnosis,
        verdict=verdict,
        claims=(*names, *claims),
        fit=diagnosis.fit if diagnosis.claims else own,
        remainder=_of_means(diagnosis),
    )
    return made, report


def _of_means(diagnosis: DiagnosisResult) -> Remainder:
    """What is still to be said of the means beside the laws of the rows."""
    if diagnosis.claims:
        return diagnosis.remainder
    made = beside_laws(diagnosis.remainder)
    return replace(made, hints=diagnosis.remainder.hints) if diagnosis.verdict in OPEN else made
