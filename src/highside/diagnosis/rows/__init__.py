"""What is looked at row by row, hundreds of thousands of them. The way in is `problem.RowsProblem`.

All tests and fits see a recording only through inner products of whitened columns. So the rows are passed through once,
in chunks (`design` makes the columns, of the functions in `bases`), and replaced by their Gram matrices (`gram`):
tests, choices and held-out errors need no more, and a random walk of an offset changes only the inner products of block
means. `noise` learns what whitens: autoregressive on each channel, its size following vibration, rate or time; `jitter`
is the one effect that is found in that size alone. Rotation and comparison with a simulation are both built on this.
"""

from __future__ import annotations

__all__ = ["policy", "problem", "session"]
"""the ways in: modules, loaded when they are used"""
