"""Development deck of `highside diagnose`: seeded simulated cases and a table of how they end.

    python -m studies.diagnosis_deck [--runs 4] [--strengths 30 100 400] [--seed 0] [--only singles|nulls|open]
    python -m studies.diagnosis_deck --design rotation [--only singles|nulls|open|pairs] [--gyros] [--rows NAME...]

Design of the poses (of the rotation: `rotation_cases`): 7 inclinations x 12 toolfaces + 42 returns from the other
side, one pose a minute, a temperature loop 25 -> 55 -> 25 C with a bump, 40 ug of noise a pose; the sensor's bias,
scale and misalignment are drawn anew each time. `strength` is the energy of the effect in units of the noise, outside
of what the base fit absorbs. The cases share the forward model with the engine, so this is a deck to develop with: it
proves nothing blind.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.core.floor import NoiseFloor
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_poses
from highside.diagnosis.poses.session import PoseSession
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.state import ChainState
from studies.scenario import random_sensor

from . import rotation_deck

Array = NDArray[np.float64]

FREE = ("bias", "scale", "misalignment")
SIGMA_G = 40e-6
SINGLES: dict[str, dict[str, float]] = {
    "base_tilt": {},
    "axis_nonorthogonality": {},
    "reference_twist": {},
    "encoder_first_harmonic": {},
    "encoder_second_harmonic": {},
    "cogging": {"k": 4.0},
    "wobble": {"k": 3.0},
    "backlash": {},
    "sag": {},
    "quadratic": {},
    "cubic": {},
    "asymmetry": {},
    "cross_product": {},
    "temperature_bias": {},
    "temperature_bias_curvature": {},
    "temperature_scale": {},
    "thermal_lag": {"tau": 400.0},
    "thermal_hysteresis": {"width": 3.0},
    "warmup": {"tau": 900.0},
    "bias_drift": {},
    "bias_step": {"t0": 3330.0},
}


def design() -> ChainState:
    """The 126 poses."""
    forth = [(i, t, 1.0) for i in (3.0, 20.0, 45.0, 70.0, 90.0, 120.0, 150.0) for t in range(0, 360, 30)]
    back = [(i, t, -1.0) for i in (20.0, 45.0, 90.0) for t in range(345, 0, -25)][:42]
    inc, tf, direction = np.array(forth + back).T
    t_s = 60.0 * np.arange(inc.size)
    temp = 25 + 30 * np.interp(t_s / t_s[-1], [0, 0.25, 0.4, 0.5, 0.6, 1], [0, 0.6, 1, 0.8, 1, 0])
    return ChainState.build(
        np.radians(inc), np.radians(tf), t_s=t_s, direction=direction, temp_c=temp, row_seconds=60.0
    )


def white_noise(state: ChainState, rng: np.random.Generator) -> Array:
    return SIGMA_G * rng.standard_normal((3, state.n))


def one_bad_channel(state: ChainState, rng: np.random.Generator) -> Array:
    return white_noise(state, rng) * np.array([[1.0], [4.0], [1.0]])


def table_jitter(state: ChainState, rng: np.random.Generator) -> Array:
    """Stops that scatter by 20 arc seconds in both angles: correlated between the channels."""
    inc, tf = state.inc_rad + rng.normal(0, 1e-4, state.n), state.tf_rad + rng.normal(0, 1e-4, state.n)
    moved = gravity_direction(inc, tf) - gravity_direction(state.inc_rad, state.tf_rad)
    return white_noise(state, rng) + moved


def heavy_tails(state: ChainState, rng: np.random.Generator) -> Array:
    return SIGMA_G * rng.standard_t(3, (3, state.n)) / np.sqrt(3)


def coloured(state: ChainState, rng: np.random.Generator) -> Array:
    noise = rng.standard_normal((3, state.n))
    for k in range(1, state.n):
        noise[:, k] = 0.5 * noise[:, k - 1] + np.sqrt(0.75) * noise[:, k]
    return SIGMA_G * noise


def walk(state: ChainState, rng: np.random.Generator) -> Array:
    """A zero offset that walks by a fifth of the noise from pose to pose."""
    return white_noise(state, rng) + 0.2 * SIGMA_G * np.cumsum(rng.standard_normal((3, state.n)), axis=1)


NULLS: dict[str, Callable[[ChainState, np.random.Generator], Array]] = {
    "white": white_noise,
    "one bad channel x4": one_bad_channel,
    "table jitter": table_jitter,
    "heavy tails": heavy_tails,
    "coloured AR(0.5)": coloured,
    "random-walk bias": walk,
}


def outsiders(state: ChainState) -> dict[str, Array]:
    """Signals (3, n) of no effect of the library."""
    x, _, z = gravity_direction(state.inc_rad, state.tf_rad)
    warm = (state.temp_c - 40.0) / 10.0
    tf, nothing = state.tf_rad, np.zeros(state.n)
    lab_square = np.sign(np.cos(3 * tf + 0.3))
    bump = np.exp(-0.5 * ((np.mod(np.degrees(tf), 360) - 130) / 25) ** 2)
    return {
        "square wave over toolface": np.stack([lab_square, nothing, nothing]),
        "bump at one toolface": np.stack([nothing, bump, nothing]),
        "temperature x z^2": np.stack([nothing, nothing, warm * z**2]),
        "temperature x z^5": np.stack([nothing, nothing, warm * z**5]),
        "temperature x cos 3T": np.stack([warm * np.cos(3 * tf), nothing, nothing]),
        "direction x x^2": np.stack([nothing, state.direction * x**2, nothing]),
    }


def scaled(signal: Array, base: Array, strength: float) -> float:
    """Factor that gives a signal (3, n) this strength beside base columns (P, 3, n)."""
    q, _ = np.linalg.qr(base.reshape(len(base), -1).T)
    flat = signal.reshape(-1) / SIGMA_G
    left = flat - q @ (q.T @ flat)
    return float(np.sqrt(strength / (left @ left)))


def sensor_and_base(state: ChainState, rng: np.random.Generator) -> tuple[ForwardModel, Array]:
    sensor = random_sensor(rng)
    return sensor, np.asarray(sensor.jacobian(state, list(FREE)), dtype=float)


def single(state: ChainState, effect_id: str, strength: float, seed: int) -> tuple[PoseSession, dict[str, float]]:
    """A session with one effect concealed in it, and the effect's parameters."""
    rng = np.random.default_rng([seed, *effect_id.encode()])
    sensor, base = sensor_and_base(state, rng)
    effect = library.get(effect_id)
    values = {
        p.name: SINGLES[effect_id][p.name] if p.shape else float(rng.normal()) * p.typical for p in effect.parameters
    }
    small = {p.name: values[p.name] * (1.0 if p.shape else 0.1) for p in effect.parameters}
    for _ in range(2):
        signal = sensor.with_effects({effect_id: small}).predict(state) - sensor.predict(state)
        factor = scaled(signal, base, strength)
        small = {p.name: small[p.name] * (1.0 if p.shape else factor) for p in effect.parameters}
    mean = sensor.with_effects({effect_id: small}).predict(state) + white_noise(state, rng)
    return PoseSession(mean, np.ones(state.n), state), small


