"""What is built from the checkout: metadata, long description, manual pages, the image and what stands beside it."""

from __future__ import annotations

import email
import importlib.util
import json
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import types
import zipfile
from pathlib import Path

import pytest
import typer
import yaml

from highside.cli import manual
from highside.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
ADDRESS = "https://code.example/us/highside"
RELATIVE = re.compile(r"\]\((?!https://|#)([^)]*)\)")


def hook() -> types.ModuleType:
    """hatch_build.py as a module."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def build(out: Path, source: Path, *targets: str, **environment: str) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-d", out, *(word for t in targets for word in ("-t", t))]
    done = subprocess.run(
        command, cwd=source, capture_output=True, text=True, timeout=200, env={"PATH": "/usr/bin:/bin", **environment}
    )
    assert done.returncode == 0, done.stderr


def metadata(wheel: Path) -> email.message.Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        return email.message_from_bytes(archive.read(name))


def description(found: email.message.Message) -> str:
    text = found.get_payload(decode=True)
    assert isinstance(text, bytes)
    return text.decode()


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources, built where the project has a public address."""
    out = tmp_path_factory.mktemp("sdist")
    build(out, ROOT, "sdist", HIGHSIDE_SOURCE_URL=ADDRESS)
    (built,) = out.glob("*.tar.gz")
    return built


def test_with_an_address_each_picture_and_link_is_absolute_and_leads_to_a_file(sdist: Path, tmp_path: Path) -> None:
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path, filter="data")
    (unpacked,) = tmp_path.glob("highside-*/")
    # the wheel of the sources says the same as they do, whatever the environment it is built in says
    build(tmp_path, unpacked, "wheel")
    (wheel,) = tmp_path.glob("*.whl")
    # as an index would look at both
    command = [sys.executable, "-m", "twine", "--no-color", "check", "--strict", sdist, wheel]
    looked = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert looked.returncode == 0, looked.stdout
    assert looked.stdout.count("PASSED") == 2
    found = metadata(wheel)
    pages = f"{ADDRESS}/blob/v{found['Version']}"
    assert found.get_all("Project-URL") == [f"Source, {ADDRESS}", f"Changelog, {pages}/CHANGELOG.md"]
    text = description(found)
    assert RELATIVE.findall(text) == []
    pictures = re.findall(rf"!\[[^\]]*\]\({ADDRESS}/raw/v{found['Version']}/([^)]*)\)", text)
    assert len(pictures) >= 4
    links = re.findall(rf"(?<!!)\[[^\]]*\]\({pages}/([^)#]*)[^)]*\)", text)
    assert len(links) > 20
    missing = [path for path in (*pictures, *links) if not (ROOT / path).exists()]
    assert missing == []
    for name in ("README.md", "CHANGELOG.md", "Containerfile", "compose.yaml", "packaging/deb", "packaging/venv"):
        assert (unpacked / name).is_file(), name


def test_without_an_address_nothing_is_made_up(tmp_path: Path) -> None:
    readme = (ROOT / "README.md").read_text()
    text = hook().long_description(readme, None, None)
    assert RELATIVE.findall(text) == []
    assert "![" not in text
    assert "*(picture: highside demo: a simulated tool, live)*" in text
    # code is not touched: what looks like a link there is none
    blocks = re.findall(r"^ *```.*?^ *```", readme, re.MULTILINE | re.DOTALL)
    assert len(blocks) >= 5
    assert all(block in text for block in blocks)
    assert hook().long_description("```\n[a](b)\n```\n", "x/", "x/") == "```\n[a](b)\n```\n"
    build(tmp_path, ROOT, "wheel")
    (wheel,) = tmp_path.glob("*.whl")
    found = metadata(wheel)
    assert found.get_all("Project-URL") is None
    assert description(found).strip() == text.strip()
    assert found["License-Expression"] == "Apache-2.0"
    assert found.get_all("License-File") == ["LICENSE", "NOTICE"]
    assert found["Description-Content-Type"] == "text/markdown"
    assert found["Requires-Python"] == ">=3.11"


def test_classifiers_are_known_and_agree_with_what_is_required() -> None:
    from trove_classifiers import classifiers

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(project["classifiers"]) <= classifiers
    assert sorted(project["classifiers"]) == project["classifiers"]
    oldest = project["requires-python"].removeprefix(">=")
    assert f"Programming Language :: Python :: {oldest}" in project["classifiers"]


def test_the_sources_carry_every_example_that_the_wheel_takes_from_them() -> None:
    targets = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]
    examples = {name for name in targets["wheel"]["force-include"] if name.startswith("config/")}
    assert examples == {name for name in targets["sdist"]["only-include"] if name.startswith("config/")}
    assert examples == {f"config/{path.name}" for path in (ROOT / "config").iterdir() if path.is_file()}


def test_an_address_that_is_none_is_refused(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", tmp_path]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, env={"HIGHSIDE_SOURCE_URL": "code.example/highside"}
    )
    assert done.returncode != 0
    assert "no https:// address" in done.stderr


