"""A law as a value: its numbers, its range, its way into a file and back, and what it does in the chain."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.api.simulation import predict
from highside.config.model import Model, as_toml, parse_model
from highside.errors import InputError
from highside.physics.forward import ForwardModel
from highside.physics.law import Axis, Law
from highside.physics.law_functions import FUNCTIONS, Function
from highside.physics.places import PLACES
from highside.physics.state import ChainState

COSINES = tuple(Function("cosine", (float(k),)) for k in range(1, 4))
WARM = Law("offset_x_temp", "offset", ("x",), (Axis("temp", 20.0, 60.0, COSINES),), ((1e-3, 2e-4, -3e-4),))

numbers = st.floats(-1e3, 1e3).map(lambda v: float(f"{v:.8g}"))


@st.composite
def laws(draw: st.DrawFn) -> Law:
    place = draw(st.sampled_from([name for name, at in PLACES.items() if at.stage is not None]))
    channels = tuple(draw(st.lists(st.sampled_from(PLACES[place].channels), min_size=1, unique=True)))
    axes = []
    for name in draw(
        st.lists(st.sampled_from(["load", "temp", "tf", "my_column"]), min_size=1, max_size=2, unique=True)
    ):
        kinds = draw(st.lists(st.sampled_from(sorted(FUNCTIONS)), min_size=1, max_size=3))
        functions = tuple(Function(k, tuple(draw(numbers) for _ in range(FUNCTIONS[k][1]))) for k in kinds)
        low, high = sorted((draw(numbers), draw(numbers)))
        axes.append(Axis(name, low, high, functions))
    count = int(np.prod([len(axis.functions) for axis in axes]))
    rows = tuple(tuple(draw(numbers) for _ in range(count)) for _ in channels)
    return Law("found", place, channels, tuple(axes), rows, (), draw(st.sampled_from(["", "2 |load|"])))


@settings(max_examples=60, deadline=None)
@given(laws())
def test_a_law_comes_back_from_its_file_as_it_was(law: Law) -> None:
    model = Model().with_laws([law])
    again = parse_model(tomllib.loads(as_toml(model)), where="model.toml")
    assert again.known_laws == (law,)
    assert again.forward().laws == (law,)


def recording(n: int = 30) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    return {
        "t_s": 10.0 * np.arange(n),
        "inc_ref_deg": rng.uniform(5, 175, n),
        "tf_ref_deg": rng.uniform(0, 360, n),
        "temp_c": rng.uniform(20, 60, n),
        "pose": np.arange(n, dtype=float),
        "pump_bar": rng.uniform(0, 4, n),
        **{name: np.zeros(n) for name in ("ax_g", "ay_g", "az_g")},
    }


def test_what_the_model_predicts_holds_the_law() -> None:
    rows = recording()
    less = predict(Model(), rows)
    more = predict(Model().with_laws([WARM]), rows)
    np.testing.assert_allclose(more["ax_g"] - less["ax_g"], WARM.value([rows["temp_c"]]), atol=1e-12)
    np.testing.assert_array_equal(more["ay_g"], less["ay_g"])


def test_a_law_may_follow_any_column_of_the_recording_and_asks_for_it_by_name() -> None:
    law = Law(
        "scale_all_pump",
        "scale_all",
        ("xyz",),
        (Axis("pump_bar", 0.0, 4.0, (Function("linear", (2.0,)),)),),
        ((1e-3,),),
    )
    rows = recording()
    less, more = predict(Model(), rows), predict(Model().with_laws([law]), rows)
    want = 1e-3 * (rows["pump_bar"] - 2.0)
    np.testing.assert_allclose(more["az_g"], less["az_g"] * (1 + want), atol=1e-9)
    del rows["pump_bar"]
    with pytest.raises(InputError, match="pump_bar"):
        predict(Model().with_laws([law]), rows)


@pytest.mark.parametrize("place", [name for name, at in PLACES.items() if at.stage is not None])
def test_a_law_in_every_place_changes_what_is_reported_as_its_derivative_says(place: str) -> None:
    channels = PLACES[place].channels
    axis = Axis("temp", 20.0, 60.0, (Function("linear", (40.0,)),))
    law = Law("some", place, channels, (axis,), tuple((1e-6,) for _ in channels))
    rng = np.random.default_rng(3)
    state = ChainState.build(
        rng.uniform(0.3, 2.8, 20), rng.uniform(0, 6, 20), temp_c=rng.uniform(20, 60, 20), rotor_rate_radps=2.0
    )
    plain = ForwardModel.of({})
    model = plain.with_laws([law])
    report = "gyro" if place.startswith("gyro") else "predict"
    jacobian = model.gyro_jacobian if place.startswith("gyro") else model.jacobian
    change = getattr(model, report)(state) - getattr(plain, report)(state)
    assert np.abs(change).max() > 1e-7
    np.testing.assert_allclose(jacobian(state, [law.id])[0], change, rtol=1e-3, atol=1e-9)


def test_beyond_the_range_that_was_visited_a_law_falls_to_nothing_and_says_so() -> None:
    inside = WARM.inside([np.array([19.0, 20.0, 60.0, 61.0])])
    assert inside.tolist() == [False, True, True, False]
    far = WARM.value([np.array([0.0, 90.0])])
    np.testing.assert_allclose(far, 0.0, atol=1e-8)
    assert abs(WARM.value([np.array([20.0])])[0]) > 1e-4


def test_the_band_is_that_of_the_coefficients() -> None:
    spread = np.diag([1e-8, 4e-8, 0.0])
    law = replace(WARM, covariance=tuple(map(tuple, spread.tolist())))
    at = np.array([20.0, 40.0])
    basis = law.basis([at])
    np.testing.assert_allclose(law.std([at]), np.sqrt(1e-8 * basis[0] ** 2 + 4e-8 * basis[1] ** 2))


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"slug": "a b"}, "slug"),
        ({"place": "nowhere"}, "place"),
        ({"channels": ["w"]}, "channels"),
        ({"axes": []}, "axes"),
        ({"coefficients": [[1.0]]}, "coefficients"),
        ({"coefficients": [[1.0, float("nan"), 0.0]]}, "coefficients"),
        ({"size": 3}, "size"),
        ({"axes": [{"covariate": "temp", "low": 0, "high": 1, "functions": [["wiggle", 1]]}]}, "functions"),
        ({"place": "channel_offset", "channels": ["rpm"]}, ""),
    ],
)
def test_a_law_that_is_not_in_order_is_refused_by_its_field(change: dict, field: str) -> None:
    table = WARM.to_dict() | change
    if change.get("place") == "channel_offset":
        # it is a law, but of no chain
        assert Model.model_validate({"laws": [table]}).forward().laws == ()
        return
    with pytest.raises(InputError, match=field) as raised:
        parse_model({"laws": [table]}, where="model.toml")
    assert "model.toml" in str(raised.value)


@pytest.mark.parametrize("kind", ["cosine", "wide_cosine"])
@pytest.mark.parametrize("constant", [False, True])
def test_cosines_taken_together_are_what_each_is_alone(kind: str, constant: bool) -> None:
    waves = tuple(Function(kind, (float(k),)) for k in range(1, 17))
    made = Axis("temp", -10.0, 50.0, (Function("one"), *waves) if constant else waves)
    values = np.concatenate([np.linspace(-20.0, 60.0, 999), [-10.0, 50.0, 20.0]])
    held, fall = made.held(values)
    alone = np.stack([function(held, (made.low, made.high)) for function in made.functions]) * fall
    np.testing.assert_allclose(made.basis(values), alone, atol=1e-12)
