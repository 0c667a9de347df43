"""The engine on stepped sessions: what is left out is named, nothing is invented, and what cannot be seen is said."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_poses
from highside.diagnosis.poses.session import PoseSession, pose_session
from highside.errors import InputError
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from studies import diagnosis_deck as deck

STATE = deck.design()
FURTHER = pytest.mark.further
"""These effects are named in `test_library_effects`, `test_diagnosis_causes` or `test_diagnosis_places`, or below."""


def at(inclinations: list[float], toolfaces: list[float], repeats: int = 1) -> ChainState:
    """Poses from one side, at constant temperature."""
    inc, tf = (np.tile(a.ravel(), repeats) for a in np.meshgrid(inclinations, toolfaces, indexing="ij"))
    return ChainState.build(np.radians(inc), np.radians(tf), t_s=60.0 * np.arange(inc.size), row_seconds=60.0)


def simulated(state: ChainState, effects: dict[str, dict[str, float]], seed: int) -> PoseSession:
    rng = np.random.default_rng(seed)
    sensor, _ = deck.sensor_and_base(state, rng)
    mean = sensor.with_effects(effects).predict(state) + deck.white_noise(state, rng)
    return PoseSession(mean, np.ones(state.n), state)


@cache
def single(effect: str) -> tuple[DiagnosisResult, dict[str, float]]:
    """The answer to a session in which one effect is left out, and its true sizes: asked for once."""
    session, truth = deck.single(STATE, effect, 400.0, seed=11)
    return deck.diagnosed(deck.measured(session)), truth


@pytest.mark.parametrize(
    "effect",
    [
        pytest.param("base_tilt", marks=FURTHER),
        "encoder_first_harmonic",
        # beside another in the next test
        pytest.param("backlash", marks=FURTHER),
        "sag",
        pytest.param("cubic", marks=FURTHER),
        pytest.param("temperature_scale", marks=FURTHER),
        "temperature_bias",
        "cogging",
    ],
)
def test_a_single_effect_is_named_and_its_size_is_found(effect: str) -> None:
    found, truth = single(effect)
    assert found.verdict in ("named", "named_plus")
    assert effect in {name for claim in found.claims for name in claim.equivalence_class}
    assert [claim.effect for claim in found.claims] == [effect]
    for name, parameter in found.claims[0].parameters.items():
        assert abs(parameter.value - truth[name]) <= max(4.5 * parameter.std, 0.02 * abs(truth[name]))
    assert found.claims[0].p_familywise < 1e-6
    assert found.fit is not None
    assert found.fit.heldout_rmse_before is not None and found.fit.heldout_rmse_after is not None
    assert found.fit.heldout_rmse_after < found.fit.heldout_rmse_before


def test_two_effects_at_once_are_both_named() -> None:
    effects = {"sag": {"s": 3e-4}, "backlash": {"h_tf": 1.5e-4, "h_inc": 0.0}}
    found = deck.diagnosed(deck.measured(simulated(STATE, effects, 4)))
    assert found.verdict in ("named", "named_plus")
    assert {claim.effect for claim in found.claims} == set(effects)


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("white", 100),
        pytest.param("white", 101, marks=FURTHER),
        pytest.param("one bad channel x4", 100, marks=FURTHER),
        pytest.param("table jitter", 101, marks=FURTHER),
        pytest.param("heavy tails", 100, marks=FURTHER),
        ("coloured AR(0.5)", 101),
    ],
)
def test_noise_alone_is_given_no_name(kind: str, seed: int) -> None:
    found = deck.diagnosed(deck.null(STATE, kind, seed))
    assert found.claims == ()
    if kind in ("white", "one bad channel x4", "table jitter"):
        assert found.verdict == "nothing_left_out"


@pytest.mark.parametrize("seed", [100, pytest.param(102, marks=FURTHER)])
def test_a_wandering_bias_is_called_wander_and_not_given_a_cause(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sensor, _ = deck.sensor_and_base(STATE, rng)
    walk = 0.4 * deck.SIGMA_G * np.cumsum(rng.standard_normal((3, STATE.n)), axis=1)
    mean = sensor.predict(STATE) + walk + deck.white_noise(STATE, rng)
    found = deck.diagnosed(PoseSession(mean, np.ones(STATE.n), STATE))
    assert found.claims == ()
    assert found.verdict in ("wander", "unknown")


@pytest.mark.parametrize(
    ("name", "follows"),
    [
        ("temperature x z^2", "temp"),
        pytest.param("temperature x cos 3T", "tf", marks=FURTHER),
        pytest.param("bump at one toolface", "tf", marks=FURTHER),
    ],
)
def test_what_the_library_does_not_have_is_given_no_name_of_it_but_a_law(name: str, follows: str) -> None:
    found = deck.diagnosed(deck.outsider(STATE, name, 400.0, seed=21))
    assert all(claim.effect.startswith("law:") for claim in found.claims)
    assert found.verdict in ("law", "unknown", "partial")
    if found.claims:
        assert any(follows in claim.depends_on for claim in found.claims)
    else:
        assert found.remainder.hints or found.remainder.resembles


def test_an_effect_that_one_inclination_cannot_show_is_said_to_be_untestable() -> None:
    state = at([60.0], list(range(0, 360, 15)), repeats=4)
    found = deck.diagnosed(simulated(state, {"sag": {"s": 1e-3}}, 1))
    assert {"sag", "backlash", "temperature_bias"} <= {entry.effect for entry in found.not_testable}
    assert "sag" not in {claim.effect for claim in found.claims}
    assert all(entry.why and entry.needs for entry in found.not_testable)


def test_the_smallest_size_that_would_show_does_show_four_times_in_five() -> None:
    """By the names alone: laws can only show more."""

    def found(size: float, seed: int) -> DiagnosisResult:
        session = simulated(STATE, {"sag": {"s": size}} if size else {}, seed)
        return diagnose_poses(session, ForwardModel.of({}), deck.FREE, method=ProcedureParts.without("laws"))[0]

    smallest = found(0.0, 1).minimum_detectable["sag"]
    assert smallest.unit == "rad"
    seen = [found(smallest.value, seed).verdict for seed in range(8)]
    assert sum(verdict != "nothing_left_out" for verdict in seen) >= 4
    larger = [found(2 * smallest.value, seed).verdict for seed in range(3)]
    assert all(verdict != "nothing_left_out" for verdict in larger)


def test_quadratic_and_asymmetry_are_one_class_where_the_poses_do_not_split_them() -> None:
    state = at([30.0, 90.0, 150.0], [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0], repeats=3)
    found = deck.diagnosed(simulated(state, {"quadratic": {"k2_x": 1.5e-4}}, 3))
    (claim,) = found.claims
    assert {"quadratic", "asymmetry"} <= set(claim.equivalence_class)
    assert claim.next_manoeuvre


def test_the_location_names_channel_and_covariate() -> None:
    """By the names alone, which tell it: laws have places of their own."""
    session = simulated(STATE, {"temperature_bias": {"bt_y": 1e-5}}, 2)
    found, _ = diagnose_poses(session, ForwardModel.of({}), deck.FREE, method=ProcedureParts.without("laws"))
    (location,) = found.location
    assert location.channels == ("ay",)
    assert location.covariate == "temp_c"
    assert location.p < 1e-6


def test_the_same_seed_gives_the_same_answer() -> None:
    first, _ = single("cogging")
    again = deck.diagnosed(deck.single(STATE, "cogging", 400.0, seed=11)[0])
    assert json.dumps(first.to_dict()) == json.dumps(again.to_dict())


def test_the_answer_has_the_fields_of_the_schema_and_only_finite_numbers() -> None:
    plain = single("sag")[0].to_dict()
    assert list(plain) == [
        "schema", "verdict", "location", "claims", "fit", "intake", "remainder", "not_testable", "minimum_detectable",
        "noise", "seed", "version", "coverage",
    ]  # fmt: skip
    assert plain["schema"] == "highside.diagnosis/1"
    json.loads(json.dumps(plain, allow_nan=False))
    assert DiagnosisResult("bad_data").to_dict()["fit"] is None


def test_a_misalignment_that_may_not_be_refitted_is_found() -> None:
    session = simulated(STATE, {}, 5)
    found, _ = diagnose_poses(session, ForwardModel.of({}), ("bias", "scale"))
    assert found.claims[0].effect in ("misalignment", "mounting")
    assert "misalignment" in {name for claim in found.claims for name in claim.equivalence_class}


def test_few_poses_are_refused_with_the_number_needed() -> None:
    columns = {name: np.zeros(11) for name in ("t_s", "inc_ref_deg", "tf_ref_deg")} | {"pose": np.arange(11.0)}
    with pytest.raises(InputError, match=r"11 poses are too few.*12"):
        pose_session(columns, np.zeros((3, 11)), gravity_mps2=9.81)


@pytest.mark.parametrize(
    ("effect", "times"),
    [
        ("sag", 100),
        pytest.param("base_tilt", 100, marks=FURTHER),
        pytest.param("reference_twist", 100, marks=FURTHER),
        pytest.param("backlash", 100, marks=FURTHER),
        ("stiction", 100),
        pytest.param("base_tilt", 10, marks=FURTHER),
        ("stiction", 10),
    ],
)
def test_what_a_strong_effect_does_beyond_first_order_is_given_no_name_of_its_own(effect: str, times: int) -> None:
    rng = np.random.default_rng(5)
    sizes = {
        p.name: float(min(times * p.typical, 0.5 * p.gate[1]) * rng.uniform(0.5, 1.0))
        for p in all_effects()[effect].parameters
    }
    found = deck.diagnosed(simulated(STATE, {effect: sizes}, seed=5))
    assert found.verdict == "named"
    assert [c.effect for c in found.claims] == [effect]
    for name, size in sizes.items():
        stated = found.claims[0].parameters[name]
        assert abs(stated.value - size) < 4 * stated.std
    assert found.fit.rmse_before > 10 * found.fit.rmse_after


@pytest.mark.parametrize(
    ("effect", "shape", "strength"),
    [
        pytest.param("warmup", {"tau": 1300.0}, 3e4, marks=FURTHER),
        pytest.param("thermal_lag", {"tau": 270.0}, 3e4, marks=FURTHER),
        pytest.param("thermal_lag", {"tau": 270.0}, 1e6, marks=FURTHER),
        ("thermal_hysteresis", {"width": 5.7}, 1e6),
    ],
)
def test_a_strong_slow_effect_is_no_walk_whatever_its_time_constant(
    effect: str, shape: dict[str, float], strength: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(deck.SINGLES, effect, shape)
    session, truth = deck.single(STATE, effect, strength, seed=3)
    found = deck.diagnosed(session)
    assert found.verdict == "named"
    assert [c.effect for c in found.claims] == [effect]
    for name, stated in found.claims[0].parameters.items():
        assert abs(stated.value - truth[name]) < 4.5 * stated.std


@FURTHER
def test_what_lives_within_a_few_poses_is_proved_on_poses_between_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(deck.SINGLES, "warmup", {"tau": 240.0})
    session, _ = deck.single(STATE, "warmup", 400.0, seed=8)
    found = deck.diagnosed(session)
    assert [c.effect for c in found.claims] == ["warmup"]
    assert found.fit.heldout_rmse_after < found.fit.heldout_rmse_before
    assert "every 10th pose" in found.fit.how_held_out
