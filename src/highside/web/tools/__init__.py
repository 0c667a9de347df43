"""The tools' page: what every tool at a broker reports, in a browser, all day. `highside serve`; needs the extra `web`.

It subscribes to the broker as any other reader does, in a process of its own: what is looked at here cannot slow
acquisition. `state` collects what the tools publish (pure), `listener` connects it with the broker, `views` and
`drawings` make what a page shows of it, `pages` the pages, `server` serves them.
"""

from __future__ import annotations

__all__ = ["listener", "server", "state", "views"]
"""the ways in: modules, loaded on request"""
