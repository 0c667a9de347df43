"""Where nobody said where the bench stands, the Earth's rotation is not a size that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from highside.api.diagnosis import _site
from highside.cli.diagnose import _known
from highside.config.model import Model
from highside.diagnosis.core.candidates import what_lacks
from highside.diagnosis.core.result import Claim, DiagnosisResult, FittedParameter
from highside.diagnosis.rotation.unknown_site import without_site
from highside.physics.effects.earth_rotation import EFFECT as EARTH
from highside.physics.gravity import EARTH_RATE_RADPS
from highside.physics.state import ChainState

INC = np.full(4, 62.0)


def claim_of(value: float, std: float, effect: str = "gyro_g_sensitivity") -> DiagnosisResult:
    fitted = FittedParameter(value, std, value - 2 * std, value + 2 * std, "rad/s/g")
    unseen = FittedParameter(0.0, 0.0115, -0.02, 0.02, "rad/s/g")
    claim = Claim(effect, "", None, "gyro", {"g_xx": fitted, "g_xz": unseen}, 1e-9, (effect,), (), "none needed")
    return DiagnosisResult("named", claims=(claim,))


@pytest.mark.parametrize(
    ("value", "std", "alike"),
    [(EARTH_RATE_RADPS, 5e-6, True), (-EARTH_RATE_RADPS, 5e-6, True), (1e-3, 5e-6, False), (1e-4, 5e-6, False)],
)
def test_gyros_that_feel_gravity_are_beside_the_earth_unless_they_feel_more(
    value: float, std: float, alike: bool
) -> None:
    (claim,) = without_site(claim_of(value, std), INC).claims
    assert ("earth_rotation" in claim.equivalence_class) == alike
    assert ("[site]" in claim.next_manoeuvre) == alike


def test_other_claims_stay() -> None:
    before = claim_of(1e-6, 1e-7, "gyro_scale")
    assert without_site(before, INC) == before


def test_the_earth_leaves_no_trace_where_the_latitude_is_not_known() -> None:
    state = ChainState.build(np.radians(INC), np.linspace(0.0, 3.0, 4), latitude_rad=0.9)
    assert np.any(EARTH.basis(state, np.zeros((3, 4))))
    unknown = replace(state, latitude_rad=np.nan)
    assert not np.any(EARTH.basis(unknown, np.zeros((3, 4))))
    assert "latitude" in what_lacks(EARTH, unknown)


def test_only_a_model_that_says_nothing_leaves_it_unknown() -> None:
    assert np.isnan(_site(Model()).latitude_rad)
    assert _site(Model.model_validate({"site": {"latitude_deg": 0.0}})).latitude_rad == 0.0
    assert _site(Model.model_validate({"effects": {"included": ["earth_rotation"]}})).latitude_rad == 0.0


def test_a_recording_alone_needs_no_model_and_that_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert _known(None, alone=True) == Model()
    assert capsys.readouterr().err == "no --model: nothing is taken as known beside the sensor\n"
    assert _known(None, alone=False) == Model()
    assert capsys.readouterr().err == ""
