"""What claimed names do in a session: their values in its time, their sizes, what they do beyond first order."""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.core.result import Claim
from highside.diagnosis.law_sessions import LawSession
from highside.diagnosis.laws.claims import reported_laws
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.policy import LAW_VERDICT
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.names_instead import names_of
from highside.physics.forward import ForwardModel


def beyond_first_order(session: LawSession, model: ForwardModel, found: Found, residual: Array) -> Array:
    """(C, m) what names and laws do beyond first order, at the sizes that a search gave them, and what is free beside
    them: a misalignment that the base fit had put in the place of a tilt acts on the load that the tilt moved."""
    reported = reported_laws(found, model.ids)
    named = {claim.effect: values_of_claim(session, model, claim) for claim in names_of(found, model)}
    # as the search has them, at the states that stand for the rows
    first = np.sum([one.effect for one in reported], axis=0) if reported else np.zeros_like(session.floor)
    for name, values in named.items():
        table, sizes = session.effect_columns(model, name, values)
        first = first + np.tensordot(sizes - sizes_in(session, model, name), table, 1)
    changed = (model.with_effects(named) if named else model).with_laws([one.law for one in reported])
    fitted, _ = base_fit(changed, session.observed, session.free)
    return _off_free(found.problem, residual - session.residual(fitted) - first)


def shows_beyond_first_order(session: LawSession, model: ForwardModel, found: Found, residual: Array) -> Array | None:
    """(C, m) what laws and names do beyond first order, where a search would take it for laws."""
    beyond = beyond_first_order(session, model, found, residual)
    shows = float(np.sum((beyond / session.floor / found.noise.factor[:, None]) ** 2)) >= LAW_VERDICT.second_order
    return beyond if shows else None


def is_beyond_first_order(session: LawSession, model: ForwardModel, found: Found) -> bool:
    """Whether laws in the place of names do so much beyond first order."""
    return bool(found.terms) and shows_beyond_first_order(session, model, found, session.residual(model)) is not None


def is_large(session: LawSession, residual: Array) -> bool:
    """Whether tilts as large as a residual (C, m) in g, of which half the square is beyond first order, would show."""
    return float(np.sum((0.5 * residual**2 / session.floor) ** 2)) >= LAW_VERDICT.second_order


def _off_free(problem: LawProblem, values: Array) -> Array:
    """Values (C, m) without what is free in a problem, which stands for itself."""
    if not len(problem.free):
        return values
    columns = flattened(problem.free / problem.floor)
    sizes = np.linalg.lstsq(columns.T, (values / problem.floor).reshape(-1), rcond=None)[0]
    return np.asarray(values - np.tensordot(sizes, problem.free, 1))


def sizes_in(session: LawSession, model: ForwardModel, effect: str) -> Array:
    """(k,) the amplitudes of an effect in the model; zero where it lacks the effect."""
    return session.effect_columns(model, effect, model.parameters().get(effect, {}))[1]


def around_onsets(session: LawSession, model: ForwardModel, effect: str, values: dict[str, float]) -> Array:
    """(k, C, m) what an effect does more if its onset is a value earlier or later: that is searched, and not fitted."""
    epochs = [p.name for p in model.effect(effect).parameters if p.epoch]
    parts = [np.empty((0, *session.floor.shape))]
    for name in epochs:
        for step in (-session.step_s, session.step_s):
            moved = session.effect_columns(model, effect, {**values, name: values[name] + step})[0]
            parts.append(moved - session.effect_columns(model, effect, values)[0])
    return np.concatenate(parts)


def values_of_claim(session: LawSession, model: ForwardModel, claim: Claim) -> dict[str, float]:
    """The values of a claim's parameters where time is counted from the session's first value."""
    effect = model.effect(claim.effect)
    known = model.parameters().get(claim.effect, {})
    reported = np.array(
        [
            claim.parameters[p.name].value if p.name in claim.parameters else known.get(p.name, p.default)
            for p in effect.parameters
        ]
    )
    factors, later = effect.restarted(reported, session.delay_s)
    return dict(zip((p.name for p in effect.parameters), ((reported - later) / factors).tolist(), strict=True))