def outsider(state: ChainState, name: str, strength: float, seed: int) -> PoseSession:
    """A session with a signal that the library does not have."""
    rng = np.random.default_rng([seed, *name.encode()])
    sensor, base = sensor_and_base(state, rng)
    signal = outsiders(state)[name]
    mean = sensor.predict(state) + signal * scaled(signal, base, strength) + white_noise(state, rng)
    return PoseSession(mean, np.ones(state.n), state)


def null(state: ChainState, kind: str, seed: int) -> PoseSession:
    """A session with nothing left out."""
    rng = np.random.default_rng([seed, *kind.encode()])
    sensor, _ = sensor_and_base(state, rng)
    return PoseSession(sensor.predict(state) + NULLS[kind](state, rng), np.ones(state.n), state)


def measured(session: PoseSession) -> PoseSession:
    """As recorded row by row: how well means repeat is known, and a search for laws ends sooner."""
    return replace(session, floor=NoiseFloor(np.full(session.mean.shape, SIGMA_G), 1000.0))


def diagnosed(session: PoseSession, method: ProcedureParts = WHOLE) -> DiagnosisResult:
    return diagnose_poses(session, ForwardModel.of({}), FREE, method=method)[0]


def outcome(diagnosis: DiagnosisResult, truth: str) -> dict[str, bool]:
    """How a case with one effect ended."""
    named = [claim.effect for claim in diagnosis.claims]
    classes = {name for claim in diagnosis.claims for name in claim.equivalence_class}
    return {
        "detected": diagnosis.verdict != "nothing_left_out",
        "exact": named == [truth],
        "class": truth in classes,
        "wrong": bool(named) and truth not in classes,
        "refused": diagnosis.verdict in ("partial", "unknown", "wander", "implausible_fit"),
    }


def in_words(diagnosis: DiagnosisResult) -> str:
    """Verdict with what was named, or what it resembles."""
    names = [c.effect for c in diagnosis.claims] or diagnosis.remainder.resembles or diagnosis.remainder.hints
    return f"{diagnosis.verdict}:{'+'.join(names)}"


