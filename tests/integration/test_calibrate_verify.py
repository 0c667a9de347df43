"""`highside calibrate verify` as a command: exit status, what it prints, the file it writes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

MODEL = Path("config/model-bench.toml")


def highside(*arguments: str, check: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [Path(sys.executable).parent / "highside", *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == check, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> tuple[Path, Path]:
    """A record, and the poses of another session of the same tool on the same bench."""
    folder = tmp_path_factory.mktemp("verify")
    for seed in (1, 2):
        highside(
            "simulate", str(project_root / MODEL), "-o", str(folder / f"{seed}.csv.gz"),
            "--poses", str(folder / f"{seed}.csv"), "--seed", str(seed),
        )  # fmt: skip
    highside("calibrate", "solve", str(folder / "1.csv"), "--method", "joint", "-o", str(folder / "cal.json"))
    return folder / "cal.json", folder / "2.csv"


def test_a_good_calibration_passes_and_the_result_is_kept(session: tuple[Path, Path], tmp_path: Path) -> None:
    record, poses = session
    out = tmp_path / "found.json"
    done = highside(
        "calibrate", "verify", str(record), str(poses), "--limit-inc-deg", "0.2", "--limit-tf-deg", "10",
        "--same-bench", "-o", str(out),
    )  # fmt: skip
    assert done.stdout.strip().endswith("uncertainty included.")
    found = json.loads(out.read_text())
    assert found["verdict"] == "pass" and found["consistent"]
    assert found["record"] == json.loads(record.read_text())["id"]


def test_a_narrow_limit_is_undecided_or_failed_and_scripts_see_it(session: tuple[Path, Path]) -> None:
    record, poses = session
    done = highside(
        "calibrate", "verify", str(record), str(poses), "--limit-inc-deg", "0.001", "--limit-tf-deg", "10", "--json",
        check=1,
    )  # fmt: skip
    assert json.loads(done.stdout)["verdict"] in ("undecided", "fail")


def test_a_session_at_many_inclinations_is_no_roll_test(session: tuple[Path, Path]) -> None:
    record, poses = session
    done = highside("calibrate", "verify", str(record), str(poses), "--roll", "--limit-inc-deg", "0.1", check=1)
    assert "not at one inclination" in done.stderr


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--limit-inc-deg", "0.1"], "--limit-tf-deg: is missing"),
        (["--limit-inc-deg", "-1", "--limit-tf-deg", "1"], "is no limit"),
        (["--limit-inc-deg", "0.1", "--limit-tf-deg", "1", "--tilt-sigma-deg", "nan"], "no standard deviation"),
    ],
)
def test_wrong_usage_is_one_line(session: tuple[Path, Path], more: list[str], said: str) -> None:
    record, poses = session
    done = highside("calibrate", "verify", str(record), str(poses), *more, check=2)
    assert said in done.stderr and done.stderr.count("\n") == 1


def test_the_journal_of_a_verification_session_is_judged(tmp_path: Path, session: tuple[Path, Path]) -> None:
    """Poses taken on the simulated bench by the plan `verification`: their journal is what is judged."""
    config = tmp_path / "bench.toml"
    settings = """
[simulated]
speed = 20.0
{seed}
[plan]
{plan}
[store]
directory = "calibrations"
sessions = "sessions"
"""
    config.write_text(settings.format(seed="", plan='kind = "joint"\nposes = 12'))
    done = highside("calibrate", "bench", "--config", str(config), "--auto")
    record = json.loads(done.stdout.splitlines()[-1])["record"]
    before = set((tmp_path / "sessions").iterdir())
    judged = f'kind = "verification"\nrecord = "{Path(record).stem[:12]}"\nsame_bench = true'
    judged += "\nlimit_inc_deg = 0.1\nlimit_tf_deg = 2"
    config.write_text(settings.format(seed="seed = 7", plan=judged))
    in_session = json.loads(highside("calibrate", "bench", "--config", str(config), "--auto").stdout.splitlines()[-1])
    (journal,) = set((tmp_path / "sessions").iterdir()) - before
    done = highside(
        "calibrate", "verify", record, str(journal), "--limit-inc-deg", "0.1", "--limit-tf-deg", "2", "--same-bench",
        "--json",
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found["verdict"] == "pass" and len(found["poses"]) == 9
    assert (in_session["verdict"], in_session["judged"]) == ("pass", found["record"]), "as the session itself said"
    damaged = tmp_path / "x.journal"
    damaged.write_text("{}")
    assert (
        "x.journal"
        in highside("calibrate", "verify", record, str(damaged), "--limit-inc-deg", "1", "--roll", check=2).stderr
    )
