"""Sessions drawn at random, stepped (12 to 200 poses) or rotating (2 to 30 rates), and a second one of the tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .world import Session

MAX_ROWS = 20_000
"""of a rotation: the cost of a case"""
TYPICAL_ROWS = 3_000
LEAST_ROWS = 1_600
"""of a rotation: below 1,000 a rotation is refused, and a third may be lost"""


def drawn(rng: np.random.Generator, kind: str, *, gyros: bool = False) -> Session:
    """A session of a kind."""
    return poses(rng) if kind == "poses" else rotation(rng, gyros=gyros)


def second(rng: np.random.Generator, first: Session) -> Session:
    """Another session of the same tool: other poses or rates, temperatures, surroundings, in what the first visited.

    No law can be known beyond the range that a session visited; this deck asks for what can be known.
    """
    made = _poses_within(rng, first) if first.kind == "poses" else _rotation_within(rng, first)
    low, high = float(first.temp.min()), float(first.temp.max())
    temp = _within(rng, made.t, low, high)
    extra = {name: _within(rng, made.t, float(v.min()), float(v.max())) for name, v in first.extra.items()}
    vibration = np.zeros(made.n)
    if np.ptp(first.vibration) > 0.0:
        vibration = _within(rng, made.t, float(first.vibration.min()), float(first.vibration.max()))
    return replace(made, temp=temp, extra=extra, vibration=vibration, gyros=first.gyros)


def _within(rng: np.random.Generator, t: np.ndarray, low: float, high: float) -> np.ndarray:
    """A slow course of something that stays between two levels, and uses most of what is between them."""
    if high - low < 1e-9:
        return np.full(t.size, low)
    raw = _course(rng, t)
    span = np.ptp(raw)
    if span < 1e-12:
        return np.full(t.size, 0.5 * (low + high))
    return low + (high - low) * (0.03 + 0.94 * (raw - raw.min()) / span)


def _course(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A slow course through time: a loop, a ramp, a wavy one, or steps with soft edges; 0..1 or so."""
    u = (t - t[0]) / max(float(np.ptp(t)), 1e-9)
    kind = rng.integers(4)
    if kind == 0:
        return np.interp(u, [0, rng.uniform(0.3, 0.6), rng.uniform(0.7, 0.9), 1], [0, 1, rng.uniform(0.3, 0.9), 0.1])
    if kind == 1:
        return 1.0 - np.exp(-u / rng.uniform(0.2, 0.8))
    if kind == 2:
        waves = [rng.normal(0, 1 / k) * np.cos(np.pi * k * u + rng.uniform(0, 6)) for k in range(1, 6)]
        return np.sum(waves, axis=0)
    edges = np.sort(rng.uniform(0.1, 0.9, 3))
    levels = rng.uniform(0, 1, 4)
    steps = [(levels[k + 1] - levels[k]) / (1 + np.exp(-(u - edges[k]) / 0.01)) for k in range(3)]
    return levels[0] + np.sum(steps, axis=0)


def _surroundings(rng: np.random.Generator, t: np.ndarray, *, shaken: float) -> dict[str, object]:
    """Temperature, perhaps a vibration, perhaps a further column."""
    base = rng.uniform(10.0, 40.0)
    temp = np.full(t.size, base)
    if rng.random() < 0.8:
        temp = base + rng.uniform(8.0, 40.0) * _course(rng, t)
    vibration = np.zeros(t.size)
    if rng.random() < shaken:
        course = _course(rng, t)
        vibration = 0.05 + 0.6 * (course - course.min()) / max(float(np.ptp(course)), 1e-9)
    extra = {}
    if rng.random() < 0.35:
        extra["supply_v"] = 5.0 + 0.2 * _course(rng, t)
    return {"temp": temp, "vibration": vibration, "extra": extra}


