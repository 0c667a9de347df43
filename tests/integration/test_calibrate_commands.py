"""`highside calibrate ...` from files to files: what is written, what is refused, and with which exit status."""

from __future__ import annotations

import csv
import gzip
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from highside.calibration.record import RecordError
from highside.cli.main import main
from highside.physics.gravity import bench_gravity, gravity_direction
from highside.recording.calibration_store import CalibrationStore, load_active, read_record

Run = Callable[..., tuple[int, str, str]]

SENSOR = np.eye(3) + 3e-3 * np.random.default_rng(70).standard_normal((3, 3))
OFFSET = np.array([1.2e-3, -0.7e-3, 1.8e-3])
QUADRANTS = (45.0, 135.0, 225.0, 315.0)
ALL_ROUND = tuple(float(tf) for tf in range(0, 360, 45))
READINGS = 1000
NOISE_G = 3.5e-4


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """The command, in this process: exit status, output, errors. Every failure is one line without a traceback."""

    def call(*args: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["highside", "calibrate", *map(str, args)])
        capsys.readouterr()
        status = 0
        try:
            main()
        except SystemExit as end:
            status = int(end.code or 0)
        out, err = capsys.readouterr()
        assert "Traceback" not in err
        return status, out, err

    return call


def measured(inc_deg: np.ndarray, tf_deg: np.ndarray, seed: int = 0, noise_g: float = 0.0) -> np.ndarray:
    noise = noise_g * np.random.default_rng(seed).standard_normal((3, np.size(inc_deg)))
    return SENSOR @ gravity_direction(np.deg2rad(inc_deg), np.deg2rad(tf_deg)) + OFFSET[:, None] + noise


def write_csv(path: Path, columns: dict[str, Any]) -> Path:
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def read_csv(path: Path) -> dict[str, list[str]]:
    with path.open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    return {name: [row[name] for row in rows] for name in rows[0]}


def numbers(path: Path, name: str) -> np.ndarray:
    return np.array([float(cell) if cell else np.nan for cell in read_csv(path)[name]])


def pose_columns(
    inclinations: tuple[float, ...], stations: tuple[float, ...] = QUADRANTS, seed: int = 1
) -> dict[str, Any]:
    inc, tf = np.repeat(inclinations, len(stations)), np.tile(stations, len(inclinations))
    a = measured(inc, tf, seed, NOISE_G / np.sqrt(READINGS))
    std = [NOISE_G] * inc.size
    return {
        "inc_ref_deg": inc.tolist(), "tf_ref_deg": tf.tolist(),
        "ax": a[0].tolist(), "ay": a[1].tolist(), "az": a[2].tolist(),
        "n": [READINGS] * inc.size, "std_ax": std, "std_ay": std, "std_az": std,
    }  # fmt: skip


@pytest.fixture
def poses(tmp_path: Path) -> Path:
    """A session of several inclinations, reversal included in spirit: beyond 90 deg."""
    return write_csv(tmp_path / "poses.csv", pose_columns((1.206, 5.0, 45.0, 90.0, 120.0), ALL_ROUND))


@pytest.fixture
def readings(tmp_path: Path) -> Path:
    inc, tf = np.array([0.8, 1.206, 3.0, 30.0, 75.0, 150.0]), np.array([10.0, 100.0, 190.0, 280.0, 350.0, 60.0])
    a = measured(inc, tf)
    return write_csv(
        tmp_path / "readings.csv",
        {
            "t_s": range(6),
            "ax_g": a[0],
            "ay_g": a[1],
            "az_g": a[2],
            "note": ["x,y"] * 6,
            "inc_true": inc,
            "tf_true": tf,
        },
    )


def turned(value_deg: np.ndarray) -> np.ndarray:
    return (value_deg + 180.0) % 360.0 - 180.0


