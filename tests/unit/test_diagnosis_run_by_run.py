"""A rotation whose rows are not in the memory: the answer of the one in the memory, and what is said of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from highside.api.diagnosis import diagnose
from highside.arrays import Array
from highside.cli.main import app
from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.intake import checks
from highside.diagnosis.intake import long as intake
from highside.diagnosis.rotation import lines, pilot, problem
from highside.diagnosis.rows.design import ChainDesign
from highside.diagnosis.rows.session import PER_ROW, RotationSession
from highside.errors import InputError
from highside.fleet.jobs import Order, row_of
from highside.long_arrays import RUN
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState, slopes, unwrapped
from highside.reading import row_groups
from highside.scratch_arrays import filed
from studies import rotation_cases as cases
from studies.giant_recording import MODEL, differences, written
from tests.unit.test_diagnosis_long import STRONG

FURTHER = pytest.mark.further
BARE = ProcedureParts.without("laws")
ROWS = 12_000
SECONDS = ROWS / 50


def in_file(session: RotationSession) -> RotationSession:
    state = replace(
        session.state,
        **{name: filed(np.ascontiguousarray(getattr(session.state, name))) for name in (*PER_ROW, "pose")},
    )
    return RotationSession(filed(session.readings), state, session.omitted)  # type: ignore[arg-type]


def turning(effects: dict[str, dict[str, float]], *, lost: float = 0.0, omitted: bool = False) -> RotationSession:
    """A rotation with effects that the model lacks; a share of its rows lost, some rows without meaning."""
    state = cases.design(3, seconds=SECONDS)
    rng = np.random.default_rng(9)
    noise = cases.noise_of("coloured", state, rng).draw(rng)
    readings = ForwardModel.of(effects).predict(state) + noise
    kept = rng.random(state.n) >= lost
    without = rng.random(int(kept.sum())) < 1e-3 if omitted else None
    return RotationSession(np.ascontiguousarray(readings[:, kept]), state.rows(kept), without)


CASES: dict[str, Callable[[], RotationSession]] = {
    "nothing left out": lambda: turning({}),
    "weak": lambda: turning({"lever_arm": {"r_x": 1e-5, "r_y": 2e-5}}),
    "strong": lambda: turning(STRONG),
    "an effect that remembers": lambda: turning({"thermal_lag": {"c_x": 4e-5, "c_y": 0.0, "c_z": 0.0, "tau": 300.0}}),
    "rows lost, rows without meaning": lambda: turning({"lever_arm": {"r_x": 4e-5}}, lost=0.1, omitted=True),
    "a line": lambda: turning({"tone": {"c_x": 3e-5, "f": 7.31}}),
}


@pytest.fixture
def many(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows that are many: what is done with a subsample of long recordings is done with these."""
    short = replace(pilot.PILOT, many_rows=5_000, pilot_rows=3_000)
    monkeypatch.setattr(pilot, "PILOT", short)
    monkeypatch.setattr(problem, "PILOT", short)
    # the others read it where they need it
    monkeypatch.setattr("highside.diagnosis.rotation.policy.PILOT", short)


@pytest.mark.parametrize(
    "case",
    [
        "nothing left out",
        # between nothing and what is strong
        pytest.param("weak", marks=FURTHER),
        pytest.param("strong", marks=FURTHER),
        pytest.param("an effect that remembers", marks=FURTHER),
        "rows lost, rows without meaning",
        "a line",
    ],
)
@pytest.mark.usefixtures("many")
def test_the_answer_is_that_of_rows_in_the_memory(case: str) -> None:
    session = CASES[case]()
    whole, report = diagnose_rotation(session, ForwardModel.of({}), cases.FREE, method=BARE)
    long, drawn = diagnose_rotation(in_file(session), ForwardModel.of({}), cases.FREE, method=BARE)
    assert whole.verdict == long.verdict
    worst = max(differences(whole.to_dict(), long.to_dict()))
    # rows are summed by the same runs wherever they lie
    assert worst[0] < 1e-12, worst
    assert report.scores is not None and drawn.scores is not None
    np.testing.assert_allclose(
        drawn.scores.score, report.scores.score, rtol=1e-9, atol=1e-12 * np.abs(report.scores.score).max()
    )
    assert f"all {session.n} rows" in long.remainder.hints[0]
    assert drawn.before.shape == drawn.after.shape == (3, in_file(session).sample_rows.size)