def poses(rng: np.random.Generator) -> Session:
    """A stepped session: stations of the inclination, toolfaces regular or not, perhaps returns from the other side."""
    count = round(float(np.exp(rng.uniform(np.log(12), np.log(200)))))
    stations = int(np.clip(rng.integers(3, 13), 3, max(3, count // 4)))
    low, high = rng.uniform(1.0, 20.0), rng.uniform(70.0, 175.0)
    inc = np.linspace(low, high, stations) + rng.uniform(-0.3, 0.3, stations) * (high - low) / stations
    returns = bool(rng.random() < 0.5)
    return _visit(rng, np.abs(inc), count, returns=returns, regular=bool(rng.random() < 0.5))


def _visit(rng: np.random.Generator, inc: np.ndarray, count: int, *, returns: bool, regular: bool) -> Session:
    """Poses of the stations one after the other, with a clock, rows and surroundings."""
    per = -(-count // inc.size)
    stops: list[tuple[float, float, float]] = []
    share = rng.uniform(0.25, 0.5) if returns else 0.0
    for k, station in enumerate(inc):
        n = min(per, count - k * per) if count - k * per > 0 else 0
        there = n - round(share * n)
        start = rng.uniform(0, 360)
        angles = start + (np.arange(there) * 360.0 / max(there, 1) if regular else np.sort(rng.uniform(0, 360, there)))
        stops += [(station, a, 1.0) for a in angles]
        stops += [(station, a, -1.0) for a in np.sort(start + rng.uniform(0, 360, n - there))[::-1]]
    if rng.random() < 0.3:
        order = rng.permutation(len(stops))
        stops = [stops[k] for k in order]
    station, toolface, side = np.array(stops).T
    n = station.size
    rows = int(rng.integers(3, 11))
    step = rng.uniform(0.5, 5.0)
    dwell = rng.uniform(10.0, 60.0, n) if rng.random() < 0.5 else np.full(n, rng.uniform(10.0, 60.0))
    begins = np.concatenate([[0.0], np.cumsum(dwell + rows * step)[:-1]])
    pose = np.repeat(np.arange(n), rows)
    t = begins[pose] + step * np.tile(np.arange(rows), n) + 5.0
    around = _surroundings(rng, t, shaken=0.1)
    zero = np.zeros(t.size)
    return Session(
        "poses", t, np.radians(station)[pose], np.radians(toolface)[pose], pose=pose, side=side[pose], rate=zero,
        acceleration=zero, returns=returns, **around,
    )  # fmt: skip


def _poses_within(rng: np.random.Generator, first: Session) -> Session:
    low, high = float(np.degrees(first.inc.min())), float(np.degrees(first.inc.max()))
    margin = 0.03 * (high - low)
    inc = rng.uniform(low + margin, high - margin, int(rng.integers(6, 12)))
    return _visit(rng, inc, int(rng.integers(60, 120)), returns=first.returns, regular=False)


def rotation(rng: np.random.Generator, *, gyros: bool = False) -> Session:
    """Steps of the rate with ramps between them, or a string that sticks and slips; at one inclination."""
    hz = float(rng.choice([5.0, 10.0, 20.0, 50.0, 100.0, 200.0]))
    longest = min(3600.0, MAX_ROWS / hz)
    shortest = max(60.0, LEAST_ROWS / hz)
    seconds = float(np.exp(rng.uniform(np.log(shortest), np.log(max(longest, shortest + 1.0)))))
    seconds = min(seconds, max(60.0, TYPICAL_ROWS / hz)) if rng.random() < 0.7 else seconds
    fastest = min(2.5, hz / 5.0)
    slips = rng.random() < 0.2
    rates = rng.uniform(-fastest, fastest, int(rng.integers(2, 31)))
    rates = np.where(np.abs(rates) < 0.03, 0.05, rates)
    if slips:
        rates = np.full(2, rng.uniform(0.3, 0.6) * fastest)
    return _turn(rng, hz, seconds, rates, rng.uniform(15.0, 85.0), slips=slips, gyros=gyros)


def _turn(
    rng: np.random.Generator, hz: float, seconds: float, rates: np.ndarray, inc_deg: float, *, slips: bool, gyros: bool
) -> Session:
    fine = max(1, round(100.0 / hz))
    n = int(seconds * hz)
    clock = np.arange(n * fine) / (hz * fine)
    hold = seconds / rates.size
    ramp = min(2.0, 0.3 * hold)
    edges = np.arange(1, rates.size) * hold
    # logistic edges: smooth, with a known derivative
    rate = np.full(clock.size, rates[0])
    acceleration = np.zeros(clock.size)
    for at, jump in zip(edges, np.diff(rates), strict=True):
        s = 1.0 / (1.0 + np.exp(np.clip(-(clock - at) / (ramp / 4.0), -700.0, 700.0)))
        rate += jump * s
        acceleration += jump * s * (1.0 - s) / (ramp / 4.0)
    if slips:
        period = rng.uniform(3.0, 8.0)
        deep = rng.uniform(0.6, 1.0)
        wave = 2 * np.pi / period
        acceleration = acceleration * (1 + deep * np.sin(wave * clock)) + rate * deep * wave * np.cos(wave * clock)
        rate = rate * (1.0 + deep * np.sin(wave * clock))
    turned = 2 * np.pi * np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) / (hz * fine)
    rows = slice(0, None, fine)
    t = clock[rows]
    around = _surroundings(rng, t, shaken=0.5)
    rate_rows = 2 * np.pi * rate[rows]
    return Session(
        "rotation", t, np.full(n, np.radians(inc_deg)), turned[rows] + rng.uniform(0, 2 * np.pi),
        pose=np.zeros(0, dtype=int), side=np.sign(rate_rows), rate=rate_rows,
        acceleration=2 * np.pi * acceleration[rows], gyros=gyros, **around,
    )  # fmt: skip


def _rotation_within(rng: np.random.Generator, first: Session) -> Session:
    low, high = float(first.rate.min()) / (2 * np.pi), float(first.rate.max()) / (2 * np.pi)
    rates = rng.uniform(low, high, int(rng.integers(6, 16)))
    rates = np.where(np.abs(rates) < 0.03, 0.05 if high > 0.05 else -0.05, rates)
    rates = np.clip(rates, low, high)
    inc = float(np.degrees(first.inc[0])) + rng.uniform(-3.0, 3.0)
    hz = float(np.clip(1.0 / np.median(np.diff(first.t)), 5.0, 50.0))
    return _turn(rng, hz, min(3000.0 / hz, 600.0), rates, inc, slips=False, gyros=first.gyros)


def missing(rng: np.random.Generator, s: Session, share: float) -> np.ndarray:
    """Rows that stay where a share of them is lost, one by one and in runs."""
    kept = np.ones(s.n, dtype=bool)
    while kept.mean() > 1.0 - share:
        length = int(rng.integers(1, max(2, s.n // 100)))
        at = int(rng.integers(0, s.n))
        kept[at : at + length] = False
    kept[0] = kept[-1] = True
    return kept
