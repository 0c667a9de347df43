"""Columns of a second table on the times of the first: a reference, an encoder, another topic of the same container.

Both have times of one clock (both since 1970, or both of one container), or the lag between them is found where what
both saw of one movement agrees best, or is given. The lag is how much later the second says a thing than the first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from highside.errors import InputError
from highside.importing.core.policy import POLICY, ImportPolicy
from highside.importing.core.recording import ImportedRecording
from highside.importing.core.wishes import Taken
from highside.recording.table import Recording

Block = NDArray[np.float64]
_LEAST_COMMON = 16
"""rows in common below which no agreement is looked at"""
_ANGLES = ("tf_ref_deg", "azi_ref_deg", "rotor_deg")
"""columns that go on at 0 behind 360 deg"""
_ACCEL, _RATES = ("ax_g", "ay_g", "az_g"), ("gx_dps", "gy_dps", "gz_dps")


@dataclass(frozen=True, slots=True)
class Lag:
    """Seconds by which the second clock is late, by what it was measured, and how well both agree there (1 at best)."""

    seconds: float
    by: str
    agreement: float
    at_zero: float


@dataclass(frozen=True, slots=True)
class JoinedRecording:
    """The first recording with the columns of the second; what was found in words; what must be decided, if anything
    (`doubt`), and whether it must (`open`)."""

    recording: Recording
    findings: tuple[str, ...]
    lag: Lag | None
    doubt: str | None = None
    open: bool = False


def joined(
    first: ImportedRecording,
    second: ImportedRecording,
    name: str,
    *,
    taken: Taken = Taken.INTERPOLATED,
    lag_s: float | None = None,
    one_clock: bool = False,
    policy: ImportPolicy = POLICY,
) -> JoinedRecording:
    """The columns of `second`, called `name` in messages, on the times of `first`.

    `lag_s`: given by the user; NaN takes what is measured. `one_clock`: both are of one container. Raises InputError
    where `second` has no column to give, or where nothing says how its clock stands to the first.
    """
    a, b = first.recording, second.recording
    same_clock = one_clock or (first.start_ns is not None and second.start_ns is not None)
    apart = ((second.start_ns or 0) - (first.start_ns or 0)) * 1e-9 if same_clock else 0.0
    times = b.t_s + apart
    lag = measured_lag(a, b, times, policy, whole=not same_clock)
    doubt: str | None = None
    undecided = False
    shift = 0.0
    if lag_s is not None and not np.isnan(lag_s):
        shift = lag_s
    elif lag_s is not None or not same_clock:
        if lag is None:
            what = "nothing moves in both that would show the lag between their clocks"
            raise InputError(f"{name}: {what}", where=a.source, remedy="--lag SECONDS says how late its times are")
        shift = lag.seconds
        if lag_s is None:
            doubt = f"{name}: no common clock; {_lag_text(lag)}"
    elif lag is not None and abs(lag.seconds) > policy.lag_steps * _step(a.t_s) and lag.agreement > lag.at_zero:
        doubt = f"{name}: its clock says so, but {_lag_text(lag)}; taken as its clock says"
    findings = [f"{name}: {_lag_text(lag)}" if lag is not None else f"{name}: the lag shows in no movement of both"]
    columns = {
        column: _on(a.t_s, times - shift, values, taken, column in _ANGLES, policy)
        for column, values in b.columns.items()
        if column != "t_s"
    }
    if not columns:
        raise InputError(
            f"{name} holds no column of numbers beside the time", where=a.source, remedy="--map says which"
        )
    without = max(int(np.isnan(values).sum()) - int(np.isnan(b.columns[c]).any()) for c, values in columns.items())
    if without == a.n:
        raise InputError(
            f"{name}: none of its times lies within those of the recording",
            where=a.source,
            remedy="--lag SECONDS says how late its times are",
        )
    if without:
        findings.append(f"{name}: {without} of {a.n} rows lie outside of its times, or in a gap of them: left empty")
    named = {_free(column, a): values for column, values in columns.items()}
    return JoinedRecording(a.with_columns(named), tuple(findings), lag, doubt, undecided)


def measured_lag(a: Recording, b: Recording, times: Block, policy: ImportPolicy, *, whole: bool) -> Lag | None:
    """Where what both saw of one movement agrees best; None where they saw nothing in common.

    `whole`: look at all lags, for clocks that have nothing in common; else within `policy.lag_s`.
    """
    apart = float(times[0] - a.t_s[0]) if whole else 0.0
    for by, one, other in _common(a, b):
        found = _correlated(a.t_s, one, times - apart, other, policy, whole)
        if found is not None:
            return Lag(found[0] + apart, by, found[1], found[2])
    return None


def _common(a: Recording, b: Recording) -> list[tuple[str, Block, Block]]:
    """Pairs of signals (K, N), (K, M) that must be one and the same, best first."""
    pairs: list[tuple[str, Block, Block]] = []
    up = a.complete(*_ACCEL) if a.has(*_ACCEL) and not a.rows_without(*_ACCEL) else None
    if up is not None:
        up = up / np.maximum(np.linalg.norm(up, axis=0), 1e-9)
    if up is not None and b.has("inc_ref_deg", "tf_ref_deg"):
        inc, tf = np.radians(b["inc_ref_deg"]), np.radians(b["tf_ref_deg"])
        pairs.append(
            ("gravity and the angles", up, np.vstack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)]))
        )
    elif up is not None and b.has("inc_ref_deg"):
        pairs.append(("the inclination", up[2:], np.cos(np.radians(b["inc_ref_deg"]))[None]))
    if up is not None and b.has(*_ACCEL):
        pairs.append(("both accelerations", up, b.complete(*_ACCEL)))
    if a.has(*_RATES) and b.has(*_RATES):
        pairs.append(("both rates", a.complete(*_RATES), b.complete(*_RATES)))
    if a.has(*_RATES) and b.has("rotor_deg") and b.n > 2:
        turn = np.gradient(np.unwrap(np.radians(b["rotor_deg"])), b.t_s)
        pairs.append(
            ("the rates and the encoder", np.linalg.norm(a.complete(*_RATES), axis=0)[None], np.abs(turn)[None])
        )
    if up is not None and b.has("rotor_deg"):
        at = np.radians(b["rotor_deg"])
        pairs.append(("gravity and the encoder", up[:2], np.vstack([np.cos(at), np.sin(at)])))
    return pairs


def _correlated(
    t: Block, one: Block, times: Block, other: Block, policy: ImportPolicy, whole: bool
) -> tuple[float, float, float] | None:
    """(lag in s, agreement there, agreement without a lag) by the peak of the correlation; None without a clear one."""
    length = max(t[-1] - t[0], times[-1] - times[0])
    step = max(min(_step(t), _step(times)), length / policy.lag_points)
    if not np.isfinite(step) or step <= 0:
        return None
    begin, end = min(t[0], times[0]), max(t[-1], times[-1])
    grid = np.arange(begin, end + step, step)
    n = 1 << int(2 * grid.size - 1).bit_length()
    total = np.zeros(n)
    powers = [0.0, 0.0]
    for x, y in zip(one, other, strict=True):
        sampled = []
        for at, values in ((t, x), (times, y)):
            good = np.isfinite(values)
            if int(good.sum()) < 2:
                return None
            within = (grid >= at[0]) & (grid <= at[-1])
            signal = np.interp(grid, at[good], values[good]) - float(values[good].mean())
            sampled.append(np.where(within, signal, 0.0))
        powers = [power + float(signal @ signal) for power, signal in zip(powers, sampled, strict=True)]
        total += np.fft.irfft(np.fft.rfft(sampled[1], n) * np.conj(np.fft.rfft(sampled[0], n)), n)
    if min(powers) <= 0:
        return None
    total /= np.sqrt(powers[0] * powers[1])
    lags = np.fft.fftshift(np.fft.fftfreq(n, 1.0 / n)) * step
    total = np.where(np.abs(lags) <= (length if whole else policy.lag_s), np.fft.fftshift(total), -np.inf)
    place = int(np.argmax(total))
    peak = float(total[place])
    # a second peak nearly as high leaves it open: a movement that comes again
    low = np.flatnonzero(total < 0.5 * peak)
    begin_, end_ = low[low < place].max(initial=-1) + 1, low[low > place].min(initial=n)
    others = np.concatenate((total[:begin_], total[end_:]))
    if peak < policy.lag_agreement or (whole and float(others.max(initial=-np.inf)) > policy.lag_second * peak):
        return None
    width = max(step, float(lags[min(end_, n - 1)] - lags[begin_]) / 2)
    near = minimize_scalar(
        lambda lag: -_agreement(t, one, times - lag, other),
        method="bounded",
        options={"xatol": step / 100},
        bounds=(float(lags[place]) - width, float(lags[place]) + width),
    )
    return float(near.x), -float(near.fun), _agreement(t, one, times, other)


def _agreement(t: Block, one: Block, times: Block, other: Block) -> float:
    """Correlation of two signals (K, N) and (K, M) where they overlap; 0 where they do not."""
    within = (t >= times[0]) & (t <= times[-1])
    if int(within.sum()) < _LEAST_COMMON:
        return 0.0
    product = left = right = 0.0
    for x, y in zip(one, other, strict=True):
        good = np.isfinite(y)
        a, b = x[within], np.interp(t[within], times[good], y[good])
        there = np.isfinite(a)
        a, b = a[there] - a[there].mean(), b[there] - b[there].mean()
        product, left, right = product + float(a @ b), left + float(a @ a), right + float(b @ b)
    return product / float(np.sqrt(left * right)) if left > 0 and right > 0 else 0.0


def _on(t: Block, times: Block, values: Block, taken: Taken, turns: bool, policy: ImportPolicy) -> Block:
    """Values (M,) at `times` taken at t (N,); NaN outside, and within gaps where between rows is interpolated."""
    order = np.argsort(times, kind="stable")
    good = order[np.isfinite(values[order])]
    at, given = times[good], values[good]
    if at.size == 0:
        return np.full(t.size, np.nan)
    after = np.searchsorted(at, t, side="right")
    before = np.clip(after - 1, 0, at.size - 1)
    after = np.clip(after, 0, at.size - 1)
    outside = (t < at[0]) | (t > at[-1])
    usual = _step(at)
    if taken is Taken.LAST:
        return np.where(t < at[0], np.nan, given[before])
    if taken is Taken.NEAREST:
        nearest = np.where(np.abs(t - at[before]) <= np.abs(at[after] - t), before, after)
        return np.where(np.abs(at[nearest] - t) > policy.gap_steps * usual, np.nan, given[nearest])
    wide = (at[after] - at[before] > policy.joined_gap_steps * usual) & (t != at[before]) & (t != at[after])
    whole = np.degrees(np.unwrap(np.radians(given))) if turns else given
    made = np.interp(t, at, whole)
    if turns:
        made = np.where(np.min(given) < 0, (made + 180.0) % 360.0 - 180.0, made % 360.0)
    return np.where(outside | wide, np.nan, made)


def _step(t: Block) -> float:
    steps = np.diff(t)
    steps = steps[steps > 0]
    return float(np.median(steps)) if steps.size else float("inf")


def _lag_text(lag: Lag) -> str:
    late = "late" if lag.seconds >= 0 else "early"
    return f"{abs(lag.seconds):.4g} s {late} by {lag.by} (agreement {lag.agreement:.3f}, {lag.at_zero:.3f} without)"


def _free(column: str, recording: Recording) -> str:
    """A name that the first does not have."""
    name, count = column, 1
    while name in recording.columns or name in recording.texts:
        count += 1
        name = f"{column}_{count}"
    return name
