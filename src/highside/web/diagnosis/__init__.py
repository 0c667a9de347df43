"""A diagnosis in the browser: send a recording, see what its columns are taken for, confirm it, read the report.

For who has shown the page's token. `jobs` runs `highside import` and `highside diagnose` in a child process with limits
(`limited`), one at a time, in a folder of its own that goes with the job; `views` and `routes` are its pages, plain
HTML and one script that asks how it stands.
"""

from __future__ import annotations

__all__ = ["jobs", "routes"]
"""the ways in: modules, loaded on request"""
