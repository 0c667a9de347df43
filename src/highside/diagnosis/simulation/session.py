"""A recording beside another program's prediction of it: common channels on one grid of times, up to one frequency.

The prediction is the reference. Both sides are low-passed and sampled on a common grid just fine enough for what the
prediction contains: above that, it has nothing to say. What the recording knows beside the channels (rates, speed,
temperature) are the covariates that effects are made of.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.rows.policy import GRAMS
from highside.diagnosis.rows.session import RotationSession
from highside.diagnosis.simulation.alignment import Align, Alignment, align, filled, in_gap, usual_rate
from highside.diagnosis.simulation.policy import SIMULATION_SESSIONS
from highside.diagnosis.simulation.prediction import Prediction, at_ends, is_low_passed, settled_s, smoothed
from highside.diagnosis.simulation.turning import angular_acceleration, noise_of_rate
from highside.errors import InputError
from highside.physics.channels import Channels
from highside.physics.effects.clock_skew import EFFECT as CLOCK_SKEW
from highside.physics.effects.time_offset import EFFECT as TIME_OFFSET
from highside.physics.state import ChainState

UNITS = {
    "g": "g",
    "dps": "deg/s",
    "mps2": "m/s2",
    "mps": "m/s",
    "deg": "deg",
    "radps": "rad/s",
    "rad": "rad",
    "mm": "mm",
    "arcmin": "arcmin",
    "c": "C",
}
NO_CHANNELS = frozenset({"t_s", "seq", "pose", "direction", "temp_c", "noise_g", "vibration_rms_g"})
RATES = ("gx_dps", "gy_dps", "gz_dps")
SENSORS = frozenset({"ax_g", "ay_g", "az_g", *RATES})
SPEED = "speed_mps"

OFFSET, SKEW = TIME_OFFSET.id, CLOCK_SKEW.id
"""The effects that move the clock of the prediction."""


@dataclass(frozen=True)
class SimulationSession(RotationSession):
    """n rows on a common grid: `readings` (C, n) and `predicted` (C, n) of the channels `names`, in their units.

    `rates` {axis: (n,) rad/s}, `speed` (n,) m/s and the temperature in `state` are covariates; None or absent where
    not recorded.
    """

    names: tuple[str, ...] = ()
    original: Array = field(default_factory=lambda: np.empty((0, 0)))
    """(C, n) what is predicted at the times as they are"""
    predicted: Array = field(default_factory=lambda: np.empty((0, 0)))
    """(C, n) what is predicted at the times `later_s` earlier"""
    rates: Mapping[str, Array] = field(default_factory=dict)
    speed: Array | None = None
    alignment: Alignment = field(default_factory=lambda: Alignment(0.0, 0.0, 1.0, True))
    band_hz: float = 0.0
    prediction: Prediction | None = None
    later_s: Array | float = 0.0
    """(n,) how much later the recording is taken to show what the prediction shows"""
    low_passed: bool = False
    """whether the grid is coarser than the rows of the recording, which were low-passed for it"""
    always_lost: NDArray[np.bool_] | None = None
    """(n,) rows left out wherever the clock is moved"""
    rate_noise: Mapping[str, float] = field(default_factory=dict)
    """{axis: (rad/s)^2 / Hz} of the noise of the rates"""

    @property
    def shortest_block_s(self) -> float:
        # what the filter has is learned beside few functions; in shorter blocks a level takes part of a motion
        return GRAMS.block_s

    @property
    def elapsed_s(self) -> Array:
        """(n,) since the first row."""
        return np.asarray(self.state.t_s - self.state.t_s[:1])

    def about(self, where: Mapping[str, tuple[float, ...]]) -> Self:
        """The session with the prediction's clock moved as `where` says of the effects that move it."""
        (offset_s,), (rate,) = where.get(OFFSET, (0.0,)), where.get(SKEW, (0.0,))
        later = offset_s + rate * self.elapsed_s
        if self.prediction is None or np.array_equal(later, np.broadcast_to(self.later_s, later.shape)):
            return self
        times = self.state.t_s - later
        lost = self.prediction.lost(times)
        lost = _smeared(lost, self.band_hz * self.step_s)
        if self.always_lost is not None:
            lost |= self.always_lost
        predicted = self.prediction.at(times)
        own = dict(zip(self.names, predicted, strict=True))
        rates = {**self.rates, **{name[1]: np.radians(own[name]) for name in RATES if name in own}}
        return replace(
            self,
            predicted=predicted,
            rates=rates,
            speed=own.get(SPEED, self.speed),
            omitted=lost if lost.any() else None,
            later_s=later,
        )

    @property
    def channels(self) -> tuple[str, ...]:
        return self.names

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each channel, from its name."""
        return tuple(unit_of(name) for name in self.names)

    @cached_property
    def rate_group(self) -> NDArray[np.intp]:
        return np.full(self.n, -1, dtype=np.intp)

    def as_channels(self, about: Mapping[str, tuple[float, ...]]) -> Channels:
        """The channels as effects see them; `about`: where those that are not linear are taken."""
        return Channels(
            self.names,
            self.units,
            self.readings,
            self.predicted,
            self.state.t_s,
            self.step_s,
            self.rates,
            self.speed,
            self.state.temp_c if self.warm else None,
            self.alignment.same_clock,
            about,
            self.slope,
            self.predicted_later,
            self.risen,
            self.alignment.in_time(self.names),
            {
                axis: angular_acceleration(r, self.step_s, self.rate_noise.get(axis, 0.0))
                for axis, r in self.rates.items()
            },
            self.predicted_through,
        )

    def risen(self, since_s: float) -> Array:
        """(n,) what a unit step of the recording becomes on the grid, so many seconds after its first row."""
        elapsed = self.elapsed_s - since_s
        if not self.low_passed:
            return np.asarray(elapsed >= 0.0, dtype=float)
        periods, response = _step_response()
        return np.asarray(np.interp(elapsed * self.band_hz, periods, response))

    @property
    def slope(self) -> Array:
        """(C, n) change of what is predicted, per second."""
        if self.prediction is None:
            return np.asarray(np.gradient(self.predicted, self.step_s, axis=1))
        return self.prediction.slope(self.state.t_s - self.later_s)

    def predicted_later(self, later_s: Array) -> Array:
        """(C, n) what is predicted at times so much earlier."""
        return self.original if self.prediction is None else self.prediction.at(self.state.t_s - later_s)

    def predicted_through(self, function: Callable[[Array], Array]) -> Array:
        """(K, n) what a function of the predicted channels, (C, N) to (K, N), is on the grid: its harmonics are cut off
        as the recording's are, and not those that what was cut off already would have."""
        if self.prediction is None or not self.low_passed:
            return function(self.predicted)
        return self.prediction.through(function).at(self.state.t_s - self.later_s)

    @property
    def warm(self) -> bool:
        """Whether the temperature was recorded and changes."""
        return bool(np.ptp(self.state.temp_c) > SIMULATION_SESSIONS.warm_span_c)


