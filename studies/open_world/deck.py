"""The deck: laws that no library holds, effects that one does, and nothing at all; under every noise, in any design.

The seed is the hash of the commit that froze the engine (`studies.sealed.deck.frozen_seed`), so nobody can have looked
at a case while working on it. A case has a second session of the same sensor: what is learned on the first has to say
there what the hidden law adds.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from studies.sealed import deck as library_deck
from studies.sealed import world as library_world

from . import designs, laws, noises, world
from .answers import Case, model_of
from .laws import Law
from .noises import Noise
from .world import Session

Makers = dict[str, Callable[[], Case]]

SWEEP = (30.0, 100.0, 400.0, 1e3, 1e4, 1e5, 1e6, 1e7)
"""strengths at which the same law is hidden"""
KINDS = ("poses", "rotation")
"""designs, by turns"""
LARGEST = {
    "offset": 0.2, "scale": 0.2, "matrix": 0.2, "inclination": 0.2, "toolface": 0.2, "timing": 0.5, "level": 0.2,
    "gyro_offset": 0.2, "gyro_scale": 0.2,
}  # fmt: skip
"""no larger departure is hidden (g, rad, s, rad/s, shares): an instrument is refused before"""


@dataclass(frozen=True)
class Size:
    """How many cases of each sort."""

    laws: int = 320
    nulls: int = 300
    known: int = 200
    sweeps: int = 200


def rng_of(seed: str, name: str) -> np.random.Generator:
    """Random numbers of one case alone: the same whatever else of the deck is made."""
    return np.random.default_rng(list(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:16]))


def kind_of(name: str) -> str:
    """Design of a case of this deck, by its name; of another, none."""
    group, *rest = name.split("/")
    return KINDS[int(rest[0]) % 2] if group in ("law", "null", "known", "sweep") else ""


def cases(seed: str, size: Size) -> Makers:
    """Every case by its name, made when it is called for."""
    found: Makers = {}
    for k in range(size.laws):
        name = f"law/{k:03d}"
        found[name] = partial(law_case, name, seed, k)
    for k in range(size.nulls):
        name = f"null/{k:03d}"
        found[name] = partial(null_case, name, seed, k)
    for k in range(size.known):
        name = f"known/{k:03d}"
        found[name] = partial(known_case, name, seed, k)
    for k in range(size.sweeps):
        for strength in SWEEP:
            name = f"sweep/{k:03d}/{strength:.0f}"
            found[name] = partial(sweep_case, name, seed, k, strength)
    return found


# --- making ---------------------------------------------------------------------------------------------------------


def _session(rng: np.random.Generator, kind: str) -> Session:
    return designs.drawn(rng, kind, gyros=kind == "rotation" and bool(rng.random() < 0.3))


def sized(s: Session, sensor: world.Sensor, law: Law, noise: Noise, strength: float) -> Law:
    """The law so large that its noncentrality off the base fit is the strength, or as large as an instrument may be."""
    for _ in range(5):
        found = noises.energy(s, noise, world.off_base(s, world.contribution(s, sensor, [law])))
        if found <= 0.0:
            break
        law = law.sized(float(np.sqrt(strength / found)))
        if law.size > LARGEST[law.place]:
            law = replace(law, size=LARGEST[law.place])
    return law


def built(
    name: str, group: str, rng: np.random.Generator, s: Session, noise: Noise, hidden: tuple[Law, ...],
    sensor: world.Sensor, second: Session | None, *, plain: bool = False,
) -> Case:  # fmt: skip
    """A case from its parts: rows lost (`plain`: none), noise added, and what is hidden written down."""
    clean = world.readings(s, sensor, hidden)
    data = noises.added(rng, s, noise, clean)
    kept = (
        designs.missing(rng, s, rng.uniform(0.05, 0.3))
        if rng.random() < 0.2 and not plain
        else np.ones(s.n, dtype=bool)
    )
    reported = s.rows(kept)
    # a third of the models say what a row's noise is
    stated = (
        noise.sigma[0] if not plain and rng.random() < 0.33 and noise.kind not in ("quantised", "modulated") else None
    )
    case = Case(
        name, group, s.kind, world.columns(reported, data[:, kept]), model_of(s, noise_g=stated), noise.kind,
        laws=hidden, sigma=noise.sigma, first=reported,
    )  # fmt: skip
    added = world.off_base(reported, world.contribution(reported, sensor, hidden))
    case.hidden = added / np.array(noise.sigma)[:, None]
    case.strength = noises.energy(reported, noise, added)
    if second is not None:
        alone = tuple(replace(law, onset_s=None) if law.onset_s is not None else law for law in hidden)
        case.second = world.columns(second, noises.added(rng, second, noise, world.readings(second, sensor, alone)))
        truth = world.contribution(second, sensor, alone)
        case.other = second
        case.kept_from = np.where(visited(s, second, hidden), truth, np.nan)
    return case


def visited(first: Session, second: Session, hidden: tuple[Law, ...]) -> np.ndarray:
    """Rows of the second session at which every covariate of the laws is within what the first has visited."""
    inside = np.ones(second.n, dtype=bool)
    for name in {name for law in hidden for name in law.covariates} - laws.ANGLES:
        before, now = laws.covariate(first, name), laws.covariate(second, name)
        room = 0.02 * float(np.ptp(before))
        inside &= (now >= before.min() - room) & (now <= before.max() + room)
    return inside


def drawn_count(rng: np.random.Generator) -> tuple[int, bool]:
    """How many laws act at a time, and whether one sets in midway: the first that is drawn of a case."""
    return int(rng.choice([1, 2, 3, 4], p=[0.6, 0.25, 0.1, 0.05])), bool(rng.random() < 0.1)


def law_case(name: str, seed: str, k: int) -> Case:
    """One to four laws; designs and noises by turns, everything else drawn."""
    rng = rng_of(seed, name)
    kind = KINDS[k % 2]
    # half white, so that both bars have their cases
    noise_kind = "white" if k % 4 < 2 else noises.KINDS[1 + (k // 4) % (len(noises.KINDS) - 1)]
    count, onset = drawn_count(rng)
    repeats = bool(rng.random() < 0.85)
    while True:
        s = _session(rng, kind)
        second = designs.second(rng, s)
        noise = noises.drawn(rng, s, noise_kind)
        sensor = world.drawn_sensor(rng)
        hidden = []
        for _ in range(count):
            law = laws.drawn_law(rng, s, repeats=repeats)
            if onset:
                law = replace(law, onset_s=float(rng.uniform(0.3, 0.6) * np.ptp(s.t)))
            hidden.append(sized(s, sensor, law, noise, float(np.exp(rng.uniform(np.log(30), np.log(1e6))))))
        case = built(name, "law", rng, s, noise, tuple(hidden), sensor, second)
        # a law that the session or the other one hardly shows is drawn again
        reported = case.kept_from is not None and np.isfinite(case.kept_from).mean() > 0.6
        if case.strength >= 25.0 and reported and _shows(second, noise, case.kept_from, case.strength):
            return case


def _shows(second: Session, noise: Noise, truth: np.ndarray, strength: float) -> bool:
    left = world.off_base(second, np.nan_to_num(truth))
    share = float(np.sum((left / np.array(noise.sigma)[:, None]) ** 2)) / second.n
    return bool(share > 1e-4 * strength / second.n)


def null_case(name: str, seed: str, k: int) -> Case:
    """Nothing hidden."""
    rng = rng_of(seed, name)
    s = _session(rng, KINDS[k % 2])
    noise = noises.drawn(rng, s, noises.KINDS[(k // 2) % len(noises.KINDS)])
    return built(name, "null", rng, s, noise, (), world.drawn_sensor(rng), None)


def sweep_case(name: str, seed: str, k: int, strength: float) -> Case:
    """The same law and the same noise at every strength: its random numbers are those of the sweep."""
    rng = rng_of(seed, f"sweep/{k}")
    s = _session(rng, KINDS[k % 2])
    noise = noises.drawn(rng, s, noises.KINDS[(k // 2) % len(noises.KINDS)])
    sensor = world.drawn_sensor(rng)
    law = sized(s, sensor, laws.drawn_law(rng, s, repeats=True), noise, strength)
    return built(name, "sweep", rng, s, noise, (law,), sensor, None)


# --- effects of the library, in these designs and noises -----------------------------------------------------------

ENDLESS = frozenset({"tone", "aliased_vibration", "clock_skew"})
"""not asked here: what they look like depends on the frame rate of the other deck"""


def known_case(name: str, seed: str, k: int) -> Case:
    """One effect of the library, or two; made by the other deck's world, which steps it through time."""
    rng = rng_of(seed, name)
    kind = KINDS[k % 2]
    drawn = library_deck.POSE_EFFECTS if kind == "poses" else library_deck.ROTATION_EFFECTS
    noise_kind = noises.KINDS[(k // 2) % len(noises.KINDS)]
    while True:
        s = _session(rng, kind)
        if kind == "rotation" and np.ptp(s.t) > 600.0:
            continue  # two thousand steps a second
        programme, s = as_programme(s)
        noise = noises.drawn(rng, s, noise_kind)
        sensor = library_world.some_sensor(rng)
        able = [e for e in drawn if e not in ENDLESS and (s.gyros or e not in library_deck.GYRO_EFFECTS)]
        effects: dict[str, dict[str, float]] = {}
        strength = float(np.exp(rng.uniform(np.log(100), np.log(1e5))))
        base = library_deck._earth(programme)
        count = 1 if rng.random() < 0.8 else 2
        for effect in rng.choice(able, count, replace=False):
            values = _within_session(drawn[str(effect)](rng), str(effect), s)
            sized_values = _effect_sized(programme, s, sensor, str(effect), values, noise, strength)
            if sized_values is None:
                break
            effects[str(effect)] = sized_values
        if len(effects) < count:
            continue
        clean = library_deck._stacked(*library_world.readings(programme, sensor, {**base, **effects}))
        plain = library_deck._stacked(*library_world.readings(programme, sensor, base))
        recorded = world.columns(s, noises.added(rng, s, noise, clean))
        case = Case(name, "known", kind, recorded, model_of(s), noise_kind, first=s)
        added = world.off_base(s, clean - plain)
        case.effects, case.sigma = effects, noise.sigma
        case.hidden = added / np.array(noise.sigma)[:, None]
        case.strength = noises.energy(s, noise, added)
        return case


def _within_session(values: dict[str, float], effect: str, s: Session) -> dict[str, float]:
    """Time constants and moments that belong to this session's length."""
    span = float(np.ptp(s.t))
    if effect == "bias_step":
        values["t0"] = 0.5 * span
    if effect in ("warmup", "thermal_lag"):
        values["tau"] = 0.15 * span
    return values


def _effect_sized(
    programme: library_world.Programme, s: Session, sensor: library_world.Sensor, effect: str,
    values: dict[str, float], noise: Noise, strength: float,
) -> dict[str, float] | None:  # fmt: skip
    """The values at which the effect has its strength; None where the design hardly shows it."""
    from studies.sealed.real_noise import PLAUSIBLE

    base = library_deck._earth(programme)
    plain = library_deck._stacked(*library_world.readings(programme, sensor, base))
    for _ in range(3):
        full = library_deck._stacked(*library_world.readings(programme, sensor, {**base, effect: values}))
        found = noises.energy(s, noise, world.off_base(s, full - plain))
        if not found > 0.0:
            return None
        values = library_deck._scaled(values, float(np.sqrt(strength / found)))
    sizes = [abs(v) for n, v in values.items() if not library_deck._is_shape(n, values)]
    return values if max(sizes) < PLAUSIBLE.get(effect, 1e-2) else None


def as_programme(s: Session) -> tuple[library_world.Programme, Session]:
    """The session as the other deck's world takes it, with its rate at two thousand steps a second; and with the angles
    that this rate sums up to."""
    fine = np.zeros(0)
    if s.kind == "rotation":
        steps = np.arange(int((s.t[-1] + 1e-9) * library_world.FINE_HZ) + 2) / library_world.FINE_HZ
        fine = np.interp(steps, s.t, s.rate)
        turned = np.concatenate([[0.0], np.cumsum(0.5 * (fine[1:] + fine[:-1]))]) / library_world.FINE_HZ
        s = replace(s, tf=np.interp(s.t, steps, turned))
    programme = library_world.Programme(
        s.kind, s.t, s.inc, s.tf, s.side, s.temp, s.vibration, s.pose, s.gyros, fine,
        np.radians(world.LATITUDE_DEG), np.radians(world.AZIMUTH_DEG),
    )  # fmt: skip
    return programme, s
