"""Multi-station analysis: what kept surveys show of a calibration, and what they never do."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import highside
from highside.cli.main import app
from highside.config.settings import SurveySettings
from highside.errors import InputError
from highside.recording.kept_surveys import AT_REST, read_surveys
from highside.service.messages import survey_dict
from highside.service.outputs import AttitudeOutput, Survey, SurveyReason, SurveyVerdict
from highside.service.rig.surveys import scatter_dict, trusted
from highside.service.stillness import AxisScatter, StillnessDetector
from highside.service.window import WindowReading, window_statistics
from highside.watch import STATED, Still, Watch, prior_of_record
from highside.watch.axis_noise import scatters
from highside.watch.surveys import detectable, iscwsa_prior
from studies.survey_analysis import Conditions, Departure, Well, calibration, run

STEP = Departure("b_x", 1.5e-3, 20)


@pytest.fixture(scope="module")
def tool() -> highside.Calibration:
    return calibration()


@pytest.fixture(scope="module")
def well(tool: highside.Calibration) -> Well:
    return Well("J", 3, Conditions(60), prior_of_record(tool.record), tool.record.id, None)


@pytest.fixture
def kept(tmp_path: Path, well: Well) -> Path:
    path = tmp_path / "surveys.jsonl"
    path.write_text("\n".join(well.lines) + "\n")
    return path


@pytest.fixture
def departing(tmp_path: Path, tool: highside.Calibration) -> Path:
    found = Well("J", 3, Conditions(60), prior_of_record(tool.record), tool.record.id, STEP)
    path = tmp_path / "departing.jsonl"
    path.write_text("\n".join(found.lines) + "\n")
    return path


def test_a_survey_as_the_service_keeps_it_gives_back_the_corrected_mean(tmp_path: Path) -> None:
    """What is kept is I, T and Gtotal; together they are the mean."""
    mean = np.array([0.31, -0.42, 0.85])
    length = float(np.linalg.norm(mean))
    inc, tf = np.degrees(np.arccos(mean[2] / length)), np.degrees(np.arctan2(mean[1], mean[0])) % 360.0
    attitude = AttitudeOutput(
        0.0, 0.0, inc, 0.01, tf, 0.02, tf, 0.0, length, 2e-5, "c", "global", (), 100, 10.0, 60.0
    )  # fmt: skip
    verdict = SurveyVerdict(False, (SurveyReason.G_TOTAL_LOW,), -3.5, 0.2, 0.0)
    line = survey_dict(7, 1.7e9, Survey(attitude, 30.0, 3e-4, verdict)) | {"g_noise_mg": 0.03}
    path = tmp_path / "surveys.jsonl"
    path.write_text(json.dumps(line) + "\n")
    (survey,) = read_surveys(path).surveys
    assert survey.at_rest and survey.seq == 7 and survey.temp_c == 60.0
    assert survey.mean_g() == pytest.approx(mean, abs=3e-8)


def test_a_stop_knows_what_its_axes_scatter_and_the_kept_survey_gives_it_back(tmp_path: Path) -> None:
    """As the watch has it of rows: what the detector adds up reading by reading is what `scatters` makes of them."""
    rng = np.random.default_rng(5)
    t = 0.1 * np.arange(600)
    rows = np.array([[0.3], [0.2], [0.93]]) + np.array([[1e-4], [2e-4], [4e-4]]) * rng.standard_normal((3, t.size))
    detector = StillnessDetector(SurveySettings(still_s=30.0))
    for first in range(0, t.size, 5):
        part = [
            WindowReading(float(t[k]), (float(rows[0, k]), float(rows[1, k]), float(rows[2, k])), None)
            for k in range(first, first + 5)
        ]
        detector.add(window_statistics(part, (1e-8, 4e-8, 16e-8)), part, (1e-8, 4e-8, 16e-8))
    stop = detector.cut()
    assert stop is not None and stop.scatter is not None and stop.scatter.slow is not None
    whole = scatters(t, rows)
    assert stop.scatter.reading == pytest.approx(whole[0], rel=1e-9)
    # means are closed by the output's own grid, not each 20 readings: some other readings, the same scatter
    assert stop.scatter.slow == pytest.approx(whole[1], rel=0.35)
    line = {"t": 1.7e9, "inc_deg": 20.0, "g_total": 1.0, "cal_id": "c", "accepted": True}
    path = tmp_path / "surveys.jsonl"
    path.write_text(
        "\n".join(
            json.dumps(line | {"t": 1e9 + k} | scatter_dict(of))
            for k, of in enumerate((stop.scatter, AxisScatter((1e-4, 1e-4, 1e-4), None), None))
        )
    )
    full, short, old = read_surveys(path).surveys
    assert full.scatter_g() == pytest.approx(np.array(stop.scatter), abs=1e-9)
    assert np.isnan(short.scatter_g()[1]).all() and short.scatter_g()[0] == pytest.approx([1e-4] * 3)  # type: ignore[index]
    assert old.scatter_g() is None


def with_scatter(lines: list[str], path: Path) -> Path:
    """The same surveys, their axes scattering alike in all."""
    kept = [json.loads(line) | {"scatter_mg": [[0.3, 0.3, 0.3], [0.07, 0.07, 0.07]]} for line in lines]
    path.write_text("\n".join(map(json.dumps, kept)))
    return path


def test_a_step_in_surveys_that_kept_their_scatter_is_said_within_two_hours(
    tmp_path: Path, tool: highside.Calibration
) -> None:
    """Noise that is constant within each survey shows in no scatter: the next ones are waited for all the same."""
    lines = Well("J", 3, Conditions(60), prior_of_record(tool.record), tool.record.id, STEP).lines
    path = tmp_path / "surveys.jsonl"
    path.write_text("\n".join(lines))
    alone = highside.analyse_surveys(path, tool).found.claims[0]
    (claim,) = highside.analyse_surveys(with_scatter(lines, tmp_path / "with.jsonl"), tool).found.claims
    assert claim.alarm_s <= alone.alarm_s
    assert claim.alarm_s <= claim.since_low_s + 5 * 1800.0
    assert "b_x" in claim.equivalence_class


@pytest.mark.parametrize("how", ["not set at first", "set back", "far ahead once", "merged from two files"])
def test_a_clock_that_jumps_between_surveys_moves_no_departure(
    how: str, departing: Path, tool: highside.Calibration, tmp_path: Path
) -> None:
    """The order in which they were kept stands, and the time of the jump is counted as none, which is said."""
    plain = highside.analyse_surveys(departing, tool).found.claims[0]
    rows = [json.loads(line) for line in departing.read_text().splitlines()]
    for k, row in enumerate(rows):
        if how == "not set at first" and k < 10:
            row["t"] -= 1.7e9
        if how == "set back" and k >= 30:
            row["t"] -= 86_400.0
        if how == "far ahead once" and k == 30:
            row["t"] = 9e10
    if how == "merged from two files":
        rows = rows[30:] + rows[:30]
    path = tmp_path / "jumps.jsonl"
    path.write_text("\n".join(map(json.dumps, rows)))
    found = highside.analyse_surveys(path, tool)
    (claim,) = found.found.claims
    assert claim.parameter == plain.parameter
    # half an hour between two surveys is what the jump hides
    assert abs(claim.since_s - plain.since_s) <= 1800.0
    assert any(note.startswith("clock set") for note in found.notes) == (how != "merged from two files")


def test_refused_surveys_count_where_the_service_trusts_them() -> None:
    assert {reason.value for reason in SurveyReason if trusted([reason.value])} == AT_REST


def test_a_well_without_a_departure_does_not_depart(kept: Path, tool: highside.Calibration) -> None:
    found = highside.analyse_surveys(kept, tool)
    assert found.verdict in ("holds", "learning")
    assert found.found.counts.stills == 60
    assert {"S_xy", "S_yx", "gravity"} <= {one.parameter for one in found.found.not_observable}


def test_a_step_is_found_with_its_axis_size_and_time(departing: Path, tool: highside.Calibration) -> None:
    found = highside.analyse_surveys(departing, tool)
    (claim,) = found.found.claims
    assert "b_x" in claim.equivalence_class
    assert claim.since_low_s <= STEP.at * 1800.0 <= claim.since_high_s + 1800.0
    assert claim.parameters[claim.parameter].value == pytest.approx(STEP.size, rel=0.3)


def test_the_variance_is_the_bound_of_all_surveys_at_once(
    tool: highside.Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is stated is wider: it allows for a random walk of 1.3 times the stated one."""
    stated = run("J", 12, Conditions(60), tool, None).efficiency
    monkeypatch.setattr(Watch, "_widened", lambda self, covariance: covariance)
    assert run("J", 12, Conditions(60), tool, None).efficiency == pytest.approx(1.0, abs=2e-3)
    assert 1.02 < stated < 1.2


