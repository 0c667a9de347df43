"""Several names together must explain more than noise with memory does in the place of all of them."""

from __future__ import annotations

import pytest

from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from studies import rotation_open
from studies.rotation_open import FREE


def diagnosed(session: RotationSession) -> DiagnosisResult:
    return diagnose_rotation(session, ForwardModel.of({}), FREE, method=ProcedureParts(laws=False))[0]


@pytest.mark.parametrize("seed", [4207, 4208, 4212])
def test_names_do_not_share_a_random_walk_among_them(seed: int) -> None:
    """`coriolis` and `lever_arm`: beside either the other was needed, as both together had left no walk."""
    found = diagnosed(rotation_open.null(seed, "walk", 1200).session)
    assert found.verdict in ("not_testable", "wander")
    assert not found.claims


@pytest.mark.parametrize("seed", [23, 27])
def test_two_effects_stay_named(seed: int) -> None:
    drawn = rotation_open.mixture(seed, count=2)
    found = diagnosed(drawn.session)
    members = {name for claim in found.claims for name in claim.equivalence_class}
    assert set(drawn.truth) <= members
