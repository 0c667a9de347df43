"""In poses a name holds at a thousand times the strength, or is refused as implausible."""

from __future__ import annotations

import pytest

from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.engine import diagnose_poses
from highside.physics.forward import ForwardModel
from studies import diagnosis_deck as deck

STATE = deck.design()


@pytest.mark.parametrize(
    ("effect", "strength"),
    [("bias_step", 1e3), ("bias_step", 1e7), ("warmup", 1e3), ("warmup", 1e7), ("sag", 1e3), ("sag", 1e7)],
)
def test_a_name_does_not_vanish_with_the_size_of_the_effect(effect: str, strength: float) -> None:
    session, _ = deck.single(STATE, effect, strength, seed=11)
    method = ProcedureParts.without("laws")
    found, _ = diagnose_poses(session, ForwardModel.of({}), deck.FREE, method=method)
    if found.verdict == "implausible_fit":
        assert effect in found.remainder.resembles
    else:
        assert found.verdict in ("named", "named_plus")
        assert effect in {name for claim in found.claims for name in claim.equivalence_class}
        assert all(claim.stable for claim in found.claims)
