"""Gyro drift from gravity: the paper's algorithm to the letter, a light filter, and the error-state filter to trust.

Recordings come in the tool frame and leave in it; inside, the equations use the body frame of the paper (`frames`).
`literal` and `literal_block` are equations (7) to (12); `recursive` a PI loop with derived gains; `kinematic` the
filter on gravity kinematics, with zero-rate updates, the Earth's rotation and an honest covariance. Every result says
where its azimuth comes from (`result.AzimuthBasis`): gravity alone gives none to a tool that does not turn.
"""

from __future__ import annotations

__all__ = ["checks", "filter", "follow", "frames", "gates", "kinematic", "literal", "recursive", "result"]
"""the ways in: modules, loaded when they are asked for"""
