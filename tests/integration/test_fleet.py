"""A fleet through its commands, on real processes of dask.distributed: results, repeats, errors, dead workers."""

from __future__ import annotations

import csv
import json
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
from typer.testing import CliRunner

import highside
from highside.cli.main import app
from highside.fleet.catalogue import catalogue_of
from highside.fleet.jobs import Order
from highside.fleet.parts import PartStore
from highside.fleet.run import run
from highside.physics.gravity import gravity_direction

MODEL = "[sensor]\nnoise_g = 5e-5\n"
TOOLS = 10


def recording(folder: Path, name: str, seed: int, effects: dict[str, dict[str, float]]) -> Path:
    """A short session of poses while the temperature rises."""
    made = highside.simulate(
        {
            "sensor": {"bias_g": [1e-3, -8e-4, 5e-4]},
            "motion": {
                "kind": "poses",
                "inclinations_deg": [3, 45, 88],
                "toolfaces_deg": list(range(0, 360, 45)),
                "hold_s": 2,
                "temperatures_c": [20, 40],
            },
            "effects": {"included": ["reading_noise", *effects], "reading_noise": {"density_ug": 50}, **effects},
        },
        seed=seed,
    )
    path = folder / f"{name}.csv"
    made.recording.write(path)
    return path


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of two lots, of which one has a temperature coefficient in common; and two rows that fail."""
    folder = tmp_path_factory.mktemp("fleet")
    rows = []
    for lot, effects in (("warm", {"temperature_bias": {"bt_x": 1e-5}}), ("plain", {})):
        for i in range(TOOLS):
            seed = 100 * (lot == "warm") + i
            rows.append((recording(folder, f"{lot}{i}", seed, effects).name, f"{lot}-{i}", lot, f"2026-{1 + i:02d}-15"))
    (folder / "damaged.csv").write_text("t_s,ax_g\n0,1\n")
    rows += [("damaged.csv", "d-1", "plain", ""), ("absent.csv", "d-2", "plain", "")]
    with (folder / "fleet.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("uri", "tool", "lot", "date"), *rows])
    (folder / "model.toml").write_text(MODEL)
    return folder


def highside_command(*arguments: str | Path) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    return result.exit_code, result.stdout, result.stderr


def test_a_fleet_is_diagnosed_once_and_its_lot_is_found(fleet: Path, tmp_path: Path) -> None:
    out = tmp_path / "results"
    asked = ("fleet", "diagnose", fleet / "fleet.csv", "--model", fleet / "model.toml", "--out", out, "--workers", "2")
    status, stdout, stderr = highside_command(*asked, "--json", "--dashboard")
    assert status == 1  # all that could be done is done, and a script sees that it was not all
    counts = json.loads(stdout)
    assert (counts["recordings"], counts["computed"], counts["failed"]) == (2 * TOOLS + 2, 2 * TOOLS + 1, 2)
    errors = {Path(one["uri"]).name: one["error"] for one in counts["errors"]}
    assert set(errors) == {"damaged.csv", "absent.csv"}
    assert errors["absent.csv"] == "no such file" and "damaged.csv" not in errors["damaged.csv"]
    assert "dashboard: http://127.0.0.1" in stderr

    # the same answer as alone, to the last digit
    rows = {row["uri"]: row for row in PartStore(out).read_catalogue()}
    part = PartStore(out).read()[rows[str(fleet / "warm0.csv")]["key"]]
    alone = highside.diagnose(fleet / "warm0.csv", fleet / "model.toml").to_dict()
    assert json.loads(part["diagnosis"]) == json.loads(json.dumps(alone))

    # a second run finds all that was done; what could not be had is tried again
    status, stdout, _ = highside_command(*asked, "--json")
    again = json.loads(stdout)
    assert (status, again["errors"]) == (1, counts["errors"])
    assert (again["computed"], again["there_already"], again["failed"]) == (0, 2 * TOOLS + 1, 2)
    assert len(PartStore(out).read()) == 2 * TOOLS + 1

    status, stdout, _ = highside_command("fleet", "summary", out, "--json", "--html", tmp_path / "fleet.html")
    assert status == 0
    found = json.loads(stdout)
    assert {one["lot"] for one in found["common"]} == {"warm"}
    assert "temperature_bias" in found["common"][0]["class"]
    assert found["common"][0]["q"] < 0.05
    assert found["common"][0]["proof"]["gain"] > found["common"][0]["proof"]["std"]
    page = (tmp_path / "fleet.html").read_text()
    assert "lot warm" in page and page.count("<svg") == 1

    by_month = json.loads(highside_command("fleet", "summary", out, "--by", "month", "--json")[1])
    assert not by_month["common"] and all("tools: 2" in one["why"] for one in by_month["not_testable"][1:])
    status, _, stderr = highside_command("fleet", "summary", out, "--by", "colour")
    assert status != 0


def test_workers_that_are_killed_cost_no_result(fleet: Path, tmp_path: Path) -> None:
    """SIGKILL of a worker each time two more results are there, five times; once of the process they are copies of."""
    entries = [entry for entry in catalogue_of(str(fleet / "fleet.csv")) if "absent" not in entry.uri]
    store = PartStore(tmp_path)
    killed: list[int] = []
    servers: list[psutil.Process] = []

    def kill(done: int, total: int, dashboard: str) -> None:
        if done >= 2 * len(killed) and len(killed) < 5 and (victims := _workers()):
            os.kill(victims[0].pid, signal.SIGKILL)
            killed.append(victims[0].pid)
        if len(killed) == 3 and not servers:
            # and that of which all are copies
            servers.extend(_servers())
            os.kill(servers[0].pid, signal.SIGKILL)

    finished = run(entries, Order("diagnose", MODEL), store, workers=2, progress=kill)
    assert len(killed) >= 3 and servers
    assert len(finished.outcomes) == len(entries)
    assert all(one.key is not None for one in finished.outcomes)
    # of a result that was written, and whose process was killed before it said so, the run knows the key alone
    assert sum(row["verdict"] == "error" for row in store.read().values()) == 1


def test_processes_that_are_killed_while_they_start_are_replaced(fleet: Path, tmp_path: Path) -> None:
    """dask gives such a one up; without any left the fleet would wait for ever."""
    entries = [entry for entry in catalogue_of(str(fleet / "fleet.csv")) if "warm" in entry.uri][:4]
    killed: set[int] = set()

    def kill_all() -> None:
        # those that work, and then those that begin in their place
        while len(killed) < 4:
            for victim in _workers():
                os.kill(victim.pid, signal.SIGKILL)
                killed.add(victim.pid)
            time.sleep(0.1)

    killer = threading.Thread(target=kill_all, daemon=True)

    def begin(done: int, total: int, dashboard: str) -> None:
        if not killer.ident:
            killer.start()

    finished = run(entries, Order("diagnose", MODEL), PartStore(tmp_path), workers=2, progress=begin)
    assert len(killed) >= 4
    assert [one.error for one in finished.outcomes] == [""] * 4


def test_results_that_cannot_be_written_are_no_fault_of_the_recordings(fleet: Path, tmp_path: Path) -> None:
    inc, tf = np.repeat([5.0, 45.0, 85.0], 4), np.tile([45.0, 135.0, 225.0, 315.0], 3)
    rows = np.column_stack([inc, tf, *gravity_direction(np.radians(inc), np.radians(tf))])
    lines = [",".join(map(repr, row)) for row in rows.tolist()]
    (tmp_path / "poses.csv").write_text("\n".join(["inc_ref_deg,tf_ref_deg,ax,ay,az", *lines]) + "\n")
    store = PartStore(tmp_path / "out")
    (tmp_path / "out" / "records").write_text("no folder")
    with pytest.raises(highside.errors.InputError, match=r"records.*cannot be (made|written)"):
        run(catalogue_of(str(tmp_path / "poses.csv*")), Order("solve", method="joint"), store, workers=1)
    assert not list((tmp_path / "out" / "parts").iterdir())


@pytest.mark.parametrize("dashboard", [False, True])
def test_nothing_is_listened_on_that_was_not_asked_for(fleet: Path, tmp_path: Path, dashboard: bool) -> None:
    """What processes tell one another by, each on the loopback interface; a page over HTTP where it is asked for."""
    entries = [entry for entry in catalogue_of(str(fleet / "fleet.csv")) if "warm" in entry.uri][:2]
    before, found, pages = set(_listening(psutil.Process())), {}, []

    def look(done: int, total: int, page: str) -> None:
        if not done:
            found["own"] = set(_listening(psutil.Process())) - before
            for worker in _workers():
                found[f"worker {worker.pid}"] = set(_listening(worker))
            pages.append(page)

    run(entries, Order("diagnose", MODEL), PartStore(tmp_path), workers=2, dashboard=dashboard, progress=look)
    assert {address for places in found.values() for address, _ in places} == {"127.0.0.1"}
    # the scheduler and who watches each worker; the workers
    assert sorted(len(places) for places in found.values()) == [1, 1, 4 if dashboard else 3]
    assert 8787 not in {port for places in found.values() for _, port in places}
    assert bool(pages[0]) == dashboard


def _listening(process: psutil.Process) -> list[tuple[str, int]]:
    return [one.laddr[:2] for one in process.net_connections("inet") if one.status == psutil.CONN_LISTEN]


def _workers() -> list[psutil.Process]:
    """The processes of this run's cluster that do work: copies of one."""
    return [worker for server in _servers() for worker in server.children()]