def unit_of(name: str) -> str:
    """Unit of a column, from the end of its name; "1" where that says nothing."""
    return UNITS.get(name.rpartition("_")[2], "1")


def simulation_session(
    columns: Mapping[str, Array], predicted: Mapping[str, Array], align_by: Align = "auto"
) -> SimulationSession:
    """Put a recording and a prediction (columns (N,), each with its own `t_s`) together.

    Raises InputError that says what the files lack.
    """
    names = _common_channels(columns, predicted)
    t_s, t_sim = np.asarray(columns["t_s"]), np.asarray(predicted["t_s"])
    _require_rising(t_s, "recording")
    _require_rising(t_sim, "prediction")
    side = {n: _turned(n, columns[n]) for n in names}
    side_sim = {n: _turned(n, predicted[n]) for n in names}
    found = align(t_s, side, t_sim, side_sim, align_by)
    t_sim = t_sim + found.shift_s
    raw_hz = min(usual_rate(t_s), usual_rate(t_sim))
    grid, grid_hz = _common_grid(t_s, side, t_sim, side_sim, found, raw_hz)
    band_hz = SIMULATION_SESSIONS.band * grid_hz

    def sampled(times: Array, values: Array) -> Array:
        return _sampled(grid, times, values, band_hz, raw_hz)

    longest = SIMULATION_SESSIONS.gap_steps / raw_hz
    measured = np.stack([sampled(t_s, side[n]) for n in names])
    # where the recording shows the motion slower, the same parts of it lie higher in the prediction's own time
    prediction = Prediction.of(t_sim, [side_sim[n] for n in names], band_hz / (1.0 - found.rate), raw_hz, longest)
    model = prediction.at(grid)
    _refuse_copies(names, measured, np.stack([sampled(t_sim, side_sim[n]) for n in names]))
    for c in (c for c, name in enumerate(names) if unit_of(name) == "deg"):
        # whole turns apart is not apart
        measured[c] -= 360.0 * np.round(np.median(measured[c] - model[c]) / 360.0)
    missing = in_gap(grid, t_s, [side[n] for n in names], longest) | prediction.lost(grid)
    lost = _smeared(missing | at_ends(grid, t_s, settled_s(t_s, band_hz, raw_hz)), SIMULATION_SESSIONS.band)
    own = dict(zip(names, model, strict=True))
    # a covariate that is a channel itself is taken as predicted: the recorded one would explain itself
    covariates = {n: own[n] if n in own else sampled(t_s, columns[n]) for n in _covariates(names, columns)}
    rates = {name[1]: np.radians(covariates[name]) for name in RATES if name in covariates}
    temp = sampled(t_s, columns["temp_c"]) if _recorded(columns, "temp_c") else SIMULATION_SESSIONS.room_c
    nothing = np.zeros(grid.size)
    state = ChainState.build(
        nothing, nothing, t_s=grid, temp_c=temp, row_seconds=1 / grid_hz, vibration_rms_g=_activity(model, rates)
    )
    omitted = lost if lost.any() else None
    return SimulationSession(
        measured,
        state,
        omitted,
        names,
        model,
        model,
        rates,
        covariates.get(SPEED),
        found,
        band_hz,
        prediction,
        low_passed=is_low_passed(t_s, band_hz, raw_hz),
        always_lost=omitted,
        rate_noise=_noise_of_rates(covariates, (t_s, columns), (t_sim, side_sim), band_hz),
    )


