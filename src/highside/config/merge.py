"""Tables of a configuration laid over one another."""

from __future__ import annotations

from typing import Any


def merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Tables laid over one another; one of another kind replaces what was there."""
    out = dict(below)
    for key, value in above.items():
        old = out.get(key)
        if isinstance(old, dict) and isinstance(value, dict) and value.get("kind") in (None, old.get("kind")):
            out[key] = merged(old, value)
        else:
            out[key] = value
    return out
