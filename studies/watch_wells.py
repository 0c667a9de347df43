"""The watch over simulated wells: does it cry wolf, does it find what departs, and is the truth in its class?

The wells are made here, apart from the product's simulator: a tool with its own `S`, `b`, coefficients, arm, bent
collar and gravity goes down a hole; each stand gives a still at a random toolface and, four times of five, two windows
of rotation, as means and harmonics with the errors that such have (white noise, a floor, whirl, a walk). One well of
the frame level, rows of accelerometers and gyros through a recording, is `frames`.

    python -m studies.watch_wells --wells 30 --departures 30 --first-seed 5000 [--workers 0 --parts DIR]

`--keep FILE` writes what became of each well, a line of JSON each. A share is given with the 95 % interval
of Wilson; that of intervals that hold the truth with the standard error between wells, whose twelve err together.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.watch import POLICY, STATED, Prior, StatedNoise, Still, Turning, Watch
from highside.watch.parameters import INDEX, NAMES, SIZE, prior
from highside.watch.present import error_of, std_of
from studies import over_seeds

G0 = 9.80665
WELLS = ("J", "S", "vertical", "45", "88")
BUILDS = ("J", "S")
"""those of them in which the inclination changes: elsewhere a class is all that there can be of most departures"""
RECORD_STD = 1e-5
"""g, and ratio: of the record alone; the tool's repeatability is `STATED.repeat_g`"""
FLICKER_H = np.geomspace(0.02, 200.0, 17)
"""1/f noise is made of these: first-order processes of equal variance, four correlation times (h) a decade"""
FLICKERING = replace(STATED, still_floor_g=3.5e-5, window_floor_g=4e-5, offset_random_walk=2e-5)
"""what the watch of a tool with 1/f noise of 30 ug is told"""
KT_STD = 1e-6
"""g/degC: the record was made over temperatures"""


@dataclass(frozen=True)
class Conditions:
    """Of a well beyond what the tool's class states: factors of noise, walk and whirl; the largest vibration, g rms;
    1/f noise of each offset, g rms; what the watch is told of the tool's class."""

    noise: float = 1.0
    walk: float = 1.0
    whirl: float = 1.0
    hours: float = 100.0
    vibration_g: float = 0.0
    flicker_g: float = 0.0
    told: StatedNoise = STATED


@dataclass(frozen=True)
class Departure:
    """A step of `name` by `size` at `at_s`; of `drift_x` and its like a growth of the offset by `size` in an hour from
    then on, of `noise` a growth of all noise by `size` times the stated in an hour, of `noise_step` by that at once."""

    name: str
    size: float
    at_s: float

    @property
    def places(self) -> list[int]:
        """Of the state that it moves."""
        if self.name.startswith("noise"):
            return []
        if self.name == "S_all":
            return [INDEX[f"S_{i}{i}"] for i in "xyz"]
        return [INDEX[self.name.replace("drift", "b")]]


def inclination_deg(kind: str, share: float) -> float:
    """Of a well of that kind after a share of its time."""
    if kind == "J":
        return float(np.clip((share - 0.1) / 0.8, 0.0, 1.0) * 90.0)
    if kind == "S":
        return float(45.0 * np.sin(np.pi * np.clip((share - 0.1) / 0.8, 0.0, 1.0)))
    return {"vertical": 0.5, "45": 45.0, "88": 88.0}[kind] + 0.4 * float(np.sin(40.0 * share))


def stated_prior(noise: StatedNoise = STATED) -> Prior:
    """What the tool's certificate and class say."""
    return prior(np.eye(12) * RECORD_STD**2, KT_STD, 20.0, noise, POLICY)


