"""Weights of the ISCWSA error model: the algebra, the file, and what welleng makes of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import highside
from highside.cli.main import app
from highside.errors import InputError
from highside.watch.iscwsa import IscwsaTerm, accelerometer_terms, covariance_of_watch
from highside.watch.parameters import NAMES
from studies.survey_analysis import calibration

G = 9.80665
STANDARD = np.diag([(0.004 / G) ** 2] * 3 + [5e-4**2 if k % 4 == 0 else 0.0 for k in range(9)])
"""a tool that is exactly what the model states"""


@pytest.fixture(scope="module")
def tool() -> highside.Calibration:
    return calibration()


def by_name(terms: tuple[IscwsaTerm, ...]) -> dict[str, float]:
    return {one.name: one.value for one in terms}


def test_a_tool_as_the_model_states_it_gets_the_weights_of_the_model() -> None:
    found = accelerometer_terms(STANDARD)
    values = by_name(found.terms)
    assert [values[name] for name in ("ABXY-TI1S", "ABXY-TI2S", "ABZ")] == pytest.approx([0.004] * 3)
    assert [values[name] for name in ("ASXY-TI1S", "ASXY-TI2S", "ASXY-TI3S", "ASZ")] == pytest.approx([5e-4] * 4)
    assert values["AMXY-TI1"] == values["AMXY-TI2"] == 0.0
    assert found.by_axis == pytest.approx({f"AB{a}": 0.004 for a in "XYZ"} | {f"AS{a}": 5e-4 for a in "XYZ"})


def test_the_terms_add_up_to_the_covariance_at_every_inclination() -> None:
    """Independent parameters, turn and shear of the triad too: the decomposition gives the mean over toolfaces, which
    is computed from the gradients."""
    std = np.random.default_rng(3).uniform(0.1, 1.0, 12) * 1e-3
    std[9], std[10] = std[5], std[8]
    found = accelerometer_terms(np.diag(std**2))
    for _, terms, whole in found.check:
        assert terms == pytest.approx(whole, rel=1e-9)


def test_correlations_that_the_model_cannot_hold_show_in_the_check() -> None:
    """A common scale moves no inclination; the model's independent terms say it does."""
    covariance = np.zeros((12, 12))
    scale = [3, 7, 11]
    covariance[np.ix_(scale, scale)] = 1e-6
    at_45 = next(one for one in accelerometer_terms(covariance).check if one[0] == 45.0)
    assert at_45[2] == pytest.approx(0.0, abs=1e-9)
    assert at_45[1] > 0.02


def test_a_record_holds_what_it_and_the_class_of_the_tool_state(tool: highside.Calibration) -> None:
    few, many = (by_name(highside.error_model(tool, hours=hours).found.terms) for hours in (0.0, 400.0))
    assert few["ABZ"] == pytest.approx(np.hypot(1e-4, 5e-6) * 9.81, rel=0.05)
    assert many["ABZ"] == pytest.approx(np.sqrt(1e-8 + 400.0 * 25e-12) * 9.81, rel=0.05)
    warm = by_name(highside.error_model(tool, hours=0.0, warmer_c=100.0).found.terms)
    assert warm["ABZ"] > few["ABZ"]


def test_after_a_watch_the_size_that_it_found_counts_too(tool: highside.Calibration, tmp_path: Path) -> None:
    names = [f"b_{i}" for i in "xyz"] + [f"S_{i}{j}" for i in "xyz" for j in "xyz"]
    watched = {"cal_id": tool.record.id, "parameters": {name: {"value": 0.0, "std": 1e-5} for name in names}}
    watched["parameters"]["b_z"] = {"value": 1e-3, "std": 1e-5}
    path = tmp_path / "watch.json"
    path.write_text(json.dumps(watched))
    values = by_name(highside.error_model(tool, watch=path).found.terms)
    assert values["ABZ"] == pytest.approx(1e-3 * 9.81, rel=1e-3)
    assert values["ABXY-TI1S"] == pytest.approx(1e-5 * 9.81)
    path.write_text(json.dumps(watched | {"cal_id": "another"}))
    with pytest.raises(InputError, match="of another calibration"):
        highside.error_model(tool, watch=path)
    path.write_text(json.dumps(watched | {"parameters": {"b_x": {"value": 0.0}}}))
    with pytest.raises(InputError, match="has no value and std of b_x"):
        highside.error_model(tool, watch=path)