def _servers() -> list[psutil.Process]:
    return [child for child in psutil.Process().children() if "forkserver" in " ".join(child.cmdline())]


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (lambda p: p.write_text("tool,lot\n1,a\n"), "uri"),
        (lambda p: p.write_text("uri,tool\na.csv\n"), "line 2"),
        (lambda p: p.write_text("uri\na.csv\na.csv\n"), "twice"),
        (lambda p: p.write_text("uri,tool\n,t\n"), "line 2"),
        (lambda p: p.write_text("uri,codec\nraw.hsw,vn100\n"), "highside decode raw.hsw --codec vn100"),
        (lambda p: p.write_text(""), "empty"),
        (lambda p: p.mkdir(), "no recording"),
    ],
)
def test_a_catalogue_that_is_not_in_order_is_one_line(
    write: Callable[[Path], object], said: str, tmp_path: Path
) -> None:
    place = tmp_path / "catalogue.csv"
    write(place)
    with pytest.raises(highside.errors.InputError, match=said) as error:
        catalogue_of(str(place))
    assert "\n" not in str(error.value)


def test_a_folder_is_a_catalogue_and_a_store_of_objects_is_a_place(fleet: Path) -> None:
    fsspec = pytest.importorskip("fsspec")
    assert {entry.tool for entry in catalogue_of(str(fleet))} >= {"warm0", "plain0"}
    memory = fsspec.filesystem("memory")
    memory.pipe("/lot7/t1.csv", (fleet / "warm0.csv").read_bytes())
    (entry,) = catalogue_of("memory://lot7/*.csv")
    assert (entry.tool, entry.lot, entry.uri) == ("t1", "lot7", "memory:///lot7/t1.csv")


def test_scores_estimate_a_small_effect_without_bias(tmp_path: Path) -> None:
    """Over 12 sessions the first-order estimates agree with the truth, and scatter by what the information says."""
    truth, away = 2e-6, []
    for seed in range(12):
        path = recording(tmp_path, f"s{seed}", 300 + seed, {"temperature_bias": {"bt_x": truth}})
        data = highside.diagnose(path, {"sensor": {"noise_g": 5e-5}}).report_data
        scores = data.scores
        own = [k for k, e in enumerate(scores.entry_of) if scores.entries[e] == "temperature_bias"]
        information = scores.information[np.ix_(own, own)]
        estimate = np.linalg.solve(information, scores.score[own])
        away.append((estimate - [truth, 0, 0]) / np.sqrt(np.diag(np.linalg.inv(information))))
    # 36 numbers of unit variance: mean within 3.3 of its standard deviation, variance 0.5 to 1.9 (chi-square, 0.999)
    assert abs(np.mean(away)) < 3.3 / 6
    assert 0.5 < np.mean(np.square(away)) < 1.9
