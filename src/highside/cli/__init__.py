"""The `highside` command: one file a group of commands, registered in `main`.

A command reads options, calls what is below (`highside.api` for everything that a program may do too), prints, and sets
the exit status. It imports neither numpy nor scipy; a contract says so.
"""

from __future__ import annotations

__all__ = ["main"]
"""the ways in: modules, loaded when they are asked for"""