@pytest.mark.parametrize("method", ["conventional", "joint"])
def test_solve_and_apply_give_back_the_true_attitude_within_the_stated_uncertainty(
    run: Run, tmp_path: Path, poses: Path, readings: Path, method: str
) -> None:
    record, out = tmp_path / "cal.json", tmp_path / "out.csv"
    status, text, _ = run("solve", poses, "--method", method, "--tool", "t-1", "-o", record)
    assert status == 0
    assert f"method    {method}" in text
    assert read_record(record).tool_id == "t-1"
    status, text, _ = run("apply", record, readings, "-o", out, "--noise-g", "0")
    assert status == 0
    assert "6 rows corrected" in text
    columns = read_csv(out)
    assert list(columns)[:5] == ["t_s", "ax_g", "ay_g", "az_g", "note"]
    assert columns["note"] == ["x,y"] * 6
    assert columns["ax_g"] == read_csv(readings)["ax_g"]
    for angle in ("inc", "tf"):
        error = turned(numbers(out, f"{angle}_deg") - numbers(out, f"{angle}_true"))
        std = numbers(out, f"{angle}_std_deg")
        assert np.all(std > 0.0)
        assert np.all(np.abs(error) < 5.0 * std)


def test_balance_leaves_rows_outside_of_every_zone_empty_and_counts_them(
    run: Run, tmp_path: Path, readings: Path
) -> None:
    table = write_csv(tmp_path / "ring.csv", pose_columns((1.206,)))
    record, out = tmp_path / "cal.json", tmp_path / "out.csv"
    status, text, _ = run("solve", table, "--method", "balance", "-o", record)
    assert status == 0
    assert "closure" in text
    assert run("apply", record, readings, "-o", out, "--zones")[0] == 0
    columns = read_csv(out)
    assert [bool(cell) for cell in columns["inc_deg"]] == [True, True, False, False, False, False]
    for name in ("tf_deg", "inc_std_deg", "tf_std_deg"):
        assert [bool(cell) for cell in columns[name]] == [True, True, False, False, False, False]
    assert columns["zone"] == ["zone 1.206"] * 2 + ["none"] * 4
    status, text, _ = run("apply", record, readings, "-o", out, "--json")
    assert status == 0
    assert json.loads(text)["outside_zone"] == 4
    assert json.loads(text)["zones"] == {"zone 1.206": 2}


def test_balance_of_several_inclinations_becomes_a_schedule_with_a_fallback_if_asked(
    run: Run, tmp_path: Path, readings: Path
) -> None:
    table = write_csv(tmp_path / "rings.csv", pose_columns((1.206, 5.0, 45.0)))
    record, out = tmp_path / "cal.json", tmp_path / "out.csv"
    status, text, _ = run("solve", table, "--method", "balance", "--fallback", "conventional", "-o", record, "--json")
    assert status == 0
    summary = json.loads(text)
    assert [round(zone["center_deg"], 3) for zone in summary["zones"]] == [1.206, 5.0, 45.0]
    assert summary["fallback"] == "conventional"
    assert run("apply", record, readings, "-o", out, "--zones")[0] == 0
    assert all(read_csv(out)["inc_deg"])
    assert read_csv(out)["zone"][3:] == ["global"] * 3
    assert np.max(np.abs(numbers(out, "inc_deg") - numbers(out, "inc_true"))) < 0.1


@pytest.mark.parametrize("triples", ["1-2-3", "2-3-4", "3-4-1", "4-1-2", "average", "least-squares"])
def test_every_triple_can_be_chosen(run: Run, tmp_path: Path, triples: str) -> None:
    table = write_csv(tmp_path / "ring.csv", pose_columns((5.0,)))
    status, text, _ = run(
        "solve", table, "--method", "balance", "--triples", triples, "-o", tmp_path / "c.json", "--json"
    )
    assert status == 0
    assert json.loads(text)["options"]["triples"] == triples
    assert read_record(tmp_path / "c.json").request.triples == triples


def test_balance_at_90_deg_is_refused_with_the_reason(run: Run, tmp_path: Path) -> None:
    only = write_csv(tmp_path / "only.csv", pose_columns((90.0,)))
    status, _, err = run("solve", only, "--method", "balance", "-o", tmp_path / "only.json")
    assert status == 1
    assert "90.000 deg" in err
    assert "gz" in err
    assert not (tmp_path / "only.json").exists()
    among = write_csv(tmp_path / "among.csv", pose_columns((5.0, 90.0)))
    status, _, err = run("solve", among, "--method", "balance", "-o", tmp_path / "among.json")
    assert status == 1
    assert "near_horizontal" in err
    assert [zone.name for zone in read_record(tmp_path / "among.json").result.zones] == ["zone 5.000"]