class Well:
    """A tool in a hole; `stand` gives the measurements of the next one."""

    def __init__(self, kind: str, seed: int, conditions: Conditions = Conditions(), what: Departure | None = None):
        self.rng = rng = np.random.default_rng(seed)
        self.kind, self.conditions, self.departure = kind, conditions, what
        own = stated_prior()
        self.truth = rng.standard_normal(SIZE) * np.sqrt(np.diag(own.covariance))
        self.truth[INDEX["growth"]] = 0.0
        self.per_km = 1.05e-4 + 2.4e-5 * rng.uniform(-1.5, 1.5)
        self.flicker = np.zeros((3, FLICKER_H.size))
        if conditions.flicker_g:
            self.flicker = rng.standard_normal(self.flicker.shape) * conditions.flicker_g / np.sqrt(FLICKER_H.size)
        self.t_s, self.walked_s = 0.0, 0.0
        self.stepped = False

    def _advance(self, t_s: float) -> None:
        before_s, hours = self.walked_s, (t_s - self.walked_s) / 3600.0
        step = 5e-6 * self.conditions.walk * np.sqrt(hours)
        self.truth[:12] += step * self.rng.standard_normal(12)
        if self.conditions.flicker_g:
            kept = np.exp(-hours / FLICKER_H)
            new = self.conditions.flicker_g * np.sqrt((1.0 - kept**2) / FLICKER_H.size)
            self.flicker = kept * self.flicker + new * self.rng.standard_normal(self.flicker.shape)
        self.walked_s = t_s
        what = self.departure
        if what is None or t_s < what.at_s:
            return
        if what.name.startswith("drift"):
            self.truth[what.places] += what.size * (t_s - max(before_s, what.at_s)) / 3600.0
        elif not self.stepped:
            self.truth[what.places] += what.size
        self.stepped = True

    @property
    def noise(self) -> float:
        """Of the stated one, now."""
        what = self.departure
        if what is None or not what.name.startswith("noise") or self.t_s < what.at_s:
            return self.conditions.noise
        lasted = 1.0 if what.name == "noise_step" else (self.t_s - what.at_s) / 3600.0
        return self.conditions.noise * (1.0 + what.size * lasted)

    def _reading(self, f: Array, *, turns: bool) -> Array:
        """(3, ...) of a specific force (3, ...) in units of the stated gravity."""
        t = self.truth
        S = t[3:12].reshape(3, 3).copy()
        if turns:
            tx, ty = t[INDEX["tilt_x"]], t[INDEX["tilt_y"]]
            S += np.array([[0.0, 0.0, ty], [0.0, 0.0, -tx], [-ty, tx, 0.0]])
        share = self.t_s / 3600.0 / self.conditions.hours
        f = f * (1.0 + t[INDEX["gravity"]] + self.per_km * 3.0 * share)
        return np.asarray((np.eye(3) + S) @ f)

    def _offset(self, temp: float) -> Array:
        return np.asarray(self.truth[:3] + self.truth[12:15] * (temp - 20.0) + self.flicker.sum(axis=1))

    def stand(self, watch: Watch) -> float:
        """Feed the next stand; its inclination in deg."""
        rng = self.rng
        self.t_s += rng.uniform(900.0, 1800.0)
        share = self.t_s / 3600.0 / self.conditions.hours
        inclination = np.radians(inclination_deg(self.kind, share))
        temp = 20.0 + 100.0 * share
        self._advance(self.t_s)
        depth = 3.0 * share
        offset = self._offset(temp)
        toolface, lasts = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(60.0, 300.0)
        f = _direction(inclination, toolface)
        std = 3e-5 * self.noise / np.sqrt(2.0 * lasts)
        floor = 1e-5 * self.noise
        mean = self._reading(f, turns=False) + offset + np.hypot(std, floor) * rng.standard_normal(3)
        watch.still(Still(self.t_s, mean, std / self.noise, temp, depth))
        for _ in range(2 if rng.random() < 0.8 else 0):
            self.t_s += 330.0
            self._advance(self.t_s)
            watch.turning(self._turn(inclination, self._offset(temp), temp, depth))
        return float(np.degrees(inclination))

    def _turn(self, inclination: float, offset: Array, temp: float, depth: float) -> Turning:
        rng, noise = self.rng, self.noise
        rate = rng.uniform(20.0, 120.0) * 2.0 * np.pi / 60.0
        slips = rng.random() < 0.5
        rate2 = rate**2 * (1.0 + (0.5 * rng.uniform(0.2, 1.0) ** 2 if slips else 0.0))
        phase, lasts = rng.uniform(0.0, 2.0 * np.pi), 300.0
        s, c = np.sin(inclination), np.cos(inclination)
        F = np.array(
            [[0.0, s * np.cos(phase), -s * np.sin(phase)], [0.0, s * np.sin(phase), s * np.cos(phase)], [c, 0.0, 0.0]]
        )
        M = self._reading(F, turns=True)
        M[:, 0] += offset
        arm = self.truth[[INDEX["arm_x"], INDEX["arm_y"]]]
        M[:2, 0] -= arm * rate2 / G0
        M[:2, 0] += self.conditions.whirl * 1e-4 * rate2 / G0 * rng.standard_normal(2)
        vibration = self.conditions.vibration_g and self.conditions.vibration_g * rng.uniform(0.2, 1.0)
        M[:, 0] += self.truth[INDEX["kV_x"] : INDEX["kV_z"] + 1] * vibration**2
        density = 3e-5 * rng.uniform(5.0, 50.0)
        stds = density * np.array([[np.sqrt(0.5), 1.0, 1.0]] * 3) / np.sqrt(lasts)
        M += noise * np.hypot(stds, 2e-5) * rng.standard_normal((3, 3))
        arm_std = rng.uniform(2e-4, 2e-3)
        return Turning(
            self.t_s,
            M,
            np.diag(stds.ravel() ** 2),
            float(rate2),
            arm + arm_std * rng.standard_normal(2) if slips else None,
            np.eye(2) * arm_std**2 if slips else None,
            temp,
            depth,
            vibration,
        )