def ellipses(model: dict[str, Any] | str) -> Any:
    survey = pytest.importorskip("welleng.survey")
    inc = np.linspace(0.0, 88.0, 30)
    header = survey.SurveyHeader(
        latitude=60.0,
        longitude=3.0,
        altitude=0.0,
        b_total=50_000.0,
        dip=72.0,
        declination=0.0,
        azi_reference="true",
        G=G,
    )
    return survey.Survey(30.0 * np.arange(30), inc, np.full(30, 40.0), header=header, error_model=model)


@pytest.mark.parametrize("axial", [False, True])
def test_welleng_reads_the_file_and_makes_the_same_of_it_as_of_its_own_model(tmp_path: Path, axial: bool) -> None:
    """With the model's own sigmas every term gives the angles of welleng's own term of that name."""
    from highside.api.iscwsa import ErrorModel

    path = tmp_path / "model.json"
    ErrorModel(accelerometer_terms(STANDARD, axial=axial), "HS-1", "0" * 64, "a test").save(path)
    ours = ellipses(json.loads(path.read_text()))
    own = ellipses("MWD+SRGM+AX" if axial else "MWD+SRGM")
    found, expected = ours.err.errors.errors, own.err.errors.errors
    names = [name for name in found if not name.startswith("AMXY")]
    assert len(names) == 7 and not ours.err.errors.dropped_terms
    for name in names:
        np.testing.assert_allclose(found[name].e_DIA, expected[name].e_DIA, atol=1e-12, err_msg=name)
    assert np.linalg.eigvalsh(ours.cov_nev[-1]).min() > 0.0


def test_a_good_tool_has_smaller_ellipses_than_the_fleet(tool: highside.Calibration) -> None:
    ours = ellipses(highside.error_model(tool).to_dict())
    fleet = ellipses(highside.api.iscwsa.ErrorModel(accelerometer_terms(STANDARD), "x", "0" * 64, "a test").to_dict())
    ratio = np.sqrt(np.trace(ours.cov_nev[-1]) / np.trace(fleet.cov_nev[-1]))
    assert 0.05 < ratio < 0.6


def test_a_tool_model_gets_our_terms_and_keeps_the_others(tool: highside.Calibration, tmp_path: Path) -> None:
    names = ["ABXY-TI1S", "ABXY-TI2S", "ABZ", "ASXY-TI1S", "ASXY-TI2S", "ASXY-TI3S", "ASZ"]
    base = {"metadata": {"short_name": "ours"}, "terms": [{"name": name, "value": 9.0} for name in ["DREFR", *names]]}
    (tmp_path / "base.json").write_text(json.dumps(base))
    made = highside.error_model(tool)
    made.save(tmp_path / "out.json", into=tmp_path / "base.json")
    out = json.loads((tmp_path / "out.json").read_text())
    values = {one["name"]: one["value"] for one in out["terms"]}
    assert out["metadata"] == base["metadata"] and values["DREFR"] == 9.0
    assert all(values[name] < 0.1 for name in names)
    (tmp_path / "base.json").write_text(json.dumps({"terms": base["terms"][:3]}))
    with pytest.raises(InputError, match="lacks accelerometer terms"):
        made.save(tmp_path / "out.json", into=tmp_path / "base.json")
    (tmp_path / "base.json").write_text("[]")
    with pytest.raises(InputError, match="no tool model"):
        made.save(tmp_path / "out.json", into=tmp_path / "base.json")


@pytest.mark.parametrize("one", [{"value": 1e308}, {"value": True}, {"std": -1e-5}, {"std": 1e308}, {"value": 10**400}])
def test_a_watch_with_numbers_that_cannot_be_is_refused(one: dict[str, float]) -> None:
    sound = {name: {"value": 1e-4, "std": 1e-5} for name in NAMES}
    assert covariance_of_watch(sound, "watch.json").shape == (12, 12)
    with pytest.raises(InputError, match="S_xy cannot be"):
        covariance_of_watch(sound | {"S_xy": sound["S_xy"] | one}, "watch.json")


def test_the_command_prints_the_terms_and_writes_the_file(tool: highside.Calibration, tmp_path: Path) -> None:
    tool.save(tmp_path / "cal.json")
    out = tmp_path / "model.json"
    done = CliRunner().invoke(app, ["calibrate", "iscwsa", str(tmp_path / "cal.json"), "-o", str(out)])
    assert done.exit_code == 0 and "ABXY-TI1S" in done.output
    assert {one["name"] for one in json.loads(out.read_text())["terms"]} >= {"ABZ", "ASZ", "AMXY-TI1"}
    done = CliRunner().invoke(app, ["calibrate", "iscwsa", str(tmp_path / "cal.json"), "-o", str(out), "--hours", "-1"])
    assert isinstance(done.exception, InputError) and "--hours" in str(done.exception)
