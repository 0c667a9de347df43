"""A shift of the clock, or a filter's lag? Both delay, and beside a real prediction the one passes for the other.

A prediction has errors of its own, and the more so the higher the frequency. In whitened rows, which count high
frequencies as much as low ones, what attenuates it fits better whatever delays it: the delay is given to a filter,
though a shift of the clock explains more of the motion itself; or a shift is shared out between a lag and an offset of
opposite signs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.fit import JointFit
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.rows.problem import RowsSelectionState
from highside.diagnosis.simulation.constancy import Constancies, stability_beside
from highside.diagnosis.simulation.design import About, SimulationDesign, Without
from highside.diagnosis.simulation.policy import SIMULATION_CHOICE
from highside.diagnosis.simulation.session import OFFSET, SKEW, SimulationSession
from highside.physics.effects.bandwidth_lag import EFFECT as BANDWIDTH_LAG

LAG = BANDWIDTH_LAG.id
DELAY_ALONE = "a shift of the clock alone explains more of the motion, or as much"
BEFORE_ITS_CAUSE = "it would have to come before its cause: its time constant would be negative"


class Scene(Constancies, Protocol):
    """What is needed of a recording beside a prediction, with its columns made about some delays."""

    @property
    def session(self) -> SimulationSession: ...
    @property
    def design(self) -> SimulationDesign: ...
    @property
    def candidates(self) -> list[Candidate]: ...
    @property
    def noise(self) -> RotationNoise: ...
    @property
    def chosen(self) -> RowsSelectionState: ...
    def fit(self, terms: Sequence[Term], noise: RotationNoise) -> JointFit: ...


Found = TypeVar("Found", bound=Scene)
Settle = Callable[[About, Without], Found]
"""Makes the columns from a start until the delays stay, without effects that are barred for a reason"""


def better_than(one: Scene, other: Scene) -> bool:
    """Whether a first choice leaves less in `one`, or as much with fewer effects."""
    sizes, left = [], []
    for scene in (one, other):
        members = scene.chosen.terms
        kept = slice(None) if scene.session.omitted is None else ~scene.session.omitted
        rest = scene.fit(members, scene.noise).residual[:, kept]
        left.append(float(np.sum(np.log(np.maximum(np.mean(rest**2, axis=1), 1e-30)))))
        sizes.append(len(members))
    if abs(left[0] - left[1]) < SIMULATION_CHOICE.alike:
        return sizes[0] < sizes[1]
    return left[0] < left[1]


def without_filter(found: Found, settle: Settle[Found]) -> Found:
    """The same, or without a filter's lag as a candidate where a shift of the clock leaves less, or as little, or where
    the lag is none that a filter could have."""
    a = found.session.alignment
    if not a.same_clock or all(found.candidates[m.candidate].id != LAG for m in found.chosen.terms):
        return found
    start: About = {OFFSET: (a.lag_s,)} if not a.rate else {OFFSET: (a.lag_s,), SKEW: (a.rate,)}
    delayed = settle(start, {LAG: DELAY_ALONE})
    if OFFSET not in delayed.design.about:
        return found
    if better_than(delayed, found):
        return delayed
    why = _no_filter(found)
    return settle(start, {LAG: why}) if why else found


def _no_filter(found: Scene) -> str:
    """Why what was chosen as a filter's lag is none, in words; empty where it may be one."""
    selection = found.chosen
    term = next(m for m in selection.terms if found.candidates[m.candidate].id == LAG)
    sizes = found.fit(selection.terms, found.noise).parameters[LAG].values()
    if any(p.high < 0.0 for p in sizes):
        return BEFORE_ITS_CAUSE
    steady = stability_beside(found, selection, term)
    return "" if steady is None or steady.stable else f"a filter's time constant is one: {steady.words}"
