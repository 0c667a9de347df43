"""Beside a prediction: what is left of a recording, held beside the noise that sensors have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.simulation.band import humps, with_humps
from highside.diagnosis.simulation.independence import (
    NoNoise,
    hidden_motions,
    no_noise,
    with_hidden_motions,
    with_no_noise,
)
from highside.diagnosis.simulation.session import SimulationSession


class Beside(Protocol):
    """What is needed of a recording beside a prediction."""

    @property
    def session(self) -> SimulationSession: ...
    @property
    def noise(self) -> RotationNoise: ...


@dataclass(frozen=True)
class Seen:
    """What stands out of the noise: whether of a spectrum, and what no noise of sensors does."""

    humps: bool
    no_noise: NoNoise | None

    @property
    def any(self) -> bool:
        """Whether anything does."""
        return self.humps or self.no_noise is not None


def beside_noise_of_sensors(problem: Beside, diagnosis: DiagnosisResult, left: Array) -> tuple[DiagnosisResult, Seen]:
    """The diagnosis with what of that which base and claims leave (C, n) is no noise of sensors, and what that is."""
    session = problem.session
    found = humps(left, session.step_s, session.omitted, session.names, session.units)
    diagnosis, departs = with_humps(diagnosis, found), None
    if diagnosis.verdict == "nothing_left_out":
        departs = no_noise(left, white_of(problem, left), session.step_s, session.omitted, session.names)
        diagnosis = with_no_noise(diagnosis, departs, left, session.state.t_s, session.names)
        motions = hidden_motions(left, session.step_s, session.omitted, session.names)
        diagnosis = with_hidden_motions(diagnosis, motions)
    return diagnosis, Seen(bool(found), departs)


def white_of(problem: Beside, left: Array) -> Array:
    """(C, n) the same in units of the noise, whitened."""
    return np.asarray(problem.noise.white(left).reshape(left.shape))