def _covariates(names: Sequence[str], columns: Mapping[str, Array]) -> list[str]:
    """Rates and speed, as far as they are channels or were recorded."""
    return [name for name in (*RATES, SPEED) if name in names or _recorded(columns, name)]


def _noise_of_rates(
    covariates: Mapping[str, Array],
    recorded: tuple[Array, Mapping[str, Array]],
    predicted: tuple[Array, Mapping[str, Array]],
    band_hz: float,
) -> dict[str, float]:
    """{axis: (rad/s)^2 / Hz} of the rates among the covariates: of the prediction where they are channels."""
    found = {}
    for name in (name for name in RATES if name in covariates):
        t_s, columns = predicted if name in predicted[1] else recorded
        found[name[1]] = noise_of_rate(t_s, np.radians(columns[name]), band_hz)
    return found


def _require_rising(t_s: Array, what: str) -> None:
    """Raises InputError for times (n,) that are too few, or do not rise."""
    if t_s.size < SIMULATION_SESSIONS.least_side or np.any(np.diff(t_s) < 0):
        raise InputError(f"the times of the {what} are too few, or do not rise", field="t_s")


def _common_channels(columns: Mapping[str, Array], predicted: Mapping[str, Array]) -> tuple[str, ...]:
    """The channels that both have. What the prediction repeats to the bit is what it was made from and handed on, as by
    `highside predict`: no channel, unless sensors read it. Raises InputError where there is none."""

    def repeated(n: str) -> bool:
        return n not in SENSORS and np.array_equal(columns[n], predicted[n], equal_nan=True)

    names = tuple(
        n
        for n in columns
        if n in predicted
        and n not in NO_CHANNELS
        and not (np.isnan(columns[n]).all() or np.isnan(predicted[n]).all() or repeated(n))
    )
    if not names:
        has = ", ".join(n for n in predicted if n not in NO_CHANNELS) or "none"
        raise InputError("has no channel that the recording has too", remedy=f"its channels are: {has}")
    return names


def _recorded(columns: Mapping[str, Array], name: str) -> bool:
    return name in columns and not np.isnan(columns[name]).all()


def _common_grid(
    t_s: Array,
    side: Mapping[str, Array],
    t_sim: Array,
    side_sim: Mapping[str, Array],
    found: Alignment,
    raw_hz: float,
) -> tuple[Array, float]:
    """Times (n,) where both sides lie over one another, and how many a second: rows of the recording as they are, where
    they are as many as are wanted. Raises InputError where they are too few."""
    policy = SIMULATION_SESSIONS
    start, stop = max(t_s[0], t_sim[0]), min(t_s[-1], t_sim[-1])
    start = float(t_s[np.searchsorted(t_s, start)])
    lag_s, rate = (found.lag_s, found.rate) if found.same_clock else (0.0, 0.0)
    band = _band(t_s, side, t_sim + lag_s + rate * (t_sim - start), side_sim, (start, stop))
    length = max(stop - start, 1e-9)
    least, most = policy.least_rows / length, min(raw_hz, policy.most_rows / length)
    grid_hz = float(min(max(policy.per_band * band, least), most))
    if (stop - start) * grid_hz < policy.least_rows / 2:
        raise InputError(
            f"only {stop - start:.3g} s of recording and prediction lie over one another",
            remedy=f"give at least {policy.least_rows / 2 / raw_hz:.3g} s",
        )
    return np.arange(start, stop, 1 / grid_hz), grid_hz