@pytest.mark.parametrize("name", ["b_x", "S_zz", "gravity", "kT_z", "drift_y"])
def test_what_could_be_seen_is_what_the_filter_and_its_bank_see(name: str, tool: highside.Calibration) -> None:
    """Two ways to the same information: all surveys at once, and one after the other."""
    rng = np.random.default_rng(5)
    stills = []
    for k in range(40):
        f = rng.standard_normal(3)
        stills.append(Still(1800.0 * k, f / np.linalg.norm(f), 1e-5, 20.0 + k))
    prior = prior_of_record(tool.record)
    watch = Watch(prior)
    for still in stills:
        watch.still(still)
    (one,) = [one for one in detectable(stills, prior) if one.name == name]
    assert one.std is not None
    assert one.std**-2 == pytest.approx(watch.information_of(name, 0.0), rel=1e-6)


def test_at_one_inclination_the_departures_along_the_axis_look_alike(tool: highside.Calibration) -> None:
    """Curvature tells them apart: with a build from 0 to 90 deg they do not."""

    def alike(inclinations: list[float]) -> tuple[str, ...]:
        rng = np.random.default_rng(1)
        stills = []
        for k, inc in enumerate(np.radians(np.repeat(inclinations, 10))):
            tf = rng.uniform(0.0, 2.0 * np.pi)
            f = np.array([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])
            stills.append(Still(1800.0 * k, f, 1e-5, 20.0))
        return next(one for one in detectable(stills, prior_of_record(tool.record)) if one.name == "b_z").alike

    assert "S_zz" in alike([30.0])
    assert "S_zz" not in alike([0.0, 20.0, 40.0, 60.0, 80.0])


