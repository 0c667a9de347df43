"""Stepped sessions with known attitudes. The way in is `problem.PoseProblem.of` on a `session.PoseSession`.

Rows become one mean a stop (`session`). Few numbers and many candidates: columns are kept whole. The noise (`noise`)
is of two kinds, the sensors' and the bench's: an error of a set angle moves three channels together along the
tangents of the sphere, so a covariance for each pose is fitted by likelihood, from what no candidate explains.
"""

from __future__ import annotations

__all__ = ["policy", "problem", "session"]
"""the ways in: modules, loaded when they are used"""
