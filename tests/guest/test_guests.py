"""Runs `tests/guest_suite` where it can run: on this host if it has CAN and root, else in a guest.

Under CI (CI=true) neither suite is ever skipped: a machine that can run it nowhere fails. The inner run's summary is
printed, and its JUnit report must show the tests that are in the files, passed: an empty or skipped run is a failure.
"""

from __future__ import annotations

import ast
import contextlib
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import pytest
import uml

ROOT = Path(__file__).resolve().parents[2]
SUITE = ROOT / "tests" / "guest_suite"
SUITES = {"systemd": "test_systemd", "power": "test_power_loss"}
"""suites with a guest of their own, and how their files begin; all other files are of the CAN suite"""
CYCLES = int(os.environ.get("HIGHSIDE_CAN_CYCLES", "20"))
PATIENCE = float(os.environ.get("HIGHSIDE_GUEST_PATIENCE", "1"))
"""Times the limits below: for a machine on which a guest gets a fraction of a processor."""
VCAN_TIMEOUT_S = PATIENCE * (340.0 + 2.0 * (CYCLES - 20))
"""a CAN interface down and up takes 0.1 s in a guest, deleted and made anew 0.2 s; ten times that on a busy machine"""
SYSTEMD_TIMEOUT_S = PATIENCE * 280.0
POWER_TIMEOUT_S = PATIENCE * 1500.0


@dataclass(frozen=True, slots=True)
class Inner:
    """What the pytest inside reported."""

    status: int | None
    output: str
    passed: int
    skipped: int
    failed: int
    figures: tuple[str, ...] = ()
    """what the tests told of themselves as their property `measured`"""


def suite_files(suite: str) -> list[Path]:
    """The files of one suite: "can", "systemd" or "power"."""
    of = {path: next((s for s, start in SUITES.items() if path.name.startswith(start)), "can")
          for path in SUITE.glob("test_*.py")}  # fmt: skip
    return sorted(path for path, name in of.items() if name == suite)


def count_tests(files: list[Path]) -> int:
    """Test functions written in the files: the least number that a complete run passes."""
    trees = [ast.parse(path.read_text()) for path in files]
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    return sum(isinstance(node, kinds) and node.name.startswith("test_") for tree in trees for node in ast.walk(tree))


def pytest_command(files: list[Path], report: Path) -> list[str]:
    """The inner run: this interpreter, no cache, every failure shown."""
    return [
        sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-ra", "--durations=10", f"--junit-xml={report}",
        "-o", f"timeout={180 + 2 * CYCLES}", *(str(path.relative_to(ROOT)) for path in files),
    ]  # fmt: skip


def judge(status: int | None, output: str, report: Path) -> Inner:
    """Read the inner report. A run that left none counts as nothing passed."""
    passed = skipped = failed = 0
    figures: list[str] = []
    if report.exists() and report.stat().st_size:
        root = ElementTree.parse(report).getroot()
        figures = [entry.get("value", "") for entry in root.iter("property") if entry.get("name") == "measured"]
        for suite in root.iter("testsuite"):
            skipped += int(suite.get("skipped", "0"))
            failed += int(suite.get("failures", "0")) + int(suite.get("errors", "0"))
            passed += int(suite.get("tests", "0"))
        passed -= skipped + failed
    return Inner(status, output, passed, skipped, failed, tuple(figures))


def assert_complete(inner: Inner, files: list[Path]) -> None:
    """All that is written in the files has run and passed."""
    print(inner.output)
    print(f"{inner.passed} passed inside", *inner.figures, sep="\n")
    expected = count_tests(files)
    assert expected > 0, f"no tests in {SUITE}"
    assert inner.status == 0, f"the inner run ended with {inner.status}: see its output above"
    assert inner.failed == 0
    assert inner.passed + inner.skipped >= expected, f"{inner.passed} passed, but {expected} are written"
    if inner.skipped and os.environ.get("CI") != "true":
        pytest.skip(f"{inner.skipped} of {expected} tests were skipped inside: see their reasons in the output")
    assert inner.skipped == 0


