"""The model file: what it means, and one clear line for whatever is wrong with it."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from highside.config.model import Model, as_toml, load_model, parse_model
from highside.errors import InputError
from highside.physics import effects
from highside.physics.law import Axis, Law
from highside.physics.law_functions import Function
from highside.physics.plan import PosePlan, RotationPlan


def model(text: str) -> Model:
    return parse_model(tomllib.loads(text), where="model.toml")


def error(text: str) -> str:
    with pytest.raises(InputError) as caught:
        model(text)
    line = str(caught.value)
    assert "\n" not in line
    assert line.startswith("model.toml: ")
    return line


def test_an_empty_file_is_a_perfect_tool() -> None:
    assert model("").forward(1.0).ids == ()


def test_the_sensor_table_stands_for_effects() -> None:
    knows = model(
        """[sensor]
        noise_g = 80e-6
        bias_g = [1e-3, 2e-3, 3e-3]
        scale = [0.01, 0.0, -0.01]
        misalignment_deg = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]"""
    )
    parameters = knows.forward(0.02).parameters()
    assert parameters["bias"] == {"b_x": 1e-3, "b_y": 2e-3, "b_z": 3e-3}
    assert parameters["scale"]["s_z"] == -0.01
    assert parameters["misalignment"]["m_yz"] == math.radians(0.4)
    # a scatter of 80 ug in rows of 20 ms
    assert parameters["reading_noise"]["density_x"] == pytest.approx(80e-6 * 0.2)
    assert "reading_noise" not in knows.forward().ids


@pytest.mark.parametrize(
    ("effect", "line", "parameter", "value"),
    [
        ("base_tilt", "tilt_x_deg = 0.02", "tilt_x", math.radians(0.02)),
        ("base_tilt", "tilt_y = 3e-4", "tilt_y", 3e-4),
        ("encoder_first_harmonic", "c1_arcsec = 36", "c1", math.radians(0.01)),
        ("lever_arm", "r_x_mm = 8", "r_x", 8e-3),
        ("bias", "b_mg = [1, 2, 3]", "b_y", 2e-3),
        ("bias", "b_x_ug = 5", "b_x", 5e-6),
        ("quadratic", "k2 = 1e-3", "k2_z", 1e-3),
        ("reading_noise", "density_ug = 50", "density_z", 5e-5),
        ("gyro_bias", "b_z_dph = 15.041", "b_z", math.radians(15.041 / 3600)),
        ("asymmetry", "ka_x_ppm = 300", "ka_x", 3e-4),
        ("time_offset", "t0_ms = 2", "t0", 2e-3),
    ],
)
def test_parameters_may_be_written_in_the_units_of_the_bench(
    effect: str, line: str, parameter: str, value: float
) -> None:
    knows = model(f'[effects]\nincluded = ["{effect}"]\n[effects.{effect}]\n{line}')
    assert knows.forward().parameters()[effect][parameter] == pytest.approx(value, rel=1e-12)


def test_every_effect_of_the_library_may_be_included_with_its_typical_size() -> None:
    for effect in effects.all_effects().values():
        table = "\n".join(f"{p.name} = {p.typical!r}" for p in effect.parameters)
        knows = model(f'[effects]\nincluded = ["{effect.id}"]\n[effects.{effect.id}]\n{table}')
        assert knows.forward().parameters()[effect.id] == {p.name: p.typical for p in effect.parameters}


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('[effects]\nincluded = ["base_tild"]', ["effects", "unknown effect 'base_tild'", "did you mean base_tilt"]),
        ('[effects]\nincluded = ["sag", "sag"]', ["names 'sag' twice"]),
        ("[effects.sag]\ns = 1e-3", ["'sag'", "add 'sag' to included"]),
        ('[effects]\nincluded = ["sag"]\n[effects.sag]\nx = 1', ["'sag' has no parameter 'x'", "it has: s"]),
        (
            '[effects]\nincluded = ["base_tilt"]\n[effects.base_tilt]\ntilt_x = 1.0',
            ["base_tilt.tilt_x = 1.0 rad is not plausible", "-0.05 to 0.05", "implausible = true"],
        ),
        ('[effects]\nincluded = ["sag"]\n[effects.sag]\ns = nan', ["sag.s must be a finite number"]),
        ('[effects]\nincluded = ["sag"]\n[effects.sag]\ns = "a lot"', ["sag.s must be a finite number"]),
        ('[effects]\nincluded = ["bias"]\n[effects.bias]\nb = [1, 2]', ["bias.b needs one number or three"]),
        ('[effects]\nincluded = ["bias"]\n[effects.bias]\nb_x = 0.1\nb = 0.1', ["bias.b_x is given twice"]),
        ("[effects]\ninclude = 1", ["'include' is not a known field"]),
        ('[sensor]\nbias_g = [0, 0, 0]\n[effects]\nincluded = ["bias"]', ["both in [sensor] and in [effects]"]),
        ("[sensor]\nscale = [1.0, 1.0, 1.0]", ["scale s_x is outside of the plausible range -0.1 to 0.1"]),
        ("[sensor]\nbias_g = [1, 2]", ["sensor.bias_g"]),
        ("[sensor]\nbiass_g = 1", ["sensor.biass_g", "is not a known field", "did you mean bias_g"]),
        ('[sensor]\nfree = ["biass"]', ["sensor.free", "did you mean bias"]),
        ('[tool]\naxes = "xyy"', ["tool.axes", "is no axis map"]),
        ("[motion]\nhold_s = 3", ["motion.kind", "is missing", '"rotation"']),
        ('[motion]\nkind = "dance"', ["motion.kind", "is unknown", '"poses"']),
        ('[motion]\nkind = "poses"', ["motion", "has no poses"]),
        ('[motion]\nkind = "poses"\ninclinations_deg = [1]', ["go together"]),
        ('[motion]\nkind = "poses"\nposes = [[1, 2]]\nholds = 3', ["motion.holds", "did you mean hold_s"]),
        ('[motion]\nkind = "poses"\nposes = [[1, 2]]\nhold_s = -3', ["motion.hold_s", "greater than 0", "given -3"]),
        ('[motion]\nkind = "rotation"', ["give either rates_hz or rates_dps"]),
        (
            '[motion]\nkind = "rotation"\nrates_hz = [1]\ntemperatures_c = [1, 2]\ntemperature_times_s = [5, 4]',
            ["rise"],
        ),
        ('[motion]\nkind = "legs"\nlegs = [{duration = 3}]', ["motion.legs.0.duration", "did you mean duration_s"]),
        ("[site]\ngravity_mps2 = 1.0", ["site.gravity_mps2", "greater than or equal to 9.7"]),
        ('[reference]\nkind = "guess"', ["reference.kind", "'pose', 'magnitude' or 'simulation'"]),
        ("[moton]\nkind = 1", ["moton", "did you mean motion"]),
    ],
)
def test_what_is_wrong_is_said_in_one_line_with_the_field_and_the_way_out(text: str, parts: list[str]) -> None:
    line = error(text)
    for part in parts:
        assert part in line


def test_an_implausible_parameter_is_accepted_when_it_is_meant() -> None:
    text = '[effects]\nincluded = ["base_tilt"]\nimplausible = true\n[effects.base_tilt]\ntilt_x = 0.49'
    assert model(text).forward().parameters()["base_tilt"]["tilt_x"] == 0.49


def test_a_parameter_is_read_under_the_name_it_had_before() -> None:
    text = '[effects]\nincluded = ["pose_error"]\n[effects.pose_error]\n'
    values = model(f"{text}inc_ring_deg = 0.009").effects.values()["pose_error"]
    assert values == {"inc_station": pytest.approx(math.radians(0.009))}
    assert "given twice" in error(f"{text}inc_ring = 1e-4\ninc_station = 1e-4")
    assert effects.get("pose_error").vector({"inc_ring": 2e-4})[2] == 2e-4


def test_gravity_follows_the_latitude_unless_it_is_given() -> None:
    assert model("").site.site.gravity_mps2 == 9.80665
    assert model("[site]\nlatitude_deg = 90").site.site.gravity_mps2 == pytest.approx(9.83218, abs=1e-5)
    assert model("[site]\nlatitude_deg = 90\ngravity_mps2 = 9.81").site.site.gravity_mps2 == 9.81


def test_a_file_without_motion_knows_a_tool_but_cannot_be_simulated() -> None:
    with pytest.raises(InputError, match=r"motion: is missing; add a table \[motion\]"):
        model("").session()


def test_kinds_of_motion_become_plans() -> None:
    turns = model('[motion]\nkind = "turns"\ninclinations_deg = [5, 45]\nstations = 73\nreadings = 4').session().plan
    assert isinstance(turns, PosePlan)
    assert len(turns.poses) == 146
    state, _ = turns.rows(model("").site.site)
    assert state.n == 4 * 146
    spin = model('[motion]\nkind = "rotation"\nrates_dps = [360, -720]').session().plan
    assert isinstance(spin, RotationPlan)
    assert spin.rates_radps == pytest.approx((2 * math.pi, -4 * math.pi))


@pytest.mark.parametrize("name", ["model-bench.toml", "model-rotation.toml"])
def test_the_examples_are_valid_and_can_be_simulated(project_root: Path, name: str) -> None:
    knows = load_model(project_root / "config" / name)
    assert knows.session().rows().state.n > 100
    assert knows.forward(1.0).ids


@pytest.mark.parametrize("name", ["model-bench.toml", "model-rotation.toml"])
def test_a_model_written_out_is_read_back_equal(project_root: Path, name: str) -> None:
    knows = load_model(project_root / "config" / name)
    assert model(as_toml(knows)) == knows


def test_all_kinds_of_values_survive_being_written() -> None:
    knows = model(
        """[motion]
        kind = "legs"
        gyros = true
        legs = [{duration_s = 5}, {duration_s = 2.5, turn_deg = -90, inclination_to_deg = 7}]
        [tool]
        axes = "-yxz"
        """
    )
    assert model(as_toml(knows)) == knows
    assert model(as_toml(model(""))) == model("")


def test_effects_found_by_a_diagnosis_go_into_the_model() -> None:
    knows = model(
        '[sensor]\nbias_g = [1e-3, 0, 0]\nnoise_g = 1e-5\n[effects]\nincluded = ["sag"]\n[effects.sag]\ns_deg = 0.1'
    )
    changed = knows.with_effects({"bias": {"b_x": 2e-3}, "lever_arm": {"r_x": 0.01}})
    parameters = model(as_toml(changed)).forward(1.0).parameters()
    assert parameters["bias"] == {"b_x": 2e-3, "b_y": 0.0, "b_z": 0.0}
    assert parameters["sag"]["s"] == pytest.approx(math.radians(0.1))
    assert parameters["lever_arm"]["r_x"] == 0.01
    assert parameters["reading_noise"]["density_x"] > 0
    with pytest.raises(InputError, match="not plausible"):
        knows.with_effects({"lever_arm": {"r_x": 3.0}})


def test_a_file_that_is_no_toml_names_the_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_text("[sensor\n")
    with pytest.raises(InputError, match=r"broken\.toml: is not valid TOML.*line 1"):
        load_model(path)


def test_what_was_found_a_little_beyond_its_range_is_written_and_read_back() -> None:
    """A cross product of -6.05e-3 +- 1e-3, where -5e-3 is plausible, was a finding; with --write-model the whole
    diagnosis ended in exit status 2."""
    found = {"cross_product": {"k_y_xy": -6.05e-3}}
    model = parse_model({}, where="model")
    with pytest.raises(InputError, match="is not plausible"):
        model.with_effects(found)
    written = as_toml(model.with_effects(found, as_found=True))
    assert "implausible = true" in written
    assert parse_model(tomllib.loads(written), where="model").effects.values()["cross_product"]["k_y_xy"] == -6.05e-3
    assert "implausible" not in as_toml(model.with_effects({"cross_product": {"k_y_xy": 1e-3}}, as_found=True))


def test_a_model_with_the_largest_laws_that_are_found_is_read_again(tmp_path: Path) -> None:
    """Two channels of eleven by twenty-one functions: what `diagnose` wrote, `predict` refused as too long."""
    waves = tuple(Function("wide_cosine", (float(k),)) for k in range(1, 22))
    axes = tuple(Axis(name, -1.0, 1.0, waves[:count]) for name, count in (("temp", 11), ("rate", 21)))
    count = 2 * 11 * 21
    rng = np.random.default_rng(1)
    half = rng.standard_normal((count, 3))
    covariance = tuple(map(tuple, (half @ half.T).tolist()))
    coefficients = tuple(map(tuple, rng.standard_normal((2, count // 2)).tolist()))
    law = Law("level_xy_temp_x_rate", "level", ("x", "y"), axes, coefficients, covariance)
    path = tmp_path / "found.toml"
    path.write_text(as_toml(model("").with_laws([law])))
    assert path.stat().st_size > 1 << 20
    (read,) = load_model(path).known_laws
    np.testing.assert_allclose(read.covariance, covariance, rtol=1e-7)
