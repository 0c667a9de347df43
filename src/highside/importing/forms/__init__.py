"""Forms of files, one module each: bytes in, tables of named columns out. `registry` knows all of them."""

from __future__ import annotations

__all__ = ["registry"]
"""the way in: a module, loaded on request"""
