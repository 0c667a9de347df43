"""Is the recording what it claims to be? The way in is `checks.check`.

Detectors, no regressions: each counts something that a healthy recording does not have, and says how often chance
would make as much. Order and times of the frames (`clock`), single readings far off (`impulses`), stuck, swapped or
quantised channels (`checks`); poses that are clipped are left out, and named (`clipped`). What is refused here no fit
is required about: a fit gives any fault of the data the name of some effect and is very sure of it.
"""

from __future__ import annotations

__all__ = ["checks", "clipped", "clock", "impulses", "policy"]
"""the ways in: modules, loaded when they are used"""