def _direction(inclination: float, toolface: float) -> Array:
    s = np.sin(inclination)
    return np.array([s * np.cos(toolface), s * np.sin(toolface), np.cos(inclination)])


@dataclass(frozen=True)
class Outcome:
    """Of one well: hours watched before the departure without an alarm, and what became of it."""

    quiet_h: float
    false_h: float | None
    relevant: bool = False
    bound_h: float | None = None
    """from the step until the Cramer-Rao bound allows it to be found"""
    found_h: float | None = None
    in_class: tuple[bool, ...] = ()
    """at the alarm, and 1, 3, 6, 12, 24 h later"""
    alone: tuple[bool, ...] = ()
    held: int = 0
    intervals: int = 0
    computed: float = 0.0
    """of these intervals how many should hold the truth, by `_computed`"""
    near: tuple[bool, ...] = ()
    """of a drift: a step of that offset is in the class"""
    nis: float = 1.0
    alarmed: bool = False
    """where noise grew: that something departs was said, too"""
    kind: str = ""
    seed: int = 0
    what: Departure | None = None

    @property
    def in_time(self) -> bool:
        """Found within max(1.5 t_CR, 2 h); where the bound is never reached, at any time."""
        return self.found_h is not None and (self.bound_h is None or self.found_h <= max(1.5 * self.bound_h, 2.0))


LAGS_H = (0.0, 1.0, 3.0, 6.0, 12.0, 24.0)


