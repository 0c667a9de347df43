"""Where things are kept when no configuration says where."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from highside.config.bench import load_bench
from highside.config.places import left_behind
from highside.config.settings import validate
from highside.service.places import state_dir


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "kept"))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    return tmp_path


def settings(tool: str = "tool-7", **service: str) -> Path:
    tables = {
        "tool": {"id": tool},
        "link": {"kind": "serial", "port": "/dev/ttyS0"},
        "codec": {"name": "tool"},
        "mqtt": {},
        "service": service,
    }
    return state_dir(validate(tables, where="a test", environment=False))


def test_a_bench_without_a_store_keeps_things_in_the_users_own_folder(home: Path) -> None:
    folder = home / "checkout" / "config"
    folder.mkdir(parents=True)
    (folder / "bench.toml").write_text('[simulated]\n[plan]\nkind = "joint"\n')
    store = load_bench(folder / "bench.toml").store
    assert store.directory == home / "data" / "highside" / "calibrations"
    assert store.sessions == home / "data" / "highside" / "sessions"


def test_a_store_that_is_named_starts_beside_the_file(home: Path) -> None:
    (home / "bench.toml").write_text('[simulated]\n[plan]\nkind = "joint"\n[store]\nsessions = "mine"\n')
    store = load_bench(home / "bench.toml").store
    assert store.sessions == home / "mine"
    assert store.directory == home / "data" / "highside" / "calibrations"
    stated = load_bench(home / "bench.toml", [f"store.directory={home}/told"])
    assert stated.store.directory == home / "told"


def test_two_services_of_one_user_have_a_folder_each(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert settings("tool-7") == home / "kept" / "highside" / "tool-7"
    assert settings("tool-8") == home / "kept" / "highside" / "tool-8"
    assert settings(state_dir="/var/lib/here") == Path("/var/lib/here")
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/highside")
    assert settings() == Path("/var/lib/highside")


def test_what_was_kept_elsewhere_is_named(tmp_path: Path) -> None:
    earlier, now = tmp_path / "state" / "sessions", tmp_path / "now"
    assert left_behind(earlier, now, "store.sessions") is None
    earlier.mkdir(parents=True)
    assert left_behind(earlier, now, "store.sessions") is None, "an empty folder is nothing"
    (earlier / "a.journal").write_text("{}")
    said = left_behind(earlier, now, "store.sessions")
    assert said is not None
    assert "\n" not in said
    assert f'store.sessions = "{earlier}"' in said
    assert left_behind(earlier, earlier, "store.sessions") is None, "it is in use"


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    own = {"XDG_DATA_HOME": str(folder / "data"), "XDG_STATE_HOME": str(folder / "kept")}
    highside = Path(sys.executable).parent / "highside"
    return subprocess.run(
        [highside, *arguments], cwd=folder, env=os.environ | own, capture_output=True, text=True, timeout=60
    )


def test_a_bench_says_where_earlier_sessions_lie(tmp_path: Path) -> None:
    (tmp_path / "state" / "sessions").mkdir(parents=True)
    (tmp_path / "state" / "sessions" / "old.journal").write_text("{}")
    (tmp_path / "bench.toml").write_text('[simulated]\n[plan]\nkind = "roll_test"\nlimit_inc_deg = 1\n')
    # there is nothing to judge yet: the session ends at once
    done = run(tmp_path, "calibrate", "bench", "--config", "bench.toml", "--auto")
    assert done.returncode in (1, 2)
    said, refused = done.stderr.splitlines()
    assert said.startswith("highside: ")
    assert f'store.sessions = "{tmp_path}/state/sessions"' in said
    assert str(tmp_path / "data" / "highside" / "calibrations") in refused
    # one that names its store does not use the default, and is told nothing
    named = ["--set", f"store.sessions={tmp_path}/mine", "--set", f"store.directory={tmp_path}/mine"]
    done = run(tmp_path, "calibrate", "bench", "--config", "bench.toml", "--auto", *named)
    assert len(done.stderr.splitlines()) == 1


def test_a_service_says_where_its_earlier_state_lies(tmp_path: Path) -> None:
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "outbox.sqlite").write_text("")
    (tmp_path / "tool.toml").write_text(
        '[tool]\nid = "places-test"\n[link]\nkind = "serial"\nport = "/dev/no-such-port"\nwait_at_start = false\n'
        '[codec]\nname = "tool"\n[mqtt]\nport = 1\n'
    )
    done = run(tmp_path, "run", "--config", "tool.toml")
    assert done.returncode == 2, done.stderr
    assert f'service.state_dir = "{tmp_path}/state"' in done.stderr
    assert (tmp_path / "kept" / "highside" / "places-test").is_dir()
