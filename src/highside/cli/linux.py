"""The service is for Linux; the desk and the bench are for any system."""

from __future__ import annotations

import sys

from highside.errors import InputError


def linux_alone(command: str) -> None:
    """Raises InputError elsewhere than on Linux."""
    if not sys.platform.startswith("linux"):
        raise InputError(
            f"`highside {command}` is of the service, which needs Linux",
            remedy="calibrate, diagnose, import and the others of the desk and the bench work here",
        )
