"""Calibrations over time: the walk against its truth, departures, due dates, and a chain of real records."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import highside
from highside.arrays import Array
from highside.calibration.record import content_id
from highside.cli.main import app
from highside.fleet.policy import STABILITY
from highside.fleet.stability import DAY_S, NAMES, Point, stability

ERROR = 2e-5
RATE = 1e-5
START = np.concatenate([np.eye(3).ravel(), [1e-3, -1e-3, 5e-4]])


def history(rng: np.random.Generator, tool: str, count: int, *, rate: float = RATE, jump: float = 0.0) -> list[Point]:
    """Calibrations 20 to 60 days apart of a sensor that walks; `jump` moves b_x (g) before the last."""
    at, truth, points = 0.0, START.copy(), []
    for i in range(count):
        gap = float(rng.uniform(20, 60)) if i else 0.0
        at += gap
        truth = truth + rate * np.sqrt(gap) * rng.standard_normal(12)
        truth[9] += jump if i == count - 1 else 0.0
        values = truth + ERROR * rng.standard_normal(12)
        points.append(Point(tool, f"{tool}-{i}", at * DAY_S, values, ERROR**2 * np.eye(12)))
    return points


@pytest.mark.parametrize("rate", [1e-6, 1e-5, 1e-4])
def test_the_rate_of_the_walk_lies_within_its_interval(rate: float) -> None:
    """12 parameters of 4 groups: of 48 intervals of 95 %, 40 or more hold with probability 0.9995."""
    held, found = 0, []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        points = [p for i in range(10) for p in history(rng, f"t{i}", 5, rate=rate)]
        for random_walk in stability(points, 0.1).random_walks:
            held += random_walk.low <= rate <= random_walk.high
            found.append(random_walk.rate)
    assert held >= 40
    if rate >= RATE:  # below, the walk of a year is less than a record's error
        assert np.median(found) == pytest.approx(rate, rel=0.2)


def test_a_departure_is_called_and_nothing_else_is() -> None:
    rng = np.random.default_rng(11)
    points = [p for i in range(10) for p in history(rng, f"t{i}", 5, jump=1e-3 if i == 4 else 0.0)]
    found = stability(points, 0.1)
    departed = [tool for tool in found.tools if tool.departures]
    assert [tool.tool for tool in departed] == ["t4"]
    (one,) = departed[0].departures
    assert (one.parameter, one.record) == ("b_x", "t4-4")
    assert one.change == pytest.approx(1e-3, rel=0.3)


def test_groups_without_departures_are_left_alone() -> None:
    """1 % of groups may call one: 4 or more of 40 has probability 0.001."""
    called = 0
    for seed in range(40):
        rng = np.random.default_rng(500 + seed)
        found = stability([p for i in range(5) for p in history(rng, f"t{i}", 4)], 0.1)
        called += any(tool.departures for tool in found.tools)
    assert called <= 3


def test_due_is_when_the_error_reaches_the_limit() -> None:
    """Offsets alone that walk: across gravity an error of b (g) is as many radians; 2 w sqrt(n) = limit."""
    rng = np.random.default_rng(3)
    points = [p for i in range(10) for p in history(rng, f"t{i}", 5, rate=1e-4)]
    found = stability(points, 0.3)
    rates = {random_walk.parameter: random_walk.rate for random_walk in found.random_walks}
    typical = float(np.median([rates[name] for name in NAMES]))
    # the error of a direction is b's and A's together: u C (dA g + db), so twice the variance of one parameter
    days = (np.deg2rad(0.3) / 2) ** 2 / (2 * typical**2)
    for tool in found.tools:
        assert tool.due_s is not None
        ahead = (tool.due_s - tool.points[-1].at_s) / DAY_S
        assert 0.5 * days < ahead < 1.2 * days
    never = stability(points, 80.0)
    assert all(tool.due_s is None for tool in never.tools)


def test_too_few_repeats_are_refused_in_words() -> None:
    rng = np.random.default_rng(4)
    found = stability(history(rng, "a", STABILITY.fewest_pairs), 0.1)
    assert not found.random_walks and f"repeated calibrations: {STABILITY.fewest_pairs - 1};" in found.refused


def test_records_of_a_folder_are_judged(tmp_path: Path) -> None:
    """Real records: simulated sessions of three tools, half a year apart, of which one moved."""
    for tool in range(3):
        for year in range(3):
            moved = 2e-3 if (tool, year) == (1, 2) else 0.0
            _record(tmp_path / "records", f"tool{tool}", year, np.array([1e-3 + moved, -5e-4, 2e-4]))
    (tmp_path / "other.json").write_text("{}")
    for beside in ("activations", "turntables"):  # as a store keeps them
        (tmp_path / beside).mkdir()
        (tmp_path / beside / "00000001.json").write_text("{}")
    result = CliRunner().invoke(app, ["fleet", "records", str(tmp_path), "--json", "--html", str(tmp_path / "p.html")])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    departed = {tool["tool"]: tool["departures"] for tool in found["tools"] if tool["departures"]}
    assert set(departed) == {"tool1"}
    assert "b_x" in {one["parameter"] for one in departed["tool1"]}
    assert [Path(name).name for name in found["omitted"]] == ["other.json"]
    assert (tmp_path / "p.html").read_text().count("<svg") == 3


def _record(folder: Path, tool: str, year: int, bias: Array) -> None:
    poses = highside.simulate(
        {
            "sensor": {"bias_g": bias.tolist(), "scale": [0.003, -0.004, 0.002]},
            "motion": {
                "kind": "poses",
                "inclinations_deg": [3, 45, 88],
                "toolfaces_deg": list(range(0, 360, 45)),
                "hold_s": 2,
            },
            "effects": {"included": ["reading_noise"], "reading_noise": {"density_ug": 50}},
        },
        seed=10 * year + len(tool) + int(tool[-1]),
    ).poses
    assert poses is not None
    made = highside.calibrate(poses, "joint", tool=tool).record
    when = f"{2020 + year}-03-01T08:00:00Z"
    # the record as if it had been made then, under its own hash
    content = {name: value for name, value in made.content.items() if name != "id"} | {
        "created": when,
        "valid_from": when,
    }
    document = json.loads(made.to_json()) | content | {"id": content_id(content)}
    folder.mkdir(exist_ok=True)
    (folder / f"{tool}-{year}.json").write_text(json.dumps(document))
