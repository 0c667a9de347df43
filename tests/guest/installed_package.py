"""Runs in a guest with systemd: the Debian package installed, its service started and heard, removed, purged.

Usage: installed_package.py PACKAGE.deb; prints one line a step, ends with an AssertionError where something is not so.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

CONFIGURATION = """\
[tool]
id = "bench1"
[link]
kind = "simulated"
[codec]
name = "tool"
[mqtt]
host = "127.0.0.1"
"""
CONFIG = Path("/etc/highside/highside.toml")
STATE = Path("/var/lib/private/highside")
OURS = (
    "/opt/highside",
    "/usr/bin/highside",
    "/lib/systemd/system/highside.service",
    "/lib/systemd/system/highside.service.d",
)


def run(*command: str, status: int | None = 0) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=400)
    assert status is None or done.returncode == status, f"{command}: {done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout.strip()


def state_of_the_unit() -> str:
    return run("systemctl", "is-active", "highside", status=None)


def main() -> None:
    began = time.monotonic()

    def say(step: str) -> None:
        print(f"{time.monotonic() - began:6.1f} s  {step}", flush=True)

    # images of containers forbid packages to start and stop services; this guest is a machine
    Path("/usr/sbin/policy-rc.d").unlink(missing_ok=True)
    # nothing of the host's own is ours
    assert not any(Path(place).exists() for place in (*OURS, "/etc/highside")), "highside is installed on this machine"
    run("dpkg", "--install", sys.argv[1])
    say("installed")
    assert state_of_the_unit() == "inactive", "a service that nobody configured was started"
    assert run("systemctl", "is-enabled", "highside", status=None) == "disabled"
    assert run("getent", "passwd", "highside").endswith("/usr/sbin/nologin")
    assert run("dpkg-query", "--showformat=${Conffiles}", "--show", "highside").split()[0] == str(CONFIG)
    assert (
        run("highside", "--version") == run("dpkg-query", "--showformat=${Version}", "--show", "highside").split("-")[0]
    )
    assert "highside.1" in run("man", "-w", "highside")
    run("highside", "check", str(CONFIG))
    owners = {path.owner() for path in Path("/opt/highside").rglob("*")}
    assert owners == {"root"}, owners

    CONFIG.write_text(CONFIGURATION)
    broker = subprocess.Popen(["mosquitto", "-p", "1883"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    run("systemctl", "start", "highside")
    say("started")
    heard = run("mosquitto_sub", "-C", "5", "-W", "60", "-t", "highside/bench1/attitude")
    assert len(heard.splitlines()) == 5, run("journalctl", "--no-pager", "-u", "highside")
    assert all('"inc_deg"' in line for line in heard.splitlines())
    health = run("mosquitto_sub", "-C", "1", "-W", "60", "-t", "highside/bench1/health")
    assert '"state":"up"' in health.replace(" ", ""), health
    assert run("systemctl", "show", "--property=MainPID", "--value", "highside") != "0"
    pid = run("systemctl", "show", "--property=MainPID", "--value", "highside")
    assert Path(f"/proc/{pid}").owner() == "highside"
    say("frames in, attitudes and health at the broker")

    run("dpkg", "--remove", "highside")
    assert state_of_the_unit() == "inactive", state_of_the_unit()
    assert not any(Path(place).exists() for place in OURS), [place for place in OURS if Path(place).exists()]
    assert CONFIG.read_text() == CONFIGURATION, "the configuration was not kept"
    assert STATE.is_dir(), "the state was not kept"
    say("removed; configuration and state kept")
    run("dpkg", "--purge", "highside")
    left = [place for place in ("/etc/highside", str(STATE), "/var/lib/highside") if Path(place).exists()]
    assert left == [], left
    assert run("dpkg-query", "--show", "highside", status=1) == ""
    broker.terminate()
    say("purged")


if __name__ == "__main__":
    main()
