"""The table `[mqtt]`: what is allowed, and where the password comes from."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from highside.config.mqtt import MqttSettings
from highside.errors import InputError


def test_the_defaults_reach_a_broker_on_this_machine() -> None:
    settings = MqttSettings()
    assert (settings.host, settings.port, settings.qos, settings.tls) == ("127.0.0.1", 1883, 1, None)
    assert settings.topic("tool-1", "attitude") == "highside/tool-1/attitude"


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"prot": 1}, "prot"),
        ({"port": 0}, "greater than or equal to 1"),
        ({"qos": 2}, "Input should be 0 or 1"),
        ({"prefix": "a/#"}, "pattern"),
        ({"prefix": "/a"}, "pattern"),
        ({"prefix": "a\x01b"}, "pattern"),
        ({"prefix": "a\u202eb"}, "pattern"),
        ({"prefix": "$SYS"}, "pattern"),
        ({"prefix": "a" * 70_000}, "at most 200"),
        ({"tls": {"cert": "a.pem"}}, "`cert` and `key` go together"),
        ({"transport": "unix", "tls": {}}, "`tls` is for transport 'tcp'"),
        ({"reconnect_min_s": 5.0, "reconnect_max_s": 1.0}, "`reconnect_max_s` is below"),
        ({"password_file": "p"}, "needs a `username`"),
        ({"host": "the broker"}, "`host` is a name or an address"),
        ({"host": "mqtt://broker"}, "`host` is a name or an address"),
        ({"host": "broker\x00"}, "`host` is a name or an address"),
        ({"password": "in the file"}, "password"),
        ({"outbox": {"max_rows": 0}}, "greater than or equal to 100"),
    ],
)
def test_what_cannot_be_meant_is_refused(table: dict[str, object], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        MqttSettings.model_validate(table)


def test_the_password_comes_from_its_file_and_is_not_shown(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text("s3cret \n")
    settings = MqttSettings(username="tool", password_file=file)
    password = settings.read_password()
    assert password is not None
    assert password.get_secret_value() == "s3cret "
    assert "s3cret" not in repr(password)
    file.write_text("changed")
    again = settings.read_password()
    assert again is not None
    assert again.get_secret_value() == "changed"


def test_systemd_credentials_are_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    assert MqttSettings(username="tool").read_password() is None
    (tmp_path / "mqtt_password").write_text("from systemd")
    (tmp_path / "other").write_text("by name")
    found = MqttSettings(username="tool").read_password()
    named = MqttSettings(username="tool", password_file=Path("other")).read_password()
    assert found is not None
    assert named is not None
    assert (found.get_secret_value(), named.get_secret_value()) == ("from systemd", "by name")
    assert MqttSettings().read_password() is None, "no user, no password"


@pytest.mark.parametrize("empty", ["", "\n", " \r\n"])
def test_an_empty_password_file_is_refused(tmp_path: Path, empty: str) -> None:
    file = tmp_path / "password"
    file.write_bytes(empty.encode())
    with pytest.raises(InputError, match=r"password: mqtt\.password_file: holds no password; write it into the file"):
        MqttSettings(username="tool", password_file=file).read_password()


def test_the_path_of_a_socket_may_hold_spaces() -> None:
    assert MqttSettings(host="/run/my broker/socket", transport="unix").host == "/run/my broker/socket"


def test_a_password_file_that_is_missing_is_named(tmp_path: Path) -> None:
    settings = MqttSettings(username="tool", password_file=tmp_path / "absent")
    with pytest.raises(InputError, match=r"absent: mqtt\.password_file: no such file"):
        settings.read_password()