def run(kind: str, seed: int, conditions: Conditions, what: Departure | None = None) -> Outcome:
    """One well."""
    well, watch = Well(kind, seed, conditions, what), Watch(stated_prior(conditions.told))
    outcome = Outcome(conditions.hours, None, kind=kind, seed=seed, what=what)
    need = np.sqrt(POLICY.threshold) + POLICY.power
    checks: list[float] = []
    in_class: list[bool] = []
    alone: list[bool] = []
    near: list[bool] = []
    while well.t_s < conditions.hours * 3600.0:
        begun = well.stepped
        inclination = well.stand(watch)
        if watch.alarm_s is not None and not begun and (what is None or watch.alarm_s < what.at_s):
            return replace(outcome, quiet_h=watch.alarm_s / 3600.0, false_h=watch.alarm_s / 3600.0)
        if what is None or not well.stepped:
            continue
        since = (well.t_s - what.at_s) / 3600.0
        if not begun:
            outcome = replace(outcome, quiet_h=what.at_s / 3600.0, relevant=_relevant(what, inclination))
        if outcome.bound_h is None and _reach(what, watch) >= need:
            outcome = replace(outcome, bound_h=since)
        if watch.alarm_s is None:
            continue
        if outcome.found_h is None:
            outcome = replace(outcome, found_h=since)
            checks = [since + lag for lag in LAGS_H]
        while checks and since >= checks[0]:
            (claim,) = watch.result().claims
            in_class.append(what.name in claim.equivalence_class)
            alone.append(claim.equivalence_class == (what.name,))
            near.append(what.name.replace("drift", "b") in claim.equivalence_class)
            checks.pop(0)
        if not checks and outcome.bound_h is not None:
            break
    result = watch.result()
    held = sum(
        abs(one.value - well.truth[INDEX[name]]) < 1.96 * one.std
        for name, one in result.parameters.items()
        if what is None and INDEX[name] < 12
    )
    return replace(
        outcome,
        in_class=tuple(in_class),
        alone=tuple(alone),
        near=tuple(near),
        held=held,
        intervals=12 * (what is None),
        computed=_computed(watch, conditions.walk) if what is None else 0.0,
        nis=result.noise_ratio,
    )


def _computed(watch: Watch, walk: float) -> float:
    """How many of the twelve 95 % intervals hold the truth where the random walk is `walk` times the stated: without
    draws, from the covariance that the filter has and what the rest of the walk leaves through the same gains."""
    known = watch.memory().arrays
    own, walked = (np.diag(known[name])[:12] for name in ("covariance", "walked"))
    true = np.sqrt(own + (walk**2 - 1.0) * walked)
    stated = np.array([one.std for one in list(watch.result().parameters.values())[:12]])
    return float(sum(math.erf(1.96 * z / math.sqrt(2.0)) for z in stated / true))


def _reach(what: Departure, watch: Watch) -> float:
    """Size over its standard deviation by the Cramer-Rao bound."""
    return float(abs(what.size) * np.sqrt(watch.information_of(what.name, what.at_s)))


def _relevant(what: Departure, inclination: float) -> bool:
    """Whether the worst toolface's effect on I or T is more than three stated standard deviations."""
    state = np.zeros(SIZE)
    # a drift is judged by what it makes in ten hours
    state[what.places] = what.size * (10.0 if what.name.startswith("drift") else 1.0)
    inc = float(np.radians(inclination))
    effect, stated = error_of(state, inc, None), std_of(stated_prior().covariance, inc, None)
    return abs(effect.inc_deg) > 3.0 * stated.inc_deg or abs(effect.tf_sin_inc_deg) > 3.0 * stated.tf_sin_inc_deg


def drawn_departure(rng: np.random.Generator, hours: float) -> Departure:
    """A step of an offset (0.2 to 5 mg) or of an element of S (0.2 to 5 mg/g)."""
    name = str(rng.choice([*NAMES[:12], "b_x", "b_y", "b_z", "S_all"]))
    size = float(np.exp(rng.uniform(np.log(2e-4), np.log(5e-3))) * rng.choice([-1.0, 1.0]))
    return Departure(name, size, float(rng.uniform(0.1, 0.6) * hours * 3600.0))


def drawn_coefficient(rng: np.random.Generator) -> Departure:
    """A temperature coefficient of an offset (3 to 50 ug/degC) that is not the record's, from the start."""
    size = float(np.exp(rng.uniform(np.log(3e-6), np.log(5e-5))) * rng.choice([-1.0, 1.0]))
    return Departure(str(rng.choice(["kT_x", "kT_y", "kT_z"])), size, 0.0)


OTHERS = ("rectification", "drift from the start", "drift from some time on", "growing noise")


