"""The first screen of README and the three paths of the documentation, typed as they stand in an empty folder.

Blocks of `sh` are run in order, those of `toml` become the file that their first line names. The environment is a fresh
one as far as it costs nothing: a home and a folder of its own, the packages of this one.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest
from broker import Mosquitto, require_mosquitto

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

ROOT = Path(__file__).resolve().parents[2]
PATHS = ROOT / "docs" / "paths"
BLOCK = re.compile(r"^ *```(\w+)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)


def blocks(page: Path) -> list[tuple[str, str]]:
    return BLOCK.findall(page.read_text())


def environment(folder: Path, **more: str) -> dict[str, str]:
    """A home of its own, and the command of this installation."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "HIGHSIDE_"))}
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    return {**kept, "HOME": str(folder / "home"), "PATH": path, **more}


def run(script: str, folder: Path, env: dict[str, str]) -> str:
    """What a block prints; each of its commands has to succeed."""
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        cwd=folder, env=env, capture_output=True, text=True, timeout=400, stdin=subprocess.DEVNULL, check=False,
    )  # fmt: skip
    assert done.returncode == 0, script + done.stdout + done.stderr
    return done.stdout + done.stderr


def test_the_path_of_the_bench_technician(tmp_path: Path) -> None:
    env = environment(tmp_path)
    session, shown, force, certificate = (text for kind, text in blocks(PATHS / "bench.md") if kind == "sh")
    assert "accepted" in run(session, tmp_path, env)
    # the shell of who follows the page keeps `$record` from one block to the next
    named = next(line for line in shown.splitlines() if line.startswith("record="))
    said = run(shown, tmp_path, env)
    assert "bench-demo" in said and "accuracy" in said and "16 of 16 poses" in said
    assert "bench-demo" in run(f"{named}\n{force}", tmp_path, env)
    assert "certificate of record" in run(f"{named}\n{certificate}", tmp_path, env)
    assert "not stated" in (tmp_path / "certificate.html").read_text()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    require_mosquitto()
    with Mosquitto(tmp_path / "broker") as running:
        yield running


def test_the_path_of_the_operator(tmp_path: Path, broker: Mosquitto) -> None:
    """Only the port of the broker is another: that of the page may be in use."""
    (tmp_path / "home" / ".config").mkdir(parents=True)
    (tmp_path / "home" / ".config" / "mosquitto_sub").write_text(f"-p {broker.port}\n-W 60\n")
    env = environment(tmp_path, HIGHSIDE__MQTT__PORT=str(broker.port))
    (configuration,) = (text for kind, text in blocks(PATHS / "tool.md") if kind == "toml")
    name, _, text = configuration.partition("\n")
    (tmp_path / name.removeprefix("# ")).write_text(text)
    check, serve, look = (text for kind, text in blocks(PATHS / "tool.md") if kind == "sh")
    assert "my.toml: good" in run(check, tmp_path, env)
    with (tmp_path / "log").open("w") as log:
        service = subprocess.Popen(["bash", "-c", f"exec {serve}"], cwd=tmp_path, env=env, stderr=log, stdout=log)
        try:
            heard = run(look.replace("highside doctor", "\nhighside doctor"), tmp_path, env)
        finally:
            service.terminate()
            status = service.wait(30)
    assert status == 0, (tmp_path / "log").read_text()
    lines = heard.splitlines()
    assert lines[0] == "online"
    attitudes = [json.loads(line) for line in lines[1:4]]
    assert [one["seq"] - attitudes[0]["seq"] for one in attitudes] == [0, 1, 2]
    assert all("uncalibrated" in one["flags"] and one["inc_std_deg"] > 0 for one in attitudes)
    assert json.loads(lines[4])["balance"]["bytes"] is True
    assert "broker" in "\n".join(lines[5:])


def test_the_path_of_the_engineer(tmp_path: Path) -> None:
    env = environment(tmp_path)
    made, found, again = (text for kind, text in blocks(PATHS / "desk.md") if kind == "sh")
    run(made, tmp_path, env)
    assert "named - The simulation omits levelling error of the bench" in run(found, tmp_path, env)
    assert json.loads((tmp_path / "report" / "diagnosis.json").read_text())["claims"][0]["effect"] == "base_tilt"
    assert (tmp_path / "report" / "report.html").is_file()
    assert "base_tilt" in (said := run(again, tmp_path, env)) and "confirmed" in said
    assert (tmp_path / "predicted.csv").is_file()


def test_the_first_screen_of_the_readme(tmp_path: Path) -> None:
    """`make demo` sets up an environment from the lock and runs the command; here the one that is there is used."""
    first = (ROOT / "README.md").read_text().partition("\n## ")[0]
    targets = re.findall(r"^make (\w+)", "\n".join(text for _, text in BLOCK.findall(first)), re.MULTILINE)
    assert targets == ["demo", "install", "test"]
    said = {
        target: subprocess.run(
            ["make", "--no-print-directory", "-n", target], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout
        for target in targets
    }
    assert said["demo"].splitlines()[-1].endswith("bin/highside demo")
    assert ".ci/suites" in said["test"]
    commands = re.findall(r"`(?:pip install '\.\[(\w+)\]' && )?(highside \w+)`", first)
    assert ("all", "highside demo") in commands and ("", "highside docs") in commands
    spoken = run("highside demo --seconds 3", tmp_path, environment(tmp_path))
    assert re.search(r"\d+ frames, \d+ attitudes delivered, 0 lost, rms error I 0\.\d+ deg", spoken)
    assert "requirements-core.lock" in (ROOT / "Makefile").read_text().partition("$(VENV)/.run:")[2].splitlines()[0]


def test_how_to_pages_give_files_that_are_good_and_commands_that_exist(tmp_path: Path) -> None:
    """Every configuration passes `check`, as far as it is a whole one, and the desk's commands run."""
    env = environment(tmp_path)
    shutil.copytree(ROOT / "config", tmp_path / "config", ignore=shutil.ignore_patterns("state"))
    checked, done = 0, set()
    for page in sorted((ROOT / "docs" / "howto").glob("*.md")):
        for kind, text in blocks(page):
            lines = textwrap.dedent(text).splitlines()
            if kind == "toml" and lines[0].startswith("# "):
                name = lines[0].removeprefix("# ")
                (tmp_path / name).write_text("\n".join(lines))
                assert f"{name}: good" in run(f"highside check {name}", tmp_path, env)
                checked += 1
            elif page.stem in ("first-calibration", "mqtt", "rotating-tool", "verify") and kind == "sh":
                new = [line for line in lines if line not in done]  # the same line makes the same file
                run("\n".join(new), tmp_path, env)
                done.update(new)
    assert checked == 4
    assert {"cal.json", "comp.json", "bench.toml", "highside.asyncapi.json"} <= {
        path.name for path in tmp_path.iterdir()
    }
