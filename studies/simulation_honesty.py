"""Beside another program's prediction: is what is said true at every strength, and of sizes that change?

    python -m studies.simulation_honesty sweep --seeds 3 --first-seed 700
    python -m studies.simulation_honesty sizes --seeds 5 --first-seed 800 --strength 1e4
    python -m studies.simulation_honesty nulls --seeds 40 --first-seed 900
    python -m studies.simulation_honesty arms --seeds 3 --first-seed 831

A hand turns and moves a sensor of three accelerometers and three gyros about for 48 s, 25 rows a second, while it warms
up. The prediction knows the motion; the recording has an effect or a law of a strength (its energy in units of the
noise, summed over rows) on top of it. An answer is `right` (the truth is named, or in the class of a claim, or a law of
its place), `law` (another law), `refused` (no name is given, the misfit is said), `nothing` or `wrong`.
"""

from __future__ import annotations

import argparse
import collections
import fnmatch
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfiltfilt
from scipy.spatial.transform import Rotation

from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_simulation
from highside.diagnosis.simulation.session import simulation_session

Array = NDArray[np.float64]

RATE_HZ, LENGTH_S = 25.0, 48.0
T_S = np.arange(0.0, LENGTH_S, 1 / RATE_HZ)
NAMES = ("ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps")
SIGMA = np.array([5e-4] * 3 + [0.05] * 3)[:, None]
TEMP_C = 25.0 + 12.0 * (1 - np.exp(-T_S / 25.0)) + 3.0 * np.sin(2 * np.pi * T_S / 47.0)
G_MPS2 = 9.80665
LAGUERRE = np.polynomial.laguerre.laggauss(32)
"""nodes and weights: a motion of 3 Hz and a time constant of 40 ms to 1e-8"""


