"""The public API: `import highside` costs nothing, gives what it names, typed and documented; tables in kind."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import highside
from highside import api
from highside.cli.options import in_options
from highside.errors import InputError

MODEL: dict[str, Any] = {
    "sensor": {"bias_g": [1.2e-3, -0.8e-3, 1.6e-3], "scale": [0.003, -0.004, 0.002], "noise_g": 50e-6},
    "motion": {
        "kind": "poses",
        "inclinations_deg": [3.0, 15.0, 45.0, 90.0],
        "toolfaces_deg": [45, 135, 225, 315],
        "hold_s": 4,
    },
}
TURNING: dict[str, Any] = {
    "sensor": {"noise_g": 50e-6},
    "motion": {"kind": "rotation", "rates_hz": [0.1, 0.2], "hold_s": 4.0, "sample_hz": 20.0, "gyros": True},
    "effects": {"included": ["gyro_noise"], "gyro_noise": {"density_dps": 0.005}},
}


class Interchanged:
    """A table that offers its columns by the DataFrame interchange protocol alone."""

    def __init__(self, frame: pd.DataFrame) -> None:
        self._table = pa.Table.from_pandas(frame)

    def __dataframe__(self, nan_as_null: bool = False, allow_copy: bool = True) -> object:
        return self._table.__dataframe__(nan_as_null, allow_copy)


class Streamed:
    """A table that speaks the Arrow PyCapsule interface alone."""

    def __init__(self, frame: pd.DataFrame) -> None:
        self._table = pa.Table.from_pandas(frame)

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        return self._table.__arrow_c_stream__(requested_schema)


@pytest.fixture(scope="module")
def simulation() -> highside.Simulation:
    return highside.simulate(MODEL, seed=3)


@pytest.fixture(scope="module")
def calibration(simulation: highside.Simulation) -> highside.Calibration:
    assert simulation.poses is not None
    return highside.calibrate(simulation.poses, tool="HS-7", pose_sigma_deg=0.01)


@pytest.mark.parametrize(("argument", "value"), [("pose_sigma_deg", 1e-300), ("expires_days", 1e17)])
def test_a_setting_or_an_expiry_beyond_reason_is_refused(
    simulation: highside.Simulation, argument: str, value: float
) -> None:
    with pytest.raises(InputError, match=argument):
        highside.calibrate(simulation.poses, **{argument: value})


@pytest.fixture(scope="module")
def turning() -> highside.Recording:
    return highside.simulate(TURNING, seed=3).recording


# --- the module itself ---------------------------------------------------------------------------------------


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_import_loads_nothing_but_itself() -> None:
    loaded = run("import sys; before = set(sys.modules); import highside; print(*sorted(set(sys.modules) - before))")
    own = [name for name in loaded.split() if name.split(".")[0] not in sys.stdlib_module_names]
    assert own == ["highside", "highside.version"], "a number alone is beside it"


def test_no_package_takes_the_place_of_a_function() -> None:
    # a package becomes an attribute of its parent whenever it is loaded, and a function of that name would be gone
    folder = Path(highside.__file__).parent
    modules = {path.name.removesuffix(".py") for path in folder.iterdir() if (path / "__init__.py").is_file()}
    modules |= {path.stem for path in folder.glob("*.py")}
    assert not modules & {*highside.__all__}
    loaded = "import highside.gyro.filter, highside.diagnosis.engine, highside.api.gyro, highside; "
    assert run(loaded + "print(callable(highside.drift), callable(highside.diagnose))") == "True True"


def test_type_checkers_and_the_interpreter_find_each_name_in_the_same_module() -> None:
    tree = ast.parse(Path(api.__file__).read_text())
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    shown = {
        name.name: node.module for node in imports for name in node.names if str(node.module).startswith("highside")
    }
    homes = {str(name): home for name, home in vars(api)["_HOMES"].items()}
    assert homes == shown
    assert sorted(homes) == sorted(api.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = api.nothing  # type: ignore[attr-defined]


def test_every_name_can_be_imported_and_is_documented() -> None:
    assert {*highside.__all__} <= {*dir(highside)}
    for name in highside.__all__:
        thing = getattr(highside, name)
        if name == "__version__":
            continue
        words = inspect.getdoc(thing)
        assert words, name
        assert len(words) > 30, name
        if inspect.isfunction(thing):
            assert thing.__annotations__["return"], name
    with pytest.raises(AttributeError, match="has no attribute 'calibrat'"):
        _ = highside.calibrat  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", [n for n in highside.__all__ if n.islower() and not n.startswith("_")])
def test_functions_say_columns_units_and_errors(name: str) -> None:
    words = " ".join((inspect.getdoc(getattr(highside, name)) or "").split())
    assert "Raises InputError" in words, f"{name} does not say what it raises"
    if name not in ("simulate", "calibrate", "new_effect", "allow_bytes"):
        assert "_deg" in words or "`t_s`" in words or name in ("fit_self",), f"{name} names no column"
    for argument in inspect.signature(getattr(highside, name)).parameters:
        if argument not in ("seed", "fitted", "by"):
            assert argument in words, f"{name} does not say what {argument} is"


def test_the_two_lists_of_names_are_one() -> None:
    import highside.api

    assert {*highside.__all__} - {"__version__"} == {*highside.api.__all__}
    tree = ast.parse(Path(highside.__file__).read_text())
    typed = {alias.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names
             if node.module == "highside.api"}  # fmt: skip
    assert typed == {*highside.api.__all__}


PROGRAM = """
import numpy as np
import polars as pl
from numpy.typing import NDArray

