"""The sealed decks judge answers as they should; the deck on real noise puts in what it says; regressions answer."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies.sealed import baselines, deck, real_noise, real_recordings, table, world
from studies.sealed.judging import judged

NO_FIT = {"heldout_rmse_before": None}


def claim(effect: str, *others: str, **parameters: float) -> dict[str, Any]:
    stated = {n: {"value": v, "low": v - 1e-4, "high": v + 1e-4, "unit": "g"} for n, v in parameters.items()}
    return {"effect": effect, "equivalence_class": [effect, *others], "parameters": stated}


def row(group: str, truth: dict[str, Any], verdict: str, *claims: dict[str, Any], **more: Any) -> dict[str, Any]:
    answer = {
        "verdict": verdict, "claims": list(claims), "not_testable": [], "location": [], "fit": more.pop("fit", NO_FIT),
        "intake": more.pop("intake", []),
    }  # fmt: skip
    return {
        "group": group, "design": "poses", "noise": "white", "strength": 400.0, "truth": truth, "channels": [],
        "interval": None, "answer": answer, **more,
    }  # fmt: skip


def test_a_wrong_name_is_wrong_and_a_class_that_holds_the_truth_is_not() -> None:
    truth = {"sag": {"s": 1e-3}}
    right = judged(row("single", truth, "named", claim("sag", s=1.1e-3)))
    assert right["exact"] and right["in_class"] and not right["wrong"]
    assert right["errors"] == pytest.approx([0.1])
    assert right["covered"] == [True]
    rival = judged(row("single", truth, "named", claim("base_tilt", "sag")))
    assert rival["in_class"] and not rival["exact"] and not rival["wrong"]
    assert judged(row("single", truth, "named", claim("base_tilt")))["wrong"]
    both = judged(row("single", truth, "named", claim("sag"), claim("cubic")))
    assert both["wrong"] and both["first"] and not both["exact"]
    # a name that is taken back is no claim
    assert judged(row("single", truth, "partial", claim("base_tilt")))["refused"]


def test_what_a_recording_shows_by_itself_is_neither_a_mistake_nor_an_alarm() -> None:
    sham = row("null", {}, "named", claim("temperature_bias", "temperature_scale"), legit=["temperature_bias"])
    assert not judged(sham)["alarm"] and not judged(sham)["wrong"] and not judged(sham)["names"]
    more = row("null", {}, "named", claim("temperature_bias"), claim("quadratic"), legit=["temperature_bias"])
    assert judged(more)["alarm"] and judged(more)["wrong"]


def test_wandering_is_an_alarm_only_where_nothing_wanders() -> None:
    assert judged(row("null", {}, "wander", noise="white"))["alarm"]
    for noise in ("walk", "sunsided"):
        assert not judged(row("null", {}, "wander", noise=noise))["alarm"]
        assert judged(row("null", {}, "partial", noise=noise))["alarm"]


def test_data_that_are_refused_have_no_fit_to_be_judged() -> None:
    found = judged(row("fault", {"wrong_unit": {}}, "bad_data", fit=None, intake=[{"check": "wrong_unit"}]))
    assert found["seen"] and found["stopped"] and found["closed"] is None


def test_the_table_holds_every_sort_of_case_and_names_those_not_made() -> None:
    rows = [
        row("null", {}, "named", claim("cubic")) | {"name": "null/poses/white/0", "seconds": 1.0, "trouble": None},
        row("single", {"sag": {"s": 1e-3}}, "named", claim("sag", s=1e-3))
        | {"name": "single/poses/sag/400/0", "seconds": 1.0, "trouble": None},
        {"name": "real/single/hand/x/cubic/1600/0", "not_made": True, "answer": None, "trouble": "not made"},
    ]
    text = table.deck_table(rows, table.DESIGNS)
    assert "| any alarm on nulls <= 3 % | 100.0 % [20.7, 100.0] (1 of 1) |" in text
    assert "| sag | stepped session | 400 | 1/1 | 1/1 | 0/1 |  |" in text
    assert "| confident and wrong, of all <= 1 % | 50.0 %" in text
    assert text.endswith("as strong: hand/x/cubic/1600/0.\n")


@pytest.mark.parametrize("name", real_recordings.HAND)
def test_the_deck_s_own_calibration_makes_gravity_one(shared_data: Path, name: str) -> None:
    del shared_data
    real = real_recordings.recording(name)
    size = [np.linalg.norm(real.force[:, s].mean(axis=1)) for s in real.still]
    assert len(size) >= 20
    assert np.abs(np.array(size) - 1).max() < 1e-3
    assert 5e-5 < real.sigma < 5e-4


def test_what_is_put_into_a_recording_has_its_strength_and_nothing_else_changes(shared_data: Path) -> None:
    del shared_data
    made = real_noise.cases("test", real_noise.Size((400.0,), 1, 1, 1))
    for name in ("imu_tk/quadratic", "imu_tk/bias_step", "imu_tk/temperature_scale", "vn100/warmup"):
        kind = "hand" if name.startswith("imu") else "rest"
        case = made[f"real/single/{kind}/{name}/400/0"]()
        assert case is not None
        real = real_recordings.recording(case.noise)
        added = np.stack([case.columns[f"a{axis}_g"] for axis in "xyz"]) - real.accel
        own = case.columns["temp_c"]
        known = (own, own**2, own**3) if case.noise == "vn100" else ()
        assert real_recordings.energy(real, added, known) == pytest.approx(400.0, rel=1e-3)
    sham = made["real/null/hand/imu_tk/0"]()
    assert sham is not None
    ours = np.linalg.norm([sham.columns[f"a{axis}_g"] for axis in "xyz"], axis=0)
    theirs = np.linalg.norm(real_recordings.recording("imu_tk").accel, axis=0)
    first = int(np.flatnonzero(np.isclose(theirs, ours[0], rtol=1e-12))[0])
    assert np.allclose(ours, theirs[first : first + ours.size], rtol=1e-12), "a sham is the recording itself"


def test_the_deck_on_real_noise_is_as_large_as_promised(shared_data: Path) -> None:
    del shared_data
    made = real_noise.cases("test", real_noise.Size())
    singles = [name.split("/") for name in made if "/single/" in name]
    assert len({parts[-3] for parts in singles}) >= 12
    assert len({parts[-2] for parts in singles}) >= 3
    assert sum("/null/" in name for name in made) >= 100


def test_regressions_find_a_strong_effect_and_say_so_by_its_name() -> None:
    made = deck.cases("test", deck.Size(0, 1, (400.0,), 0, 0, 0, 0))
    found = baselines.names_of(made["single/poses/sag/400/0"]())
    assert set(found) == {"LassoCV", "LassoCV, one standard error", "STLSQ", "STLSQ, one standard error"}
    assert "sag" in found["LassoCV"]
    assert set(found["LassoCV, one standard error"]) <= set(found["LassoCV"])


def test_a_bench_with_real_noise_has_the_noise_of_the_rest(shared_data: Path) -> None:
    del shared_data
    rng = np.random.default_rng(4)
    p = world.rotation_programme(rng)
    rows, size = real_noise._rest_noise(p, "tomisuarez", rng)
    assert rows.shape == (3, p.n)
    assert np.all((size > 1e-3) & (size < 6e-3))
    # rows are means of two readings of a converter: its steps are still there
    steps = np.diff(rows, axis=1) / (real_recordings.recording("tomisuarez").step / 2)
    assert np.abs(steps - np.round(steps)).max() < 1e-6


def test_the_seed_is_the_last_commit_that_changed_what_answers(project_root: Path) -> None:
    """The places that the seed is taken from are those where the engine is now."""
    for place in deck.ENGINE:
        assert list((project_root / place).rglob("*.py")), f"no engine in {place}"
    last = subprocess.run(
        ["git", "log", "-1", "--format=%H", "--name-only", "--", *deck.ENGINE],
        cwd=project_root, capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    assert len(last[0]) == 40
    assert any(name.startswith(deck.ENGINE) for name in last[1:])
    changed = ["git", "status", "--porcelain", "--", *deck.ENGINE]
    if subprocess.run(changed, cwd=project_root, capture_output=True, check=True).stdout:
        with pytest.raises(SystemExit, match="not frozen"):
            deck.frozen_seed()
    else:
        assert deck.frozen_seed() == last[0]
    # whoever reads the page of evidence is told the same places
    assert all(f"`{place}`" in (project_root / "docs/evidence.md").read_text() for place in deck.ENGINE)


def test_the_frozen_package_answers_and_not_the_tree(tmp_path: Path, project_root: Path) -> None:
    head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=project_root, capture_output=True, text=True, check=True)
    words = (
        "from pathlib import Path; from studies.sealed import score;"
        f"score.use_frozen({head.stdout.strip()!r}, Path({str(tmp_path)!r}));"
        "import highside.cli.main as m; print(m.__file__)"
    )
    stated = subprocess.run([sys.executable, "-c", words], cwd=project_root, capture_output=True, text=True, check=True)
    assert Path(stated.stdout.strip()) == tmp_path / "src/highside/cli/main.py"


def located(covariate: str, *intervals: tuple[float, float]) -> list[dict[str, Any]]:
    return [{"channels": ["az"], "covariate": covariate, "intervals": [list(i) for i in intervals]}]


def test_an_interval_is_compared_by_length_and_where_the_recording_steps_by_settings() -> None:
    def iou(interval: tuple[str, float, float], place: list[dict[str, Any]], settings: list[float] | None) -> float:
        case = row("open", {"a bump": {}}, "unknown", interval=interval, settings=settings)
        case["answer"]["location"] = place
        return float(judged(case)["iou"])

    bump = ("tf_ref_deg", 80.0, 160.0)
    assert iou(bump, located("tf_ref_deg", (100.0, 180.0)), None) == pytest.approx(0.6)
    assert iou(bump, located("inc_ref_deg", (80.0, 160.0)), None) == 0.0
    ring, rings = ("inc_ref_deg", 54.9, 55.1), [25.0, 40.0, 55.0, 70.0]
    assert iou(ring, located("inc_ref_deg", (47.5, 62.5)), rings) == 1.0
    assert iou(ring, located("inc_ref_deg", (47.5, 77.5)), rings) == 0.5
    assert iou(ring, located("inc_ref_deg", (62.5, 77.5)), rings) == 0.0
    assert iou(ring, [], rings) == 0.0


def test_a_step_is_where_it_is_from_its_time_on_and_rings_are_settings() -> None:
    made = deck.cases("test", deck.Size())
    step = made["single/poses/bias_step/400/0"]()
    assert step is not None and step.interval is not None
    t0 = step.truth["bias_step"]["t0"]
    assert step.interval == ("t_s", pytest.approx(30.0 + t0), float(step.columns["t_s"][-1]))
    assert step.settings is None
    ring = made["open/poses/one ring off/0"]()
    assert ring is not None and ring.settings is not None
    assert len(ring.settings) == 11