# --- manual pages ----------------------------------------------------------------------------------------------------


def test_every_command_has_a_manual_page(tmp_path: Path) -> None:
    written = {path.stem for path in manual.write(tmp_path)}
    top = typer.main.get_command(app)
    assert {"highside", "highside-run", "highside-calibrate", "highside-calibrate-verify"} <= written
    assert {f"highside-{name}" for name in top.commands} <= written  # type: ignore[attr-defined]
    page = (tmp_path / "highside-run.1").read_text()
    for part in (".SH NAME", ".SH SYNOPSIS", ".SH OPTIONS", "\\-\\-config", ".SH EXAMPLE", ".SH EXIT STATUS"):
        assert part in page, part
    if shutil.which("groff"):
        for path in tmp_path.glob("*.1"):
            done = subprocess.run(["groff", "-man", "-Tutf8", "-ww", "-z", path], capture_output=True, text=True)
            assert done.stderr == "", path


# --- the image and what stands beside it -----------------------------------------------------------------------------


def instructions() -> list[tuple[str, str]]:
    """The Containerfile's instructions, continued lines joined."""
    text = re.sub(r"\\\n", " ", (ROOT / "Containerfile").read_text())
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [(line.split()[0], line.split(maxsplit=1)[1]) for line in lines]


def test_the_image_is_of_two_stages_without_rights_and_says_how_it_is() -> None:
    instruction_list = instructions()
    stages = [n for n, (word, _) in enumerate(instruction_list) if word == "FROM"]
    assert len(stages) == 2
    last = instruction_list[stages[1] :]
    assert [rest for word, rest in last if word == "USER"] == ["highside"]
    assert not any("venv" in rest for word, rest in last if word == "RUN"), "what installs is left behind"
    entry, command = (json.loads(next(rest for word, rest in last if word == name)) for name in ("ENTRYPOINT", "CMD"))
    assert [*entry, *command][:2] == ["highside", "run"]
    assert [word for word, _ in last].count("HEALTHCHECK") == 1
    # what is copied is there, and is let in
    let_in = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert all((ROOT / name).exists() for name in let_in)
    needed = {"requirements-service.lock", "pyproject.toml", "hatch_build.py", "README.md", "LICENSE", "NOTICE", "src"}
    assert needed <= let_in


def test_the_lock_of_the_service_is_a_part_of_that_of_all() -> None:
    def pins(name: str) -> set[str]:
        return set(re.findall(r"^[a-z0-9_.-]+==[^ \\]+", (ROOT / name).read_text(), re.MULTILINE))

    service, everything = pins("requirements-service.lock"), pins("requirements.lock")
    core = pins("requirements-core.lock")
    assert len(core) > 20
    assert core <= service, "what `make demo` installs is a part of what a tool needs"
    assert len(service) > 20
    assert service <= everything
    assert not {name for name in service if re.match(r"(matplotlib|nicegui|numba|pyarrow)==", name)}


def test_what_is_composed_fits_together() -> None:
    composed = yaml.safe_load((ROOT / "compose.yaml").read_text())
    services = composed["services"]
    mounted: dict[str, dict[str, str]] = {}
    for name, service in services.items():
        for volume in service["volumes"]:
            source, target, *_ = volume.split(":")
            mounted.setdefault(name, {})[target] = source
            known = source in composed["volumes"] if not source.startswith(".") else (ROOT / source).is_file()
            assert known, volume
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", [])), "of this machine alone"

    def read(service: str, target: str) -> str:
        return (ROOT / mounted[service][target]).read_text()

    tool = tomllib.loads(read("tool", "/etc/highside/highside.toml"))
    assert tool["mqtt"]["host"] in services
    prometheus = yaml.safe_load(read("prometheus", "/etc/prometheus/prometheus.yml"))
    (target,) = prometheus["scrape_configs"][0]["static_configs"][0]["targets"]
    assert target.split(":") == ["tool", next(rest for word, rest in instructions() if word == "EXPOSE")]
    (source,) = yaml.safe_load(read("grafana", "/etc/grafana/provisioning/datasources/highside.yaml"))["datasources"]
    assert source["type"] == "prometheus"
    assert source["url"] == "http://prometheus:9090"
    (provider,) = yaml.safe_load(read("grafana", "/etc/grafana/provisioning/dashboards/highside.yaml"))["providers"]
    (dashboard,) = [path for path in mounted["grafana"] if path.startswith(provider["options"]["path"])]
    assert json.loads(read("grafana", dashboard))["uid"] == "highside"
    assert services["grafana"]["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"] == dashboard


def test_the_composed_tool_is_a_good_configuration() -> None:
    highside = Path(sys.executable).with_name("highside")
    checked = subprocess.run(
        [highside, "check", ROOT / "packaging" / "compose" / "tool.toml"], capture_output=True, text=True, timeout=100
    )
    assert checked.returncode == 0, checked.stderr