import highside
from highside import api


def of_file(path: str) -> None:
    recording: highside.Recording = highside.read(path)
    poses: highside.PoseTable = highside.find_poses(path)
    calibration: highside.Calibration = highside.calibrate(poses, "balance", triples="average", tool="HS-7")
    corrected = calibration.correct(recording, frame="bench")
    reveal: NDArray[np.float64] = corrected["inc_deg"]
    found: highside.Diagnosis = highside.diagnose(recording, "model.toml")
    model: highside.Model | None = found.model()
    print(reveal.mean(), found.verdict, [claim.effect for claim in found.claims], model)


def of_frames(frame: pl.DataFrame) -> pl.DataFrame:
    model = highside.Model()
    predicted: pl.DataFrame = highside.predict(model, frame)
    followed: highside.Drift[pl.DataFrame] = highside.drift(predicted, "kinematic", latitude_deg=52.0)
    compensated = highside.compensate(followed.data, method="sine")
    return compensated.data.select("t_s")


def of_arrays(columns: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    return highside.predict({"sensor": {"noise_g": 1e-4}}, columns)["ax_g"]
"""


def test_a_users_program_is_checked_strictly(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)

    def mypy() -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", "--cache-dir", tmp_path / "cache"]
        return subprocess.run([*command, program], capture_output=True, text=True, timeout=280, cwd=tmp_path)

    done = mypy()
    assert done.returncode == 0, done.stdout
    program.write_text(PROGRAM + '\n\nhighside.drift("rec.csv", "kinematik", latitude_deg="52")\n')
    wrong = mypy().stdout
    assert "drift" in wrong and "error" in wrong, "a wrong method and a text for a number must be seen"


# --- tables in kind ------------------------------------------------------------------------------------------


def test_a_table_comes_back_as_what_it_was(
    simulation: highside.Simulation, calibration: highside.Calibration, tmp_path: Path
) -> None:
    recording = simulation.recording
    path = tmp_path / "rec.csv"
    recording.write(path)
    expected = calibration.correct(recording)
    assert isinstance(expected, highside.Table)

    frame = recording.to_pandas()
    frame.index = pd.Index(np.arange(frame.shape[0]) * 2 + 7, name="mine")
    frame["remark"] = pd.date_range("2026-01-01", periods=len(frame))
    pandas = calibration.correct(frame)
    assert isinstance(pandas, pd.DataFrame)
    assert pandas.index.equals(frame.index)
    assert pandas["remark"].equals(frame["remark"]), "what highside does not know stays as it is"
    assert "inc_deg" not in frame, "what was given is not changed"

    polars = calibration.correct(recording.to_polars())
    assert isinstance(polars, pl.DataFrame)
    arrow = calibration.correct(recording.to_arrow())
    assert isinstance(arrow, pa.Table)
    plain = calibration.correct({name: recording[name].tolist() for name in recording.order})
    assert isinstance(plain, dict)
    of_file = calibration.correct(path)
    plain_frame = recording.to_pandas()
    streamed, interchanged = calibration.correct(Streamed(plain_frame)), calibration.correct(Interchanged(plain_frame))
    assert isinstance(streamed, pa.Table)
    assert isinstance(interchanged, pa.Table)
    for name in ("inc_deg", "tf_deg", "inc_std_deg", "tf_std_deg", "ax_g"):
        values = [pandas[name], polars[name], arrow[name], plain[name], of_file[name], streamed[name]]
        values.append(interchanged[name])
        for one in values:
            np.testing.assert_array_equal(np.asarray(one), expected[name], err_msg=name)


def test_what_is_missing_is_null_in_polars_and_nan_in_pandas(calibration: highside.Calibration) -> None:
    # a tool of one zone knows no correction for readings that are no gravity; here a row has no reference
    model = {"sensor": {"bias_g": [1e-3, 0, 0]}}
    frame = pl.DataFrame(
        {"t_s": [0.0, 1.0, 2.0], "inc_ref_deg": [30.0, None, 60.0], "tf_ref_deg": [0.0, 0.0, 0.0], "pose": [0, 1, 2]}
    )
    predicted = highside.predict(model, frame)
    assert predicted["ax_g"].is_null().to_list() == [False, True, False]
    assert predicted.schema["pose"] == pl.Int64, "columns that are not predicted keep their type"
    assert highside.predict(model, frame.to_pandas())["ax_g"].isna().tolist() == [False, True, False]
    assert np.isnan(highside.predict(model, frame.to_dict(as_series=False))["ax_g"]).tolist() == [False, True, False]


def test_times_that_are_texts_name_the_command_that_reads_them(tmp_path: Path) -> None:
    """By `diagnose` as by every other command: of its file it asked for seconds and said no more."""
    path = tmp_path / "iso.csv"
    path.write_text("t_s,ax_g,ay_g,az_g\n2026-11-22T10:00:00Z,0.1,0.2,0.97\n")
    for read in (highside.read, highside.diagnose):
        with pytest.raises(InputError, match=r"t_s: is a text .*seconds are expected; .*highside import .*iso\.csv"):
            read(path)


def test_tables_of_highside_are_taken_by_others(simulation: highside.Simulation) -> None:
    recording = simulation.recording
    assert pl.DataFrame(recording).columns == list(recording.order)
    assert pa.table(recording).num_rows == recording.n
    np.testing.assert_array_equal(recording.to_polars()["ax_g"].to_numpy(), recording["ax_g"])


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"t_s": [0.0, 1.0], "ax_g": [0.0]}, "ax_g: has 1 rows where t_s has 2"),
        ({"t_s": [[0.0]]}, r"t_s: has the shape \(1, 1\)"),
        ({"t_s": ["a", "b"]}, r"row 0: t_s: is a text \('a'\), seconds are expected"),
        ({"t_s": [0.0, None]}, "row 1: t_s: every row needs its time"),
        ({"t_s": [0.0, 1.0], "ax_g": [0.0, np.inf]}, "row 1: ax_g: inf is not a finite number; multiples of g"),
        ({"ax_g": [0.0]}, "lacks the column t_s; it has: ax_g"),
        (pd.DataFrame({"t_s": pd.date_range("2026-01-01", periods=2)}), "t_s: is of the type Datetime.*seconds"),
        (pd.DataFrame({"t_s": [0.0, 1.0], "ax_g": ["1 g", "2"]}), r"row 0: ax_g: is a text \('1 g'\)"),
        (pl.LazyFrame({"t_s": [0.0]}), "a LazyFrame has no rows yet; collect"),
        (7, "a int is no table; give a file, a DataFrame, or a dict of columns"),
        ([1.0, 2.0], "a list is no table"),
    ],
)  # fmt: skip
def test_a_table_that_is_not_in_order_is_refused_in_one_line(data: Any, words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        highside.read(data)
    assert "\n" not in str(error.value)


def test_a_gap_is_reported_by_the_row_of_a_table_and_the_line_of_a_file(
    simulation: highside.Simulation, calibration: highside.Calibration, tmp_path: Path
) -> None:
    frame = simulation.recording.to_pandas()
    frame.loc[4, "ay_g"] = np.nan
    with pytest.raises(InputError, match="table: row 4: ay_g: is missing"):
        calibration.correct(frame)
    path = tmp_path / "gap.csv"
    frame.to_csv(path, index=False)
    with pytest.raises(InputError, match=r"gap.csv: line 6: ay_g: is missing"):
        calibration.correct(path)


def test_without_narwhals_a_frame_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "narwhals", None)
    with pytest.raises(InputError, match=r"needs narwhals, which is not installed; pip install 'highside\[frames\]'"):
        highside.read(pd.DataFrame({"t_s": [0.0]}))
    assert highside.read({"t_s": [0.0]}).n == 1, "dicts of arrays need no library"


def test_without_matplotlib_a_plot_says_what_to_install(
    turning: highside.Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(InputError, match=r"matplotlib, which is not installed; pip install 'highside\[plot\]'"):
        turning.plot().figure()


def test_without_bokeh_a_chart_says_what_to_install_and_a_notebook_shows_it_still(
    turning: highside.Recording, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("highside.shown.screen.can_draw", lambda: False)
    chart = turning.plot("ax_g")
    with pytest.raises(InputError, match=r"needs Bokeh, which is not installed; pip install 'highside\[notebook\]'"):
        chart.save(tmp_path / "chart.html")
    assert list(tmp_path.iterdir()) == []
    assert chart._repr_html_().startswith("<svg")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert "pip install &#39;highside[notebook]&#39;" in chart._repr_html_()
    with pytest.raises(InputError, match=r"x\.gif: is no kind of picture; end it in \.html"):
        chart.save(tmp_path / "x.gif")


# --- what the functions answer -------------------------------------------------------------------------------


def test_a_session_is_simulated_calibrated_and_corrected(
    simulation: highside.Simulation, calibration: highside.Calibration
) -> None:
    np.testing.assert_allclose(calibration.bias_g, [1.2e-3, -0.8e-3, 1.6e-3], atol=2e-4)
    corrected = calibration.correct(simulation.recording)
    error = corrected["inc_deg"] - corrected["inc_ref_deg"]
    raw = np.degrees(np.arctan2(np.hypot(corrected["ax_g"], corrected["ay_g"]), corrected["az_g"]))
    assert np.sqrt(np.mean(error**2)) < 0.02 < np.sqrt(np.mean((raw - corrected["inc_ref_deg"]) ** 2))
    assert calibration.recomputed() == 0.0
    assert not calibration.refused


def test_poses_are_found_in_the_kind_that_came_in(simulation: highside.Simulation) -> None:
    found = highside.find_poses(simulation.recording.to_polars())
    assert isinstance(found, pl.DataFrame)
    assert found.shape[0] == 16
    known = highside.find_poses(simulation.recording)
    np.testing.assert_array_equal(found["ax"].to_numpy(), known["ax"])


def test_a_prediction_leaves_the_noise_and_nothing_else(turning: highside.Recording) -> None:
    predicted = highside.predict(TURNING, turning)
    for name in ("ax_g", "ay_g", "az_g"):
        left = turning[name] - predicted[name]
        assert 40e-6 < np.std(left) < 60e-6
        assert abs(np.mean(left)) < 10e-6
    assert np.std(turning["gz_dps"] - predicted["gz_dps"]) < 0.05 < np.std(turning["gz_dps"])
    assert predicted.order == turning.order
    np.testing.assert_array_equal(predicted["temp_c"], turning["temp_c"])
    other = highside.predict({"sensor": {"bias_g": [1e-3, 0.0, 0.0]}}, turning)
    assert np.mean(other["ax_g"] - predicted["ax_g"]) == pytest.approx(1e-3)


def test_a_prediction_is_in_the_makers_axes() -> None:
    rows = {"t_s": [0.0, 1.0], "inc_ref_deg": [90.0, 90.0], "tf_ref_deg": [0.0, 90.0], "pose": [0, 1]}
    tool = highside.predict({}, rows)
    maker = highside.predict({"tool": {"axes": "-yxz"}}, rows)
    np.testing.assert_allclose(tool["ax_g"], -np.asarray(maker["ay_g"]), atol=1e-15)
    np.testing.assert_allclose(tool["ay_g"], maker["ax_g"], atol=1e-15)


def test_drift_says_what_its_azimuth_rests_on(turning: highside.Recording) -> None:
    followed = highside.drift(turning.to_pandas(), "recursive", latitude_deg=52.0, azimuth_deg=30.0)
    assert isinstance(followed.data, pd.DataFrame)
    assert len(followed.data) == turning.n
    assert followed.basis
    with pytest.raises(InputError, match="smooth: has no meaning with the method recursive"):
        highside.drift(turning, "recursive", smooth=True)
    with pytest.raises(InputError, match="'kinematik' is unknown; one of literal"):
        highside.drift(turning, "kinematik")  # type: ignore[call-overload]


def test_an_error_by_the_rotor_angle_is_taken_off() -> None:
    angle = np.linspace(0.0, 3600.0, 2000)
    rng = np.random.default_rng(5)
    error = 4.0 * np.sin(np.radians(angle)) + rng.normal(0.0, 0.05, angle.size)
    frame = pl.DataFrame({"t_s": angle / 36.0, "rotor_deg": angle, "d_roll_arcmin": error})
    done = highside.compensate(frame)
    assert isinstance(done.data, pl.DataFrame)
    assert done.data["d_roll_comp_arcmin"].std() == pytest.approx(0.05, rel=0.1)
    again = highside.compensate(frame, done.compensation)
    np.testing.assert_array_equal(again.data["d_roll_comp_arcmin"], done.data["d_roll_comp_arcmin"])
    with pytest.raises(InputError, match="method: has no meaning with a compensation"):
        highside.compensate(frame, done.compensation, method="sine")


def test_a_diagnosis_names_what_the_model_lacks(simulation: highside.Simulation, tmp_path: Path) -> None:
    known = {key: value for key, value in MODEL.items() if key != "motion"}
    leaning = {"included": ["base_tilt"], "base_tilt": {"tilt_x_deg": 0.2, "tilt_y_deg": -0.15}}
    recording = highside.simulate(MODEL | {"effects": leaning}, seed=5).recording
    found = highside.diagnose(recording.to_polars(), known)
    assert found.verdict == "named"
    assert [claim.effect for claim in found.claims] == ["base_tilt"]
    tilt = found.claims[0].parameters["tilt_x"]
    assert tilt.low < np.radians(0.2) < tilt.high
    model = found.model()
    assert model is not None
    left = recording["ax_g"] - highside.predict(model, recording)["ax_g"]
    assert np.std(left) < 0.2 * np.std(recording["ax_g"] - highside.predict(known, recording)["ax_g"])
    found.save(tmp_path / "report")
    assert {path.name for path in (tmp_path / "report").iterdir()} == {"diagnosis.json", "report.html"}
    assert "base_tilt" in found._repr_html_()
    assert [line.name for line in found.plot().panels[2].lines] == ["before", "with the claims"]
    assert found.plot().panels[0].lines[0].y.std() > 10 * found.plot().panels[0].lines[1].y.std()


def test_results_show_themselves(
    simulation: highside.Simulation, calibration: highside.Calibration, turning: highside.Recording, tmp_path: Path
) -> None:
    hostile = highside.read({"t_s": [0.0], "<script>alert(1)</script>": ["<b>&"]})
    assert "<script>" not in hostile._repr_html_()
    assert "&lt;b&gt;&amp;" in hostile._repr_html_()
    followed = highside.drift(turning, "recursive")
    for shown in (simulation, simulation.recording, calibration, followed):
        assert "<table>" in shown._repr_html_()
        shown.plot().save(tmp_path / "figure.png")
        assert (tmp_path / "figure.png").stat().st_size > 10_000
    assert len(turning.plot("ax_g", "gz_dps").figure().axes) == 2


def test_of_a_table_in_memory_the_record_has_its_own_hash(simulation: highside.Simulation, tmp_path: Path) -> None:
    assert simulation.poses is not None
    path = tmp_path / "poses.csv"
    simulation.poses.write(path)
    of_file = highside.calibrate(path, pose_sigma_deg=0.01).record.content["raw"]
    of_memory = highside.calibrate(simulation.poses, pose_sigma_deg=0.01).record.content["raw"]
    assert of_file["sha256"] == of_memory["sha256"], "the same rows"
    changed = simulation.poses.with_columns({"ax": simulation.poses["ax"] + 1e-6})
    changed.source = str(path)
    of_changed = highside.calibrate(changed, pose_sigma_deg=0.01).record.content["raw"]
    assert of_changed["sha256"] != of_file["sha256"], "a file's hash does not vouch for rows that were changed since"


# --- packages ------------------------------------------------------------------------------------------------

PACKAGES = sorted(
    ".".join(path.parent.relative_to(Path(highside.__file__).parents[1]).parts)
    for path in Path(highside.__file__).parent.rglob("__init__.py")
)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_opens_with_what_it_is_and_names_its_ways_in(package: str) -> None:
    opened = importlib.import_module(package)
    assert len(opened.__doc__ or "") > 60, "what the room is for"
    assert isinstance(opened.__all__, list), package
    assert len(opened.__all__) == len({*opened.__all__})
    for name in opened.__all__:
        if not hasattr(opened, name):
            assert importlib.import_module(f"{package}.{name}").__doc__, name


PACKAGES = ("api", "attitude", "calibration", "diagnosis", "gyro", "physics", "reading", "recording", "rotation")
"""What the functions of the API are made of: their words reach programs too."""


def said_by(path: Path) -> Iterator[str]:
    """All texts of a module but its docstrings."""
    tree = ast.parse(path.read_text())
    about = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in about:
            yield node.value


def test_what_the_library_says_names_arguments_and_no_options(project_root: Path) -> None:
    """An option may be named with its command alone, which a program's user can type too."""
    option = re.compile(r"(?<![\w-])--[a-z][a-z-]+")
    known = re.compile(r"(highside|calibrate solve|RECORD)( [a-z]+)* --[a-z][a-z-]+")
    wrong = []
    for package in PACKAGES:
        for path in sorted((project_root / "src/highside" / package).rglob("*.py")):
            wrong += [f"{path.name}: {text}" for text in said_by(path) if option.search(known.sub("", text))]
    assert wrong == []


def test_a_remedy_fits_the_program_and_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError) as fault:
        highside.calibrate({name: np.zeros(6) for name in ("ax_g", "ay_g", "az_g")}, tool="t")
    assert 'reference="magnitude"' in str(fault.value) and "--" not in str(fault.value)
    assert "(or use --reference magnitude)" in in_options(fault.value)
    named = InputError("is wrong", where="model=a.csv", remedy="leave model= out")
    assert in_options(named) == "model=a.csv: is wrong; leave --model out"


def test_a_long_file_is_read_when_the_program_allows_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("highside.reading.files._allowed", 64)
    monkeypatch.setattr("highside.reading.files._configured", False)
    place = tmp_path / "rows.csv"
    place.write_text("t_s,ax_g\n" + "0.5,0.25\n" * 20)
    with pytest.raises(InputError, match=r"has more than 64 bytes; if it is meant so: .*highside\.allow_bytes"):
        highside.read(place)
    highside.allow_bytes(4096)
    assert highside.read(place).n == 20


@pytest.mark.parametrize("cell", ["0x1F", "1e400", "True", "1_000", "?"])
def test_a_cell_that_is_no_number_is_named_and_its_column_is_not_called_missing(tmp_path: Path, cell: str) -> None:
    path = tmp_path / "rec.csv"
    rows = "".join(f"{k / 100},0.1,0.2,{cell if k == 7 else 0.97},30,{3 * k}\n" for k in range(100))
    path.write_text("t_s,ax_g,ay_g,az_g,inc_ref_deg,tf_ref_deg\n" + rows)
    with pytest.raises(InputError, match=r"line 9: az_g: .*multiples of g are expected"):
        highside.diagnose(path, {"sensor": {"free": ["bias"]}})