def drawn_other(word: str, rng: np.random.Generator, hours: float) -> Departure:
    """One of `OTHERS`: rectification of 0.05 to 1 mg/g^2 from the start, an offset that drifts by 5 to 200 ug/h, noise
    that grows by 2 to 30 % of the stated in an hour."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    axis, sign, at_s = (
        str(rng.choice(["x", "y", "z"])),
        rng.choice([-1.0, 1.0]),
        float(rng.uniform(0.1, 0.6)) * hours * 3600.0,
    )
    if word == "rectification":
        return Departure(f"kV_{axis}", sign * between(5e-5, 1e-3), 0.0)
    if word == "growing noise":
        return Departure("noise", between(0.02, 0.3), at_s)
    return Departure(f"drift_{axis}", sign * between(5e-6, 2e-4), 0.0 if word == OTHERS[1] else at_s)


def run_noise(kind: str, seed: int, conditions: Conditions, what: Departure) -> Outcome:
    """One well in which noise grows. `bound_h`: until it is as large as `noise_grown` says; found: when that is said;
    in the class: nothing is said to depart."""
    well, watch = Well(kind, seed, conditions, what), Watch(stated_prior())
    outcome = Outcome(what.at_s / 3600.0, None)
    reached_h, checks = (POLICY.grown - 1.0) / what.size, []
    right: list[bool] = []
    while well.t_s < conditions.hours * 3600.0:
        well.stand(watch)
        since = (well.t_s - what.at_s) / 3600.0
        if not well.stepped:
            if watch.alarm_s is not None:
                return replace(outcome, quiet_h=watch.alarm_s / 3600.0, false_h=watch.alarm_s / 3600.0)
            continue
        if outcome.bound_h is None and since >= reached_h:
            outcome = replace(outcome, bound_h=reached_h)
        if outcome.found_h is None and watch.result().noise_grown:
            outcome = replace(outcome, found_h=since)
            checks = [since + lag for lag in LAGS_H]
        while checks and since >= checks[0]:
            right.append(watch.alarm_s is None)
            checks.pop(0)
    return replace(outcome, in_class=tuple(right), alone=tuple(right), alarmed=watch.alarm_s is not None)


def others(word: str, wells: int, first_seed: int, conditions: Conditions) -> list[Outcome]:
    """Wells in each of which one departure of that kind happens; a turning tool vibrates with up to 3 g rms."""
    shaken = replace(conditions, vibration_g=3.0)
    out = []
    for k in range(wells):
        what = drawn_other(word, np.random.default_rng([first_seed, k]), conditions.hours)
        one = run_noise if what.name == "noise" else run
        out.append(one(WELLS[k % len(WELLS)], first_seed + k, shaken, what))
    return out


def _print_others(word: str, found: list[Outcome]) -> None:
    """Right class, wrong, missed, delay: each against how many."""
    judged = [one for one in found if one.false_h is None]
    within = [one for one in judged if one.bound_h is not None]
    got = [one for one in within if one.found_h is not None]
    # after the bound (of noise: after the ratio that is to be said) was reached
    delays = [one.found_h - one.bound_h for one in got if one.found_h is not None and one.bound_h is not None]
    say = ", ".join(f"{q} % {np.quantile(delays, q / 100.0):.1f} h" for q in (50, 90)) if delays else "none"
    beyond = sum(one.found_h is not None for one in judged) - len(got)
    print(
        f"{word}: {len(found)} wells, {len(found) - len(judged)} alarms before it; within reach {len(within)}, found"
        f" {len(got)}, missed {len(within) - len(got)}, found beyond reach {beyond}; found after the bound: {say}"
    )
    for k in (0, 3, len(LAGS_H) - 1):
        of = [one for one in judged if len(one.in_class) > k]
        right, alone = sum(one.in_class[k] for one in of), sum(one.alone[k] for one in of)
        step = sum(not one.in_class[k] and one.near[k] for one in of if one.near)
        print(
            f"  {LAGS_H[k]:g} h later: right class {right}, wrong {len(of) - right} of {len(of)} (of a drift, a step of"
            f" that offset: {step}), one name {alone}"
        )
    print(f"  where noise grew: departs was said, too, in {sum(one.alarmed for one in judged)}", flush=True)


def quiet(wells: int, first_seed: int, conditions: Conditions) -> list[Outcome]:
    """Wells in which nothing departs."""
    return [run(WELLS[k % len(WELLS)], first_seed + k, conditions) for k in range(wells)]


def departing(wells: int, first_seed: int, conditions: Conditions) -> list[Outcome]:
    """Wells in each of which one step happens."""
    return [departing_well(first_seed, k, conditions) for k in range(wells)]


def departing_well(first_seed: int, k: int, conditions: Conditions, *, coefficients: bool = False) -> Outcome:
    """The k-th of wells in each of which one thing departs: a step, or a coefficient of temperature."""
    rng = np.random.default_rng([first_seed, k])
    what = drawn_coefficient(rng) if coefficients else drawn_departure(rng, conditions.hours)
    return run(WELLS[k % len(WELLS)], first_seed + k, conditions, what)


def upper_95(count: int, hours: float) -> float:
    """Upper limit (95 %, one-sided) of a Poisson rate per 1,000 h."""
    from scipy.stats import chi2

    return float(chi2.ppf(0.95, 2 * (count + 1)) / 2.0 / hours * 1000.0)


def share(count: int, of: int) -> str:
    """With the 95 % interval of Wilson."""
    if not of:
        return "0 of 0"
    z, p = 1.96, count / of
    middle, half = p + z * z / (2 * of), z * math.sqrt(p * (1.0 - p) / of + (z / (2 * of)) ** 2)
    low, high = ((middle + sign * half) / (1.0 + z * z / of) for sign in (-1.0, 1.0))
    return f"{count} of {of} [{100 * abs(low):.1f}, {100 * high:.1f}] %"


def ways(hours: float) -> dict[str, Conditions]:
    """Conditions of wells in which nothing departs, by what is said of them."""
    stated = Conditions(hours=hours)
    return {
        "as stated": stated,
        "noise 1.4 and walk 1.5 times the stated": replace(stated, noise=1.4, walk=1.5),
        "walk 1.5 times the stated": replace(stated, walk=1.5),
        "1/f noise of 30 ug, as the watch is told": replace(stated, flicker_g=3e-5, told=FLICKERING),
    }


def one_quiet(word: str, hours: float, seed: int, kind: str) -> tuple[dict[str, Any], float]:
    """A well in which nothing departs, as `Outcome`, and its processor time, s."""
    begun = time.process_time()
    return asdict(run(kind, seed, ways(hours)[word])), time.process_time() - begun


def one_departing(first_seed: int, k: int, hours: float, coefficients: bool) -> dict[str, Any]:
    """A well in which one thing departs, as `Outcome`."""
    return asdict(departing_well(first_seed, k, Conditions(hours=hours), coefficients=coefficients))


def kept(path: Path | None, word: str, found: Sequence[dict[str, Any]]) -> list[Outcome]:
    """The outcomes; a line of each, of that `word`, is added to a file."""
    if path is not None:
        with path.open("a", encoding="utf-8") as file:
            for one in found:
                print(json.dumps({"of": word, **one}), file=file)
    return [Outcome(**one | {"what": None if one["what"] is None else Departure(**one["what"])}) for one in found]


def main() -> None:
    """Print the scores."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--wells", type=int, default=30, help="without a departure, of each condition")
    parser.add_argument("--departures", type=int, default=30)
    parser.add_argument("--coefficients", type=int, default=0, help="wells with a temperature coefficient instead")
    parser.add_argument("--hours", type=float, default=100.0)
    parser.add_argument("--first-seed", type=int, default=5000)
    parser.add_argument(
        "--walk", action="store_true", help="also wells whose random walk alone is 1.5 times the stated"
    )
    parser.add_argument(
        "--flicker", action="store_true", help="also wells with 1/f noise of 30 ug, whirl, and a watch that is told so"
    )
    parser.add_argument("--others", type=int, default=0, help="wells each with rectification, drifts, growing noise")
    parser.add_argument("--keep", type=Path, help="file to which a line of JSON of each well is added")
    over_seeds.add_options(parser)
    args = parser.parse_args()
    over = over_seeds.chosen(args, seconds=10.0)
    stated = Conditions(hours=args.hours)
    asked = [True, True, args.walk, args.flicker]
    for word in [name for name, wanted in zip(ways(args.hours), asked, strict=True) if wanted and args.wells]:
        cases = [(word, args.hours, args.first_seed + k, WELLS[k % len(WELLS)]) for k in range(args.wells)]
        made = over(one_quiet, cases)
        _print_quiet(word, kept(args.keep, word, [one for one, _ in made]), sum(seconds for _, seconds in made))

    def departures(count: int, first_seed: int, *, coefficients: bool) -> list[dict[str, Any]]:
        return over(one_departing, [(first_seed, k, args.hours, coefficients) for k in range(count)])

    if args.departures:
        found = departures(args.departures, args.first_seed + 100_000, coefficients=False)
        _print_departures(kept(args.keep, "departure", found))
    for k, word in enumerate(OTHERS if args.others else ()):
        _print_others(word, others(word, args.others, args.first_seed + 300_000 + 10_000 * k, stated))
    if args.coefficients:
        print("temperature coefficients:")
        found = departures(args.coefficients, args.first_seed + 200_000, coefficients=True)
        _print_departures(kept(None, "coefficient", found))