class Motion:
    """A motion drawn by a seed: what a perfect sensor reads of it, earlier or later, and away from where it turns."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.fine_hz = 4 * RATE_HZ
        fine = np.arange(-4.0, LENGTH_S + 4.0, 1 / self.fine_hz)
        turning = sosfiltfilt(
            butter(2, [0.15, 2.0], "band", fs=self.fine_hz, output="sos"), rng.standard_normal((3, fine.size))
        )
        turning *= np.radians(60) / turning.std(axis=1, keepdims=True)
        attitude, up = Rotation.identity(), np.empty((3, fine.size))
        for k, step in enumerate(Rotation.from_rotvec(turning.T / self.fine_hz)):
            up[:, k] = attitude.as_matrix()[2]
            attitude = attitude * step
        moved = sosfiltfilt(
            butter(2, [0.3, 3.0], "band", fs=self.fine_hz, output="sos"), rng.standard_normal((3, fine.size))
        )
        self.fine, self.turning = fine, turning
        self.all = np.concatenate([up + 0.15 * moved / moved.std(), np.degrees(turning)])
        self.curves = CubicSpline(fine, self.all, axis=1)

    def at(self, t_s: Array) -> Array:
        """(6, n) readings of a perfect sensor."""
        return np.asarray(self.curves(t_s))

    def thrown(self, arm: Array) -> Array:
        """(3, n) g of an arm (3,) m between the centre of the motion and the sensor."""
        w, a = self.turning, CubicSpline(self.fine, self.turning, axis=1)(self.fine, 1)
        r = np.broadcast_to(arm[:, None], w.shape)
        added = np.cross(w.T, np.cross(w.T, r.T)) + np.cross(a.T, r.T)
        return np.asarray(CubicSpline(self.fine, added)(T_S)).T / G_MPS2


def _on(channel: int, values: Array) -> Array:
    added = np.zeros((6, T_S.size))
    added[channel] = values
    return added


def _lagged(motion: Motion, tau_s: float) -> Array:
    """What a first-order lag changes: the mean of the past under exp(-u), u in time constants (Gauss and Laguerre)."""
    past = sum(w * motion.at(T_S - tau_s * u)[:3] for u, w in zip(*LAGUERRE, strict=True))
    return np.concatenate([past - motion.at(T_S)[:3], np.zeros((3, T_S.size))])


def _late(motion: Motion, later_s: Array) -> Array:
    return motion.at(T_S - later_s) - motion.at(T_S)


def _late_one(motion: Motion, later_s: float) -> Array:
    late = _late(motion, np.full(T_S.size, later_s))
    return _on(1, late[1])


def _late_accelerations(motion: Motion, later_s: float) -> Array:
    late = _late(motion, np.full(T_S.size, later_s))
    late[3:] = 0.0
    return late


def _unknown_motion(motion: Motion) -> Array:
    """The room moves, and the prediction does not know."""
    rng = np.random.default_rng(int(1e6 * abs(motion.all[0, 0])))
    pushed = sosfiltfilt(butter(2, [0.8, 2.5], "band", fs=RATE_HZ, output="sos"), rng.standard_normal((3, T_S.size)))
    return np.concatenate([pushed, np.zeros((3, T_S.size))])


def _burst(motion: Motion) -> Array:
    """As `_unknown_motion`, for ten seconds."""
    window = np.sin(np.pi * np.clip((T_S - 15.0) / 10.0, 0.0, 1.0)) ** 2
    return _unknown_motion(motion) * window


def _turned(motion: Motion, turn: Callable[[np.random.Generator], Array]) -> Array:
    """The tool turns by rotation vectors (3, n), rad, about its own axes, and the prediction does not know."""
    angle = turn(np.random.default_rng(int(1e6 * abs(motion.all[0, 0]))))
    clean, back = motion.at(T_S), Rotation.from_rotvec(-angle.T)
    rates = back.apply(clean[3:].T).T + np.degrees(np.gradient(angle, T_S, axis=1))
    return np.asarray(np.concatenate([back.apply(clean[:3].T).T, rates]) - clean)


def _about_an_axis(rng: np.random.Generator, *, back: bool) -> Array:
    """(3, n) a turn by one, of four seconds, which ends where it began or stays."""
    axis = rng.standard_normal(3)
    u = np.clip((T_S - rng.uniform(0.3, 0.6) * LENGTH_S) / 4.0, 0.0, 1.0)
    course = np.sin(np.pi * u) ** 2 if back else u - np.sin(2 * np.pi * u) / (2 * np.pi)
    return np.asarray(np.outer(axis / np.linalg.norm(axis), course))


def _rocked(rng: np.random.Generator, start_s: float, stop_s: float) -> Array:
    """(3, n) a random turning to and fro of unit size, from 0.3 to 2 Hz, between two instants."""
    drawn = sosfiltfilt(butter(2, [0.3, 2.0], "band", fs=RATE_HZ, output="sos"), rng.standard_normal((3, T_S.size)))
    window = np.sin(np.pi * np.clip((T_S - start_s) / (stop_s - start_s), 0.0, 1.0)) ** 2
    return np.asarray(drawn / drawn.std() * window)


TURNS: dict[str, Callable[[np.random.Generator], Array]] = {
    "missing turn": lambda rng: _about_an_axis(rng, back=False),
    "missing turn and back": lambda rng: _about_an_axis(rng, back=True),
    "missing rocking": lambda rng: _rocked(rng, 0.0, 2 * LENGTH_S),
    "missing rocking for 12 s": lambda rng: _rocked(rng, 20.0, 32.0),
}


def _turned_so_far(motion: Motion, size: float, turn: Callable[[np.random.Generator], Array]) -> Array:
    """A turn of so many mrad."""
    return _turned(motion, lambda rng: 1e-3 * size * turn(rng))


def _turned_by(motion: Motion, clean: Array, turn: Callable[[np.random.Generator], Array]) -> Array:
    del clean
    return _turned_so_far(motion, 1.0, turn)


MISSING = "a motion is missing from the prediction"
"""how an answer begins that tells it"""
Truth = tuple[Callable[[Motion, Array], Array], tuple[str, ...]]
WARM = TEMP_C - TEMP_C.mean()
CASES: dict[str, Truth] = {
    "bias": (lambda m, s: _on(0, np.ones(T_S.size)), ("bias",)),
    "scale": (lambda m, s: _on(1, s[1]), ("scale",)),
    "misalignment": (lambda m, s: _on(2, s[0]), ("misalignment",)),
    "quadratic": (lambda m, s: _on(2, s[2] ** 2), ("quadratic",)),
    "gyro_bias": (lambda m, s: _on(4, np.ones(T_S.size)), ("gyro_bias",)),
    "gyro_scale": (lambda m, s: _on(5, s[5]), ("gyro_scale",)),
    "gyro_misalignment": (lambda m, s: _on(3, s[4]), ("gyro_misalignment",)),
    "temperature_bias": (lambda m, s: _on(0, WARM), ("temperature_bias",)),
    "temperature_scale": (lambda m, s: _on(1, WARM * s[1]), ("temperature_scale",)),
    "reference_voltage": (lambda m, s: WARM * s, ("reference_voltage",)),
    "bias_drift": (lambda m, s: _on(1, T_S - T_S.mean()), ("bias_drift",)),
    "lever_arm": (
        lambda m, s: np.concatenate([m.thrown(np.array([1e-2, -4e-3, 6e-3])), np.zeros((3, T_S.size))]),
        ("lever_arm",),
    ),
    "time_offset": (lambda m, s: _late(m, np.full(T_S.size, 1e-4)), ("time_offset",)),
    "bandwidth_lag": (lambda m, s: _lagged(m, 1e-3), ("bandwidth_lag",)),
    "late channel": (lambda m, s: _late_one(m, 1e-4), ("late_channel",)),
    "late accelerations": (lambda m, s: _late_accelerations(m, 1e-4), ("late_channel",)),
    # constants of the simulation
    "value of g": (lambda m, s: np.concatenate([s[:3], np.zeros_like(s[3:])]), ("scale",)),
    "unit of rates": (lambda m, s: np.concatenate([np.zeros_like(s[:3]), s[3:]]), ("gyro_scale",)),
    "sample rate": (lambda m, s: _late(m, 1e-5 * T_S), ("clock_skew",)),
    # outside of what acts on channels
    "step": (lambda m, s: _on(0, (T_S > 0.55 * LENGTH_S).astype(float)), ("law:*offset*time*", "*step*")),
    "gyro step": (lambda m, s: _on(4, (T_S > 0.4 * LENGTH_S).astype(float)), ("law:*offset*time*", "gyro_bias_step")),
    "gyro factor by time": (lambda m, s: _on(5, s[5] * np.sin(2 * np.pi * T_S / 40.0)), ("law:*factor*time*",)),
    "gyro of the load": (lambda m, s: _on(3, np.abs(s[2])), ("law:*gx_dps*",)),
    "cubic": (lambda m, s: _on(1, s[1] ** 3), ("law:*ay_g*", "cubic")),
    "odd quadratic": (lambda m, s: _on(2, s[2] * np.abs(s[2])), ("law:*az_g*", "odd_quadratic")),
    "kink of the rate": (lambda m, s: _on(0, np.maximum(s[3], 0.0)), ("law:*rate*",)),
    "factor by time": (lambda m, s: _on(1, s[1] * np.sin(2 * np.pi * T_S / 40.0)), ("law:*factor*time*",)),
    "tone": (lambda m, s: _on(2, np.sin(2 * np.pi * 1.7 * T_S)), ("*tone*",)),
    "missing motion": (lambda m, s: _unknown_motion(m), (MISSING,)),
    "missing motion for 10 s": (lambda m, s: _burst(m), (MISSING,)),
    **{name: (partial(_turned_by, turn=turn), (MISSING,)) for name, turn in TURNS.items()},
    "delay by time": (lambda m, s: _late(m, 1e-4 * np.sin(2 * np.pi * T_S / 45.0)), ("law:*delay*time*",)),
    "rectified rate": (lambda m, s: _on(1, s[5] ** 2), ("law:*rate*", "*centripetal*")),
}
NONLINEAR: dict[str, Callable[[Motion, float], Array]] = {
    **{name: partial(_turned_so_far, turn=turn) for name, turn in TURNS.items()},
    "time_offset": lambda m, x: _late(m, np.full(T_S.size, 1e-4 * x)),
    "bandwidth_lag": lambda m, x: _lagged(m, 1e-3 * x),
    "late channel": lambda m, x: _late_one(m, 1e-4 * x),
    "late accelerations": lambda m, x: _late_accelerations(m, 1e-4 * x),
    "sample rate": lambda m, x: _late(m, 1e-5 * x * T_S),
    "delay by time": lambda m, x: _late(m, 1e-4 * x * np.sin(2 * np.pi * T_S / 45.0)),
}
"""what so many times the size does, where that is not so many times what the size does"""
COURSES: dict[str, Callable[[], Array]] = {
    "constant": lambda: np.ones(T_S.size),
    "step": lambda: np.where(T_S < 0.5 * LENGTH_S, 1.3, 0.7),
    "ramp": lambda: 0.5 + T_S / LENGTH_S,
    "bump": lambda: 1.0 + 0.5 * np.cos(2 * np.pi * T_S / LENGTH_S),
}
NOISES = ("white", "coloured", "heavy", "walk", "loud in motion", "AR 0.7", "AR 0.97", "1/f", "quantised")
COLOURS = {"AR 0.7": 0.7, "coloured": 0.9, "AR 0.97": 0.97}
"""coefficient of autoregressive noise of the first order"""
STEP = np.array([8 / 4096] * 3 + [1000 / 4096] * 3)[:, None]
"""a step of 12 bits over +-4 g and +-500 deg/s: four to five times the noise"""


def noise_of(kind: str, rng: np.random.Generator, clean: Array) -> Array:
    """(6, n) of unit size."""
    drawn = rng.standard_normal((6, T_S.size))
    if kind in COLOURS:
        # what comes before the first row is drawn as well: it starts as it goes on
        lead = rng.standard_normal((6, 200))
        a = COLOURS[kind]
        drawn = lfilter([np.sqrt(1 - a * a)], [1.0, -a], np.concatenate([lead, drawn], axis=1), axis=1)[:, 200:]
    elif kind == "1/f":
        hz = np.fft.rfftfreq(T_S.size)
        drawn = np.fft.irfft(np.fft.rfft(drawn, axis=1) / np.sqrt(np.maximum(hz, hz[1])), n=T_S.size, axis=1)
        drawn -= drawn.mean(axis=1, keepdims=True)
        drawn /= drawn.std(axis=1, keepdims=True)
    elif kind == "heavy":
        drawn = rng.standard_t(4, (6, T_S.size)) / np.sqrt(2.0)
    elif kind == "walk":
        drawn = drawn + np.cumsum(rng.standard_normal((6, T_S.size)), axis=1) * 0.01
    elif kind == "loud in motion":
        size = np.linalg.norm(clean[3:], axis=0)
        drawn = drawn * size / np.sqrt(np.mean(size**2))
    return np.asarray(drawn)


def reported(motion: Motion, added: Array, noise: str, seed: int, *, laws: bool = True) -> DiagnosisResult:
    """The answer to a recording that has `added` (6, n) beside the motion; without `laws` that of names alone."""
    clean = motion.at(T_S)
    rows = clean + added + SIGMA * noise_of(noise, np.random.default_rng(seed + 10_000), clean)
    if noise == "quantised":
        rows = STEP * np.round(rows / STEP)
    recorded = {"t_s": T_S, **dict(zip(NAMES, rows, strict=True)), "temp_c": TEMP_C}
    predicted = {"t_s": T_S, **dict(zip(NAMES, clean, strict=True))}
    session = simulation_session(recorded, predicted)
    return diagnose_simulation(session, (), method=WHOLE if laws else ProcedureParts.without("laws"))[0]


def _energy(added: Array) -> float:
    return float(np.sum((added / SIGMA) ** 2))


def of_strength(added: Array, strength: float) -> Array:
    """What is added (6, n), of a strength."""
    return added * np.sqrt(strength / _energy(added))


def made(name: str, motion: Motion, strength: float) -> Array:
    """(6, n) what a case adds, of a strength."""
    if name not in NONLINEAR:
        return of_strength(CASES[name][0](motion, motion.at(T_S)), strength)
    size = 1.0
    for _ in range(8):
        size *= np.sqrt(strength / _energy(NONLINEAR[name](motion, size)))
    return NONLINEAR[name](motion, size)


def judged(found: DiagnosisResult, right: Sequence[str]) -> str:
    """What of an answer is right."""
    if MISSING in right and found.remainder.hints[:1] and found.remainder.hints[0].startswith(MISSING):
        return "right" if all(c.effect.startswith("law") for c in found.claims) else "right+wrong"
    if not found.claims:
        return "nothing" if found.verdict == "nothing_left_out" else "refused"

    def fits(name: str) -> bool:
        return any(fnmatch.fnmatch(name, one) for one in right)

    names = [(c.effect, c) for c in found.claims]
    good = [
        fits(e) or any(fits(o) for o in c.equivalence_class) or fits(":".join([e, c.place, *c.depends_on]))
        for e, c in names
    ]
    wrong = [not g and not e.startswith("law") for g, (e, _) in zip(good, names, strict=True)]
    if any(wrong):
        return "wrong" if not any(good) else "right+wrong"
    return "right" if any(good) else "law"


def short(found: DiagnosisResult) -> str:
    """The answer in a line."""
    names = ", ".join(
        f"{c.effect}{list(c.depends_on) or ''}{'' if c.stable is not False else '!'}" for c in found.claims
    )
    more = f" ~{','.join(found.remainder.resembles[:4])}" if found.remainder.resembles else ""
    return f"{found.verdict}: {names}{more} {found.remainder.hints[:1] or ''}"


def sweep(seeds: Sequence[int], only: Sequence[str], noise: str, decades: Sequence[float], *, laws: bool) -> None:
    """Every case at every strength."""
    table: dict[float, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    for name in only or CASES:
        right = CASES[name][1]
        for seed in seeds:
            motion = Motion(seed)
            for strength in decades:
                found = reported(motion, made(name, motion, strength), noise, seed, laws=laws)
                verdict = judged(found, right)
                table[strength][verdict] += 1
                print(f"{name:18s} {seed} {strength:7.0e} {verdict:11s} {short(found)}", flush=True)
    for strength, count in table.items():
        print(f"| {strength:.0e} | " + ", ".join(f"{v} {k}" for k, v in count.most_common()) + " |")


LINEAR = (
    "scale",
    "misalignment",
    "quadratic",
    "gyro_scale",
    "lever_arm",
    "temperature_bias",
    "time_offset",
    "bandwidth_lag",
)


def sizes(
    seeds: Sequence[int], only: Sequence[str], noise: str, strength: float, courses: Sequence[str], *, laws: bool
) -> None:
    """Effects whose sizes are constant, or change over the session."""
    table: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    for name in only or LINEAR:
        right = CASES[name][1]
        for seed in seeds:
            motion = Motion(seed)
            added = made(name, motion, strength)
            for course in courses:
                found = reported(motion, COURSES[course]() * added, noise, seed, laws=laws)
                names = {n for c in found.claims for n in (c.effect, *c.equivalence_class)}
                # of a delay that changes steadily, or of what follows the temperature, there are names
                other = {"time_offset": "clock_skew", "misalignment": "temperature_misalignment"}.get(name, "")
                kept = "its name" if name in names and other not in names else judged(found, (*right, other))
                table[course][kept] += 1
                print(f"{name:18s} {seed} {noise:9s} {course:9s} {kept:11s} {short(found)}", flush=True)
    for course, count in table.items():
        print(f"| {course} | " + ", ".join(f"{v} {k}" for k, v in count.most_common()) + " |")


def nulls(seeds: Sequence[int], noises: Sequence[str], *, laws: bool) -> None:
    """Recordings from which nothing is missing."""
    for noise in noises:
        count: collections.Counter[str] = collections.Counter()
        for seed in seeds:
            motion = Motion(seed)
            found = reported(motion, np.zeros((6, T_S.size)), noise, seed, laws=laws)
            count[found.verdict] += 1
            if found.verdict != "nothing_left_out":
                print(f"{noise:15s} {seed} {short(found)}", flush=True)
        print(f"| {noise} | " + ", ".join(f"{v} {k}" for k, v in count.most_common()) + " |", flush=True)


def arms(seeds: Sequence[int], noise: str, decades: Sequence[float], *, laws: bool) -> None:
    """Lever arms of any direction: how long each component is found, in units of what it is, and how sure."""
    for strength in decades:
        off, sigmas, found = [], [], 0
        for seed in seeds:
            motion, arm_m = Motion(seed), np.random.default_rng(seed).standard_normal(3)
            added = np.concatenate([motion.thrown(arm_m), np.zeros((3, T_S.size))])
            arm_m *= np.sqrt(strength / _energy(added))
            answer = reported(motion, of_strength(added, strength), noise, seed, laws=laws)
            for parameters in (c.parameters for c in answer.claims if c.effect == "lever_arm"):
                found += 1
                error = [p.value - arm_m["xyz".index(name[-1])] for name, p in parameters.items()]
                # of its own length, in the direction in which it points
                off.append(float(np.linalg.norm(error) / np.linalg.norm(arm_m)))
                sigmas += [abs(e) / p.std for e, p in zip(error, parameters.values(), strict=True)]
        beyond = float(np.mean(np.array(sigmas or [0.0]) > 2.6))
        print(
            f"| {noise} | {strength:.0e} | {found} of {len(seeds)} | off by at most {max(off, default=np.nan):.1%} of "
            f"the arm, {max(sigmas, default=np.nan):.1f} standard deviations, {beyond:.0%} "
            "of components beyond 2.6 |",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("sweep", "sizes", "nulls", "arms"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=700)
    parser.add_argument("--noise", default="white", choices=(*NOISES, "all"))
    parser.add_argument("--only", nargs="*", default=())
    parser.add_argument("--strength", type=float, nargs="*", default=[1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6])
    parser.add_argument("--courses", nargs="*", default=list(COURSES), choices=list(COURSES))
    parser.add_argument("--names-alone", action="store_true", help="six times as fast: no search for laws")
    given = parser.parse_args()
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    noises = NOISES if given.noise == "all" else (given.noise,)
    if given.what == "sweep":
        sweep(seeds, given.only, given.noise, given.strength, laws=not given.names_alone)
    elif given.what == "arms":
        for noise in noises:
            arms(seeds, noise, given.strength, laws=not given.names_alone)
    elif given.what == "sizes":
        for strength in given.strength:
            for noise in noises:
                print(f"strength {strength:g}, {noise} noise")
                sizes(seeds, given.only, noise, strength, given.courses, laws=not given.names_alone)
    else:
        nulls(seeds, noises, laws=not given.names_alone)


if __name__ == "__main__":
    main()