def singles_table(runs: int, strengths: list[float], seed: int) -> None:
    state = design()
    print(f"{'effect':28s}{'strength':>9s}" + "".join(f"{key:>{width}s}" for key, width in WIDTHS) + "   answers")
    for strength in strengths:
        totals: dict[str, list[bool]] = {}
        errors, inside = [], []
        for effect_id in SINGLES:
            rows, answers = [], []
            for run in range(runs):
                session, truth = single(state, effect_id, strength, seed + run)
                diagnosis = diagnosed(session)
                rows.append(outcome(diagnosis, effect_id))
                answers.append(in_words(diagnosis))
                if rows[-1]["exact"]:
                    fitted = diagnosis.claims[0].parameters
                    amplitudes = [p.name for p in library.get(effect_id).parameters if not p.shape]
                    true = np.array([truth[name] for name in amplitudes])
                    found = np.array([fitted[name].value for name in amplitudes])
                    errors.append(float(np.linalg.norm(found - true) / np.linalg.norm(true)))
                    inside += [fitted[name].low <= truth[name] <= fitted[name].high for name in amplitudes]
            shares = {key: np.mean([row[key] for row in rows]) for key in rows[0]}
            for key in rows[0]:
                totals.setdefault(key, []).extend(row[key] for row in rows)
            odd = [a for row, a in zip(rows, answers, strict=True) if not row["exact"]]
            print(
                f"{effect_id:28s}{strength:9g}"
                + "".join(f"{100 * shares[k]:{w}.0f}" for k, w in WIDTHS)
                + f"   {'; '.join(odd)}"
            )
        print(
            f"{'ALL':28s}{strength:9g}" + "".join(f"{100 * np.mean(totals[k]):{w}.1f}" for k, w in WIDTHS)
            + f"   n={len(totals['exact'])}, parameter error median {100 * np.median(errors):.1f} %,"
            f" 95 % intervals hold {100 * np.mean(inside):.1f} % of {len(inside)}"
        )  # fmt: skip


WIDTHS = (("detected", 9), ("exact", 7), ("class", 7), ("wrong", 7), ("refused", 8))


def nulls_table(runs: int, seed: int) -> None:
    state = design()
    print(f"{'null':28s}{'runs':>6s}{'alarm %':>9s}{'named %':>9s}   answers")
    for kind in NULLS:
        found = [diagnosed(null(state, kind, seed + run)) for run in range(runs)]
        alarms = [d for d in found if d.verdict != "nothing_left_out"]
        named = [d for d in alarms if d.claims]
        words = "; ".join(in_words(d) for d in alarms[:8])
        print(f"{kind:28s}{runs:6d}{100 * len(alarms) / runs:9.1f}{100 * len(named) / runs:9.1f}   {words}")


def open_table(runs: int, strengths: list[float], seed: int) -> None:
    state = design()
    print(
        f"{'outside of the library':28s}{'strength':>9s}{'refused %':>10s}{'named %':>9s}{'nothing %':>10s}   answers"
    )
    for strength in strengths:
        for name in outsiders(state):
            found = [diagnosed(outsider(state, name, strength, seed + run)) for run in range(runs)]
            named = [d for d in found if d.claims]
            nothing = [d for d in found if d.verdict == "nothing_left_out"]
            refused = len(found) - len(named) - len(nothing)
            words = "; ".join("+".join(c.effect for c in d.claims) for d in named)
            print(
                f"{name:28s}{strength:9g}{100 * refused / runs:10.1f}{100 * len(named) / runs:9.1f}"
                f"{100 * len(nothing) / runs:10.1f}   {words}"
            )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--strengths", type=float, nargs="+", default=[30.0, 100.0, 400.0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=("singles", "nulls", "open", "pairs"))
    parser.add_argument("--design", choices=("poses", "rotation"), default="poses")
    parser.add_argument("--gyros", action="store_true", help="rotation with gyros")
    parser.add_argument("--rows", nargs="*", default=[], help="rotation: only these truths or kinds of noise")
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    started = time.perf_counter()
    if given.design == "rotation":
        for only in (given.only,) if given.only else ("singles", "pairs", "nulls", "open"):
            print(f"rotation, {only}{', gyros' if given.gyros else ''}")
            rotation_deck.table(
                rotation_deck.jobs(only, given.runs, given.strengths, given.seed, given.gyros, given.rows),
                given.processes,
            )
        print(f"{time.perf_counter() - started:.0f} s")
        return
    if given.only in (None, "singles"):
        singles_table(given.runs, given.strengths, given.seed)
    if given.only in (None, "nulls"):
        nulls_table(5 * given.runs, given.seed)
    if given.only in (None, "open"):
        open_table(given.runs, given.strengths[-2:], given.seed)
    print(f"{time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
