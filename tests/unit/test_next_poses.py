"""Advice on what to measure next: poses that tell a claim from its rivals, each of them once."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.rivals import next_poses
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState


def candidate(name: str) -> Candidate:
    effect = all_effects()[name]
    return Candidate(name, effect, tuple(p.name for p in effect.parameters if not p.shape), ())


@pytest.mark.parametrize(("claim", "rival"), [("quadratic", "cubic"), ("sag", "cubic"), ("base_tilt", "misalignment")])
@pytest.mark.parametrize("one_side", [True, False])
def test_no_pose_is_advised_twice(claim: str, rival: str, one_side: bool) -> None:
    """The same pose stood up to three times among six."""
    inc, tf = np.radians([30.0, 60.0, 90.0, 120.0]).repeat(4), np.tile(np.radians([0.0, 90.0, 180.0, 270.0]), 4)
    direction = np.ones(16) if one_side else np.tile([1.0, -1.0], 8)
    state = ChainState.build(inc, tf, t_s=60.0 * np.arange(16), direction=direction)
    own = candidate(claim)
    sizes = 1e-4 * np.ones(len(own.amplitudes))
    free = ("bias", "scale", "misalignment") if rival != "misalignment" else ("bias", "scale")
    model = ForwardModel.of({name: {} for name in free})
    base = np.asarray(model.jacobian(state, list(free)), dtype=float)
    advice = next_poses(model, state, free, (own, {}, sizes), [(candidate(rival), {})], base, np.full(3, 1e5))
    places = [(i, t, d) for i, t, d in advice.poses]
    assert len(places) == 6
    assert len(set(places)) == 6
    if claim == "quadratic":
        # upright, errors of the readings are the same at every toolface
        upright = [(i, d) for i, _, d in places if i in (0.0, 180.0)]
        assert len(set(upright)) == len(upright)
    assert advice.after > advice.before
    assert not one_side or {d for _, _, d in places} == {1}
