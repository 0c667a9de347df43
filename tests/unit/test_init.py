"""`highside init`: few questions, and what is written works."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from highside.cli.main import app
from highside.config.first import Answers, first_configuration, settings_of
from highside.errors import InputError
from highside.link import detect


@pytest.fixture(autouse=True)
def nothing_plugged_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detect, "serial_ports", list)
    monkeypatch.setattr(detect, "can_interfaces", list)


@pytest.fixture
def broker() -> Iterator[str]:
    """Somebody who takes connections."""
    with closing(socket.create_server(("127.0.0.1", 0))) as door:
        yield f"127.0.0.1:{door.getsockname()[1]}"


@pytest.fixture
def nobody() -> str:
    """An address where nobody listens."""
    with closing(socket.create_server(("127.0.0.1", 0))) as door:
        return f"127.0.0.1:{door.getsockname()[1]}"


def init(*words: str | Path, typed: str = "") -> Result:
    return CliRunner().invoke(app, ["init", *map(str, words)], input=typed)


def test_without_a_question_it_is_a_simulated_tool_that_is_good(tmp_path: Path, nobody: str) -> None:
    path = tmp_path / "highside.toml"
    done = init(path, "--yes", "--broker", nobody)
    assert done.exit_code == 0, done.output
    assert f"no broker at {nobody}" in done.output
    settings = settings_of(path.read_text(), where=str(path))
    assert settings.link.kind == "simulated"
    assert settings.codec.name == "tool"
    assert f"{settings.mqtt.host}:{settings.mqtt.port}" == nobody
    assert settings.site.latitude_deg is None
    checked = CliRunner().invoke(app, ["check", str(path)])
    assert checked.exit_code == 0, checked.output
    assert path.read_text().count("#") > 10, "it explains itself"


def test_what_is_found_is_proposed_and_what_is_answered_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broker: str
) -> None:
    monkeypatch.setattr(detect, "serial_ports", lambda: ["/dev/serial/by-id/usb-a", "/dev/ttyS0"])
    path = tmp_path / "tool.toml"
    done = init(path, "--broker", broker, typed="tool-7\n\n52,5\n")
    assert done.exit_code == 0, done.output
    assert "found: /dev/serial/by-id/usb-a, /dev/ttyS0" in done.output
    assert f"a broker at {broker}" in done.output
    settings = settings_of(path.read_text(), where=str(path))
    assert settings.tool.id == "tool-7"
    assert settings.link.kind == "serial"
    assert settings.link.port == "/dev/serial/by-id/usb-a"
    assert settings.site.latitude_deg == 52.5


def test_a_can_interface_gets_its_link_and_its_codec(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detect, "can_interfaces", lambda: ["can0"])
    path = tmp_path / "tool.toml"
    assert init(path, "--yes").exit_code == 0
    settings = settings_of(path.read_text(), where=str(path))
    assert (settings.link.kind, settings.codec.name) == ("socketcan", "dbc")


def test_a_file_that_is_there_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "highside.toml"
    path.write_text("mine")
    done = init(path, "--yes")
    assert isinstance(done.exception, InputError)
    assert "--force" in str(done.exception)
    assert path.read_text() == "mine"
    assert init(path, "--yes", "--force").exit_code == 0
    assert path.read_text() != "mine"


@pytest.mark.parametrize(
    ("words", "says"),
    [(("--tool", "a/b"), "tool.id"), (("--broker", "host:port"), "no broker"), (("--latitude-deg", "91"), "latitude")],
)
def test_an_answer_that_cannot_be_is_refused_and_nothing_is_written(
    words: tuple[str, ...], says: str, tmp_path: Path
) -> None:
    done = init(tmp_path / "x.toml", "--yes", *words)
    assert done.exit_code != 0
    assert says in str(done.exception) + done.output
    assert list(tmp_path.iterdir()) == []


def test_text_cannot_leave_its_place_in_the_file() -> None:
    with pytest.raises(InputError):
        first_configuration(Answers(tool='a"\nkind = "x'))
    settings = settings_of(first_configuration(Answers(port='/dev/a"b', broker="::1")), where="x")
    assert settings.link.port == '/dev/a"b'  # type: ignore[union-attr]
    assert settings.mqtt.host == "::1"


def test_questions_that_nobody_answers_are_one_line_and_nothing_is_written(tmp_path: Path, nobody: str) -> None:
    command = [Path(sys.executable).with_name("highside"), "init", tmp_path / "highside.toml", "--port", "simulated"]
    done = subprocess.run(
        [*command, "--broker", nobody], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2, done.stderr
    assert done.stderr.splitlines()[-1].startswith("highside: the input ended before all questions were answered")
    assert not list(tmp_path.iterdir())
