"""Multi-station analysis over simulated wells: false and missed departures, names, intervals, the Cramer-Rao bound.

A tool whose `S`, `b`, coefficients and gravity are drawn from what its record and class state makes a survey each
stand, at a random toolface; the surveys are kept as the service keeps them (rounded, one line of JSON each), and the
file goes through `highside.analyse_surveys`. The reading is nonlinear; bounds are computed here from their definition,
with all surveys at once, not by the filter.

    python -m studies.survey_analysis --wells 60 --departures 300 --first-seed 7000
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import highside
from highside.arrays import Array
from highside.watch import POLICY, STATED, Prior, prior_of_record
from highside.watch.parameters import INDEX, NAMES, SIZE
from studies.watch_wells import WELLS, inclination_deg, upper_95

G_STD_MG = 0.05
"""of the site's gravity as the tool was told it, mg"""
PER_KM = 1.05e-4
NOISE_G = 3e-4
"""of one reading; 600 of them a survey"""
READINGS = 600
SLOW, SLOW_MEANS = 20**-0.5, 30
"""of means of two seconds within it: scatter in units of a reading's, and how many"""


@dataclass(frozen=True)
class Conditions:
    """Of a well: surveys, hours between two, and noise (floor) and walk in units of the stated ones."""

    surveys: int = 100
    every_h: float = 0.5
    noise: float = 1.0
    walk: float = 1.0
    scatter: bool = False
    """whether surveys keep what their axes scatter"""


@dataclass(frozen=True)
class Departure:
    """A step of `name` by `size` before survey `at` (0: before the first)."""

    name: str
    size: float
    at: int


def calibration() -> highside.Calibration:
    """A good tool's record: 8 inclinations, 6 toolfaces, 20 ug a pose."""
    rng = np.random.default_rng(1)
    inc, tf = (grid.ravel() for grid in np.meshgrid(np.arange(10.0, 171.0, 20.0)[:8], np.arange(0.0, 360.0, 60.0)))
    s, c = np.sin(np.radians(inc)), np.cos(np.radians(inc))
    f = np.stack([s * np.cos(np.radians(tf)), s * np.sin(np.radians(tf)), c]) + 2e-5 * rng.standard_normal(
        (3, inc.size)
    )
    poses = {
        "inc_ref_deg": inc,
        "tf_ref_deg": tf,
        "ax": f[0],
        "ay": f[1],
        "az": f[2],
        "temp_c": np.full(inc.size, 20.0),
    }
    return highside.calibrate(poses, "joint", tool="HS-1", temp_c=20.0, gravity_mps2=9.81, gravity_std_mps2=1e-5)


class Well:
    """Surveys of one tool in one hole."""

    def __init__(self, kind: str, seed: int, conditions: Conditions, prior: Prior, cal_id: str, what: Departure | None):
        rng = np.random.default_rng(seed)
        covariance = prior.covariance
        truth = np.linalg.cholesky(covariance + 1e-30 * np.eye(SIZE)) @ rng.standard_normal(SIZE)
        truth[INDEX["growth"]] = STATED.gravity_per_km_std * rng.uniform(-1.5, 1.5)
        self.lines: list[str] = []
        rows: list[Array] = []
        hours = conditions.every_h * np.arange(conditions.surveys)
        for k in range(conditions.surveys):
            share = (k + 1) / conditions.surveys
            if k:
                truth[:12] += 5e-6 * conditions.walk * np.sqrt(conditions.every_h) * rng.standard_normal(12)
            if what is not None and k == what.at:
                places = [f"S_{i}{i}" for i in "xyz"] if what.name == "S_all" else [what.name]
                truth[[INDEX[name] for name in places]] += what.size
            inc, tf = np.radians(inclination_deg(kind, share)), rng.uniform(0.0, 2.0 * np.pi)
            f = np.array([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])
            temp, km = 20.0 + 100.0 * share, 3.0 * share
            pull = 1.0 + truth[INDEX["gravity"]] + (PER_KM + truth[INDEX["growth"]]) * (km - 3.0 / conditions.surveys)
            mean = (np.eye(3) + truth[3:12].reshape(3, 3)) @ f * pull + truth[:3] + truth[12:15] * (temp - 20.0)
            white = NOISE_G / np.sqrt(READINGS)
            mean = mean + conditions.noise * np.hypot(white, STATED.still_floor_g) * rng.standard_normal(3)
            line = _line(k, hours[k], mean, temp, km, cal_id, white)
            self.lines.append(with_scatter(line, 1000 * seed + k) if conditions.scatter else line)
            rows.append(_row(f, temp, km - 3.0 / conditions.surveys) / np.hypot(white, STATED.still_floor_g))
        self.truth, self.H, self.hours = truth, np.array(rows), hours

    def bound(self, prior: Prior) -> Array:
        """(12,) Bayesian Cramer-Rao bound of b and S at the last survey, without a departure."""
        P = _with_depth(prior)
        V, now = self._covariance(prior, P), (P + prior.process_noise * self.hours[-1])
        cross = P @ self.H.T + prior.process_noise @ self.H.T * self.hours[None, :]
        return np.asarray(np.sqrt(np.diag(now - cross @ np.linalg.solve(V, cross.T))))[:12]

    def information(self, what: Departure, prior: Prior) -> float:
        """1 / variance of the size of a departure, everything else unknown within the prior."""
        direction = np.zeros(SIZE)
        places = [f"S_{i}{i}" for i in "xyz"] if what.name == "S_all" else [what.name]
        direction[[INDEX[name] for name in places]] = 1.0
        seen = self.H @ direction * (np.arange(self.hours.size) >= what.at)
        return float(seen @ np.linalg.solve(self._covariance(prior, _with_depth(prior)), seen))

    def _covariance(self, prior: Prior, P: Array) -> Array:
        walked = self.H @ prior.process_noise @ self.H.T * np.minimum.outer(self.hours, self.hours)
        return np.asarray(self.H @ P @ self.H.T + walked + np.eye(self.hours.size))