def _print_quiet(word: str, found: list[Outcome], processor_s: float) -> None:
    hours = sum(one.quiet_h for one in found)
    false = sum(one.false_h is not None for one in found)
    whole = [one for one in found if one.intervals]
    held, of = sum(one.held for one in whole), max(sum(one.intervals for one in whole), 1)
    shares = [one.held / one.intervals for one in whole]
    error = np.std(shares, ddof=1) / math.sqrt(len(shares)) if len(shares) > 1 else np.nan
    computed, ratio = sum(one.computed for one in found), np.median([one.nis for one in found])
    print(
        f"{word}: {false} false departures in {hours:.0f} h, {false / hours * 1000:.2f} per 1,000 h"
        f" (below {upper_95(false, hours):.2f}, 95 %); intervals of b and S hold {100 * held / of:.1f}"
        f" +- {100 * error:.1f} % of {of} (computed {100 * computed / of:.1f} %); noise ratio {ratio:.2f};"
        f" {processor_s:.0f} s of processor",
        flush=True,
    )


def _print_departures(found: list[Outcome]) -> None:
    false = [one for one in found if one.false_h is not None]
    hours = sum(one.quiet_h for one in found)
    print(f"with one departure each: {len(found)} wells, {len(false)} alarms before it in {hours:.0f} h")
    reach = [one for one in found if one.bound_h is not None]
    relevant = [one for one in found if one.relevant]
    for word, of in (
        ("within reach of the Cramer-Rao bound", reach),
        ("effect above 3 stated sigmas", relevant),
        ("effect above 3 stated sigmas, within reach", [one for one in relevant if one.bound_h is not None]),
    ):
        got = sum(one.found_h is not None for one in of)
        in_time = share(sum(one.in_time for one in of), len(of))
        print(f"  {word}: {len(of)}, found {got}, within max(1.5 t_CR, 2 h) {in_time}")
    for one in [*reach, *(one for one in relevant if one.bound_h is None)]:
        if not one.in_time:
            print(
                f"    not in time: {one.kind}, seed {one.seed}, {one.what};"
                f" bound {one.bound_h} h, found {one.found_h} h"
            )
    for k, lag in enumerate(LAGS_H):
        judged = [one for one in found if len(one.in_class) > k]
        right, alone = sum(one.in_class[k] for one in judged), sum(one.alone[k] for one in judged)
        building = [one.alone[k] for one in judged if one.kind in BUILDS]
        print(
            f"  {lag:g} h after the alarm: truth in the class {share(right, len(judged))}, one name alone"
            f" {share(alone, len(judged))}, of wells that build {share(sum(building), len(building))}"
        )
        for one in judged:
            if not one.in_class[k]:
                print(f"    not in the class: {one.kind}, seed {one.seed}, {one.what}")


if __name__ == "__main__":
    main()