def _smeared(lost: NDArray[np.bool_], band: float) -> NDArray[np.bool_]:
    """Rows (n,) that are lost, and those about them: a low-pass, at this share of the rate, smears what was bridged."""
    reach = max(1, round(1.0 / band))
    return np.asarray(np.convolve(lost, np.ones(2 * reach + 1), mode="same") > 0.5)


def _refuse_copies(names: tuple[str, ...], measured: Array, model: Array) -> None:
    """A recording has noise of its own: a prediction (C, N) that equals it but for an offset and a factor was made from
    it. Raises InputError with its name."""
    for name, own, other in zip(names, measured, model, strict=True):
        own, other = own - own.mean(), other - other.mean()
        power = float(other @ other)
        left = own - (float(own @ other) / power if power > 0.0 else 0.0) * other
        if float(own @ own) > 0.0 and float(left @ left) <= SIMULATION_SESSIONS.copy**2 * float(own @ own):
            raise InputError(
                "is the recording itself, to rounding: there is no noise that a difference could stand out of",
                field=name,
                remedy="give what the simulation predicts, or leave the column out",
            )


def _turned(name: str, values: Array) -> Array:
    """Angles that go on beyond a full turn."""
    if unit_of(name) != "deg":
        return np.asarray(values, dtype=float)
    result = np.array(values, dtype=float)
    good = ~np.isnan(result)
    result[good] = np.unwrap(result[good], period=360.0)
    return result


def _band(
    t_s: Array, side: Mapping[str, Array], t_sim_s: Array, side_sim: Mapping[str, Array], span: tuple[float, float]
) -> float:
    """Frequency up to which recording and prediction have something in common, on any channel.

    Above, each has noise of its own and the prediction nothing to say. It is where the power of the prediction ends, or
    where the two cease to be coherent, if that comes first.
    """
    from scipy.signal import coherence

    raw_hz = min(usual_rate(t_s), usual_rate(t_sim_s))
    times = np.arange(*span, 1 / raw_hz)
    length = min(times.size // SIMULATION_SESSIONS.segments, round(SIMULATION_SESSIONS.segment_s * raw_hz))
    band = 0.0
    for name, values in side_sim.items():
        series = filled(times, t_sim_s, values)
        power = np.abs(np.fft.rfft((series - series.mean()) * np.hanning(series.size))) ** 2
        if (
            power.sum() <= SIMULATION_SESSIONS.constant * max(float(series @ series), 1e-300)
            or np.nanstd(side[name]) == 0
        ):
            continue
        content = (
            int(np.searchsorted(np.cumsum(power), SIMULATION_SESSIONS.content * power.sum())) * raw_hz / series.size
        )
        frequency, shared = coherence(filled(times, t_s, side[name]), series, fs=raw_hz, nperseg=length)
        octave = np.array([shared[(frequency > f / 2) & (frequency <= f)].mean() if f > 0 else 1.0 for f in frequency])
        common = float(frequency[np.flatnonzero(octave >= SIMULATION_SESSIONS.coherent)[-1]])
        band = max(band, min(content, common))
    return band


def _activity(model: Array, rates: Mapping[str, Array]) -> Array:
    """(n,) how much it moves, of mean square 1: what goes wrong in motion scatters with it, as with vibration."""
    moving = np.stack(list(rates.values())) if rates else np.gradient(model, axis=1)
    size = moving.std(axis=1, keepdims=True)
    square = np.sum((moving / np.where(size > 0, size, 1.0)) ** 2 if not rates else moving**2, axis=0)
    return np.asarray(np.sqrt(square / max(float(square.mean()), 1e-30)))


@cache
def _step_response() -> tuple[Array, Array]:
    """Times in periods of the edge of the band, and what the low-pass of `smoothed` makes of a unit step at zero."""
    from scipy.signal import butter, sosfiltfilt

    reach, per_period = SIMULATION_SESSIONS.step_reach, SIMULATION_SESSIONS.step_rows
    periods = np.arange(-reach * per_period, reach * per_period + 1) / per_period
    step = np.where(periods == 0.0, 0.5, periods > 0.0)
    return periods, np.asarray(sosfiltfilt(butter(4, 1.0, fs=per_period, output="sos"), step))


def _sampled(grid: Array, t_s: Array, values: Array, band_hz: float, raw_hz: float) -> Array:
    """Values on the grid, low-passed where that is coarser than the rows."""
    from scipy.interpolate import CubicSpline

    times, smooth = smoothed(t_s, values, band_hz, raw_hz)
    if not is_low_passed(t_s, band_hz, raw_hz):
        # noise and all: a curve would swing between rows that are near one another
        return np.asarray(np.interp(grid, times, smooth))
    return np.asarray(CubicSpline(times, smooth)(grid))