def test_surveys_of_another_calibration_and_torn_lines_are_counted_and_left_out(
    kept: Path, tool: highside.Calibration
) -> None:
    lines = kept.read_text().splitlines()
    other = json.dumps(json.loads(lines[0]) | {"cal_id": "another", "t": 1.6e9})
    moved = json.dumps(json.loads(lines[0]) | {"reasons": ["moved"], "t": 1.6e9 + 1.0})
    kept.write_text("\n".join([other, moved, lines[0][:-20], *lines, lines[5]]) + "\n")
    found = highside.analyse_surveys(kept, tool)
    assert found.found.counts.stills == 60
    assert found.found.counts.left_out == {"made under another calibration": 1, "not at rest under a calibration": 1}
    assert any(note.startswith("1 lines are no surveys") for note in found.notes)
    assert any(note.startswith("1 lines repeat") for note in found.notes)


def test_without_a_record_the_error_model_of_the_field_is_assumed(departing: Path) -> None:
    found = highside.analyse_surveys(departing)
    assert found.prior == "iscwsa"
    assert found.found.parameters["b_x"].stated_std == pytest.approx(np.hypot(0.004 / 9.80665, STATED.repeat_g))
    assert found.found.parameters["b_x"].stated_std == pytest.approx(float(np.sqrt(iscwsa_prior().covariance[0, 0])))