def test_a_wrong_pose_breaks_the_closure_is_refused_and_not_put_in_force_by_accident(run: Run, tmp_path: Path) -> None:
    columns = pose_columns((5.0, 45.0))
    columns["ay"][5] += 0.02
    table, record, store = write_csv(tmp_path / "bad.csv", columns), tmp_path / "cal.json", tmp_path / "store"
    status, _, err = run("solve", table, "--method", "balance", "--store", store, "-o", record)
    assert status == 1
    assert "closure" in err
    assert run("activate", record, "--store", store)[0] == 1
    assert CalibrationStore(store).history() == []
    assert run("activate", record, "--store", store, "--force")[0] == 0


def test_a_record_keeps_what_was_said_about_bench_and_operator(run: Run, tmp_path: Path, poses: Path) -> None:
    record = tmp_path / "cal.json"
    options = ["--tool", "t-1", "--serial", "0042", "--bench", "north", "--operator", "A. B.", "--temp-c", "25"]
    options += ["--gravity-mps2", "9.81234", "--gravity-std-mps2", "0.00002", "--expires-days", "90"]
    assert run("solve", poses, "--method", "conventional", *options, "-o", record)[0] == 0
    content = read_record(record).content
    assert content["tool"] == {"id": "t-1", "serial": "0042"}
    assert content["environment"] == {
        "bench": "north", "operator": "A. B.", "temp_c": 25.0, "gravity_mps2": 9.81234, "gravity_std_mps2": 2e-5,
    }  # fmt: skip
    assert content["expires"] > content["valid_from"]
    status, text, _ = run("show", record, "--recompute")
    assert status == 0
    assert "serial 0042" in text
    assert "parameters equal within" in text


def test_activate_history_and_rollback(run: Run, tmp_path: Path, poses: Path) -> None:
    store, first, second = tmp_path / "store", tmp_path / "first.json", tmp_path / "second.json"
    run("solve", poses, "--method", "conventional", "--tool", "t-1", "--store", store, "-o", first)
    run("solve", poses, "--method", "joint", "--tool", "t-1", "--store", store, "-o", second)
    one, two = read_record(first).id, read_record(second).id
    assert run("history", "--store", store)[1] == "nothing was put in force; 2 records are kept\n"
    assert run("activate", first, "--store", store)[0] == 0
    status, text, _ = run("activate", two[:10], "--store", store, "--json")
    assert (status, json.loads(text)["id"]) == (0, two)
    assert json.loads(run("show", "--store", store, "--json")[1])["id"] == two
    status, text, _ = run("rollback", "--store", store)
    assert (status, text) == (0, f"in force for tool t-1: {one}\n")
    assert load_active(store, tool_id="t-1").cal_id == one
    rows = json.loads(run("history", "--store", store, "--json")[1])["history"]
    assert [(row["action"], row["id"], row["active"]) for row in rows] == [
        ("activate", one, False), ("activate", two, False), ("rollback", one, True),
    ]  # fmt: skip
    assert "*    3" in run("history", "--store", store)[1]
    status, _, err = run("rollback", "--store", store)
    assert status == 1
    assert "nothing_before" in err and "--to-nothing" in err
    # the only one that stands is taken out: as if none had ever been put in force
    assert run("rollback", "--store", store, "--to-nothing")[:2] == (0, "in force for tool t-1: nothing\n")
    with pytest.raises(RecordError, match="none_active"):
        load_active(store, tool_id="t-1")
    assert run("history", "--store", store)[1].splitlines()[-1].endswith("rollback  nothing")
    assert run("rollback", "--store", store, "--to-nothing")[0] == 1, "there is none to take out"
    assert run("activate", one[:10], "--store", store)[0] == 0
    assert load_active(store, tool_id="t-1").cal_id == one


def refused(outcome: tuple[int, str, str], status: int, *words: str) -> None:
    """One line on stderr that says what is wrong, and the exit status."""
    got, _, err = outcome
    assert got == status, err
    assert err.count("\n") == 1, err
    for word in words:
        assert word in err


