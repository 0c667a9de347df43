"""Where things are kept when no configuration says where: in the user's own folders, not in a checkout and not beside
a configuration file, whose folder may be read-only, shared or packed up with what lies in it.

On Linux these are `~/.local/share/highside` (`$XDG_DATA_HOME`) for what is worth keeping, calibrations and the journals
of sessions, and `~/.local/state/highside` (`$XDG_STATE_HOME`) for what a service needs to go on.
"""

from __future__ import annotations

from pathlib import Path

from platformdirs import user_data_path, user_state_path

NAME = "highside"


def calibrations() -> Path:
    """The calibration store of bench sessions."""
    return user_data_path(NAME, appauthor=False) / "calibrations"


def sessions() -> Path:
    """The journals of bench sessions."""
    return user_data_path(NAME, appauthor=False) / "sessions"


def service_state(tool_id: str) -> Path:
    """Outbox, recordings and logs of the service of one tool; several tools of one user do not share them."""
    return user_state_path(NAME, appauthor=False) / tool_id


def acts() -> Path:
    """The journal of what signed-in people did at the pages."""
    return user_state_path(NAME, appauthor=False) / "acts.jsonl"


def bench_pages() -> Path:
    """What is known of bench sessions that were begun at a page."""
    return user_state_path(NAME, appauthor=False) / "bench-pages"


def left_behind(earlier: Path, now: Path, field: str) -> str | None:
    """A word about what an earlier version, whose default was the directory `earlier`, has kept there; None if nothing
    or if it is the one in use."""
    was = earlier.resolve()
    if was == now.resolve() or not was.is_dir() or not any(was.iterdir()):
        return None
    return f'{was} holds what was kept there before; to go on with it give {field} = "{was}"'
