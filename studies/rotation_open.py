"""Short rotations with what was hard for `highside diagnose`: several effects at once, orders of the turn, coloured
nulls, jitter beside noise that is correlated, laws of gyros, sizes that change. Each case is drawn from its seed.

    python -m studies.rotation_open mixtures|orders|nulls|gyros|jitter|sizes [--first-seed 0] [--seeds 20] [--kind ...]
        [--strength ...] [--names-alone]

A design: six steady rates of both senses up to 1.6 turns a second, 12 s each at 25 Hz (1,900 rows; the nulls as
`--rows` says, at 50 Hz), inclination 25 to 85 deg, a temperature loop, vibration that differs from rate to rate.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.rows.session import RotationSession
from highside.physics import effects as library
from highside.physics.covariates import covariate
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.plan import Profile, RotationPlan, Session, Site
from highside.physics.state import ChainState
from studies import rotation_cases as cases
from studies.rotation_cases import FREE, GYRO_FREE, Noise, predicted, strength_of

Array = NDArray[np.float64]

SHAPES: dict[str, dict[str, float]] = {
    **cases.SINGLES,
    "cogging": {"k": 5.0},
    "wobble": {"k": 3.0},
    "thermal_lag": {"tau": 15.0},
    "warmup": {"tau": 15.0},
    "bias_step": {"t0": 29.3},
    "tone": {"f": 7.3},
    "odd_quadratic": {},
    "temperature_misalignment": {},
    "reference_voltage": {},
}
"""what mixtures are drawn of"""


def design(rng: np.random.Generator, *, hz: float = 25.0, hold_s: float = 12.0) -> ChainState:
    """The rows of one case."""
    sizes = np.array([0.25, 0.5, 0.75, 1.0, 1.3, 1.6]) * rng.uniform(0.9, 1.05, 6)
    rates = rng.permutation(sizes) * np.where(rng.permutation(6) % 2, 1, -1)
    vibration = tuple(float(v) for v in np.abs(rng.normal(0.3, 0.2, 6)))
    plan = RotationPlan(
        float(rng.uniform(25, 85)), tuple(2 * np.pi * rates), hold_s, 1.0, hz, float(rng.uniform(0, 360)), vibration
    )
    top = float(rng.uniform(35, 50))
    temperature = Profile((25.0, 25 + 0.7 * (top - 25), top, 25 + 0.5 * (top - 25), 25 + rng.uniform(0, 4)))
    site = Site(latitude_rad=cases.LATITUDE, azimuth_rad=float(rng.uniform(0, 2 * np.pi)))
    return Session(plan, site, temperature).rows().state


@dataclass(frozen=True)
class Drawn:
    """A recording, the ids of the effects in it or what else is, and the strength of each."""

    session: RotationSession
    truth: tuple[str, ...]
    note: str = ""


def _noise(state: ChainState, phi: float, *, gyros: bool = False) -> Noise:
    size = np.array([cases.SIGMA_G] * 3 + [cases.SIGMA_RADPS] * 3 * gyros)
    return Noise(phi, size, np.ones(state.n))


def mixture(seed: int, count: int | None = None) -> Drawn:
    """Three to five effects of the library, each of a strength of 400 to 9,000 by itself, AR(1) noise of 0 to 0.6."""
    rng = np.random.default_rng([seed, 31])
    state = design(rng)
    known = [name for name in SHAPES if name in library.registry() and not library.get(name).random]
    names = [str(n) for n in rng.choice(known, count or int(rng.choice([3, 3, 4, 5])), replace=False)]
    noise = _noise(state, float(rng.choice([0.0, 0.3, 0.6])))
    sensor = cases._sensor(rng, False)
    base, clean = cases._base(sensor, state, False), predicted(sensor, state, False)
    truth: dict[str, dict[str, float]] = {}
    for name in names:
        truth[name] = sized(sensor, state, name, clean, base, noise, float(np.exp(rng.uniform(6.0, 9.1))), rng)
    readings = predicted(sensor.with_effects(truth), state, False) + noise.draw(rng)
    return Drawn(RotationSession(readings, state), tuple(names))


def sized(
    sensor: ForwardModel, state: ChainState, name: str, clean: Array, base: Array, noise: Noise, strength: float,
    rng: np.random.Generator,
) -> dict[str, float]:  # fmt: skip
    """Parameters of an effect drawn at random and scaled to a strength."""
    effect, shapes = library.get(name), SHAPES.get(name, {})
    sizes = {p.name: float(rng.normal()) * p.typical for p in effect.parameters}
    sizes = {p.name: abs(sizes[p.name]) if p.gate[0] == 0.0 else sizes[p.name] for p in effect.parameters}
    factor, values = 0.1, {}
    for _ in range(4):
        values = {
            p.name: shapes.get(p.name, p.default) if p.shape else sizes[p.name] * factor for p in effect.parameters
        }
        gyros = len(clean) > len("xyz")
        added = predicted(sensor.with_effects({name: values}), state, gyros) - clean
        factor *= float(np.sqrt(strength / max(strength_of(added, base, noise), 1e-12)))
        # a size that nobody would believe is not looked for
        most = min(abs(p.gate[s > 0]) / abs(s) for p in effect.parameters if not p.shape and (s := sizes[p.name]))
        factor = min(factor, 0.7 * most)
    return values


def order(seed: int) -> Drawn:
    """A harmonic of the turn: order 1 to 20 whole, or a fraction; pick-up on an axis or an error of the toolface."""
    rng = np.random.default_rng([seed, 32])
    state = design(rng, hz=50.0, hold_s=6.0)
    sensor, noise = cases._sensor(rng, False), _noise(state, float(rng.choice([0.0, 0.4])))
    # up to the third order an axis reads as from powers of its load, at one inclination
    k = float(rng.integers(4, 21)) if rng.uniform() < 0.7 else round(float(rng.uniform(0.3, 11.0)), 2)
    wave = np.cos(k * state.tf_rad + rng.uniform(0, 6))
    where = ("ax", "ay", "toolface")[int(rng.integers(3))]
    signal = np.zeros((3, state.n))
    if where == "toolface":
        moved = gravity_direction(state.inc_rad, state.tf_rad + 1e-6) - gravity_direction(state.inc_rad, state.tf_rad)
        signal = np.asarray(moved) / 1e-6 * wave
    else:
        signal[("ax", "ay").index(where)] = wave
    # the library's own forms of the same
    truth = ("cogging",) if where == "toolface" and k == round(k) else ()
    truth = ("aliased_vibration",) if where != "toolface" and k != round(k) else truth
    base = cases._base(sensor, state, False)
    strength = float(np.exp(rng.uniform(6.0, 9.1)))
    factor = np.sqrt(strength / strength_of(signal, base, noise))
    readings = sensor.predict(state) + factor * signal + noise.draw(rng)
    return Drawn(RotationSession(readings, state), truth, f"{where} order {k:g}")


def null(seed: int, kind: str, rows: int) -> Drawn:
    """Nothing left out: `kind` is an AR(1) coefficient, `1/f`, or `walk`."""
    rng = np.random.default_rng([seed, 33, rows, *kind.encode()])
    state = design(rng, hz=50.0, hold_s=max((rows / 50 - 5) / 6, 0.5))
    shape = (3, state.n)
    if kind == "1/f":
        spectrum = np.fft.rfft(rng.standard_normal(shape), axis=1)
        frequency = np.arange(spectrum.shape[1])
        spectrum /= np.sqrt(np.maximum(frequency, 1))
        noise = np.fft.irfft(spectrum, state.n, axis=1)
        noise *= cases.SIGMA_G / noise.std(axis=1, keepdims=True)
    elif kind == "walk":
        noise = cases.SIGMA_G * (rng.standard_normal(shape) + 0.02 * np.cumsum(rng.standard_normal(shape), axis=1))
    else:
        phi = float(kind)
        noise = cases.SIGMA_G * lfilter([np.sqrt(1 - phi**2)], [1, -phi], rng.standard_normal(shape), axis=1)
    return Drawn(RotationSession(cases._sensor(rng, False).predict(state) + noise, state), (), f"{kind} {state.n}")


def gyro_law(seed: int) -> Drawn:
    """A law of a gyro: its offset or scale follows a covariate by a power, a sine or a bump, strength 400 to 9,000."""
    rng = np.random.default_rng([seed, 34])
    state = design(rng, hold_s=8.0)
    sensor, noise = cases._sensor(rng, True), _noise(state, 0.0, gyros=True)
    name = str(rng.choice(["temp", "tf", "vibration", "time", "rate"]))
    values = np.asarray(covariate(name).of(state, np.zeros((3, state.n)), -1), dtype=float)
    u = (values - values.min()) / np.ptp(values)
    shape = str(rng.choice(["bump", "sine", "fourth power"]))
    centre = rng.uniform(0.2, 0.8)
    curve = {
        "bump": np.exp(-0.5 * ((u - centre) / 0.12) ** 2),
        "sine": np.sin(2 * np.pi * (2 if name == "tf" else 1.6) * u + rng.uniform(0, 6)),
        "fourth power": (2 * u - 1) ** 4 * (1 + (2 * u - 1)),
    }[shape]
    axis, scale = int(rng.integers(3)), bool(rng.uniform() < 0.3) and name != "rate"
    if scale:
        axis = 2
    rates = sensor.gyro(state)
    signal = np.zeros((6, state.n))
    signal[3 + axis] = curve * (rates[axis] if scale else 1.0)
    strength = float(np.exp(rng.uniform(6.0, 9.1)))
    factor = np.sqrt(strength / strength_of(signal, cases._base(sensor, state, True), noise))
    readings = predicted(sensor, state, True) + factor * signal + noise.draw(rng)
    place = "gyro_scale" if scale else "gyro_offset"
    return Drawn(RotationSession(readings, state), (), f"{place} {'xyz'[axis]} {name} {shape}")


def jittered(seed: int) -> Drawn:
    """Rows sampled early or late at random by 0.1 to 1 ms, beside noise of a level that is correlated; in half of the
    cases one effect of the library more."""
    rng = np.random.default_rng([seed, 35])
    state = design(rng, hz=50.0, hold_s=6.0)
    sensor, noise = cases._sensor(rng, False), _noise(state, float(rng.choice([0.6, 0.9])))
    truth: dict[str, dict[str, float]] = {}
    if rng.uniform() < 0.5:
        name = str(rng.choice(["lever_arm", "quadratic", "encoder_first_harmonic", "temperature_bias"]))
        base, clean = cases._base(sensor, state, False), predicted(sensor, state, False)
        truth[name] = sized(sensor, state, name, clean, base, noise, 3000.0, rng)
    sigma = float(np.exp(rng.uniform(np.log(5e-5), np.log(1e-3))))
    late = state.shifted(sigma * rng.standard_normal(state.n))
    readings = sensor.with_effects(truth).predict(late) + noise.draw(rng)
    note = f"jitter {1e3 * sigma:.2g} ms beside AR(1) {noise.phi}"
    return Drawn(RotationSession(readings, state), ("sampling_jitter", *truth), note)


KINDS = ("0.7", "0.9", "0.97", "0.99", "1/f", "walk")
"""of nulls: coefficients of AR(1) noise, and what has a spectrum of its own"""
COURSES = ("constant", "step", "ramp", "wave", "half wave")
"""how the size of an effect goes over the session, its mean about 1"""


def course_of(name: str, u: Array, rng: np.random.Generator) -> Array:
    """(n,) size at instants `u` of 0 to 1 in units of its mean."""
    if name == "step":
        return np.where(u < rng.uniform(0.35, 0.65), 1.3, 0.7)
    if name == "ramp":
        return 0.5 + u
    if name == "wave":
        return 1 + 0.4 * np.cos(2 * np.pi * u + rng.uniform(0, 2 * np.pi))
    return 1 + 0.5 * np.cos(np.pi * u) if name == "half wave" else np.ones_like(u)


def changing_size(seed: int, course: str, strength: float) -> Drawn:
    """One effect of the library whose size is constant or changes over the session, beside AR(1) noise of 0.4."""
    rng = np.random.default_rng([seed, 36, *course.encode()])
    state = design(rng)
    sensor, noise = cases._sensor(rng, False), _noise(state, 0.4)
    name = ("lever_arm", "size_effect", "vibration_rectification", "temperature_bias", "backlash")[seed % 5]
    base, clean = cases._base(sensor, state, False), predicted(sensor, state, False)
    values = sized(sensor, state, name, clean, base, noise, strength, rng)
    added = predicted(sensor.with_effects({name: values}), state, False) - clean
    size = course_of(course, (state.t_s - state.t_s[0]) / np.ptp(state.t_s), rng)
    return Drawn(RotationSession(clean + size * added + noise.draw(rng), state), (name,), f"{course} {name}")


def judged(drawn: Drawn, found: DiagnosisResult) -> tuple[str, int]:
    """In a word, and how many of the effects are named or in the class of a name."""
    names = [c for c in found.claims if c.law is None]
    laws = [c for c in found.claims if c.law is not None]
    covered = {t for t in drawn.truth if any(t in (c.effect, *c.equivalence_class) for c in found.claims)}
    wrong = [c for c in names if not set(drawn.truth) & {c.effect, *c.equivalence_class}]
    course = next((name for name in COURSES[1:] if drawn.note.startswith(f"{name} ")), None)
    if course is not None and covered:
        # a name beside a law of what its size follows, or with its doubt, says that it is no constant
        told = bool(laws) or any("may be no constant" in hint for hint in found.remainder.hints)
        return "named, its change told" if told else "named as constant", len(covered)
    if " order " in drawn.note and not wrong and found.claims:
        where = drawn.note.split(" order ")[0]
        right = [c for c in laws if c.place == "toolface" or (where != "toolface" and where in c.channels)]
        return ("law" if right or not laws else "other law") + (" beside names" if names and laws else ""), len(covered)
    if not drawn.truth and not drawn.note.startswith(("toolface", "ax", "ay", "gyro")):
        # a random walk that is called one is no alarm
        quiet = found.verdict in ("nothing_left_out", "not_testable", *(["wander"] if "walk" in drawn.note else []))
        return (found.verdict if quiet else "alarm"), 0
    if wrong:
        return "wrong name", len(covered)
    if found.verdict == "nothing_left_out":
        return "nothing", 0
    if not found.claims:
        return f"refused ({found.verdict})", 0
    if drawn.truth:
        whole = len(covered) == len(drawn.truth)
        return ("all" if whole else "part") + (" and a law" if laws else ""), len(covered)
    return "law" if laws and not names else "law beside names", 0


def said(claim: Claim) -> str:
    """A claim in a word or two."""
    more = [name for name in claim.equivalence_class if name != claim.effect]
    formula = f" {claim.formula}" if claim.law is not None and claim.formula else ""
    return claim.effect + formula + (f" or {' '.join(more[:4])}" if more else "")


def drawn_cases(given: argparse.Namespace) -> Iterator[tuple[int, str, Drawn]]:
    """The cases asked for, with the seed of each and the group it counts in."""
    for seed in range(given.first_seed, given.first_seed + given.seeds):
        if given.group == "mixtures":
            yield seed, "mixtures", mixture(seed)
        elif given.group == "orders":
            yield seed, "orders", order(seed)
        elif given.group == "gyros":
            yield seed, "gyros", gyro_law(seed)
        elif given.group == "jitter":
            yield seed, "jitter", jittered(seed)
        elif given.group == "sizes":
            for strength in given.strength:
                for course in given.kind or COURSES:
                    yield seed, f"{course} {strength:g}", changing_size(seed, course, strength)
        else:
            for kind in given.kind or KINDS:
                yield seed, kind, null(seed, kind, given.rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("group", choices=["mixtures", "orders", "nulls", "gyros", "jitter", "sizes"])
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--rows", type=int, default=1200)
    parser.add_argument("--kind", nargs="*", help="of nulls or sizes: all where absent")
    parser.add_argument("--strength", type=float, nargs="*", default=[1e3, 1e4])
    parser.add_argument("--names-alone", action="store_true", help="without the search for laws")
    given = parser.parse_args()
    method = ProcedureParts(laws=not given.names_alone)
    tally: dict[str, Counter[str]] = {}
    named = [0, 0]
    for seed, group, drawn in drawn_cases(given):
        began = time.process_time()
        gyros = len(drawn.session.readings) > len("xyz")
        free = (*FREE, *GYRO_FREE) if gyros else FREE
        found, _ = diagnose_rotation(drawn.session, ForwardModel.of({}), free, method=method)
        word, count = judged(drawn, found)
        tally.setdefault(group, Counter())[word] += 1
        named = [named[0] + count, named[1] + len(drawn.truth)]
        what = drawn.note or " ".join(drawn.truth)
        claims = "; ".join(said(c) for c in found.claims) or "; ".join(found.remainder.hints[:2])
        took = time.process_time() - began
        print(f"{seed:5d} {word:14s} {found.verdict:18s} {what} -> {claims} [{took:.1f} s]", flush=True)
    for group, counts in tally.items():
        print(group, dict(counts), f"effects named or in the class {named[0]} of {named[1]}" if named[1] else "")


if __name__ == "__main__":
    main()