def test_a_tampered_foreign_expired_or_broken_record_is_refused_by_name(
    run: Run, tmp_path: Path, poses: Path, readings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, out, store = tmp_path / "cal.json", tmp_path / "out.csv", tmp_path / "store"
    run("solve", poses, "--method", "conventional", "--tool", "t-1", "--expires-days", "1", "-o", record)
    good = record.read_text()
    refused(run("apply", record, readings, "-o", out, "--tool", "t-2"), 1, "wrong_tool", "t-2")
    refused(run("activate", record, "--store", store, "--tool", "t-2"), 1, "wrong_tool")
    record.write_text(good.replace("0.0052", "0.0053"))
    for command in (("apply", record, readings, "-o", out), ("show", record), ("activate", record, "--store", store)):
        refused(run(*command), 1, "tampered")
    record.write_text(good[: len(good) // 2])
    refused(run("show", record), 2, "cal.json")
    record.write_text(good)
    import time

    tomorrow = time.time() + 90000.0
    monkeypatch.setattr(time, "time", lambda: tomorrow)
    refused(run("apply", record, readings, "-o", out), 1, "expired")
    refused(run("activate", record, "--store", store), 1, "expired")
    assert not out.exists()
    assert run("apply", record, readings, "-o", out, "--allow-expired")[0] == 0


def _without(name: str) -> Callable[[dict[str, Any]], None]:
    return lambda columns: columns.pop(name)


def _scaled(factor: float) -> Callable[[dict[str, Any]], None]:
    return lambda columns: columns.update({name: [factor * v for v in columns[name]] for name in ("ax", "ay", "az")})


def _cell(name: str, row: int, value: object) -> Callable[[dict[str, Any]], None]:
    return lambda columns: columns[name].__setitem__(row, value)


def _copied(columns: dict[str, Any]) -> None:
    for values in columns.values():
        values[3] = values[2]


def _cut(count: int) -> Callable[[dict[str, Any]], None]:
    return lambda columns: columns.update({name: values[:count] for name, values in columns.items()})


@pytest.mark.parametrize("method", ["conventional", "balance", "joint"])
@pytest.mark.parametrize(
    ("spoil", "status", "words"),
    [
        (_without("az"), 2, ["az", "poses.csv"]),
        (_without("tf_ref_deg"), 2, ["tf_ref_deg"]),
        (_cell("ay", 2, "nan"), 2, ["ay", "pose 3"]),
        (_cell("ay", 2, "inf"), 2, ["ay", "line 4"]),
        (_cell("ax", 1, "oops"), 2, ["ax", "line 3", "oops"]),
        (_scaled(9.80665), 2, ["m/s2"]),
        (_scaled(1000.0), 2, ["mg"]),
        (_scaled(16384.0), 2, ["cannot be g"]),
        (_copied, 2, ["pose 3", "pose 4"]),
        (_cut(2), 1, ["pose"]),
        (_cut(0), 2, ["poses.csv"]),
        (_cell("n", 1, 0), 2, ["n", "pose 2"]),
    ],
    ids=["no az", "no tf", "nan", "inf", "text", "m/s2", "mg", "counts", "same pose", "two poses", "none", "n = 0"],
)
def test_bad_pose_tables_are_named_in_one_line(
    run: Run, tmp_path: Path, method: str, spoil: Callable[[dict[str, Any]], None], status: int, words: list[str]
) -> None:
    columns = pose_columns((5.0, 45.0))
    spoil(columns)
    table, record = write_csv(tmp_path / "poses.csv", columns), tmp_path / "cal.json"
    refused(run("solve", table, "--method", method, "-o", record), status, *words)
    assert not record.exists()


def test_a_session_of_another_tool_is_refused(run: Run, tmp_path: Path) -> None:
    columns = pose_columns((5.0, 45.0))
    columns["tool"] = ["t-1"] * 8
    table, record = write_csv(tmp_path / "poses.csv", columns), tmp_path / "cal.json"
    refused(
        run("solve", table, "--method", "conventional", "--tool", "t-2", "-o", record), 1, "wrong_tool", "t-1", "t-2"
    )
    assert run("solve", table, "--method", "conventional", "-o", record)[0] == 0
    assert read_record(record).tool_id == "t-1"
    columns["tool"][5] = "t-2"
    refused(run("solve", write_csv(table, columns), "--method", "conventional", "-o", record), 2, "tool")


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"t_s": [0, 1], "ax_g": [0, 0], "ay_g": [0, 0]}, ["az_g"]),
        ({"t_s": [0, 1], "ax_g": [0, "nan"], "ay_g": [0, 0], "az_g": [1, 1]}, ["ax_g", "line 3"]),
        ({"t_s": [0, 1], "ax_g": [0, 0], "ay_g": [0, 0], "az_g": [9.8, 9.8]}, ["m/s2"]),
        ({"t_s": [0, 1], "ax_g": [0, 0], "ay_g": [0, 0], "az_g": [1, 1], "noise_g": [-1, 1]}, ["noise_g"]),
    ],
    ids=["missing", "nan", "units", "noise"],
)
def test_bad_readings_are_named_in_one_line(
    run: Run, tmp_path: Path, poses: Path, columns: dict[str, Any], words: list[str]
) -> None:
    record, out = tmp_path / "cal.json", tmp_path / "out.csv"
    run("solve", poses, "--method", "conventional", "-o", record)
    refused(run("apply", record, write_csv(tmp_path / "r.csv", columns), "-o", out), 2, "r.csv", *words)
    assert not out.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", "{tmp}/none.csv", "--method", "joint", "-o", "{tmp}/c.json"),
        ("solve", "{poses}", "--method", "best", "-o", "{tmp}/c.json"),
        ("solve", "{poses}", "--method", "joint", "-o", "{tmp}/no/such/c.json"),
        ("solve", "{poses}", "--method", "joint", "-o", "{tmp}/c.json", "--gravity-mps2", "981"),
        ("solve", "{poses}", "--method", "joint", "-o", "{tmp}/c.json", "--expires-days", "0"),
        ("solve", "{poses}", "--method", "joint", "-o", "{tmp}/c.json", "--pose-sigma-deg", "-1"),
        ("solve", "{poses}", "--method", "balance", "--triples", "1-3-2", "-o", "{tmp}/c.json"),
        ("solve", "{poses}", "--method", "balance", "--reference", "magnitude", "-o", "{tmp}/c.json"),
        ("apply", "{poses}", "{poses}", "-o", "{tmp}/o.csv"),
        ("apply", "{tmp}/none.json", "{poses}", "-o", "{tmp}/o.csv"),
        ("show",),
        ("show", "--store", "{tmp}/none"),
        ("history", "--store", "{tmp}/none"),
        ("poses", "{tmp}/none.csv", "-o", "{tmp}/p.csv"),
    ],
)
def test_wrong_usage_ends_with_2(run: Run, tmp_path: Path, poses: Path, arguments: tuple[str, ...]) -> None:
    before = sorted(tmp_path.iterdir())
    status, _, err = run(*(part.format(tmp=tmp_path, poses=poses) for part in arguments))
    assert status == 2
    assert err
    assert sorted(tmp_path.iterdir()) == before


