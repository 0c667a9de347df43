"""Whether another session confirms what a model took up from the first: the share of each law and effect in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from highside.api.bench import ModelLike, model_of
from highside.api.diagnosis import rows_of
from highside.api.simulation import ACCELEROMETERS, GYROS, state_of
from highside.arrays import Array
from highside.config.model import Model
from highside.diagnosis.recording import GYRO_FREE
from highside.errors import InputError
from highside.physics.effect import Effect
from highside.physics.effects import title_of
from highside.physics.forward import ForwardModel
from highside.physics.law import LawEffect
from highside.physics.state import ChainState
from highside.recording.frames import Columns, File, FrameT
from highside.recording.table import Recording
from highside.shown.card import card
from highside.shown.panel import PlotLine, PlotPanel
from highside.shown.plot import Plot
from highside.special import stdtrit

__all__ = ["Confirmation", "ConfirmedClaim", "confirm"]

BLOCKS = 30
"""Blocks of rows that err together (whole poses, or stretches of a rotation), at most. Source: chosen; blocks of a
thirtieth of a session leave little correlation between them, and an interval of 30 is 4 % wider than one of many"""
LEAST_BLOCKS = 6
"""fewer leave no error to judge by"""
CONCLUSIVE = 0.5
"""Half width of a share's interval beyond which the session does not vary what the claim follows: neither all of it nor
none of it is ruled out. Source: an interval of +-0.5 just parts 0 from 1"""
ENOUGH = 0.5
"""Least share, and most excess over 1, of a claim that is confirmed: most of it is there again. Source: chosen"""

NOTHING_OF_ITS_OWN = 1e-8
"""Share of a claim's square beside what is free, from which on its size is rounding. Source: the square of 1e-4, by
which a first-order column departs from what an effect of 100 ppm does"""

ShareVerdict = Literal["confirmed", "not_confirmed", "not_varied"]
WORDS: dict[ShareVerdict, str] = {
    "confirmed": "confirmed",
    "not_confirmed": "not confirmed",
    "not_varied": "this session does not vary it enough to say",
}


@dataclass(frozen=True)
class ConfirmedClaim:
    """A claim in another session: `share` of it that is there again (1: all of it), with its 95 % interval."""

    claim: str
    title: str
    share: float
    low: float
    high: float
    verdict: ShareVerdict
    visited: float
    """share of the rows within the range in which a law was learnt; 1 of an effect"""

    def in_words(self) -> str:
        """One line."""
        if self.verdict == "not_varied":
            return f"{self.claim} ({self.title}): {WORDS[self.verdict]}"
        beyond = f"; {100 * (1 - self.visited):.0f} % of the rows lie beyond what it was learnt in"
        return (
            f"{self.claim} ({self.title}): {WORDS[self.verdict]}, {100 * self.share:.0f} % of it"
            f" ({100 * self.low:.0f} to {100 * self.high:.0f} %){beyond if self.visited < 0.995 else ''}"
        )


@dataclass(frozen=True)
class Confirmation:
    """What a session says of the claims of a model."""

    claims: tuple[ConfirmedClaim, ...]
    rows: int

    @property
    def confirmed(self) -> bool:
        """Whether no claim is refuted, and one at least is confirmed."""
        verdicts = {claim.verdict for claim in self.claims}
        return "confirmed" in verdicts and "not_confirmed" not in verdicts

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        claims = [
            {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in vars(claim).items()}
            for claim in self.claims
        ]
        return {"rows": self.rows, "claims": claims}

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        rows = [[c.claim, f"{c.share:.2f} ({c.low:.2f} to {c.high:.2f})", WORDS[c.verdict]] for c in self.claims]
        return card(["claim", "share", "verdict"], rows, f"{self.rows} rows")

    def plot(self) -> Plot:
        """The share of each claim that this session shows, with its 95 % interval; 1 is all of it."""
        share, low, high = (np.array([getattr(c, name) for c in self.claims]) for name in ("share", "low", "high"))
        found = PlotLine("share that is shown again", share, (high - low) / 2.0, "points")
        whole = PlotLine("all of it", np.ones(share.size), None, "dashed", "#2c9a62")
        none = PlotLine("none of it", np.zeros(share.size), None, "dashed", "#808890")
        names = tuple(claim.title for claim in self.claims)
        panel = PlotPanel(np.arange(share.size, dtype=float), (found, whole, none), "", "share", names=names)
        return Plot(f"Confirmation by another session, {self.rows} rows", (panel,))


def confirm(model: ModelLike, recording: File | Columns | FrameT) -> Confirmation:
    """Say of each law and effect of a model how much of it another session shows.

    `model`: what `Diagnosis.model` gives, its tables, or a file of it (`diagnose --write-model`). `recording`: another
    session of the same sensor, as for `diagnose`: a file, DataFrame, dict of arrays or Recording with `t_s` in s,
    `ax_g, ay_g, az_g` in g and a reference (`inc_ref_deg`, `tf_ref_deg`). What the model lets free (offset, scale,
    misalignment) is fitted anew. The shares of all claims are fitted together, each a factor of what the claim does in
    this session; their errors come from blocks of the session, so that noise which is correlated within a block widens
    them. Raises InputError for a model without claims, and for a recording that is not in order.
    """
    knows = model_of(model)
    where = None if isinstance(model, Model | dict) else str(model)
    if knows.reference.kind != "pose":
        raise InputError(
            "only a model of sessions with a reference attitude can be confirmed", where=where, field="reference.kind"
        )
    forward = knows.forward()
    claims = [(e, p) for e, p in forward.effects if not e.random and e.id not in knows.sensor.free and p.size]
    if not claims:
        raise InputError(
            "holds no law and no effect to confirm",
            where=where,
            remedy="give the model that diagnose made of what it found",
        )
    rows = rows_of(recording)
    state, kept = state_of(rows, knows)
    readings = _readings(rows, knows, kept)
    held: NDArray[np.bool_] = np.asarray(np.isfinite(readings).all(axis=0))
    if "pose" in rows.columns:
        held &= np.isfinite(rows.columns["pose"][kept])
    if not held.any():
        raise InputError("has no row with readings, reference and covariates", where=rows.source)
    state, readings = state.rows(held), readings[:, held]
    block = _blocks(state)
    if block[-1] + 1 < LEAST_BLOCKS:
        raise InputError(
            f"has {block[-1] + 1} poses or stretches, and {LEAST_BLOCKS} are needed to say how sure a share is",
            where=rows.source,
        )
    free = [*knows.sensor.free, *(GYRO_FREE if len(readings) > 3 else ())]
    shares, spread, freedom = _shares(forward, claims, state, readings, tuple(dict.fromkeys(free)), block)
    wide = float(stdtrit(freedom, 0.975))
    found = [
        _claim(effect, float(share), wide * float(sigma), _visited(effect, state))
        for (effect, _), share, sigma in zip(claims, shares, spread, strict=True)
    ]
    return Confirmation(tuple(found), state.n)


def _claim(effect: Effect, share: float, half: float, visited: float) -> ConfirmedClaim:
    # also where nothing is determined: the half width is not finite then
    if not half <= CONCLUSIVE:
        verdict: ShareVerdict = "not_varied"
    elif share - half > 0 and abs(share - 1) <= ENOUGH:
        verdict = "confirmed"
    else:
        verdict = "not_confirmed"
    title = effect.title if isinstance(effect, LawEffect) else title_of(effect.id)
    return ConfirmedClaim(effect.id, title, share, share - half, share + half, verdict, visited)


def _readings(rows: Recording, knows: Model, kept: NDArray[np.bool_]) -> Array:
    """(3 or 6, M) readings at the rows kept, in tool axes: g, and rad/s where gyros were recorded."""
    axes = knows.tool.map
    names = [ACCELEROMETERS] + ([GYROS] if rows.has(*GYROS) else [])
    parts = []
    for own in names:
        makers = np.stack(rows.require(*own))[:, kept]
        tool = np.stack([sign * makers[axis] for axis, sign in zip(axes.order, axes.signs, strict=True)])
        parts.append(np.radians(tool) if own is GYROS else tool)
    return np.concatenate(parts)


def _blocks(state: ChainState) -> Array:
    """(N,) number of the block of each row: runs of whole poses, or of rows where there is one pose."""
    runs = np.concatenate([[0], np.cumsum(np.diff(state.pose) != 0)])
    count = int(runs[-1]) + 1
    if count == 1:
        runs, count = np.arange(state.n), state.n
    blocks = min(BLOCKS, count)
    return np.asarray(runs * blocks // count)


def _visited(effect: Effect, state: ChainState) -> float:
    """Share of the rows within what a law was learnt in."""
    if not isinstance(effect, LawEffect):
        return 1.0
    law = effect.law
    load = ForwardModel.of({}).predict(state)
    inside = np.logical_and.reduce([law.inside(law.covariates(state, load, channel)) for channel in law.channels])
    return float(np.mean(inside))


def _shares(
    forward: ForwardModel,
    claims: Sequence[tuple[Effect, Array]],
    state: ChainState,
    readings: Array,
    free: tuple[str, ...],
    block: Array,
) -> tuple[Array, Array, float]:
    """Of each claim the share in these readings and its standard error, and the degrees of freedom of the errors."""
    gyros = len(readings) > 3

    def reported(model: ForwardModel) -> Array:
        triad = model.predict(state)
        return np.concatenate([triad, model.gyro(state)]) if gyros else np.asarray(triad)

    without = forward.without(*(effect.id for effect, _ in claims))
    names = list(free)
    start = reported(without)
    signals = [reported(forward) - reported(forward.without(effect.id)) for effect, _ in claims]
    base = without.jacobian(state, names)
    if gyros:
        base = np.concatenate([base, without.gyro_jacobian(state, names)], axis=1)
    columns = np.concatenate([np.stack(signals), base])
    left = readings - start
    # each channel counts by what it scatters: once evenly, then by what is left of it
    weight = np.ones(len(readings))
    for _ in range(2):
        rows = (columns * weight[:, None]).reshape(len(columns), -1)
        solved, inverse = _solve(rows, (left * weight[:, None]).ravel())
        residual = left - np.tensordot(solved, columns, 1)
        weight = 1.0 / np.maximum(residual.std(axis=1), 1e-12)
    scores = np.stack([np.bincount(block, (c * residual * weight[:, None] ** 2).sum(axis=0)) for c in columns])
    rows = (columns * weight[:, None]).reshape(len(columns), -1)
    solved, inverse = _solve(rows, (left * weight[:, None]).ravel())
    count = scores.shape[1]
    covariance = inverse @ (scores @ scores.T) @ inverse * count / max(count - 1, 1)
    # blocks say less than white rows where few of them carry a signal: the larger of the two
    white = np.diag(inverse)
    spread = np.sqrt(np.maximum(np.diag(covariance), white))
    determined = np.array([_own_share(rows, k) > NOTHING_OF_ITS_OWN for k in range(len(claims))])
    spread[: len(claims)] = np.where(determined, spread[: len(claims)], np.inf)
    solved[: len(claims)] = np.where(determined, solved[: len(claims)], np.nan)
    return solved[: len(claims)], spread[: len(claims)], float(count - 1)


def _own_share(rows: Array, k: int) -> float:
    """Share of the square of a row (P, n) that the others do not do as well; 0 of one that does nothing."""
    others = np.delete(rows, k, axis=0)
    left = rows[k] - _solve(others, rows[k])[0] @ others
    whole = float(rows[k] @ rows[k])
    return float(left @ left) / whole if whole > 0 else 0.0


def _solve(rows: Array, target: Array) -> tuple[Array, Array]:
    """Least squares of rows (P, n), and the inverse of their inner products."""
    size = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
    unit = rows / size[:, None]
    inverse = np.linalg.pinv(unit @ unit.T, rcond=1e-10, hermitian=True) / size[:, None] / size
    return inverse @ (rows @ target), inverse
