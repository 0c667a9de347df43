"""What the watch detects against what the Cramer-Rao bound allows: sizes found with 50 and 90 % probability.

Wells are those of `studies.watch_wells`. In each the size of one departure is bisected, with all random numbers the
same, until it is just found in the hours that are left; quantiles over wells are the sizes found with 50 and 90 %. The
bound is of the same measurements: the readings' Jacobian is made here by differences of the generator's own formulas,
all measurements at once, inclination and phase of each turn unknown, everything else within the prior and its random
walk. A departure of known kind and time that is `z` standard deviations of the bound passes the threshold `h` with 50 %
where `z = sqrt(h)`, with 90 % where it is 1.28 more. The watch knows neither kind nor time nor sign.

    python -m studies.watch_limits --wells 20 --first-seed 41000 [--workers 0 --parts DIR]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.watch import POLICY, STATED, Prior, Still, Turning, Watch
from highside.watch.parameters import INDEX, SIZE
from studies import over_seeds
from studies.watch_wells import G0, Conditions, Departure, Well, stated_prior

KINDS = (
    *(("bias", f"b_{i}", "g") for i in "xyz"),
    *(("scale", f"S_{i}{i}", "g/g") for i in "xyz"),
    *((f"misalignment of {i}", f"S_{i}{j}", "g/g") for i in "xyz" for j in "xyz" if i != j),
    ("temperature", "kT_x", "g/degC"),
    *(("rectification", f"kV_{i}", "g/g^2") for i in "xz"),
    *(("drift", f"drift_{i}", "g/h") for i in "xz"),
    ("growing noise", "noise_step", "of the stated"),
)
"""Class, departure, unit. The generator treats x and y alike: coefficients and drifts of y are left out."""
FROM_THE_START = ("kT", "kV", "drift")
"""no onset: a coefficient is what it is; drifts that begin later are in `studies.watch_wells --others`"""
SHARES = {50: 0.0, 90: 1.2816}
"""percent found, and by how many standard deviations the bound must pass the threshold for it"""
STEPS = 6
SPAN = (0.25, 8.0)
"""of the size that the bound finds with 50 %: between these it is sought"""


@dataclass(frozen=True)
class Seen:
    """One measurement without inclination and phase: time s, `J` (M, N) of the state, whitened; `warmer` degC."""

    t_s: float
    J: Array
    warmer: float


class Listener:
    """In the place of a watch: keeps what it is given."""

    def __init__(self) -> None:
        self.taken: list[Still | Turning] = []

    def still(self, still: Still) -> None:
        """A mean at rest."""
        self.taken.append(still)

    def turning(self, turn: Turning) -> None:
        """A window of rotation."""
        self.taken.append(turn)


def reading(x: Array, f: Array, warmer: float, km: float, turn: Turning | None) -> Array:
    """What a tool with the deviations `x` (N,) reads of the force `f` (3, ...), as the generator has it."""
    S = x[3:12].reshape(3, 3).copy()
    if turn is not None:
        tx, ty = x[INDEX["tilt_x"]], x[INDEX["tilt_y"]]
        S += np.array([[0.0, 0.0, ty], [0.0, 0.0, -tx], [-ty, tx, 0.0]])
    read = (np.eye(3) + S) @ f * (1.0 + x[INDEX["gravity"]] + x[INDEX["growth"]] * km)
    constant = x[:3] + x[12:15] * warmer
    if turn is None:
        return np.asarray(read + constant)
    constant = constant + x[15:18] * turn.vibration_g**2
    constant[:2] -= x[[INDEX["arm_x"], INDEX["arm_y"]]] * turn.rate2 / G0
    read[:, 0] += constant
    return np.asarray(read)


def seen(one: Still | Turning, first_km: float) -> Seen:
    """The Jacobian at no deviation, by differences."""
    assert one.temp_c is not None
    assert one.depth_km is not None
    warmer, km = one.temp_c - 20.0, one.depth_km - first_km
    if isinstance(one, Still):
        f = one.mean_g / np.linalg.norm(one.mean_g)
        row = _slopes(lambda x: np.array([np.linalg.norm(reading(x, f, warmer, km, None))]), SIZE)
        return Seen(one.t_s, row / np.hypot(one.std_g, STATED.still_floor_g), warmer)
    M = one.harmonics_g
    inc = np.arctan2(0.5 * np.hypot(M[0, 1] + M[1, 2], M[1, 1] - M[0, 2]), M[2, 0])
    phase = np.arctan2(M[1, 1] - M[0, 2], M[0, 1] + M[1, 2])

    def of(values: Array) -> Array:
        s, c = np.sin(inc + values[SIZE]), np.cos(inc + values[SIZE])
        cp, sp = np.cos(phase + values[SIZE + 1]), np.sin(phase + values[SIZE + 1])
        F = np.array([[0.0, s * cp, -s * sp], [0.0, s * sp, s * cp], [c, 0.0, 0.0]])
        return reading(values[:SIZE], F, warmer, km, one).ravel()

    R = one.covariance + STATED.window_floor_g**2 * np.eye(9)
    R[[0, 3], [0, 3]] += (STATED.whirl_m * one.rate2 / G0) ** 2
    whole = np.linalg.solve(np.linalg.cholesky(R), _slopes(of, SIZE + 2))
    free = np.linalg.svd(whole[:, SIZE:])[0][:, 2:]
    J = free.T @ whole[:, :SIZE]
    if one.arm_m is not None and one.arm_covariance is not None:
        place = np.zeros((2, SIZE))
        place[:, [INDEX["arm_x"], INDEX["arm_y"]]] = np.eye(2)
        J = np.vstack([J, np.linalg.solve(np.linalg.cholesky(one.arm_covariance), place)])
    return Seen(one.t_s, J, warmer)


def _slopes(of: object, size: int) -> Array:
    """(M, size) derivative of a function of (size,) at zero, by central differences."""
    assert callable(of)
    step = 1e-6
    return np.stack([(of(row) - of(-row)) / (2.0 * step) for row in step * np.eye(size)], axis=1)


def bound(taken: list[Still | Turning], what: Departure, prior: Prior) -> float:
    """Standard deviation of the size of a departure by the Cramer-Rao bound, all else within the prior."""
    first_km = taken[0].depth_km
    assert first_km is not None
    all_seen = [seen(one, first_km) for one in taken]
    J = np.vstack([one.J for one in all_seen])
    t = np.concatenate([np.full(len(one.J), one.t_s) for one in all_seen])
    P = prior.covariance.copy()
    P[INDEX["growth"], INDEX["growth"]] = STATED.gravity_per_km_std**2
    hours = (t - t[0]) / 3600.0
    V = np.eye(t.size) + J @ P @ J.T + (J @ prior.process_noise @ J.T) * np.minimum.outer(hours, hours)
    direction = np.zeros(SIZE)
    direction[what.places] = 1.0
    begun = t >= what.at_s
    course = begun * (hours - hours[np.argmax(begun)]) if what.name.startswith("drift") else 1.0 * begun
    signature = (J @ direction) * course
    return float(1.0 / np.sqrt(signature @ np.linalg.solve(V, signature)))


def noise_bound(taken: list[Still | Turning], at_s: float) -> float:
    """Standard deviation of a factor of the noise near one: `1 / sqrt(2 n)` of the numbers of which it is judged."""
    prior = stated_prior()
    first_km = taken[0].depth_km
    assert first_km is not None
    count = sum(len(seen(one, first_km).J) for one in taken if one.t_s >= at_s)
    assert prior.noise is STATED
    return float(1.0 / np.sqrt(2.0 * min(count, POLICY.scale_over)))


def found(kind: str, seed: int, conditions: Conditions, what: Departure) -> bool:
    """Whether the watch says something before the well ends: of noise that it has grown, or, wrongly, that something
    departs (how often: `studies.watch_wells --others`)."""
    well, watch = Well(kind, seed, conditions, what), Watch(stated_prior())
    while well.t_s < conditions.hours * 3600.0:
        well.stand(watch)
        if watch.alarm_s is not None:
            return True
    return what.name.startswith("noise") and watch.result().noise_grown


def least(kind: str, seed: int, conditions: Conditions, name: str) -> tuple[float, float] | None:
    """The least size that is found, and the bound's standard deviation; None where nothing in the span is found."""
    at_s = 0.0 if name.startswith(FROM_THE_START) else 0.5 * conditions.hours * 3600.0
    sign = 1.0 if seed % 2 or name.startswith("noise") else -1.0
    well, listener = Well(kind, seed, conditions), Listener()
    while well.t_s < conditions.hours * 3600.0:
        well.stand(listener)  # type: ignore[arg-type]
    if name.startswith("noise"):
        std, low, high = noise_bound(listener.taken, at_s), 0.1, 3.0
    else:
        std = bound(listener.taken, Departure(name, 1.0, at_s), stated_prior())
        low, high = (share * np.sqrt(POLICY.threshold) * std for share in SPAN)
    if not found(kind, seed, conditions, Departure(name, sign * high, at_s)):
        return None
    for _ in range(STEPS):
        middle = float(np.sqrt(low * high))
        if found(kind, seed, conditions, Departure(name, sign * middle, at_s)):
            high = middle
        else:
            low = middle
    return float(np.sqrt(low * high)), std


