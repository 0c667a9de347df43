"""Gyro drift from gravity: the paper's algorithm to the letter, a complementary filter, and the error-state filter.

Recordings come in the tool frame and leave in it; inside, the equations use the body frame of the paper (`frames`). The
methods `literal` and `literal_block` are equations (7) to (12) (`gyro/literal.py`); `recursive` is a Mahony (PI)
complementary filter with derived gains (`gyro/complementary.py`); `kinematic` the error-state Kalman filter with
zero-rate updates and the Earth's rotation (`gyro/filter.py`, over a recording `gyro/recording_filter.py`; its equations
in `filter_state`, `time_update`, `measurements` and `stop_test`). Every result says where its azimuth comes from
(`result.AzimuthBasis`): gravity alone gives none to a tool that does not turn.
"""

from __future__ import annotations

__all__ = ["checks", "complementary", "filter", "follow", "frames", "gates", "literal", "recording_filter", "result"]
"""the ways in: modules, loaded when they are requested"""