def run_in_guest(
    files: list[Path], directory: Path, *, systemd: bool = False, timeout_s: float, memory: str = "1024M"
) -> Inner:
    """The suite in a guest, its report written through to `directory`."""
    report = directory / "report.xml"
    result = uml.run_in_guest(
        pytest_command(files, report),
        cwd=ROOT,
        env={"HIGHSIDE_SYSTEMD" if systemd else "HIGHSIDE_VCAN": "1", "PYTHONDONTWRITEBYTECODE": "1"}
        | {name: value for name, value in os.environ.items() if name == "HIGHSIDE_CAN_CYCLES"},
        timeout_s=timeout_s,
        writable=[directory],
        systemd=systemd,
        memory=memory,
    )
    note = f"guest: up after {result.boot_s} s, {result.total_s:.1f} s in all\n"
    console = "" if result.status is not None else f"console of the guest:\n{result.console}\n"
    return judge(result.status, result.stdout + result.stderr + console + note, report)


def run_here(files: list[Path], directory: Path) -> Inner:
    """The vcan suite on this host."""
    report = directory / "report.xml"
    done = subprocess.run(
        pytest_command(files, report),
        cwd=ROOT,
        env=os.environ | {"HIGHSIDE_VCAN": "1"},
        capture_output=True,
        text=True,
        timeout=VCAN_TIMEOUT_S,
        check=False,
    )
    return judge(done.returncode, done.stdout + done.stderr, report)


def host_has_vcan() -> bool:
    """Whether vcan0 is up here after all that this user can do for it."""
    if not Path("/sys/class/net/vcan0").exists():
        for command in ("modprobe -a can can-raw vcan", "ip link add vcan0 type vcan", "ip link set vcan0 up"):
            with contextlib.suppress(OSError):
                subprocess.run(command.split(), capture_output=True, check=False, timeout=30)
    try:
        flags = int(Path("/sys/class/net/vcan0/flags").read_text(), 16)
    except OSError:
        return False
    return bool(flags & 1) and os.geteuid() == 0


def demand_guest(*, systemd: bool) -> None:
    """Skip with the reason, or fail under CI, where no guest can be run."""
    reason = uml.why_not(systemd=systemd)
    if reason is None:
        return
    if os.environ.get("CI") == "true":
        pytest.fail(f"CI must not skip these tests, but a guest cannot be run: {reason}")
    pytest.skip(f"a guest cannot be run: {reason}")


@pytest.mark.guest
@pytest.mark.slow
@pytest.mark.timeout(VCAN_TIMEOUT_S + 140)
def test_the_can_suite_passes_on_a_real_vcan(tmp_path: Path) -> None:
    files = suite_files("can")
    if host_has_vcan():
        inner = run_here(files, tmp_path)
    else:
        demand_guest(systemd=False)
        inner = run_in_guest(files, tmp_path, timeout_s=VCAN_TIMEOUT_S)
    assert_complete(inner, files)


@pytest.mark.guest
@pytest.mark.slow
@pytest.mark.timeout(SYSTEMD_TIMEOUT_S + 120)
def test_the_systemd_suite_passes_under_a_real_systemd(tmp_path: Path) -> None:
    demand_guest(systemd=True)
    files = suite_files("systemd")
    assert_complete(run_in_guest(files, tmp_path, systemd=True, timeout_s=SYSTEMD_TIMEOUT_S), files)


@pytest.mark.guest
@pytest.mark.slow
@pytest.mark.timeout(POWER_TIMEOUT_S + 80)
def test_the_power_loss_suite_passes_on_a_disk_that_forgets(tmp_path: Path) -> None:
    demand_guest(systemd=False)
    files = suite_files("power")
    assert_complete(run_in_guest(files, tmp_path, timeout_s=POWER_TIMEOUT_S, memory="1536M"), files)


def test_a_guest_hands_back_output_and_status_apart() -> None:
    demand_guest(systemd=False)
    result = uml.run_in_guest(
        ["bash", "-c", 'echo out; echo err >&2; echo "$GREETING"; ip -br link show vcan0; exit 7'],
        cwd=ROOT,
        env={"GREETING": 'it\'s a "quoted" $value'},
        timeout_s=60.0,
        memory="256M",
    )
    assert result.status == 7, result.console
    lines = result.stdout.splitlines()
    assert lines[:2] == ["out", 'it\'s a "quoted" $value']
    assert "UP" in lines[2]
    assert result.stderr == "err\n"
