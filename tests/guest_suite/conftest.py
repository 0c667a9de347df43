"""Tests that need root, a vcan interface or systemd. `tests/guest/test_guests.py` runs them, in a guest if need be.

Collected only where the runner says so: HIGHSIDE_VCAN=1 (vcan0 is up, this process may change interfaces and mount),
HIGHSIDE_SYSTEMD=1 (systemd is the first process, this process is root).
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

SYSTEMD_TESTS = "test_systemd"


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """Keep each file to the place it is made for."""
    if collection_path.suffix != ".py" or not collection_path.name.startswith("test_"):
        return None
    needs = "HIGHSIDE_SYSTEMD" if collection_path.name.startswith(SYSTEMD_TESTS) else "HIGHSIDE_VCAN"
    return None if os.environ.get(needs) == "1" else True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Everything here belongs to a guest."""
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.guest)
