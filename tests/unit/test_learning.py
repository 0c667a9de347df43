"""A law becomes the file of an effect: it does what the law did, is found in its folder, and is named when met."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from highside.api.learning import new_effect
from highside.diagnosis.poses.session import PoseSession
from highside.errors import InputError
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.law import Law, LawEffect
from highside.physics.learnt import LearntEffect
from highside.physics.outside_effects import effect_of_file
from highside.physics.state import ChainState
from studies import diagnosis_deck as deck
from studies.scenario import random_sensor

DENT = {
    "slug": "dent", "place": "offset", "channels": ["y"], "formula": "exp(-((tf - 130) / 20)^2 / 2)",
    "coefficients": [[2.5e-4]],
    "axes": [{"covariate": "tf", "low": 0.0, "high": 360.0, "functions": [["dent", 130.0, 20.0]]}],
}  # fmt: skip
CURVE = {
    "slug": "curve", "place": "scale", "channels": ["x", "z"], "formula": "",
    "coefficients": [[1e-4, -5e-5, 2e-5], [-4e-5, 1e-5, 3e-5]],
    "axes": [
        {"covariate": "temp", "low": 22.0, "high": 58.0, "functions": [["cosine", k] for k in (1, 2, 5)]},
    ],
}  # fmt: skip
PAIR = {
    "slug": "pair", "place": "toolface", "channels": ["tf"], "formula": "",
    "coefficients": [[1e-4, -5e-5, 2e-5, 3e-5]],
    "axes": [
        {"covariate": "temp", "low": 22.0, "high": 58.0, "functions": [["one"], ["cosine", 1]]},
        {"covariate": "tf", "low": 0.0, "high": 360.0, "functions": [["cos", 2], ["sin", 3]]},
    ],
}  # fmt: skip
LOAD = {
    "slug": "load", "place": "offset", "channels": ["x", "y"], "formula": "|load|^2.5",
    "coefficients": [[-3e-4], [2e-4]],
    "axes": [{"covariate": "load", "low": -1.0, "high": 1.0, "functions": [["power", 0.0, 2.5]]}],
}  # fmt: skip
SETTLES = {
    "slug": "settles", "place": "inclination", "channels": ["inc"], "formula": "exp(-t / 30)",
    "coefficients": [[2e-4]],
    "axes": [{"covariate": "time_since_move", "low": 0.0, "high": 90.0, "functions": [["decay", 0.0, 30.0]]}],
}  # fmt: skip
PRESSURE = {
    "slug": "pressure", "place": "offset", "channels": ["z"], "formula": "",
    "coefficients": [[1e-4, 4e-5]],
    "axes": [{"covariate": "mud bar", "low": 0.0, "high": 300.0, "functions": [["cosine", 1], ["cosine", 2]]}],
}  # fmt: skip
GYRO = {
    "slug": "gyro", "place": "gyro_offset", "channels": ["z"], "formula": "tanh((rate - 10) / 40)",
    "coefficients": [[1e-4]],
    "axes": [{"covariate": "rate", "low": -180.0, "high": 180.0, "functions": [["saturation", 10.0, 40.0]]}],
}  # fmt: skip
LAWS = [DENT, CURVE, PAIR, LOAD, SETTLES, PRESSURE, GYRO]


@pytest.fixture
def clean() -> Iterator[None]:
    yield
    library.use_folders(())


def answer(*laws: dict[str, Any], **claim: Any) -> dict[str, Any]:
    """What `diagnosis.json` holds of claims of laws."""
    claims = [
        {"effect": "law:" + law["slug"], "law": law, "resembles": [], "readings": [], "confirm": "vary it", **claim}
        for law in laws
    ]
    return {"verdict": "law", "claims": claims}


BANDED = {
    **LOAD, "slug": "banded", "coefficients": [[-3e-4, 0.0, 0.0], [2e-4, 0.0, 0.0]],
    "axes": [{**LOAD["axes"][0], "functions": [["power", 0.0, 2.5], ["one"], ["wide_cosine", 1]]}],
}  # fmt: skip


def rows() -> ChainState:
    """Rows within and beyond the range that was visited, poses and rates of all kinds."""
    k = np.arange(120.0)
    state = ChainState.build(
        0.2 + 0.02 * k, 0.4 * k, t_s=3.0 * k, temp_c=15 + 0.5 * k, pose=(k // 6).astype(np.int64),
        rotor_rate_radps=2.5 * np.sin(k / 9), rotor_accel_radps2=np.cos(k / 9), direction=np.where(k % 2, 1.0, -1.0),
    )  # fmt: skip
    return ChainState(**{**vars(state), "extra": {"mud bar": 3.0 * k}})


def test_what_set_in_midway_is_an_effect_all_the_time(tmp_path: Path) -> None:
    step = {"covariate": "time", "low": 0.0, "high": 900.0, "functions": [["step", 400.0]]}
    late = {**CURVE, "axes": [*CURVE["axes"], step]}
    effect = effect_of_file(new_effect(answer(late), "late_one", tmp_path))
    assert isinstance(effect, LearntEffect)
    assert effect.depends_on == tuple(axis["covariate"] for axis in CURVE["axes"])


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law["slug"])
def test_the_file_does_what_the_law_did(law: dict[str, Any], tmp_path: Path) -> None:
    path = new_effect(answer(law), "learnt_one", tmp_path / "mine")
    effect = effect_of_file(path)
    assert isinstance(effect, LearntEffect)
    learnt = LawEffect(Law.from_dict(law))
    assert effect.stage is learnt.stage
    state = rows()
    sizes = np.array([p.typical for p in effect.parameters])
    model, like = ForwardModel(((effect, sizes),)), ForwardModel(((learnt, np.ones(1)),))
    plain = ForwardModel.of({})
    does = np.concatenate([like.predict(state) - plain.predict(state), like.gyro(state) - plain.gyro(state)])
    copied = np.concatenate([model.predict(state) - plain.predict(state), model.gyro(state) - plain.gyro(state)])
    # a table has straight lines between its points
    assert np.max(np.abs(does)) > 0
    assert np.max(np.abs(copied - does)) < 5e-3 * np.max(np.abs(does))
    for parameter in effect.parameters:
        assert parameter.gate == pytest.approx((-10 * parameter.typical, 10 * parameter.typical))


def test_what_a_recording_lacks_does_nothing_rather_than_stop_a_diagnosis(tmp_path: Path) -> None:
    effect = effect_of_file(new_effect(answer(PRESSURE), "mud_pressure", tmp_path))
    state = deck.design()
    assert not effect.delta(state, np.ones(1), np.zeros((3, state.n))).any()


def test_the_next_recording_is_reported_by_its_name(tmp_path: Path, clean: None) -> None:
    folder = tmp_path / "mine"
    new_effect(answer(DENT), "contact_at_130", folder)
    library.use_folders([folder])
    state, rng = deck.design(), np.random.default_rng(3)
    tf = np.degrees(state.tf_rad)
    mean = random_sensor(rng).predict(state) + deck.white_noise(state, rng)
    mean[1] += 2e-4 * np.exp(-0.5 * ((np.mod(tf - 130 + 180, 360) - 180) / 20) ** 2)
    found = deck.diagnosed(PoseSession(mean, np.ones(state.n), state))
    assert [claim.effect for claim in found.claims] == ["contact_at_130"], deck.in_words(found)
    size = found.claims[0].parameters["a_y"]
    assert size.low < 2e-4 < size.high


def test_its_words_are_those_of_the_claim(tmp_path: Path) -> None:
    answered = answer(
        LOAD, resembles=["quadratic", "none such"], readings=["a suspension with two sides"], confirm="tumble"
    )
    effect = effect_of_file(new_effect(answered, "two_sided", tmp_path))
    assert effect.confused_with == ("quadratic",)
    assert effect.splitter == "tumble"
    assert "a suspension with two sides" in effect.story
    assert "to fill in" in (tmp_path / "two_sided.py").read_text()


@pytest.mark.parametrize(
    ("answered", "effect_id", "law", "what"),
    [
        (answer(DENT), "Not a name", None, "no name of an effect"),
        (answer(DENT), "quadratic", None, "there is an effect 'quadratic' already"),
        (answer(), "mine", None, "claims no law"),
        (answer(DENT, LOAD), "mine", None, "law:dent, law:load"),
        (answer(DENT), "mine", "other", "claims no 'law:other'"),
        ({"verdict": "law"}, "mine", None, "claims: is missing"),
        (answer({**DENT, "place": "channel_delay", "channels": ["a"]}), "mine", None, "another program's output"),
        (answer({**DENT, "coefficients": [[0.0]]}), "mine", None, "does nothing"),
        (answer({**DENT, "place": "nowhere"}), "mine", None, "is unknown"),
    ],
)
def test_what_cannot_be_made_is_one_line_and_nothing_is_written(
    answered: dict[str, Any], effect_id: str, law: str | None, what: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as refused:
        new_effect(answered, effect_id, tmp_path / "mine", law=law)
    assert what in str(refused.value) and "\n" not in str(refused.value)
    assert not (tmp_path / "mine").exists()


def test_an_effect_that_is_there_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "answer.json").write_text(json.dumps(answer(DENT)))
    path = new_effect(tmp_path / "answer.json", "mine", tmp_path)
    path.write_text(path.read_text().replace("to fill in", "filled in"))
    with pytest.raises(InputError, match="is there already"):
        new_effect(tmp_path / "answer.json", "mine", tmp_path)
    assert "filled in" in path.read_text()


def test_an_answer_of_an_earlier_version_is_learnt_from_all_the_same(tmp_path: Path, clean: None) -> None:
    """Its keys of the noise had other names."""
    noise = {"wanders": True, "memory_poses": ["walk", 12.5], "memory_evidence": [9.1, 4.0]}
    file, texts = tmp_path / "diagnosis.json", []
    for folder, found in (("now", answer(DENT)), ("then", answer(DENT) | {"noise": noise})):
        file.write_text(json.dumps(found))
        texts.append(new_effect(file, "as_ever", tmp_path / folder).read_text())
    assert texts[0] == texts[1]


def test_what_a_law_has_for_its_band_alone_is_left_away(tmp_path: Path, clean: None) -> None:
    made = {}
    for law in (LOAD, BANDED):
        folder = tmp_path / law["slug"]
        made[law["slug"]] = new_effect(answer(law), "mine", folder).read_text()
    assert made["banded"] == made["load"]
    assert "wide_cosine" not in made["banded"]
