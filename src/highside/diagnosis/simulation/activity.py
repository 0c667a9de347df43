"""Noise beside a prediction whose size follows how much it moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.simulation.design import SimulationDesign
from highside.diagnosis.simulation.policy import SIMULATION_CHOICE


def by_activity(design: SimulationDesign, noise: RotationNoise, residual: Array) -> RotationNoise:
    """The noise with its size following how much it moves, in whatever way: by bins of activity."""
    session = design.session
    activity = session.state.vibration_rms_g
    order = np.argsort(activity, kind="stable")
    bins = np.array_split(order, max(1, min(SIMULATION_CHOICE.most_bins, session.n // SIMULATION_CHOICE.least_in_bin)))
    weight = noise.weight.copy()
    for c, functions in enumerate(design.functions(slice(0, session.n), residual, design.before_noise)):

        def left(c: int = c, functions: Array = functions) -> Array:
            white = replace(noise, weight=weight).whiten(c, functions, slice(0, session.n))
            explained = np.linalg.lstsq(white[:-1].T, white[-1], rcond=1e-9)[0]
            return np.asarray(white[-1] - explained @ white[:-1])

        for _ in range(2):
            innovations, counts = left(), weight[c] > 0
            full = [
                rows[counts[rows]]
                for rows in bins
                if counts[rows].sum() > SIMULATION_CHOICE.least_in_bin // SIMULATION_CHOICE.full
            ]
            if len(full) < SIMULATION_CHOICE.least_bins:
                break
            sizes = [float(np.sqrt(np.mean(innovations[rows] ** 2))) for rows in full]
            middles = [float(activity[rows].mean()) for rows in full]
            weight[c] /= np.maximum(np.interp(activity, middles, sizes), SIMULATION_CHOICE.quietest * max(sizes))
        innovations = left()
        freedom = int(np.sum(weight[c] > 0)) - design.before_noise[c].size
        weight[c] *= np.sqrt(freedom / max(float(innovations @ innovations), 1e-300))
    return replace(noise, weight=weight)