def _with_depth(prior: Prior) -> Array:
    P = prior.covariance.copy()
    P[INDEX["growth"], INDEX["growth"]] = STATED.gravity_per_km_std**2
    return P


def _row(f: Array, temp: float, km: float) -> Array:
    """What the length of a survey depends on."""
    row = np.zeros(SIZE)
    row[:3], row[3:12], row[12:15] = f, np.outer(f, f).ravel(), f * (temp - 20.0)
    row[INDEX["gravity"]], row[INDEX["growth"]] = 1.0, km
    return row


def with_scatter(line: str, seed: int) -> str:
    """A kept line with what its axes scatter: noise as in all others, as well known as of so many readings."""
    rng = np.random.default_rng(seed)
    of = [
        [round(1e3 * sigma * float(np.sqrt(rng.chisquare(n) / n)), 6) for _ in "xyz"]
        for sigma, n in ((NOISE_G, READINGS), (NOISE_G * SLOW, SLOW_MEANS))
    ]
    return json.dumps(json.loads(line) | {"scatter_mg": of})


def _line(k: int, hours: float, mean: Array, temp: float, km: float, cal_id: str, white: float) -> str:
    """As the service keeps a survey, with the depth joined."""
    length = float(np.linalg.norm(mean))
    tf = np.degrees(np.arctan2(mean[1], mean[0])) % 360.0
    survey = {
        "seq": k, "t": 1.7e9 + 3600.0 * hours, "inc_deg": round(float(np.degrees(np.arccos(mean[2] / length))), 6),
        "tf_deg": round(float(tf), 6) % 360.0, "g_total": round(length, 8), "cal_id": cal_id,
        "zone": "global", "flags": [],
        "n": READINGS, "g_std": NOISE_G, "temp_c": temp, "accepted": True, "reasons": [],
        "g_error_mg": round(1e3 * (length - 1.0), 4), "g_error_std_mg": G_STD_MG, "g_noise_mg": round(1e3 * white, 6),
        "tvd_m": 1e3 * km,
    }  # fmt: skip
    return json.dumps(survey)


@dataclass(frozen=True)
class Outcome:
    """Of one well."""

    departs: bool
    alarm: int | None = None
    held: int = 0
    of: int = 0
    efficiency: float = 1.0
    """mean of the stated variance of b and S over that of the bound"""
    squared: float = 0.0
    """mean squared error over the bound's variance"""
    reach: float = 0.0
    """size x sqrt(information)"""
    in_class: bool = False
    alone: bool = False
    covered: bool = False


