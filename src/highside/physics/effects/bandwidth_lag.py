"""First-order lag of the accelerometers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import TIMED, Channels, ChannelTerm, lagged
from highside.physics.effect import Effect, Parameter, Stage
from highside.physics.gravity import gravity_direction, gravity_jacobians
from highside.physics.state import ChainState

# a first-order lag is the average of the past under exp(-u), u in units of tau: Gauss-Laguerre nodes and weights
FEW, MANY, PAST = (list(zip(*np.polynomial.laguerre.laggauss(count), strict=True)) for count in (4, 12, 32))
LAGS_S = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Time constants tried on channels beside another program's prediction."""
LITTLE = 0.05
"""Turn within tau, in rad, up to which four nodes err by less than 1e-12."""


def _nodes(state: ChainState, tau: complex) -> Sequence[tuple[float, float]]:
    """Nodes and weights that the fastest turn needs."""
    fastest = max(float(np.abs(rate).max(initial=0.0)) for rate in (state.rotor_rate_radps, state.inc_rate_radps))
    return FEW if abs(tau) * fastest < LITTLE else MANY


def _gravity_before(state: ChainState, seconds: AnyArray) -> AnyArray:
    """Gravity in the tool frame, (3, N), so many seconds earlier, by the recorded rates."""
    tf = state.tf_rad - state.rotor_rate_radps * seconds + 0.5 * state.rotor_accel_radps2 * seconds**2
    return gravity_direction(state.inc_rad - state.inc_rate_radps * seconds, tf)


class BandwidthLag(Effect):
    id = "bandwidth_lag"
    title = "Bandwidth lag"
    stage = Stage.KINEMATIC
    formula = "tau df_out/dt = f - f_out: at a steady rate a gain of 1/sqrt(1 + (w tau)^2) and a phase of -atan(w tau)"
    story = (
        "The accelerometers answer with a delay and a loss of amplitude, as any filter of finite bandwidth: the faster "
        "the tool turns, the more."
    )
    parameters = (Parameter("tau", "s", 2e-3, (0.0, 0.1)),)
    confused_with = ("time_offset", "encoder_first_harmonic", "sampling_jitter")
    splitter = (
        "ramps of the gyro (they have no accelerometer lag) and the loss of swing, which goes as the square of the rate"
    )
    needs = ("rotor_rate_radps",)
    depends_on_input = False
    channel_story = "The channel answers with a delay and a loss of amplitude, as any filter of finite bandwidth."

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        nominal = gravity_direction(state.inc_rad, state.tf_rad)
        lagged = sum(w * _gravity_before(state, p[0] * u) for u, w in _nodes(state, p[0]))
        return np.asarray(lagged - nominal)

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        tau = float(np.real(p[0]))
        total = np.zeros((3, state.n))
        # at tau = 0 all nodes are the present instant, and their weighted mean is 1
        nodes = _nodes(state, tau) if tau else [(1.0, 1.0)]
        for u, w in nodes:
            seconds = tau * u
            tf = state.tf_rad - state.rotor_rate_radps * seconds + 0.5 * state.rotor_accel_radps2 * seconds**2
            by_inc, by_tf = gravity_jacobians(state.inc_rad - state.inc_rate_radps * seconds, tf)
            rate = state.rotor_rate_radps - state.rotor_accel_radps2 * seconds
            total -= w * u * (by_inc * state.inc_rate_radps + by_tf * rate)
        return total[None]

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        # each kind of channel answers slowly for itself; the lag is not linear in its time
        kinds = data.kinds()
        about = data.about.get(self.id, ())
        tried = [(tau,) * len(kinds) for tau in LAGS_S if data.step_s / 3 < tau < 0.2 * data.n * data.step_s]
        if any(about):
            tried = [tuple(tau or data.step_s for tau in about)]
        # of a time constant far below the step a lag shows as a delay: what it is to first order is tried too
        sets = [] if any(about) or not tried else [[-data.slope for _ in kinds]]
        sets += [[_behind(data, tau) for tau in taus] for taus in tried]
        channels = np.arange(len(data.names))[:, None]
        of_kind = [np.isin(channels, own) for own in kinds.values()]
        columns = [
            np.stack([np.where(own, rows, 0.0) for rows, own in zip(made, of_kind, strict=True)]) for made in sets
        ]
        parameters = tuple(Parameter(f"tau_{kind.replace('/', '_')}", "s", 1e-3, (0.0, 3.0)) for kind in kinds)
        return [ChannelTerm(parameters, tuple(columns), (TIMED, 0, 1), relinearised=True)] if columns else []


def _behind(data: Channels, tau: float) -> AnyArray:
    """(C, n) what a lag changes, for each second of its time constant."""
    if tau > data.step_s / 3:
        return np.stack([lagged(s, data.step_s, tau) for s in data.predicted])
    # a filter that goes on rising up to the edge of the band rings with what is unknown beyond the rows' ends: instead
    # the mean of what the prediction says of the past
    later = data.later_s
    past = sum(w * data.at(later + tau * u) for u, w in PAST)
    return np.asarray((past - data.at(later)) / tau)


EFFECT = BandwidthLag()
