"""Continuous rotations with known attitudes. Way in: `problem.RotationProblem.of` on `rows.session.RotationSession`.

Beyond what `rows` does: of a long recording some rows are diagnosed first and show what strong effects do beyond first
order (`pilot`); lines of fixed frequency or of an order of the rotation are found by Fourier transform and join the
candidates (`lines`); short bursts are looked for in the residual (`bursts`); a range of a covariate is found by inner
products of its cells (`support`); the proof is in means over sectors of the turn, as single rows are nearly all noise
(`means`); `advice` weighs which rates would distinguish two explanations.
"""

from __future__ import annotations

__all__ = ["policy", "problem"]
"""the ways in: modules, loaded when they are used"""
