"""The watch: does the calibration in force still hold, in the hole, without a bench and without a reference?

Theory. A corrected reading is `c = (1 + S) f + b` of the specific force `f` (the gravity direction, in g): where the
calibration holds, `S` and `b` are zero within the record's covariance. `parameters.py` says what else is unknown
(temperature coefficients, rectification, where the sensor sits, gravity, a bent collar). A hole gives two kinds of
evidence of them, and of both the attitude is unknown:

- a tool *at rest* gives one number, `|mean c| - 1` (`measurement.Still`);
- a tool that *turns* gives the first harmonics of the three axes on the phase of the gyro, with the accelerations that
  the turn itself makes fitted in the same window (`turning.py`); inclination and phase are projected out, seven to
  eleven numbers remain.

`bank.py` runs a Kalman filter on them, from the record's covariance, and beside it one column for each *hypothesis*
(a step of a bias, of an element of S, a drift, a coefficient) and each *onset*: how the innovations would look had it
happened then (Willsky and Jones, IEEE Trans. Automatic Control 21, 1976, 108). Twice the logarithm of the likelihood
ratio of each is two sums; the largest is held against one threshold. Hypotheses that explain the innovations within
`same_class` of the best are told as one class, never as a name.

The way in: `Watch` (`monitor.py`) takes measurements in the order of time and gives a `WatchResult` (`result.py`);
`rows.py` finds the measurements in a recording. No file, no clock, no link; the numbers that decide are in `policy.py`.
The watch never corrects anything.
"""

from highside.watch.measurement import Still, Turning
from highside.watch.monitor import Watch
from highside.watch.parameters import Prior, prior_of_record
from highside.watch.policy import POLICY, STATED, StatedNoise, WatchPolicy
from highside.watch.result import WatchClaim, WatchResult

__all__ = [
    "POLICY",
    "STATED",
    "Prior",
    "StatedNoise",
    "Still",
    "Turning",
    "Watch",
    "WatchClaim",
    "WatchPolicy",
    "WatchResult",
    "prior_of_record",
]
