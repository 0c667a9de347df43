"""What a law may depend on: one function for each name, of the chain's state and the load on the triad.

`COVARIATES` is the one place in which a name is added; it lists some of the temperatures that lag and knows every whole
number of seconds (`temp_filtered_613`). A name that stands not in it is a numeric column of the
recording (`ChainState.extra`). Angles are in degrees, rates in deg/s, the load in g, time in s since the first row.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import AnyArray
from highside.errors import InputError
from highside.physics.memory import low_pass
from highside.physics.state import ChainState
from highside.words import said

OWN = -1
"""axis of a channel that is not one of the triad"""
LAGS_S = (60, 90, 130, 200, 300, 450, 650, 900, 1200, 1800, 2700, 4000)
"""Time constants of a temperature that lags, s: each about 1.5 times the one before, so that none is off by more than a
quarter. Source: chosen; from a sensor in its housing to a bench in a room. Between these it is estimated of a law that
was found"""
STATION_DEG = 0.25
"""Change of the inclination from pose to pose from which the table stands at another station, deg. Source: chosen; set
angles of a station are off by hundredths of it, stations are degrees apart"""
LAGGING_NAME = re.compile(r"temp_filtered_([1-9]\d{0,5})")


@dataclass(frozen=True, slots=True)
class Covariate:
    """A quantity that varies: its unit, and its values (n,) from (state, load (3, n) g, axis 0 to 2 or `OWN`).

    `periodic`: it is an angle that comes round after 360. `own`: it differs from axis to axis. `history`: it depends on
    the rows before. `clock`: it needs the time of each row.
    """

    unit: str
    title: str
    of: Callable[[ChainState, AnyArray, int], AnyArray]
    periodic: bool = False
    own: bool = False
    history: bool = False
    clock: bool = False


def _own_load(state: ChainState, load: AnyArray, axis: int) -> AnyArray:
    return load[axis] if axis != OWN else np.zeros(state.n)


def _on_axis(axis: int) -> Callable[[ChainState, AnyArray, int], AnyArray]:
    return lambda state, load, own: load[axis]


def _since_move(state: ChainState, load: AnyArray, axis: int) -> AnyArray:
    """Time since the pose of a row began, s."""
    if not state.n:
        return np.zeros(0)
    begins = np.flatnonzero(np.diff(state.pose, prepend=state.pose[0] - 1))
    length = np.diff(np.append(begins, state.n))
    return np.asarray(state.t_s - np.repeat(state.t_s[begins], length))


def _previous_load(state: ChainState, load: AnyArray, axis: int) -> AnyArray:
    """Load on the own axis in the pose before; in the first one its own."""
    if not state.n:
        return np.zeros(0)
    begins = np.flatnonzero(np.diff(state.pose, prepend=state.pose[0] - 1))
    length = np.diff(np.append(begins, state.n))
    own = _own_load(state, load, axis)
    first = np.real(own)[begins]
    return np.repeat(np.concatenate([first[:1], first[:-1]]), length)


def _over_turns(state: ChainState, load: AnyArray, axis: int) -> AnyArray:
    """(n,) toolface, deg, of a table that goes on past 360. In motion its turns are counted. From pose to pose at a
    station it goes the short way, and is turned back before the next, unless toolfaces beyond a turn were written down.

    Of a whole session: rows that begin within a station lack the turns before them.
    """
    degrees = np.asarray(np.degrees(state.tf_rad))
    begins = np.flatnonzero(np.diff(state.pose, prepend=state.pose[:1] - 1))
    if begins.size < 2 or float(np.ptp(degrees)) > 360.0:
        return degrees
    inc, set_to = np.degrees(state.inc_rad)[begins], degrees[begins]
    stations = np.split(np.arange(begins.size), 1 + np.flatnonzero(np.abs(np.diff(inc)) > STATION_DEG))
    turned = np.concatenate([np.unwrap(set_to[one], period=360.0) for one in stations]) - set_to
    return np.asarray(degrees + np.repeat(turned, np.diff(np.append(begins, state.n))))


def lag_of(name: str) -> int:
    """Time constant, s, of a covariate that is a temperature that lags; 0 of every other."""
    found = LAGGING_NAME.fullmatch(name)
    return int(found[1]) if found else 0


def lagging_name(lag_s: int) -> str:
    """Name of the temperature that lags by so many seconds."""
    return f"temp_filtered_{lag_s}"


def _lagging(lag_s: int) -> Covariate:
    return Covariate(
        "C",
        said("temperature that lags by %(lag)s s", lag=lag_s),
        lambda state, load, axis: low_pass(state.t_s, np.asarray(state.temp_c, dtype=float), float(lag_s)),
        history=True,
        clock=True,
    )


class _Covariates(Mapping[str, Covariate]):
    """Covariates by name: those that are listed; and temperatures of any lag, which are known and not listed."""

    def __init__(self, listed: Mapping[str, Covariate]) -> None:
        self._listed = listed

    def __getitem__(self, name: str) -> Covariate:
        if name not in self._listed and (lag := lag_of(name)):
            return _lagging(lag)
        return self._listed[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._listed)

    def __len__(self) -> int:
        return len(self._listed)


COVARIATES: Mapping[str, Covariate] = _Covariates({
    "load": Covariate("g", "load on the own axis", _own_load, own=True),
    "load_x": Covariate("g", "load on x", _on_axis(0)),
    "load_y": Covariate("g", "load on y", _on_axis(1)),
    "load_z": Covariate("g", "load on z", _on_axis(2)),
    "inc": Covariate("deg", "inclination", lambda s, f, a: np.degrees(s.inc_rad)),
    "tf": Covariate("deg", "toolface", lambda s, f, a: np.mod(np.degrees(s.tf_rad), 360.0), periodic=True),
    "tf_fraction": Covariate("deg", "toolface over several turns", _over_turns),
    "rate": Covariate("deg/s", "rotation rate", lambda s, f, a: np.degrees(s.rotor_rate_radps)),
    "rate_sign": Covariate(
        "1",
        "sense of rotation",
        lambda s, f, a: np.where(s.rotor_rate_radps != 0, np.sign(s.rotor_rate_radps), s.direction),
    ),
    "acceleration": Covariate("deg/s2", "angular acceleration", lambda s, f, a: np.degrees(s.rotor_accel_radps2)),
    "temp": Covariate("C", "temperature", lambda s, f, a: s.temp_c),
    "temp_rate": Covariate("C/s", "rate of the temperature", lambda s, f, a: s.temp_rate_cps, clock=True),
    **{lagging_name(lag): _lagging(lag) for lag in LAGS_S},
    "vibration": Covariate("g", "vibration", lambda s, f, a: s.vibration_rms_g),
    "time": Covariate("s", "time", lambda s, f, a: s.t_s - s.t_s[:1], clock=True),
    "time_since_move": Covariate("s", "time since the last move", _since_move, history=True, clock=True),
    "previous_load": Covariate("g", "load in the pose before", _previous_load, own=True, history=True),
})  # fmt: skip
"""All names that are known beforehand."""
FILTERED = tuple(map(lagging_name, LAGS_S))
"""of these the temperatures that lag"""


def covariate(name: str) -> Covariate:
    """The covariate of that name; a name that is not known is that of a numeric column of the recording."""
    if name in COVARIATES:
        return COVARIATES[name]

    def column(state: ChainState, load: AnyArray, axis: int) -> AnyArray:
        if name not in state.extra:
            raise InputError("is missing: a law of the model depends on it", field=name, remedy="add this column")
        return state.extra[name]

    return Covariate("", name, column)


BESIDE = "_x_"
"""between the names of the covariates of one law, in its id"""


def joined(names: Sequence[str]) -> str:
    """The names of the covariates of a law as its id has them."""
    return BESIDE.join(names)


def parted(words: str) -> tuple[str, ...]:
    """One or two names from what `joined` made of them. A name may hold what stands between two (`load_x` beside `inc`
    is `load_x_x_inc`): of all ways to part the words that in which most of them belong to names that are known."""
    ends = [i for i in range(len(words)) if words.startswith(BESIDE, i)]
    ways = [(words,), *((words[:i], words[i + len(BESIDE) :]) for i in ends)]
    return max(ways, key=lambda names: sum(len(name) for name in names if name in COVARIATES))
