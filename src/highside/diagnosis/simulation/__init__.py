"""A recording beside another program's prediction. The way in is `problem.SimulationProblem.beside`.

Time bases are brought together by cross-correlation (`alignment`), both sides put on one grid up to the frequency
that they share (`session`), unit, sign and axes checked (`intake`). No forward model is at hand, only its output s:
effects are columns made of s and of the covariates recorded (`design`), a delay is -t0 ds/dt, a lever arm
w x (w x r) + a x r. Which they are the effects of the library say themselves (`Effect.on_channels`). All of them are
linear, so claims are fitted in the inner products of `rows`.
"""

from __future__ import annotations

__all__ = ["intake", "policy", "problem", "session"]
"""the ways in: modules, loaded when they are used"""
