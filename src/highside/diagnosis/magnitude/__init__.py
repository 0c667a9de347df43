"""Sessions of unknown attitude, of which only |g| is known. The way in is `problem.MagnitudeProblem.of`.

A reading m of a sensor S at rest fulfils m = S(u) with |u| = 1. An error adds to the one number that is known its
component along n = J^-T u, J = dS/du, and what only turns the reading adds nothing (`observed`). So a session
(`session`) has one channel, candidates are projected (`candidates`), an interval holds all that stays open within the
plausible (`fit`), and a random walk of three offsets shows projected on the attitudes in which they act
(`projected_random_walk`).
"""

from __future__ import annotations

__all__ = ["policy", "problem", "session"]
"""the ways in: modules, loaded when they are used"""
