"""Named effects are located along what they follow, not along what their readings happen to look like."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.core.causes import followed_covariate
from highside.physics.effects import get
from highside.physics.forward import ForwardModel
from studies import diagnosis_deck as deck

FURTHER = pytest.mark.further

STATE = deck.design()


@pytest.mark.parametrize(
    ("effect", "covariate"),
    [
        ("encoder_first_harmonic", "tf_ref_deg"),
        ("encoder_second_harmonic", "tf_ref_deg"),
        ("cogging", "tf_ref_deg"),
        ("base_tilt", "tf_ref_deg"),
        ("sag", "inc_ref_deg"),
        ("reference_twist", "inc_ref_deg"),
        ("backlash", "direction"),
        ("temperature_bias", "temp_c"),
        ("bias_drift", "t_s"),
        ("temperature_scale", None),
        ("axis_nonorthogonality", None),
    ],
)
def test_an_effect_follows_its_cause(effect: str, covariate: str | None) -> None:
    known = get(effect)
    p = known.vector({q.name: q.typical for q in known.parameters if not q.shape})
    assert followed_covariate(known, p, ForwardModel.of({}), STATE) == covariate


@pytest.mark.parametrize(
    ("effect", "covariate", "harmonic"),
    [
        pytest.param("encoder_first_harmonic", "tf_ref_deg", 1, marks=FURTHER),
        ("encoder_second_harmonic", "tf_ref_deg", 2),
        ("sag", "inc_ref_deg", None),
    ],
)
def test_a_diagnosis_tells_the_cause(effect: str, covariate: str, harmonic: int | None) -> None:
    session, _ = deck.single(STATE, effect, 400.0, seed=3)
    found = deck.diagnosed(deck.measured(session))
    assert [claim.effect for claim in found.claims] == [effect]
    place = found.location[0]
    assert (place.covariate, place.harmonic) == (covariate, harmonic)
    inc = np.degrees(STATE.inc_rad)
    first, last = (inc.min(), inc.max()) if covariate == "inc_ref_deg" else (0.0, 360.0)
    assert all(first - 1e-6 <= low < high <= last + 1e-6 for low, high in place.intervals)