def run(kind: str, seed: int, conditions: Conditions, tool: highside.Calibration, what: Departure | None) -> Outcome:
    """One well through the file and the analysis."""
    noise = replace(STATED, gravity_g=1e-3 * G_STD_MG / (9.81 / 9.80665))
    prior = prior_of_record(tool.record, noise)
    well = Well(kind, seed, conditions, prior, tool.record.id, what)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "surveys.jsonl"
        path.write_text("\n".join(well.lines) + "\n")
        found = highside.analyse_surveys(path, tool).found
    if what is None:
        bound = well.bound(prior)
        pairs = [(found.parameters[name], well.truth[k]) for k, name in enumerate(NAMES[:12])]
        return Outcome(
            bool(found.claims),
            held=sum(abs(one.value - truth) < 1.96 * one.std for one, truth in pairs),
            of=12,
            efficiency=float(np.mean([one.std**2 / b**2 for (one, _), b in zip(pairs, bound, strict=True)])),
            squared=float(np.mean([(one.value - t) ** 2 / b**2 for (one, t), b in zip(pairs, bound, strict=True)])),
        )
    reach = abs(what.size) * np.sqrt(well.information(what, prior))
    if not found.claims:
        return Outcome(False, reach=reach)
    claim = found.claims[0]
    alarm = round(claim.alarm_s / 3600.0 / conditions.every_h)
    size = claim.parameters[claim.parameter]
    return Outcome(
        True,
        alarm=alarm - what.at,
        reach=reach,
        in_class=what.name in claim.equivalence_class,
        alone=claim.equivalence_class == (what.name,),
        covered=claim.parameter == what.name and size.low <= what.size <= size.high,
        of=int(claim.parameter == what.name),
    )


def drawn_departure(rng: np.random.Generator, surveys: int) -> Departure:
    """A step of 0.2 to 5 mg or mg/g, in half of the wells there from the start."""
    name = str(rng.choice([*NAMES[:12], "b_x", "b_y", "b_z", "S_all"]))
    size = float(np.exp(rng.uniform(np.log(2e-4), np.log(5e-3))) * rng.choice([-1.0, 1.0]))
    return Departure(name, size, 0 if rng.random() < 0.5 else int(rng.integers(surveys // 10, surveys * 6 // 10)))


def _print_quiet(word: str, found: list[Outcome], conditions: Conditions) -> None:
    false = sum(one.departs for one in found)
    hours = len(found) * conditions.surveys * conditions.every_h
    held, of = sum(one.held for one in found), sum(one.of for one in found)
    print(
        f"{word}: {false} of {len(found)} wells depart falsely ({hours:.0f} h: below {upper_95(false, hours):.2f} per"
        f" 1,000 h, 95 %); intervals of b and S hold {100 * held / max(of, 1):.1f} % of {of}; stated variance over the"
        f" bound {np.mean([one.efficiency for one in found]):.3f}, squared error over it"
        f" {np.mean([one.squared for one in found]):.3f}"
    )


def _print_departing(found: list[Outcome]) -> None:
    reach = np.sqrt(POLICY.threshold) + POLICY.power
    early = [one for one in found if one.alarm is not None and one.alarm < 0]
    print(f"with one departure each: {len(found)} wells, {len(early)} alarms before it")
    judged = [one for one in found if one.alarm is None or one.alarm >= 0]
    for word, low, high in (
        ("below the threshold (z < 6)", 0.0, 6.0),
        ("near it (6 to 7.65)", 6.0, reach),
        ("within reach (z >= 7.65)", reach, np.inf),
    ):
        of = [one for one in judged if low <= one.reach < high]
        got = [one for one in of if one.departs]
        print(
            f"  {word}: {len(of)}, found {len(got)}; truth in the class {sum(one.in_class for one in got)}, wrong names"
            f" {sum(not one.in_class for one in got)}, one name alone {sum(one.alone for one in got)}; intervals of the"
            f" size, where the likeliest is the truth, hold {sum(one.covered for one in got)} of"
            f" {sum(one.of for one in got)}"
        )


def main() -> None:
    """Print the scores."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--wells", type=int, default=60, help="without a departure, of each condition")
    parser.add_argument("--departures", type=int, default=300)
    parser.add_argument("--surveys", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=7000)
    parser.add_argument("--scatter", action="store_true", help="surveys keep what their axes scatter")
    args = parser.parse_args()
    tool, stated = calibration(), Conditions(args.surveys, scatter=args.scatter)
    for word, conditions in (
        ("as stated", stated),
        ("noise 1.4 and walk 1.5 times the stated", replace(stated, noise=1.4, walk=1.5)),
        ("20 surveys", replace(stated, surveys=20, every_h=2.5)),
    ):
        quiet = [run(WELLS[k % 5], args.first_seed + k, conditions, tool, None) for k in range(args.wells)]
        _print_quiet(word, quiet, conditions)
    found = []
    for k in range(args.departures):
        what = drawn_departure(np.random.default_rng([args.first_seed, k]), args.surveys)
        found.append(run(WELLS[k % 5], args.first_seed + 100_000 + k, stated, tool, what))
    _print_departing(found)


if __name__ == "__main__":
    main()
