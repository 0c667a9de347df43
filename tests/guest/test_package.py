"""The Debian package: built from this checkout, then its whole life in a guest with a real systemd."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import uml

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.guest
@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_package_is_built_installed_heard_removed_and_purged(tmp_path: Path) -> None:
    reason = uml.why_not(systemd=True)
    if reason is None and shutil.which("dh") is None:
        reason = "debhelper is not installed"
    if reason is not None:
        (pytest.fail if os.environ.get("CI") == "true" else pytest.skip)(f"cannot be tried: {reason}")
    # not packed: the guest is slow to unpack, and nobody downloads this one
    environment = {"PYTHON": sys.executable, "UV": str(Path(sys.executable).with_name("uv")), "COMPRESSION": "none"}
    built = subprocess.run(
        [ROOT / "packaging" / "deb", tmp_path],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert built.returncode == 0, built.stderr
    (package,) = tmp_path.glob("highside_*.deb")
    print(f"{package.name}: {package.stat().st_size / 1e6:.0f} MB unpacked")
    inner = ["/usr/bin/python3", str(ROOT / "tests" / "guest" / "installed_package.py"), str(package)]
    result = uml.run_in_guest(inner, cwd=ROOT, timeout_s=500, memory="2048M", systemd=True)
    print(result.stdout, result.stderr, f"guest: {result.total_s:.0f} s in all")
    assert result.status == 0, result.stdout + result.stderr + result.console[-2000:]
    assert result.stdout.splitlines()[-1].endswith("purged")
