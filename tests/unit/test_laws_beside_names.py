"""Names and laws in one answer: a law where the library has none, a name where it has one, both where both act."""

import tomllib

import numpy as np
import pytest

from highside.api.diagnosis import diagnose
from highside.api.simulation import predict
from highside.config.model import Model, parse_model
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

FURTHER = pytest.mark.further

SIGMA = 2e-5
ROWS = 4
PLAIN = ForwardModel.of({})
MODEL = Model.model_validate({"sensor": {"noise_g": SIGMA * ROWS**0.5}})


def recording(seed: int, add: str, n: int = 72) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns of a stepped session with something added, and (3, N) what was added."""
    rng = np.random.default_rng(seed)
    inc, tf = np.repeat([15.0, 40.0, 65.0, 90.0, 115.0, 140.0], n // 6), np.tile(np.arange(n // 6) * 30.0, 6)
    inc, tf = inc + rng.uniform(-4, 4, n), tf + rng.uniform(0, 30, n)
    t = 60.0 * np.arange(n)
    temp = 35 + 15 * np.sin(2 * np.pi * t / t[-1] * 1.7 + seed) + rng.normal(0, 0.3, n)
    state = ChainState.build(np.radians(inc), np.radians(tf), t_s=t, temp_c=temp)
    load = PLAIN.predict(state)
    added = np.zeros((3, n))
    if "fourth" in add:
        added[0] += 8e-4 * load[0] ** 4
    if "quadratic" in add:
        added += np.array([[4e-4], [-3e-4], [2e-4]]) * load**2
    if "warm" in add:
        added[1] += 2e-4 * np.tanh((temp - 33) / 4)
    every = np.repeat(np.arange(n), ROWS)
    read = (load + added)[:, every] + SIGMA * ROWS**0.5 * rng.normal(size=(3, n * ROWS))
    columns = {
        "t_s": t[every] + np.tile(np.arange(ROWS), n),
        **dict(zip(("ax_g", "ay_g", "az_g"), read, strict=True)),
        "inc_ref_deg": inc[every],
        "tf_ref_deg": tf[every],
        "temp_c": temp[every],
        "pose": every.astype(float),
    }
    return columns, added[:, every]


def test_a_law_that_was_found_predicts_the_next_session_and_leaves_nothing_there() -> None:
    made = diagnose(recording(1, "warm")[0], MODEL)
    assert made.verdict == "law"
    (claim,) = made.claims
    assert (claim.place, claim.channels, claim.depends_on) == ("offset", ("ay",), ("temp",))
    text = made.model_toml()
    assert text is not None
    model = parse_model(tomllib.loads(text), where="found.toml")
    columns, added = recording(2, "warm")
    change = predict(model, columns)["ay_g"] - predict(Model(), columns)["ay_g"]
    away = added[1] - change
    assert np.var(away) < 0.05 * np.var(added[1])
    assert diagnose(columns, model).verdict == "nothing_left_out"


@FURTHER
def test_two_names_that_stand_for_one_law_give_way_to_it() -> None:
    made = diagnose(recording(3, "fourth")[0], MODEL)
    assert made.verdict == "law"
    (claim,) = made.claims
    assert (claim.place, claim.channels, claim.depends_on) == ("offset", ("ax",), ("load",))


def test_a_name_of_the_library_stays() -> None:
    made = diagnose(recording(4, "quadratic")[0], MODEL)
    assert (made.verdict, [claim.effect for claim in made.claims]) == ("named", ["quadratic"])


def test_a_name_and_a_law_stand_side_by_side() -> None:
    made = diagnose(recording(5, "quadratic and warm")[0], MODEL)
    assert made.verdict == "named_plus"
    assert [claim.effect for claim in made.claims] == ["quadratic", "law:offset_y_temp"]
    assert made.fit is not None
    assert made.fit.rmse_after < 1.2 * SIGMA


def test_where_nothing_was_added_nothing_is_claimed() -> None:
    made = diagnose(recording(6, "")[0], MODEL)
    assert (made.verdict, made.claims) == ("nothing_left_out", ())


@pytest.mark.parametrize("shape", ["factor", "own"])
def test_beside_another_program_a_factor_that_follows_something_is_a_law(shape: str) -> None:
    rng = np.random.default_rng(7)
    t = 0.1 * np.arange(2400)
    waves = [(rng.normal(), rng.uniform(0.05, 1.0), rng.uniform(0, 6)) for _ in range(5)]
    predicted = 0.2 * sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in waves)
    temp = 25 + 10 * np.sin(2 * np.pi * t / 160)
    factor = 0.05 * np.tanh((temp - 27) / 4) if shape == "factor" else 0.1 * np.abs(predicted) ** 0.5
    columns = {"t_s": t, "ax_g": predicted * (1 + factor) + 2e-3 * rng.normal(size=t.size), "temp_c": temp}
    made = diagnose(columns, simulation={"t_s": t, "ax_g": predicted})
    laws = [claim for claim in made.claims if claim.law is not None]
    assert made.verdict in ("law", "named_plus")
    assert {claim.channels for claim in laws} == {("ax_g",)}
    if shape == "factor":
        assert [(claim.place, claim.depends_on) for claim in laws] == [("channel_factor", ("temp",))]
    else:
        assert ("ax_g",) in [claim.depends_on for claim in laws]