def test_noise_comes_from_the_option_or_the_column_or_the_record(run: Run, tmp_path: Path, poses: Path) -> None:
    record, out = tmp_path / "cal.json", tmp_path / "out.csv"
    run("solve", poses, "--method", "joint", "-o", record)
    a = measured(np.full(3, 5.0), np.full(3, 10.0))
    plain = {"t_s": [0, 1, 2], "ax_g": a[0], "ay_g": a[1], "az_g": a[2]}
    with_column = write_csv(tmp_path / "with.csv", plain | {"noise_g": [1e-3, 2e-3, 4e-3]})
    run("apply", record, with_column, "-o", out)
    std = np.deg2rad(numbers(out, "inc_std_deg"))
    assert np.allclose(std, [1e-3, 2e-3, 4e-3], rtol=0.02)
    run("apply", record, with_column, "-o", out, "--noise-g", "0.003")
    assert np.allclose(np.deg2rad(numbers(out, "inc_std_deg")), 3e-3, rtol=0.02)
    run("apply", record, write_csv(tmp_path / "without.csv", plain), "-o", out)
    assert np.allclose(np.deg2rad(numbers(out, "inc_std_deg")), NOISE_G, rtol=0.05)


def test_the_bench_frame_gives_back_the_benchs_own_angles(run: Run, tmp_path: Path) -> None:
    inclinations = (1.206, 5.0, 45.0, 90.0, 135.0)
    inc, tf = np.repeat(inclinations, 8), np.tile(ALL_ROUND, len(inclinations))
    tilt = np.deg2rad([0.04, -0.03])
    noise = NOISE_G / np.sqrt(READINGS) * np.random.default_rng(3).standard_normal((3, inc.size))
    a = SENSOR @ bench_gravity(np.deg2rad(inc), np.deg2rad(tf), *tilt) + OFFSET[:, None] + noise
    columns = pose_columns(inclinations, ALL_ROUND) | {"ax": a[0], "ay": a[1], "az": a[2]}
    table, record = write_csv(tmp_path / "poses.csv", columns), tmp_path / "cal.json"
    assert run("solve", table, "--method", "joint", "-o", record)[0] == 0
    errors = {}
    for frame in ("bench", "gravity"):
        out = tmp_path / f"{frame}.csv"
        assert run("apply", record, table, "-o", out, "--frame", frame)[0] == 0
        errors[frame] = numbers(out, "inc_deg") - inc
    assert abs(errors["bench"].mean()) < 0.004
    assert errors["gravity"].mean() == pytest.approx(0.04, abs=0.004)


