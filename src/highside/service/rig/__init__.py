"""What the daemon has around I and T for the rig: surveys, toolface offset, shock, WITS, metrics, announcement.

`rig.rig.Rig` holds it together. It takes what the pipeline has made, and nothing in it can hold that up.
"""

from __future__ import annotations

__all__ = ["home_assistant", "metrics", "rig", "shock", "surveys", "toolface", "wits"]
"""the ways in: modules, loaded on request"""
