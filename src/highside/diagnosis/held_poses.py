"""What rows do while a pose is held, before the poses are diagnosed by their means.

Laws of the time since the last move are found in the rows, and what they do is taken out of these; the means of what
remains are diagnosed as ever, and the laws stand beside what is found there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import DiagnosisResult, Fit, Verdict
from highside.diagnosis.law_answers import beside_laws, with_shares
from highside.diagnosis.laws.claims import ReportedLaw, heldout_of
from highside.diagnosis.laws.course import HeldRows
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.since_move import laws_since_move, without_laws
from highside.diagnosis.poses.session import PoseSession, rows_of_poses
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

Ints = NDArray[np.intp]
UNTOUCHED = frozenset({"bad_data", "not_testable"})


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
) -> tuple[PoseSession, SinceMove | None]:
    """The session of readings `accel` (3, N) without what follows the time since the last move; `again` makes one of
    other readings. The poses must be given by a column: else nothing says when a move ended."""
    if "pose" not in columns:
        return session, None
    rows = rows_of_poses(columns, accel)
    held = HeldRows(accel, columns["t_s"], rows)
    made = laws_since_move(held, session.state, model)
    if made is None:
        return session, None
    laws, found = made
    used = np.concatenate(rows)
    state = ChainState.from_columns({name: column[used] for name, column in columns.items()})
    left = accel.copy()
    left[:, used] = without_laws(accel[:, used], state, model, laws)
    before, after = (_about_means(values, rows) for values in (accel, left))
    return again(left), SinceMove(tuple(laws), found, before, after)


def _about_means(accel: Array, rows: Sequence[Ints]) -> float:
    square = sum(float(np.sum((accel[:, r] - accel[:, r].mean(axis=1, keepdims=True)) ** 2)) for r in rows)
    return float(np.sqrt(square / (len(accel) * sum(r.size for r in rows))))


def with_since_move(
    diagnosis: DiagnosisResult, report: ReportData, since: SinceMove | None
) -> tuple[DiagnosisResult, ReportData]:
    """A diagnosis of the means with these laws beside what it claims."""
    if since is None or diagnosis.verdict in UNTOUCHED:
        return diagnosis, report
    claims = tuple(one.claim for one in since.laws)
    names, fit = diagnosis.claims, diagnosis.fit
    if names and fit is not None:
        # the means do not show what the laws explain: mean squares of both kinds, g^2
        of_rows = since.before_g**2 - since.after_g**2
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
        remainder=diagnosis.remainder if diagnosis.claims else beside_laws(diagnosis.remainder),
    )
    return made, report
