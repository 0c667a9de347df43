"""An effect that the simulation has, at another size than the tool, is not told as one that it leaves out."""

import json
from dataclasses import replace

import numpy as np
import pytest

from highside.api.diagnosis import Diagnosis, diagnose
from highside.api.simulation import simulate
from highside.config.model import Model
from highside.physics.state import ChainState

FURTHER = pytest.mark.further

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
    from highside.report.diagnosis_claims import claim_size, first_sentence

    made = diagnosed(model(0.2), model(0.05))
    (claim,) = made.claims
    assert claim.effect == "base_tilt"
    assert claim.simulated == pytest.approx({"tilt_x": TILT_RAD / 4, "tilt_y": -TILT_RAD / 4})
    assert claim.parameters["tilt_x"].low < TILT_RAD < claim.parameters["tilt_x"].high
    assert first_sentence(made.found, {}, "") == (
        "The simulation has levelling error of the bench, or what cannot be told from it here (100% of the misfit) "
        "at another size."
    )
    assert "in the simulation 0.87" in claim_size(claim)
    assert "at another size" in made.html()
    assert json.loads(json.dumps(made.to_dict()))["claims"][0]["simulated"]["tilt_x"] == pytest.approx(TILT_RAD / 4)


@pytest.mark.parametrize("simulated", [None, 0.0])
def test_what_the_simulation_lacks_or_has_at_zero_is_left_out(simulated: float | None) -> None:
    from highside.report.diagnosis_claims import first_sentence

    made = diagnosed(model(0.2), model(simulated))
    assert [claim.simulated for claim in made.claims] == [{}]
    assert first_sentence(made.found, {}, "") == (
        "The simulation omits levelling error of the bench, or what cannot be told from it here (100% of the misfit)."
    )


def test_one_left_out_and_one_at_another_size_are_told_apart() -> None:
    from highside.report.diagnosis_claims import first_sentence

    made = diagnosed(model(0.2, quadratic=4e-4), model(0.05))
    assert {claim.effect: bool(claim.simulated) for claim in made.claims} == {"base_tilt": True, "quadratic": False}
    said = first_sentence(made.found, {}, "")
    assert said.startswith(
        "The simulation omits scale-factor nonlinearity K2 (quadratic), or what cannot be told from it here ("
    )
    assert "of the misfit), and has levelling error of the bench, or what cannot be told from it here (" in said
    assert said.endswith("of the misfit) at another size.")
    # where two run alike, what either explains is in the share of neither; what is left unexplained is not theirs
    alike = [replace(claim, share=0.21 if claim.effect == "quadratic" else 0.06) for claim in made.claims]
    said = first_sentence(replace(made.found, claims=tuple(alike)), {"quadratic": 0.105, "base_tilt": 0.03}, "")
    assert "(3% of the misfit) at another size. Either of them explains the other 37%." in said
    assert said.endswith(" What is left, 50% of the misfit, is taken for noise that wanders.")
    # where one explains next to nothing, where both do, and where the set angles were learned to be off
    said = first_sentence(replace(made.found, claims=tuple(alike)), {"quadratic": 0.06, "base_tilt": 0.0}, "")
    assert said.endswith(" What is left, 78% of the misfit, is taken for noise that wanders.")
    nothing = {"quadratic": 0.0, "base_tilt": 0.0}
    said = first_sentence(replace(made.found, claims=tuple(alike)), nothing, "")
    assert said.endswith(" What is left, 100% of the misfit, is taken for noise that wanders.")
    noise = {**made.found.noise, "beside_laws_set_angles_rad": [4e-3, 0.0, 0.0]}
    said = first_sentence(replace(made.found, claims=tuple(alike), noise=noise), nothing, "")
    assert said.endswith(" What is left, 100% of the misfit, is taken for errors of the set angles.")
    # shares know no law within the poses
    within = [replace(claim, depends_on=("time_since_move",)) for claim in alike]
    assert "is taken for" not in first_sentence(replace(made.found, claims=tuple(within)), nothing, "")


def test_the_right_size_is_nothing() -> None:
    assert diagnosed(model(0.2), model(0.2)).verdict == "nothing_left_out"


def beside_a_law(seed: int, tilt_deg: float) -> dict[str, np.ndarray]:
    """72 poses over temperature, a tilt of the base, and an offset of y that no effect of the library is."""
    rng, n = np.random.default_rng(seed), 72
    inc, tf = np.tile(np.arange(6) * 30.0, 12) + rng.uniform(0, 5, n), np.repeat(np.arange(12) * 30.0, 6)
    temp = 20 + 40 * ((np.arange(n) * 5) % n) / n
    state = ChainState.build(np.radians(inc), np.radians(tf), t_s=60.0 * np.arange(n), temp_c=temp)
    read = model(tilt_deg).forward().predict(state)
    read = (np.eye(3) + rng.normal(0, 2e-3, (3, 3))) @ read + rng.normal(0, 3e-3, (3, 1))
    read[1] += 3e-3 * np.tanh((temp - 38) / 4)
    read += rng.normal(0, 2e-4, read.shape)
    return {"inc_ref_deg": inc, "tf_ref_deg": tf, "temp_c": temp, "ax": read[0], "ay": read[1], "az": read[2]}


@pytest.mark.parametrize(
    ("true_deg", "seed"),
    [
        pytest.param(0.0, 1, marks=FURTHER),
        pytest.param(0.0, 3, marks=FURTHER),
        (0.05, 2),
        pytest.param(0.1, 2, marks=FURTHER),
    ],
)
def test_beside_a_law_a_size_that_the_simulation_has_wrong_is_named_with_the_right_one(
    seed: int, true_deg: float
) -> None:
    knows = Model.model_validate(
        {
            "sensor": {"noise_g": 2e-4},
            "effects": {"included": ["base_tilt"], "base_tilt": {"tilt_x_deg": 0.05, "tilt_y_deg": -0.05}},
        }
    )
    made = diagnose(beside_a_law(seed, true_deg), knows)
    laws = [claim for claim in made.claims if claim.effect.startswith("law:")]
    assert [claim.place for claim in laws] == ["offset"]
    assert (laws[0].channels, laws[0].depends_on) == (("ay",), ("temp",))
    names = {claim.effect: claim for claim in made.claims if claim not in laws}
    if true_deg == 0.05:
        assert not names
        return
    assert set(names) == {"base_tilt"}
    assert names["base_tilt"].simulated["tilt_x"] == pytest.approx(np.radians(0.05))
    for parameter, sign in (("tilt_x", 1), ("tilt_y", -1)):
        found = names["base_tilt"].parameters[parameter]
        assert abs(found.value - sign * np.radians(true_deg)) < 4 * found.std