def test_gravity_that_is_hardly_known_hides_the_scale_and_says_so(kept: Path, tool: highside.Calibration) -> None:
    lines = [json.loads(line) | {"g_error_std_mg": 1.56} for line in kept.read_text().splitlines()]
    kept.write_text("\n".join(json.dumps(line) for line in lines) + "\n")
    found = highside.analyse_surveys(kept, tool)
    assert found.found.parameters["gravity"].stated_std == pytest.approx(1.56e-3, rel=1e-2)
    assert any("gravity is known to 1.56 mg only" in note for note in found.notes)


def test_gravity_of_the_site_may_be_given_where_the_bench_is_known(kept: Path, tool: highside.Calibration) -> None:
    """5 mg more than the tool read: that is no small error, and it is the same for all attitudes."""
    found = highside.analyse_surveys(kept, tool, gravity_mps2=9.81 * 1.005, gravity_std_mps2=1e-4)
    (claim,) = found.found.claims
    assert {"gravity", "S_all"} & set(claim.equivalence_class)
    with pytest.raises(InputError, match="no gravity of the earth"):
        highside.analyse_surveys(kept, tool, gravity_mps2=1.6)
    with pytest.raises(InputError, match="not known"):
        highside.analyse_surveys(kept, gravity_mps2=9.81)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "holds no survey (it is empty)"),
        ("t_s,ax_g\n1,2\n", "holds no survey (first line:"),
        ('{"t": 1.0, "cal_id": "c", "accepted": true, "inc_deg": 300.0, "g_total": 1.0}\n', "holds no survey"),
        (
            '{"t": 1.0, "cal_id": "c", "accepted": true, "inc_deg": null, "g_total": null}\n',
            "no survey of calibration c",
        ),
        (
            '{"t": 1.0, "cal_id": "c", "accepted": true, "inc_deg": 3.0, "g_total": 1.0}\n',
            "without what Gtotal should be",
        ),
    ],
)
def test_a_file_without_one_usable_survey_is_one_line(tmp_path: Path, content: str, says: str) -> None:
    path = tmp_path / "surveys.jsonl"
    path.write_text(content)
    done = CliRunner().invoke(app, ["surveys", "analyse", str(path), "--out", str(tmp_path / "out")])
    assert isinstance(done.exception, InputError)
    assert says in str(done.exception)
    assert "\n" not in str(done.exception)


def test_the_command_writes_both_files_and_says_in_its_status_what_it_found(
    departing: Path, kept: Path, tool: highside.Calibration, tmp_path: Path
) -> None:
    record = tmp_path / "cal.json"
    tool.save(record)
    out = tmp_path / "out"
    done = CliRunner().invoke(
        app, ["surveys", "analyse", str(departing), "--calibration", str(record), "--out", str(out)]
    )
    assert done.exit_code == 1
    assert done.output.startswith("departs: ")
    saved = json.loads((out / "surveys.json").read_text())
    assert saved["schema"] == "highside.surveys/1"
    assert saved["verdict"] == "departs" and "b_x" in saved["claims"][0]["equivalence_class"]
    assert {one["name"] for one in saved["detectable"]} >= {"b_x", "S_zz", "gravity"}
    page = (out / "report.html").read_text()
    assert "What these surveys could show" in page and page.count("<svg") == 2
    done = CliRunner().invoke(app, ["surveys", "analyse", str(kept), "--calibration", str(record), "--out", str(out)])
    assert done.exit_code == 0


def test_names_are_right_and_false_departures_absent_in_a_small_run(tool: highside.Calibration) -> None:
    conditions = Conditions(50)
    assert not any(run(kind, 40 + k, conditions, tool, None).departs for k, kind in enumerate(("J", "45", "88")))
    for k, name in enumerate(("b_y", "S_xx", "b_z")):
        outcome = run("J", 50 + k, conditions, tool, replace(STEP, name=name, size=3e-3, at=0))
        assert outcome.departs and outcome.in_class
