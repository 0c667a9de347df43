"""Repeatability of the bench: where it stops is not exactly where its encoders say."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import Parameter, RandomEffect, Stage
from highside.physics.state import ChainState

LIMIT = (0.0, 0.02)


class PoseError(RandomEffect):
    """Uniform errors of given half-width, as a bench of finite steps makes them (a step of 0.018 deg: 0.009 deg).

    The inclination stage does not move between the poses of an inclination station, so these have an inclination
    error in common; the toolface encoder repeats itself, so a toolface station has a toolface error in common.
    """

    id = "pose_error"
    title = "Pose error of the bench"
    stage = Stage.NOISE
    draws_at = Stage.POSE
    formula = (
        "dI = U(inc_station) an inclination + U(inc_pose) a pose, dT = U(tf_station) a toolface + U(tf_pose) a pose"
    )
    story = (
        "The bench stops near, not at, the angle it shows: partly anew at each stop, partly the same for all "
        "poses at an inclination or at each return to a toolface."
    )
    parameters = (
        Parameter("inc_pose", "rad", 1.57e-4, LIMIT),
        Parameter("tf_pose", "rad", 1.57e-4, LIMIT),
        Parameter("inc_station", "rad", 1.57e-4, LIMIT, formerly="inc_ring"),
        Parameter("tf_station", "rad", 1.57e-4, LIMIT),
    )
    confused_with = ("reading_noise", "cogging")
    splitter = "repeat a pose without moving the table (noise) and after moving it (pose error)"

    def draw(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        inc_pose, tf_pose, inc_station, tf_station = p

        def per(group: AnyArray, half_width: float) -> AnyArray:
            _, index = np.unique(group, return_inverse=True)
            return half_width * rng.uniform(-1, 1, index.max(initial=-1) + 1)[index.reshape(-1)]

        inc = per(state.inclination_station, inc_station) + per(state.pose, inc_pose)
        tf = per(state.toolface_station, tf_station) + per(state.pose, tf_pose)
        return np.stack([inc, np.zeros(state.n), tf])


EFFECT = PoseError()
