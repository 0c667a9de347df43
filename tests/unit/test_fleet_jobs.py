"""What a fleet does with one recording, job by job, without a cluster."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

import highside
from highside.calibration.record import parse_record
from highside.fleet import jobs
from highside.fleet.catalogue import catalogue_of
from highside.fleet.jobs import Order, row_of
from highside.fleet.parts import PartStore
from highside.fleet.run import _order_of, work_on
from highside.physics.gravity import gravity_direction

TRUE_BIAS_G = 2e-3


def poses(folder: Path, *, twice: bool = False) -> Path:
    """A pose table of a sensor with an offset on x; `twice`: one of its attitudes is named as another one."""
    inc, tf = np.repeat([5.0, 45.0, 85.0], 4), np.tile([45.0, 135.0, 225.0, 315.0], 3)
    mean = gravity_direction(np.radians(inc), np.radians(tf)) + np.array([[TRUE_BIAS_G], [0.0], [0.0]])
    if twice:
        tf[0] += 20.0
    path = folder / "poses.csv"
    rows = np.column_stack([inc, tf, *mean])
    text = "\n".join(",".join(map(repr, row)) for row in rows.tolist())
    path.write_text(f"inc_ref_deg,tf_ref_deg,ax,ay,az\n{text}\n")
    return path


def test_a_pose_table_becomes_a_calibration_record_in_its_row(tmp_path: Path) -> None:
    path = poses(tmp_path)
    row = row_of(Order("solve", method="joint"), path)
    assert (row["verdict"], row["error"], row["rows"]) == ("done", "", 12)
    record = parse_record(row["record"])
    assert record.result.b[0] == pytest.approx(TRUE_BIAS_G, abs=1e-6)
    same = highside.calibrate(path).record
    np.testing.assert_array_equal(record.result.A, same.result.A)


def test_a_record_is_of_the_tool_that_the_catalogue_names(tmp_path: Path) -> None:
    """Corrected there, it is another record; a table that names another tool is refused."""
    path = poses(tmp_path)
    catalogue = tmp_path / "fleet.csv"
    catalogue.write_text("uri,tool,serial\nposes.csv,probe-7,0042\n")
    (entry,) = catalogue_of(str(catalogue))
    order = _order_of(entry, Order("solve", method="joint"))
    record = parse_record(row_of(order, path)["record"])
    assert (record.tool_id, record.serial) == ("probe-7", "0042")
    catalogue.write_text("uri,tool,serial\nposes.csv,probe-8,0042\n")
    assert _order_of(catalogue_of(str(catalogue))[0], Order("solve", method="joint")).key != order.key
    assert _order_of(entry, Order("diagnose")).key == Order("diagnose").key, "a diagnosis is of the recording alone"
    (unnamed,) = catalogue_of(str(path.parent / "poses.csv*"))
    assert parse_record(row_of(_order_of(unnamed, Order("solve")), path)["record"]).tool_id == "tool"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0] + ",tool", *(line + ",other" for line in lines[1:])]))
    row = row_of(order, path)
    assert row["verdict"] == "error" and "the poses are of tool 'other', not of 'probe-7'" in row["error"]


def test_a_pose_set_that_is_refused_is_no_calibration(tmp_path: Path) -> None:
    row = row_of(Order("solve", method="joint"), poses(tmp_path, twice=True))
    assert highside.calibrate(tmp_path / "poses.csv").refused
    assert (row["verdict"], row["error"]) == ("refused", "")


def test_a_recording_of_gyros_is_followed(tmp_path: Path) -> None:
    t = np.arange(0, 120, 0.02)
    rng = np.random.default_rng(1)
    gravity = gravity_direction(np.radians([30.0]), np.radians([60.0]))
    columns = {"t_s": t}
    noise = 1e-4 * rng.standard_normal((6, t.size))
    columns |= dict(zip(("ax_g", "ay_g", "az_g"), gravity + noise[:3], strict=True))
    columns |= dict(zip(("gx_dps", "gy_dps", "gz_dps"), 0.01 + noise[3:], strict=True))
    path = tmp_path / "still.csv"
    rows = [",".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([",".join(columns), *rows]))
    row = row_of(Order("drift"), path)
    assert (row["verdict"], row["error"], row["rows"]) == ("done", "", t.size)
    last = json.loads(row["last"])
    assert last["inc_deg"] == pytest.approx(30.0, abs=0.05)
    assert last["tf_deg"] == pytest.approx(60.0, abs=0.1)


@pytest.mark.parametrize("job", ["diagnose", "solve", "drift"])
def test_a_file_that_cannot_be_read_is_a_row_with_its_error(tmp_path: Path, job: str) -> None:
    path = tmp_path / "x.csv"
    path.write_text("a,b\n1,2\n")
    row = row_of(Order(job), path)
    assert row["verdict"] == "error"
    assert "x.csv" in row["error"]
    assert "internal" not in row["error"]


@pytest.mark.parametrize("change", ["written", "replaced", "removed"])
def test_a_recording_that_changes_while_it_is_read_has_no_result(
    change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its key is the content of before: the result of another would stand there for good."""
    path = poses(tmp_path)
    whole, work = path.read_bytes(), jobs.JOBS["solve"]

    def changed(order: Order, path: Path) -> dict[str, object]:
        match change:
            case "written":
                path.write_bytes(whole + b"5,45,0,0,1\n")
            case "replaced":
                (tmp_path / "other").write_bytes(whole)
                (tmp_path / "other").replace(path)
            case _:
                path.unlink()
        return work(order, path)

    order, out = Order("solve", method="joint"), tmp_path / "results"
    with monkeypatch.context() as during:
        during.setattr(jobs, "JOBS", {**jobs.JOBS, "solve": changed})
        (outcome,) = work_on([(str(path), order)], str(out))
    assert (outcome.key, outcome.error) == (
        None,
        "changed while it was read; run it again when it is written",
    )
    assert not PartStore(out).read()
    path.write_bytes(whole)
    (outcome,) = work_on([(str(path), order)], str(out))
    assert (outcome.verdict, outcome.error, outcome.computed) == ("done", "", True)
    (row,) = PartStore(out).read().values()
    assert row["verdict"] == "done"


def test_what_is_no_file_is_told_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    (outcome,) = work_on([(str(tmp_path / "pipe.csv"), Order("solve"))], str(tmp_path / "results"))
    assert (outcome.key, outcome.error) == (None, "is a named pipe, not a file; give a file")
