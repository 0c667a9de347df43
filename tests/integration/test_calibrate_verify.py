"""`highside calibrate verify` as a command: exit status, what it prints, the file it writes."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from inside import highside_inside

MODEL = Path("config/model-bench.toml")


def highside(*arguments: str, check: int = 0) -> subprocess.CompletedProcess[str]:
    done = highside_inside(*arguments)
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


README = ("--limit-inc-deg", "0.1", "--limit-tf-deg", "1")


def test_what_the_readme_suggests_passes(session: tuple[Path, Path], tmp_path: Path, project_root: Path) -> None:
    """The level of the bench is not stated: inclinations set from both sides tell it; the truth is in the model's
    file."""
    one_side = (project_root / MODEL).read_text()
    key = "inclinations_deg = ["
    assert one_side.count(key) == 1
    (tmp_path / "model.toml").write_text(one_side.replace(key, key + "-90.0, -45.0, "))
    poses = tmp_path / "poses.csv"
    highside(
        "simulate", str(tmp_path / "model.toml"), "-o", str(tmp_path / "s.csv.gz"), "--poses", str(poses), "--seed", "3"
    )  # fmt: skip
    done = highside("calibrate", "verify", str(session[0]), str(poses), *README, "--json")
    found = json.loads(done.stdout)
    assert found["verdict"] == "pass" and len(found["poses"]) == 52
    level = found["bench_level"]
    assert level["source"] == "reversed"
    for stated, std, true in zip(level["tilt_deg"], level["tilt_std_deg"], (0.02, -0.015), strict=True):
        assert abs(stated - true) < 4 * std and std < 0.003
    said = highside("calibrate", "verify", str(session[0]), str(poses), *README).stdout
    assert "level of the bench, by poses with the table turned the other way" in said


def test_from_one_side_it_is_undecided_and_says_what_would_decide(session: tuple[Path, Path], tmp_path: Path) -> None:
    """A bench that may lean by 0.05 deg hides an error of the tool of that size: what it is, no pose here can tell."""
    out = tmp_path / "found.json"
    done = highside("calibrate", "verify", *map(str, session), *README, "-o", str(out), check=1)
    assert done.stdout.strip().splitlines()[-1].startswith("Undecided from one side")
    assert "Set poses also with the table turned the other way (inclination -I, toolface + 180)" in done.stdout
    assert "level of the bench, as stated" in done.stdout
    found = json.loads(out.read_text())
    assert found["verdict"] == "undecided" and found["bench_level"]["tilt_std_deg"] == pytest.approx([0.05, 0.05])
    highside("calibrate", "verify", *map(str, session), *README, "--same-bench")


def test_a_limit_that_no_tool_could_pass_is_refused_with_the_term_that_is_too_large(
    session: tuple[Path, Path], tmp_path: Path
) -> None:
    record, poses = map(str, session)
    narrow = ("--limit-inc-deg", "0.01", "--limit-tf-deg", "1", "--same-bench")
    done = highside("calibrate", "verify", record, poses, *narrow, check=2)
    assert done.stderr.startswith("highside: --limit-inc-deg: no tool could pass: U of I at pose")
    assert "one setting of the bench: 0.0052 deg" in done.stderr and "pose_sigma_deg" in done.stderr
    # from one side, too: better knowledge of the bench's level, which is what is wanting there, would not help
    done = highside("calibrate", "verify", record, poses, *narrow[:-1], check=2)
    assert done.stderr.startswith("highside: --limit-inc-deg: no tool could pass: U of I at pose")
    assert "one setting of the bench: 0.0052 deg" in done.stderr
    few = tmp_path / "few.csv"
    few.write_text("".join(Path(poses).read_text().splitlines(keepends=True)[:9]))
    done = highside("calibrate", "verify", record, str(few), *README, check=1)
    assert "Undecided from one side" in done.stdout and "U of T at pose" in done.stdout
    assert "the bench's level (as stated)" in done.stdout and "tilt_sigma_deg" in done.stdout
    highside("calibrate", "verify", record, str(few), *README, "--same-bench")


def test_a_narrow_limit_is_undecided_or_failed_and_scripts_see_it(session: tuple[Path, Path]) -> None:
    record, poses = session
    done = highside(
        "calibrate", "verify", str(record), str(poses), "--limit-inc-deg", "0.0115", "--limit-tf-deg", "10", "--json",
        "--same-bench", check=1,
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found["verdict"] in ("undecided", "fail")
    assert found["verdict"] == "fail" or "most of it by one setting of the bench" in found["text"]


def test_a_session_at_many_inclinations_is_no_roll_test(session: tuple[Path, Path]) -> None:
    record, poses = session
    done = highside("calibrate", "verify", str(record), str(poses), "--roll", "--limit-inc-deg", "0.1", check=1)
    assert "not at one inclination" in done.stderr


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--limit-inc-deg", "0.1"], "--limit-tf-deg: is missing"),
        (["--limit-inc-deg", "-1", "--limit-tf-deg", "1"], "is no limit"),
        (["--limit-inc-deg", "0.1", "--limit-tf-deg", "1", "--tilt-sigma-deg", "-1"], "no standard deviation"),
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
    judged = f'kind = "verification"\nrecord = "{Path(record).stem[:12]}"'
    judged += "\nlimit_inc_deg = 0.1\nlimit_tf_deg = 1"  # as config/bench.toml suggests, and nothing said of the bench
    config.write_text(settings.format(seed="seed = 7", plan=judged))
    in_session = json.loads(highside("calibrate", "bench", "--config", str(config), "--auto").stdout.splitlines()[-1])
    (journal,) = set((tmp_path / "sessions").iterdir()) - before
    done = highside(
        "calibrate", "verify", record, str(journal), *README, "--json",
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert found["verdict"] == "pass" and len(found["poses"]) == 12
    # a copy under another name is the same
    copied = tmp_path / "copy of the session.txt"
    copied.write_bytes(journal.read_bytes())
    assert json.loads(highside("calibrate", "verify", record, str(copied), *README, "--json").stdout) == found
    assert found["bench_level"]["source"] == "reversed"
    # what no tool could pass is refused before the first pose, by its field
    for fields, field, said in (
        ("limit_inc_deg = 0.01\nlimit_tf_deg = 1", "plan.limit_inc_deg", "one setting of the bench"),
        ("limit_inc_deg = 0.1\nlimit_tf_deg = 1\ninclinations_deg = [5, 45, 90]", "plan.limit_tf_deg", "bench's level"),
    ):
        sessions = set((tmp_path / "sessions").iterdir())
        refused = f'kind = "verification"\nrecord = "{Path(record).stem[:12]}"\n{fields}'
        config.write_text(settings.format(seed="", plan=refused))
        done = highside("calibrate", "bench", "--config", str(config), "--auto", check=2)
        assert f"{field}: no tool could pass" in done.stderr and said in done.stderr, done.stderr
        checked = highside("check", str(config), check=2)
        assert checked.stderr.startswith(f"highside: {config}: {field}: no tool could pass"), checked.stderr
        assert set((tmp_path / "sessions").iterdir()) == sessions, "nothing was begun"
    assert (in_session["verdict"], in_session["judged"]) == ("pass", found["record"]), "as the session itself said"
    damaged = tmp_path / "x.journal"
    damaged.write_text("{}")
    assert (
        "x.journal"
        in highside("calibrate", "verify", record, str(damaged), "--limit-inc-deg", "1", "--roll", check=2).stderr
    )
