"""Bench sessions begun in a browser: each in a process of its own, which is `highside calibrate bench --web`.

The page that begins them acquires nothing and holds nothing of them: it may end and come back, and finds them again.
"""

from __future__ import annotations

__all__ = ["children", "routes"]
"""the ways in: modules, loaded on request"""