def test_what_remembers_is_the_same_number_at_late_times_too() -> None:
    """A day's clock tells two neighbouring rows apart by fewer digits than that of a new recording."""
    rows, rng = 3 * RUN // 2, np.random.default_rng(4)
    t_s = 3e4 + 0.02 * np.arange(rows)
    assert np.ptp(np.diff(t_s)) > 1e-10 * 0.02
    state = ChainState.build(
        np.full(rows, 1.2),
        np.mod(0.01 * t_s, 2 * np.pi),
        t_s=t_s,
        temp_c=25 + 5 * np.sin(t_s / 200),
        rotor_rate_radps=np.full(rows, 0.01),
    )
    session = RotationSession(1e-4 * rng.standard_normal((3, rows)), state)
    whole, long = (ChainDesign(one, ForwardModel.of({}), ()) for one in (session, in_file(session)))
    assert [c.id for c in whole.candidates] == [c.id for c in long.candidates]
    remembering = [c for c in whole.candidates if c.effect is not None and c.effect.remembers]
    assert {"thermal_lag", "thermal_hysteresis"} <= {c.id for c in remembering}
    for part in (slice(0, 2000), slice(RUN - 1000, RUN + 1000), slice(rows - 2000, rows)):
        for one, other in zip(whole.functions(part), long.functions(part), strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_line_of_a_stretch_is_known_as_well_as_all_rows_know_it(monkeypatch: pytest.MonkeyPatch) -> None:
    session = turning({"tone": {"c_x": 2e-4, "f": 7.31}})
    monkeypatch.setattr(lines, "LINES_POLICY", replace(lines.LINES_POLICY, most_rows=1500))
    residual = session.readings - ForwardModel.of({}).predict(session.state)
    found = [one.value for one in lines.found_lines(in_file(session), filed(residual)) if one.effect == "tone"]  # type: ignore[arg-type]
    assert np.min(np.abs(np.array(found) - 7.31)) < 0.1 / SECONDS


def test_angles_and_rates_are_those_of_the_whole() -> None:
    rng = np.random.default_rng(1)
    t_s = np.arange(200_000) * 0.02
    kept = rng.random(t_s.size) > 0.01
    kept[65_500:65_560] = False
    t_s = t_s[kept]
    way = 240 * np.arcsin(np.sin(t_s / 80))
    angle, rows = np.mod(way, 2 * np.pi), t_s.size
    whole = unwrapped(angle, t_s)
    np.testing.assert_allclose(whole, way, atol=1e-12)
    long = unwrapped(filed(angle), filed(t_s))  # type: ignore[arg-type]
    np.testing.assert_array_equal(long[:rows], whole)
    np.testing.assert_array_equal(slopes(long, filed(t_s))[:rows], slopes(whole, t_s))  # type: ignore[arg-type]


# --- from files ----------------------------------------------------------------------------------------------


def table_of(path: Path) -> dict[str, Array]:
    read = parquet.read_table(path)
    return {name: read.column(name).to_numpy().copy() for name in read.column_names}


def write(columns: dict[str, Array], path: Path) -> Path:
    parquet.write_table(pa.table(columns), path)
    return path


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(ROWS, tmp_path_factory.mktemp("recorded"))


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "model.toml"
    path.write_text(MODEL)
    return path


def test_a_file_is_diagnosed_alike_both_ways(recorded: Path, model: Path) -> None:
    whole = diagnose(recorded, model, method=BARE)
    long = diagnose(recorded, model, run_by_run=True, method=BARE)
    worst = max(differences(whole.to_dict(), long.to_dict()))
    # so few rows are in the memory worked on at once
    assert worst[0] < 1e-10, worst
    assert long.verdict == "named"
    assert long.notes[0].startswith(f"{ROWS} rows are")
    assert "lever_arm" in long.html()


def test_rows_that_lack_a_value_are_left_out_and_counted(recorded: Path, model: Path, tmp_path: Path) -> None:
    columns = table_of(recorded)
    lost = np.random.default_rng(2).random(ROWS) < 0.02
    columns["ay_g"] = np.where(lost, np.nan, columns["ay_g"])
    columns["note"] = np.zeros(ROWS)
    path = write(columns, tmp_path / "gaps.parquet")
    whole = diagnose(path, model, method=BARE)
    long = diagnose(path, model, run_by_run=True, method=BARE)
    assert [f.check for f in long.intake] == [f.check for f in whole.intake] == ["missing_values"]
    assert long.intake[0].remedy.startswith(f"{int(lost.sum())} of {ROWS} rows lack a value")
    assert "not used: note" in long.notes[0]
    assert max(differences(whole.to_dict()["claims"], long.to_dict()["claims"]))[0] < 1e-9


def test_faults_are_found_stretch_by_stretch(
    recorded: Path, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(intake, "CHECKS", replace(checks.CHECKS, stretch=3000))
    columns = table_of(recorded)
    swapped = slice(3000, 6000)
    columns["ax_g"][swapped], columns["ay_g"][swapped] = columns["ay_g"][swapped], columns["ax_g"][swapped].copy()
    columns["az_g"][[200, 9000]] += 0.1
    path = write(columns, tmp_path / "swapped.parquet")
    found = diagnose(path, model, run_by_run=True, method=BARE)
    assert found.verdict == "bad_data"
    assert found.intake[0].check == "swapped_axis"
    assert "in 1 of 4 stretches, from 60 to 119.98 s" in found.intake[0].remedy
    assert any(f.check == "impulses" for f in found.intake)


def test_what_cannot_be_read_run_by_run_is_said(recorded: Path, model: Path, tmp_path: Path) -> None:
    columns = table_of(recorded)
    infinite = dict(columns, ax_g=np.where(np.arange(ROWS) == 7, np.inf, columns["ax_g"]))
    timeless = {name: values for name, values in columns.items() if name != "t_s"}
    poses = dict(columns, pose=np.zeros(ROWS))
    text = tmp_path / "rows.csv"
    text.write_text("t_s,ax_g\n0,1\n")
    for path, words in (
        (write(infinite, tmp_path / "infinite.parquet"), "row 7: ax_g: holds an infinite number"),
        (write(timeless, tmp_path / "timeless.parquet"), "lacks the column t_s"),
        (write(poses, tmp_path / "poses.parquet"), "run_by_run: is no rotation"),
        (text, "run_by_run: is no rotation"),
    ):
        with pytest.raises(InputError, match=words):
            diagnose(path, model, run_by_run=True)


def test_a_row_group_that_fills_the_memory_is_refused(
    recorded: Path, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(row_groups, "GROUP_BYTES", 1000)
    with pytest.raises(InputError, match=r"row group of .* bytes.*row groups of a million rows"):
        diagnose(recorded, model, run_by_run=True)


def test_a_damaged_file_is_one_line(recorded: Path, model: Path, tmp_path: Path) -> None:
    torn = bytearray(recorded.read_bytes())
    torn[1000:60_000] = bytes(59_000)
    (tmp_path / "torn.parquet").write_bytes(torn)
    with pytest.raises(InputError, match="is a damaged Parquet file"):
        diagnose(tmp_path / "torn.parquet", model, run_by_run=True)


@FURTHER
def test_the_command_and_a_fleet_read_a_long_file_run_by_run(
    recorded: Path, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("highside.api.diagnosis.MANY_ROWS", "highside.recording.long.MANY_ROWS"):
        monkeypatch.setattr(place, 10_000)
    given = ["diagnose", str(recorded), "--model", str(model), "--out", str(tmp_path / "out"), "--workers", "3"]
    done = CliRunner().invoke(app, given)
    assert done.exit_code == 0, done.output
    assert f"{ROWS} rows are more than are held in the memory" in done.output
    told = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert told["verdict"] == "named"
    assert "laws were sought in" in told["remainder"]["hints"][0]
    # laws, half a minute of them, were sought by the command
    monkeypatch.setattr("highside.api.diagnosis.diagnose", partial(diagnose, method=BARE))
    row = row_of(Order("diagnose", MODEL), recorded)
    assert (row["verdict"], row["rows"], row["claims"]) == ("named", ROWS, ["lever_arm"])
    assert row["score"]
