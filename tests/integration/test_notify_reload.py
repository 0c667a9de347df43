"""What systemd 253 and newer ask of `Type=notify-reload`, played by a stand-in that is as strict; the unit's grammar.

sd_notify(3), systemd.service(5): after its SIGHUP the manager waits for a datagram with RELOADING=1 and MONOTONIC_USEC=
of a time after the signal, then for READY=1; it takes nothing else for an answer. `systemctl reload` waits so long.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest
from broker import Mosquitto
from daemon import Daemon, Pty, running
from test_reload import text

ROOT = Path(__file__).resolve().parents[2]


class StrictManager:
    """The service manager's side of one service."""

    def __init__(self, folder: Path) -> None:
        self.address = str(folder / "notify")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.address)

    def receive(self, timeout_s: float = 60.0) -> dict[str, str]:
        """The next datagram that is more than a status or a sign of life, its fields; each may come once."""
        end = time.monotonic() + timeout_s
        while True:
            self._socket.settimeout(max(end - time.monotonic(), 0.001))
            lines = self._socket.recv(65536).decode().split("\n")
            fields = dict(line.split("=", 1) for line in lines)
            assert len(fields) == len(lines), lines
            if not fields.keys() <= {"STATUS", "WATCHDOG"}:
                return fields
            if time.monotonic() > end:
                raise TimeoutError

    def all_of(self, seconds: float) -> list[dict[str, str]]:
        """What comes within a time."""
        found, end = [], time.monotonic() + seconds
        with contextlib.suppress(TimeoutError):
            while (left := end - time.monotonic()) > 0.0:
                found.append(self.receive(left))
        return found

    def reload(self, daemon: Daemon) -> str:
        """SIGHUP and the answer to it; returns the status line that came with READY."""
        sent_us = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
        daemon.process.send_signal(signal.SIGHUP)
        begun = self.receive()
        assert begun["RELOADING"] == "1"
        assert "READY" not in begun
        stamp = begun["MONOTONIC_USEC"]
        assert re.fullmatch(r"[0-9]+", stamp)
        assert sent_us <= int(stamp) <= time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
        ended = self.receive()
        assert ended["READY"] == "1"
        assert not {"RELOADING", "MONOTONIC_USEC"} & ended.keys()
        return ended["STATUS"]


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_each_sighup_is_answered_as_sd_notify_asks_whether_taken_or_refused(tmp_path: Path) -> None:
    manager, line, path = StrictManager(tmp_path), Pty(), tmp_path / "highside.toml"
    with Mosquitto(tmp_path / "broker") as broker:
        good = text(tmp_path, line.path, broker.port)
        path.write_text(good)
        with running(path, env={"NOTIFY_SOCKET": manager.address}) as daemon:
            assert manager.receive() == {"READY": "1", "STATUS": "tool t1"}
            assert manager.reload(daemon) == "reloaded"
            for bad, says in (
                (good.replace("= 10", "= -1"), "output_rate_hz"),
                (good.replace(line.path, "/dev/no-such-port"), "/dev/no-such-port"),
                ("[link\n", "line 1"),
                ("", "link"),
            ):
                path.write_text(bad)
                status = manager.reload(daemon)
                assert status.startswith("reload refused: ")
                assert says in status
            path.unlink()
            assert "no such file" in manager.reload(daemon)
            path.write_text(good.replace("= 10", "= 20"))
            assert manager.reload(daemon) == "reloaded"
            # asked again before the first is done: what began is ended, and READY is the last word
            for _ in range(3):
                daemon.process.send_signal(signal.SIGHUP)
                time.sleep(0.01)
            words = ["READY" if "READY" in word else "RELOADING" for word in manager.all_of(8.0)]
            assert words[0] == "RELOADING"
            assert words[-1] == "READY"
            # each READY is the answer to something
            assert words.count("READY") <= words.count("RELOADING") <= 3
            daemon.process.send_signal(signal.SIGTERM)
            assert manager.receive()["STOPPING"] == "1"
            assert daemon.process.wait(15) == 0
    line.close()


def test_the_unit_and_its_drop_in_are_good_grammar(tmp_path: Path) -> None:
    """By systemd's own parser. One of before 253 says that it goes by the first `Type`; nothing else may be said."""
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        if os.environ.get("CI") == "true":
            pytest.fail("systemd-analyze is not installed, and CI must not skip this test")
        pytest.skip("needs systemd-analyze")
    unit = (ROOT / "systemd" / "highside.service").read_text()
    # the program is not installed here, which is another matter
    here = unit.replace("ExecStart=/opt/highside/bin/highside", f"ExecStart={shutil.which('true')}")
    assert here != unit
    (tmp_path / "highside.service").write_text(here)
    drop_in = tmp_path / "highside.service.d"
    drop_in.mkdir()
    (drop_in / "reload.conf").write_bytes((ROOT / "systemd" / "systemd-252.conf").read_bytes())

    def said() -> list[str]:
        done = subprocess.run(
            [analyze, "verify", "--recursive-errors=no", str(tmp_path / "highside.service")],
            capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
        own = [text for text in (done.stdout + done.stderr).splitlines() if "highside" in text]
        return [text for text in own if not text.endswith("Failed to parse service type, ignoring: notify-reload")]

    assert said() == []
    # and it would be said if there were anything
    (tmp_path / "highside.service").write_text(here.replace("KillMode=mixed", "KillMode=mixd\nKilMode=mixed"))
    assert len(said()) == 2
