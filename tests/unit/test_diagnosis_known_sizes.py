"""An effect that the simulation has, at another size than the tool, is not told as one that it leaves out."""

import json

import numpy as np
import pytest

from highside.api.diagnosis import Diagnosis, diagnose
from highside.api.simulation import simulate
from highside.config.model import Model

MOTION = {"kind": "poses", "inclinations_deg": [10.0, 35.0, 60.0, 85.0, 110.0, 140.0], "hold_s": 10.0, "row_s": 1.0}
TILT_RAD = np.radians(0.2)


def model(tilt_deg: float | None, quadratic: float = 0.0) -> Model:
    effects: dict[str, object] = {"included": ["reading_noise"], "reading_noise": {"density_ug": 30}}
    if tilt_deg is not None:
        effects["included"] = ["base_tilt", "reading_noise"]
        effects["base_tilt"] = {"tilt_x_deg": tilt_deg, "tilt_y_deg": -tilt_deg}
    if quadratic:
        effects["included"] = [*effects["included"], "quadratic"]  # type: ignore[misc]
        effects["quadratic"] = {"k2_x": quadratic}
    return Model.model_validate({"effects": effects, "motion": MOTION | {"toolfaces_deg": [45.0, 135.0, 225.0, 315.0]}})


def diagnosed(true: Model, simulated: Model) -> Diagnosis:
    return diagnose(simulate(true, seed=3).recording, simulated)


def test_the_size_in_the_simulation_stands_beside_the_one_found() -> None:
    from highside.report.diagnosis_claims import claim_size
    from highside.report.diagnosis_words import claimed

    made = diagnosed(model(0.2), model(0.05))
    (claim,) = made.claims
    assert claim.effect == "base_tilt"
    assert claim.simulated == pytest.approx({"tilt_x": TILT_RAD / 4, "tilt_y": -TILT_RAD / 4})
    assert claim.parameters["tilt_x"].low < TILT_RAD < claim.parameters["tilt_x"].high
    assert claimed(made.found) == "At another size than the simulation has it: base_tilt"
    assert "in the simulation 0.87" in claim_size(claim)
    assert "at another size" in made.html()
    assert json.loads(json.dumps(made.to_dict()))["claims"][0]["simulated"]["tilt_x"] == pytest.approx(TILT_RAD / 4)


@pytest.mark.parametrize("simulated", [None, 0.0])
def test_what_the_simulation_lacks_or_has_at_zero_is_left_out(simulated: float | None) -> None:
    from highside.report.diagnosis_words import claimed

    made = diagnosed(model(0.2), model(simulated))
    assert [claim.simulated for claim in made.claims] == [{}]
    assert claimed(made.found) == "The simulation leaves out: base_tilt"


def test_one_left_out_and_one_at_another_size_are_told_apart() -> None:
    from highside.report.diagnosis_words import claimed

    made = diagnosed(model(0.2, quadratic=4e-4), model(0.05))
    assert {claim.effect: bool(claim.simulated) for claim in made.claims} == {"base_tilt": True, "quadratic": False}
    assert claimed(made.found) == (
        "The simulation leaves out: quadratic; at another size than the simulation has it: base_tilt"
    )


def test_the_right_size_is_nothing() -> None:
    assert diagnosed(model(0.2), model(0.2)).verdict == "nothing_left_out"