def test_readings_outside_of_the_calibrated_temperature_are_counted(run: Run, tmp_path: Path, poses: Path) -> None:
    record, out = tmp_path / "cal.json", tmp_path / "out.csv"
    run("solve", poses, "--method", "conventional", "--temp-c", "25", "-o", record)
    a = measured(np.full(3, 5.0), np.full(3, 10.0))
    table = {"t_s": [0, 1, 2], "ax_g": a[0], "ay_g": a[1], "az_g": a[2], "temp_c": [25.0, 60.0, 25.0]}
    status, text, _ = run("apply", record, write_csv(tmp_path / "r.csv", table), "-o", out, "--json")
    assert (status, json.loads(text)["temperature_outside"]) == (0, 1)
    std = numbers(out, "inc_std_deg")
    assert std[1] > 2.0 * std[0] == 2.0 * std[2]


def test_an_oven_cycle_is_solved_over_temperature(run: Run, tmp_path: Path) -> None:
    base = pose_columns((5.0, 45.0, 90.0), ALL_ROUND)
    temps = (25.0, 75.0, 125.0, 75.0, 25.0)
    columns: dict[str, list[float]] = {name: [] for name in (*base, "temp_c")}
    for k, temp in enumerate(temps):
        part = pose_columns((5.0, 45.0, 90.0), ALL_ROUND, seed=10 + k)
        part["ax"] = [value + 20e-6 * (temp - 25.0) for value in part["ax"]]
        part["temp_c"] = [temp] * len(part["ax"])
        for name, values in part.items():
            columns[name] += values
    table, record, out = write_csv(tmp_path / "oven.csv", columns), tmp_path / "cal.json", tmp_path / "out.csv"
    status, _, err = run("solve", table, "--method", "joint", "-o", record)
    assert status == 0, err
    assert run("show", record, "--recompute")[0] == 0
    a = measured(np.full(2, 45.0), np.full(2, 10.0)) + np.array([[0.0, 20e-6 * 80.0], [0.0, 0.0], [0.0, 0.0]])
    cells = {"t_s": [0, 1], "ax_g": a[0], "ay_g": a[1], "az_g": a[2], "temp_c": [25.0, 105.0]}
    assert run("apply", record, write_csv(tmp_path / "r.csv", cells), "-o", out)[0] == 0
    assert np.allclose(numbers(out, "inc_deg"), 45.0, atol=0.005)