def one_well(kind: str, seed: int, hours: float, name: str) -> tuple[float, float] | None:
    """As `least`, in wells of that many hours and the vibration of this study."""
    return least(kind, seed, Conditions(hours=hours, vibration_g=3.0), name)


def row(word: str, name: str, unit: str, results: list[tuple[float, float] | None]) -> str:
    """Of the table: sizes found with 50 and 90 %, the bound's, and their ratios."""
    got = [one for one in results if one is not None]
    cells = []
    for percent, more in SHARES.items():
        # what was not found within the span counts as larger than all
        sizes = np.sort([one[0] for one in got] + [np.inf] * (len(results) - len(got)))
        size = sizes[int(np.ceil(percent / 100.0 * len(sizes))) - 1]
        std = float(np.median([one[1] for one in got])) if got else np.nan
        if name.startswith("noise"):
            allowed = (POLICY.grown / (1.0 - more * std)) - 1.0
        else:
            allowed = (np.sqrt(POLICY.threshold) + more) * std
        cells.append(f"{size:.3g} | {allowed:.3g} | {size / allowed:.2f}")
    return f"| {word} | {name} | {unit} | {' | '.join(cells)} | {len(results) - len(got)} of {len(results)} |"


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--wells", type=int, default=20, help="of each kind of departure")
    parser.add_argument("--hours", type=float, default=30.0)
    parser.add_argument("--profile", default="J", help="of the wells: J, S, vertical, 45, 88")
    parser.add_argument("--only", nargs="*", default=[""], help="departures whose name begins so")
    parser.add_argument("--first-seed", type=int, default=41_000)
    over_seeds.add_options(parser)
    args = parser.parse_args()
    over = over_seeds.chosen(args, seconds=5.0)
    print("| class | departure | unit | 50 % | bound | ratio | 90 % | bound | ratio | not found at all |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for word, name, unit in KINDS:
        if name.startswith(tuple(args.only)):
            seeds = range(args.first_seed, args.first_seed + args.wells)
            cases = [(args.profile, k, args.hours, name) for k in seeds]
            print(row(word, name, unit, over(one_well, cases)), flush=True)


if __name__ == "__main__":
    main()
