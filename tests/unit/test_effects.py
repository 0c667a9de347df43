"""Every effect of the library, held to what an effect must be; a new file is tested without an edit here."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from highside.errors import InputError
from highside.physics import effects
from highside.physics.effect import Effect, RandomEffect, Stage
from highside.physics.effects_page import markdown
from highside.physics.forward import ForwardModel
from highside.physics.memory import low_pass, play
from highside.physics.state import ChainState

LIBRARY = list(effects.all_effects().values())
by_id = pytest.mark.parametrize("effect", LIBRARY, ids=lambda effect: effect.id)


def rich_state(n: int = 60) -> ChainState:
    """Rows in which every covariate varies, so that no effect is hidden by the plan."""
    rng = np.random.default_rng(7)
    return ChainState.build(
        rng.uniform(-0.6, 2.9, n),
        rng.uniform(-7.0, 7.0, n),
        t_s=np.cumsum(rng.uniform(5.0, 20.0, n)),
        direction=rng.choice([-1.0, 1.0], n),
        temp_c=rng.uniform(20.0, 70.0, n),
        rotor_rate_radps=rng.uniform(-12.0, 12.0, n),
        rotor_accel_radps2=rng.uniform(-5.0, 5.0, n),
        inc_rate_radps=rng.uniform(-0.2, 0.2, n),
        vibration_rms_g=rng.uniform(0.1, 2.0, n),
        vibration_x_rms_g=rng.uniform(0.1, 1.0, n),
        vibration_y_rms_g=rng.uniform(0.1, 1.0, n),
        vibration_z_rms_g=rng.uniform(0.1, 1.0, n),
        since_move_s=rng.uniform(1.0, 60.0, n),
        stay_s=rng.uniform(0.0, 2.0, n),
        latitude_rad=0.7,
        azimuth_rad=0.4,
    )


def model_with(effect: Effect, p: np.ndarray) -> ForwardModel:
    """The effect on top of a sensor and a bench that are imperfect in other ways."""
    base = ForwardModel.of(
        {
            "scale": {"s_x": 4e-3, "s_z": -3e-3},
            "misalignment": {"m_xy": 2e-3},
            "quadratic": {"k2_y": 1e-3},
            "base_tilt": {"tilt_x": 4e-4, "tilt_y": -3e-4},
            "mounting": {"roll": 5e-3},
        }
    )
    return ForwardModel((*base.without(effect.id).effects, (effect, p)))


def random_parameters(effect: Effect) -> np.ndarray:
    rng = np.random.default_rng(11)
    values = [
        p.default if p.shape and p.integer else (p.typical if p.shape else p.typical * rng.uniform(0.5, 1.0))
        for p in effect.parameters
    ]
    return np.array(values, dtype=float)


def reported(model: ForwardModel, state: ChainState) -> np.ndarray:
    """All six channels without anything random, (6, N)."""
    return np.concatenate([model.predict(state), model.gyro(state)])


def recorded(model: ForwardModel, state: ChainState, seed: int) -> np.ndarray:
    """All six channels of the rows that reach a recording."""
    rng = np.random.default_rng(seed)
    draws = model.draw(state, rng)
    accel = model.recorded(state, model.chain(state, draws).reported, rng)
    return np.concatenate([accel, model.gyro(state, draws)])[:, model.recorded_rows(state, rng)]


def jacobian(model: ForwardModel, state: ChainState, names: list[str]) -> np.ndarray:
    """(P, 6, N)."""
    return np.concatenate([model.jacobian(state, names), model.gyro_jacobian(state, names)], axis=1)


@by_id
def test_the_derivative_agrees_with_finite_differences(effect: Effect) -> None:
    state, p = rich_state(), random_parameters(effect)
    model = model_with(effect, p)
    parameters = [q for q in effect.parameters if not q.integer]
    for parameter in parameters:
        name = [f"{effect.id}.{parameter.name}"]
        column, value = jacobian(model, state, name)[0], model.get_free(name)
        errors = []
        # fourth-order central differences of several steps: for a step neither too long nor too short they must agree
        for share in (1e-2, 1e-3, 1e-5, 1e-7):
            h = share * abs(parameter.typical)
            at = [reported(model.set_free(value + k * h, name), state) for k in (-2, -1, 1, 2)]
            difference = ((at[0] - at[3]) + 8 * (at[2] - at[1])) / (12 * h)
            errors.append(np.max(np.abs(column - difference)))
        assert min(errors) <= 2e-6 * np.max(np.abs(column)), (parameter.name, errors)


@by_id
def test_without_size_an_effect_does_nothing(effect: Effect) -> None:
    state, p = rich_state(), random_parameters(effect)
    p[list(effect.amplitudes)] = 0.0
    model = model_with(effect, p)
    np.testing.assert_allclose(
        recorded(model, state, 3), reported(model.without(effect.id), state), rtol=0, atol=1e-15 * 12.0
    )


@by_id
def test_with_its_usual_size_an_effect_does_something(effect: Effect) -> None:
    state = rich_state(400)
    model = model_with(effect, random_parameters(effect))
    with_it, without = recorded(model, state, 3), recorded(model.without(effect.id), state, 3)
    assert with_it.shape != without.shape or np.max(np.abs(with_it - without)) > 1e-9


@pytest.mark.parametrize("effect", [e for e in LIBRARY if not e.random], ids=lambda effect: effect.id)
def test_each_parameter_has_a_column_of_its_own(effect: Effect) -> None:
    columns = jacobian(model_with(effect, random_parameters(effect)), rich_state(), [effect.id])
    flat = columns.reshape(len(effect.amplitudes), -1)
    sizes = np.linalg.norm(flat, axis=1)
    assert np.all(sizes > 0)
    assert np.linalg.matrix_rank(flat / sizes[:, None]) == len(flat)


@by_id
def test_an_effect_tells_its_story(effect: Effect) -> None:
    assert effect.title
    assert effect.formula
    assert effect.story.endswith(".")
    assert len(effect.story) > 40
    assert effect.stage in Stage
    for parameter in effect.parameters:
        low, high = parameter.gate
        assert low <= parameter.default <= high
        assert low <= parameter.typical <= high
        assert parameter.shape or parameter.default == 0.0
        assert parameter.unit
    for needed in effect.needs:
        assert hasattr(rich_state(), needed)


@by_id
def test_confounders_are_effects_of_the_library_and_come_with_a_splitter(effect: Effect) -> None:
    for rival in effect.confused_with:
        assert effects.get(rival).id == rival
        assert rival != effect.id
    assert bool(effect.confused_with) == bool(effect.splitter)


@by_id
def test_typical_size_lies_within_the_gate_and_ten_times_the_gate_does_not(effect: Effect) -> None:
    typical = np.array([p.typical for p in effect.parameters])
    assert effect.outside_gate(typical) == []
    assert effect.outside_gate(np.full(len(typical), np.nan)) == [p.name for p in effect.parameters]
    beyond = np.array([10 * p.gate[1] for p in effect.parameters])
    assert effect.outside_gate(beyond) == [p.name for p in effect.parameters]


@pytest.mark.parametrize("effect", [e for e in LIBRARY if isinstance(e, RandomEffect)], ids=lambda effect: effect.id)
def test_a_random_effect_repeats_with_its_seed_and_only_then(effect: RandomEffect) -> None:
    state = rich_state()
    model = ForwardModel(((effect, np.array([p.typical for p in effect.parameters])),))
    first = recorded(model, state, 1)
    assert np.array_equal(first, recorded(model, state, 1))
    assert not np.array_equal(first, recorded(model, state, 2))


def test_adding_a_random_effect_leaves_the_draws_of_the_others_as_they_were() -> None:
    state = rich_state()
    noise = ForwardModel.of({"reading_noise": {f"density_{axis}": 5e-5 for axis in "xyz"}})
    both = noise.with_effects({"turn_on_bias": {"sigma_x": 3e-4}})
    difference = both.simulate(state, np.random.default_rng(5)) - noise.simulate(state, np.random.default_rng(5))
    assert np.ptp(difference[0]) < 1e-15
    assert abs(difference[0, 0]) > 1e-6
    assert np.all(difference[1:] == 0)


def test_an_unknown_effect_is_answered_with_the_nearest_names() -> None:
    with pytest.raises(InputError, match="did you mean quadratic"):
        effects.get("quadratc")


def test_an_unknown_parameter_is_answered_with_those_that_exist() -> None:
    with pytest.raises(InputError, match="it has: tilt_x, tilt_y"):
        ForwardModel.of({"base_tilt": {"tilt_z": 1.0}})


def test_an_effect_given_twice_is_refused() -> None:
    with pytest.raises(InputError, match="given twice"):
        ForwardModel.of([("bias", {}), ("bias", {})])


def test_the_page_of_the_library_is_up_to_date() -> None:
    page = Path(effects.__path__[0]) / "README.md"
    assert page.read_text() == markdown(), "run: highside effects > src/highside/physics/effects/README.md"


def test_the_page_has_every_effect_and_every_parameter() -> None:
    page = markdown()
    for effect in LIBRARY:
        entry = page.split(f"### `{effect.id}`")[1].split("### ")[0]
        assert effect.story in entry
        assert all(f"`{p.name}`" in entry for p in effect.parameters)


def test_an_effect_is_found_by_its_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = (Path(effects.__path__[0]) / "sag.py").read_text()
    (tmp_path / "droop.py").write_text(source.replace('"sag"', '"droop"').replace("Sag", "Droop"))
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    effects.registry.cache_clear()
    try:
        assert effects.get("droop").stage is Stage.POSE
        assert ForwardModel.of({"droop": {"s": 1e-3}}).ids == ("droop",)
    finally:
        effects.registry.cache_clear()
        sys.modules.pop("highside.physics.effects.droop", None)


@pytest.mark.parametrize("half_width", [0.0, 0.01, 0.5, 3.0])
def test_play_by_stretches_is_play_row_by_row(half_width: float) -> None:
    t = np.arange(4000) / 50
    rng = np.random.default_rng(0)
    steps = np.repeat(rng.normal(size=40), 100)
    for x in (np.sin(t) + 0.3 * np.sin(0.3 * t), np.cumsum(steps), steps):
        last, expected = float(x[0]), []
        for value in x.tolist():
            last = min(max(last, value - half_width), value + half_width)
            expected.append(last)
        assert np.array_equal(play(x, half_width), expected)


def test_lag_of_even_rows_is_that_of_uneven_ones() -> None:
    t = np.arange(3000) / 50
    x = 25 + 10 * np.sin(t / 5)
    uneven = t + np.where(np.arange(t.size) == 1500, 1e-9, 0.0)
    assert np.allclose(low_pass(t, x, 7.0), low_pass(uneven, x, 7.0), rtol=0, atol=1e-8)