def test_poses_are_found_in_a_recording_and_solved(run: Run, tmp_path: Path) -> None:
    """A pose-stepped session at 50 Hz: 4 s still at each of 24 poses, 2 s of turning between them."""
    rng = np.random.default_rng(5)
    inclinations, rate = (5.0, 45.0, 90.0), 50
    targets = [(inc, tf) for inc in inclinations for tf in ALL_ROUND]
    inc_all, tf_all, pose = [], [], []
    at = (0.0, 0.0)
    for number, target in enumerate(targets):
        for axis, out in ((0, inc_all), (1, tf_all)):
            out += np.linspace(at[axis], target[axis], 2 * rate, endpoint=False).tolist() + [target[axis]] * (4 * rate)
        pose += [""] * (2 * rate) + [str(number)] * (4 * rate)
        at = target
    a = measured(np.array(inc_all), np.array(tf_all)) + 2e-4 * rng.standard_normal((3, len(inc_all)))
    table = {"t_s": np.arange(len(inc_all)) / rate, "ax_g": a[0], "ay_g": a[1], "az_g": a[2]}
    reference = {"inc_ref_deg": inc_all, "tf_ref_deg": tf_all, "pose": pose, "temp_c": [25.0] * len(pose)}
    recording = write_csv(tmp_path / "rec.csv", table | reference)
    packed = tmp_path / "rec.csv.gz"
    packed.write_bytes(gzip.compress(recording.read_bytes()))
    found = tmp_path / "found.csv"
    status, text, _ = run("poses", packed, "-o", found)
    assert status == 0
    assert "24 poses" in text
    assert numbers(found, "inc_ref_deg").tolist() == [target[0] for target in targets]
    assert np.all(numbers(found, "n") >= 0.9 * 4 * rate)
    assert np.all(numbers(found, "n") <= 4 * rate)
    assert numbers(found, "std_ax") == pytest.approx(2e-4, rel=0.25)
    assert run("solve", found, "--method", "joint", "-o", tmp_path / "cal.json")[0] == 0
    assert np.allclose(read_record(tmp_path / "cal.json").result.A, SENSOR, atol=1e-4)
    # without reference columns the same poses are found for a session by hand
    status, text, _ = run("poses", write_csv(tmp_path / "bare.csv", table), "-o", found, "--json")
    assert (status, json.loads(text)["poses"]) == (0, 24)
    assert "inc_ref_deg" not in read_csv(found)
    assert run("solve", found, "--method", "joint", "--reference", "magnitude", "-o", tmp_path / "cal.json")[0] == 0
    refused(run("solve", found, "--method", "joint", "-o", tmp_path / "other.json"), 2, "inc_ref_deg")


def test_a_recording_that_never_rests_is_refused(run: Run, tmp_path: Path) -> None:
    t = np.arange(2000) / 50.0
    a = measured(40.0 + 30.0 * np.sin(3.0 * t), 100.0 * t)
    table = write_csv(tmp_path / "rec.csv", {"t_s": t, "ax_g": a[0], "ay_g": a[1], "az_g": a[2]})
    refused(run("poses", table, "-o", tmp_path / "p.csv"), 2)
    assert not (tmp_path / "p.csv").exists()


def test_the_installed_command_does_the_same(tmp_path: Path, poses: Path, readings: Path) -> None:
    """Through a real process: exit statuses, and nothing but one line on stderr."""
    highside = Path(sys.executable).parent / "highside"

    def call(*args: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run([highside, "calibrate", *map(str, args)], capture_output=True, text=True, check=False)

    record, out = tmp_path / "cal.json", tmp_path / "out.csv"
    assert call("solve", poses, "--method", "joint", "-o", record).returncode == 0
    assert call("apply", record, readings, "-o", out).returncode == 0
    bad = call("apply", readings, readings, "-o", out)
    assert bad.returncode == 2
    assert bad.stderr.startswith("highside: ")
    assert bad.stderr.count("\n") == 1
    record.write_text(record.read_text().replace('"tool"', '"loot"', 1))
    assert call("show", record).returncode == 1


def test_a_refused_roll_back_or_activation_leaves_no_store_behind(tmp_path: Path) -> None:
    other = tmp_path / "other"
    for words in (["rollback", "--tool", "t1"], ["activate", "0123456789ab"], ["history"]):
        command = [Path(sys.executable).parent / "highside", "calibrate", *words, "--store", str(other)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode == 2, done.stderr
        assert "no such calibration store" in done.stderr
        assert not other.exists()
