"""The service's configuration in the browser: shown, edited, checked, compared with what is in force, saved whole."""

from __future__ import annotations

__all__ = ["proposal", "routes"]
"""the ways in: modules, loaded on request"""
