"""Named people at the pages: who signs in, what each may do, and the journal of what was done.

With `[web] users` every page wants a person; without it the pages are as open as they were, and commands need the
token. `people` is what the host asks, `routes` the pages for signing in and out, `acts` the journal; `attempts`,
`sessions` and `passwords` are what they rest on.
"""

from __future__ import annotations

__all__ = ["people", "routes"]
"""the ways in: modules, loaded on request"""
