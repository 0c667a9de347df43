"""Sessions of unknown attitude, of which only |g| is known. The way in is `scene.MagnitudeScene.of`.

A reading m of a sensor S at rest fulfils m = S(u) with |u| = 1. An error adds to the one number that is known its
component along n = J^-T u, J = dS/du, and what only turns the reading adds nothing (`observed`). So a session
(`session`) has one channel, candidates are projected (`candidates`), an interval holds all that stays open within the
plausible (`fit`), and a walk of three offsets is seen through the attitudes in which they act (`directed_walk`).
"""

from __future__ import annotations

__all__ = ["policy", "scene", "session"]
"""the ways in: modules, loaded when they are asked for"""
