"""Effects of the side of approach, where every pose was approached from one side, or may have been.

There they are constants, which no session can show by themselves. But a constant error of the angles is what other
effects do as well: a claim that such a constant does too is one of a class, and the other side would part the two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import columns_of
from highside.diagnosis.core.policy import RIVALS
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.diagnosis.poses.noise import PoseNoise
from highside.physics.effect import Effect
from highside.physics.effects import registry
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState


@dataclass(frozen=True)
class OneSide:
    """A session in which the side of approach does not change, or is not known to, and what it is judged by."""

    state: ChainState
    model: ForwardModel
    force: Array
    """(3, n) g"""
    base: Array
    """(P, 3, n) derivatives by what may be refitted"""
    noise: PoseNoise
    constants: tuple[Effect, ...]
    """effects of the side that are constants here"""

    def told(self, diagnosis: DiagnosisResult) -> DiagnosisResult:
        """The diagnosis with the constants that do what a claim does in that claim's class."""
        if not self.constants or not diagnosis.claims:
            return diagnosis
        return replace(diagnosis, claims=tuple(map(self._with_constants, diagnosis.claims)))

    def _with_constants(self, claim: Claim) -> Claim:
        effect = registry().get(claim.effect)
        if effect is None or effect.random:
            return claim
        values = {name: parameter.value for name, parameter in claim.parameters.items()}
        moved = np.array([values[effect.parameters[k].name] for k in effect.amplitudes])
        does = np.tensordot(moved, self._columns(effect, {p.name: values[p.name] for p in effect.shapes}), 1)
        new = [one for one in self.constants if one.id not in claim.equivalence_class]
        alike = [one for one in new if self._reproduce(does, self._columns(one, {}))]
        if not alike:
            return claim
        advice = "; ".join(one.splitter for one in alike)
        if len(claim.equivalence_class) > 1:
            advice = f"{claim.next_manoeuvre}; {advice}"
        members = (*claim.equivalence_class, *(one.id for one in alike))
        return replace(claim, equivalence_class=members, next_manoeuvre=advice)

    def _columns(self, effect: Effect, shape: dict[str, float]) -> Array:
        return columns_of(self.model, self.state, effect, shape, self.force)

    def _reproduce(self, does: Array, columns: Array) -> bool:
        """Whether base and constants leave less of what a claim does than chance hides."""
        left = outside(span(self.noise.white(np.concatenate([self.base, columns]))), self.noise.white(does))
        return float(left @ left) < RIVALS.same_class_evidence
