"""HTML reports, certificates, and the plots in them: answers in, one page out, without anything fetched."""

from __future__ import annotations

__all__ = ["certificate", "diagnosis_page", "rotation_page", "session_page"]
"""the ways in: modules, loaded when they are requested"""
