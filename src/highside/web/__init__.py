"""The bench page: one session in a browser, for a technician two metres away. Needs the extra `web`."""

from __future__ import annotations

__all__ = ["front", "page", "server"]
"""the ways in: modules, loaded on request"""
