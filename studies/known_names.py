"""Effects of the library in stepped sessions of any design, strengths 100 to 1e5: is each told by its name?

    python -m studies.known_names [--seed 1] [--cases 69] [--noise white coloured] [--only cogging ...] [--null]

Sessions (12 to 200 poses, returns or not, any order, rows lost, temperature in any course) and noises are those of the
open world's deck. Effects that the sealed deck's own world makes are made by it, which shares no code with the product;
the others by the product's model (marked with a star), so that of these only the choice among names and laws is judged,
not their physics. Strength is the noncentrality outside of offset, scale factor and misalignment.

right: the name alone; class: the name is in the class of the one claim; two: the name and something else; resembled: a
law in its place, which is said to resemble it; law: a law in its place; wrong: another name; implausible: refused, with
the name; refused: `unknown`, `wander`, `partial` or `not_testable`; nothing.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

import highside
from highside.errors import HighsideError
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from studies.open_world import deck, designs, noises, world
from studies.open_world.world import Columns, Session
from studies.sealed import deck as sealed
from studies.sealed import world as sealed_world
from studies.sealed.deck import Values
from studies.sealed.table import wilson

OWN = (
    "bench_settling",
    "inclination_first_harmonic",
    "inclination_second_harmonic",
    "load_hysteresis",
    "odd_quadratic",
    "reference_voltage",
    "temperature_misalignment",
)
"""effects that are made by the product's model"""
EFFECTS = (*sealed.POSE_EFFECTS, *OWN)
WORDS = ("right", "class", "two", "resembled", "law", "wrong", "implausible", "refused", "nothing")
STRENGTHS = (100.0, 1e5)


def state_of(s: Session) -> ChainState:
    """The chain's state of a session."""
    columns = world.columns(s, np.zeros((3, s.n)))
    return ChainState.from_columns(columns, latitude_rad=np.radians(52.0), azimuth_rad=np.radians(30.0))


def drawn_by_model(rng: np.random.Generator, effect: str) -> Values:
    """Amplitudes beside one another as they are typical; shapes between the ends of their grids."""
    values = {}
    for p in library.get(effect).parameters:
        if not p.shape:
            values[p.name] = float(rng.normal(0, p.typical))
        else:
            low, high = p.grid[0], p.grid[-1]
            values[p.name] = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return values


def made_by_model(
    rng: np.random.Generator, s: Session, effect: str, noise: noises.Noise, strength: float
) -> tuple[Columns, float] | None:
    """A recording with an effect that only the product's model makes, and its strength; None where it hardly shows."""
    state, known = state_of(s), library.get(effect)
    values = drawn_by_model(rng, effect)
    sensor = world.drawn_sensor(rng)
    plain = ForwardModel.of({})
    clean = np.asarray(plain.predict(state), dtype=float)
    for _ in range(3):
        full = np.asarray(plain.with_effects({effect: values}).predict(state), dtype=float)
        found = noises.energy(s, noise, world.off_base(s, full - clean))
        if not found > 1e-6:
            return None
        shapes = {p.name for p in known.shapes}
        factor = float(np.sqrt(strength / found))
        values = {name: v if name in shapes else v * factor for name, v in values.items()}
    if known.outside_gate(known.vector(values)):
        return None
    full = np.asarray(plain.with_effects({effect: values}).predict(state), dtype=float)
    found = noises.energy(s, noise, world.off_base(s, full - clean))
    read = sensor.matrix @ full + sensor.bias[:, None]
    return world.columns(s, noises.added(rng, s, noise, read)), found


def made_by_world(
    rng: np.random.Generator, s: Session, effect: str, noise: noises.Noise, strength: float
) -> tuple[Columns, float] | None:
    """The same, by the sealed deck's world."""
    programme, s = deck.as_programme(s)
    sensor = sealed_world.some_sensor(rng)
    values = deck._within_session(sealed.POSE_EFFECTS[effect](rng), effect, s)
    sized = deck._effect_sized(programme, s, sensor, effect, values, noise, strength)
    if sized is None:
        return None
    base = sealed._earth(programme)
    clean = sealed._stacked(*sealed_world.readings(programme, sensor, {**base, effect: sized}))
    plain = sealed._stacked(*sealed_world.readings(programme, sensor, base))
    found = noises.energy(s, noise, world.off_base(s, clean - plain))
    return world.columns(s, noises.added(rng, s, noise, clean)), found


def case(seed: int, number: int, effect: str, kind: str) -> tuple[Columns, float, int]:
    """Recording, strength and number of poses of a case."""
    rng = np.random.default_rng([seed, number])
    while True:
        s = designs.poses(rng)
        noise = noises.drawn(rng, s, kind)
        strength = float(np.exp(rng.uniform(*np.log(STRENGTHS))))
        poses = int(s.pose[-1]) + 1
        if not effect:
            plain = world.readings(s, world.drawn_sensor(rng))
            return world.columns(s, noises.added(rng, s, noise, plain)), 0.0, poses
        made = (made_by_model if effect in OWN else made_by_world)(rng, s, effect, noise, strength)
        if made is not None and made[1] > 0.5 * STRENGTHS[0]:
            return *made, poses


def outcome(found: dict[str, Any], truth: str) -> str:
    """What became of an effect, in a word of `WORDS`."""
    claims = found["claims"]
    hit = [truth in (claim["effect"], *claim["equivalence_class"]) for claim in claims]
    near = {name for claim in claims for name in claim.get("resembles", ())}
    near |= {*found["remainder"]["resembles"]}
    if found["verdict"] == "implausible_fit":
        return "implausible" if truth in near else "refused"
    if not claims:
        return "nothing" if found["verdict"] == "nothing_left_out" else "refused"
    if any(hit):
        if len(claims) > 1:
            return "two"
        return "right" if claims[0]["effect"] == truth else "class"
    if any(claim["effect"].startswith("law:") for claim in claims):
        return "resembled" if truth in near else "law"
    return "wrong"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--cases", type=int, default=2 * len(EFFECTS))
    parser.add_argument("--noise", nargs="+", default=["white", "coloured"], choices=noises.KINDS)
    parser.add_argument("--only", nargs="+", default=list(EFFECTS), choices=EFFECTS)
    parser.add_argument("--numbers", nargs="+", type=int, help="these cases alone")
    parser.add_argument("--null", action="store_true", help="nothing is left out")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    counted: dict[str, Counter[str]] = {kind: Counter() for kind in given.noise}
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / "model.toml"
        for number in range(given.cases):
            effect = "" if given.null else given.only[number % len(given.only)]
            turn = number if given.null else number // len(given.only)
            kind = given.noise[turn % len(given.noise)]
            if given.numbers is not None and number not in given.numbers:
                continue
            columns, strength, poses = case(given.seed, number, effect, kind)
            model.write_text("[sensor]\n")
            began = time.process_time()
            try:
                found = highside.diagnose(columns, str(model)).to_dict()
            except HighsideError as error:
                print(f"{number:3d} {effect} {poses} poses: {error}", flush=True)
                continue
            word = outcome(found, effect)
            counted[kind][word] += 1
            told = ", ".join(claim["effect"] for claim in found["claims"]) or "-"
            near = ", ".join({*found["remainder"]["resembles"], *(n for c in found["claims"] for n in c["resembles"])})
            head = f"{number:3d} {effect or 'nothing'}{'*' * (effect in OWN)} {kind}"
            print(
                f"{head:44s} {strength:8.0f} {poses:3d} poses {time.process_time() - began:5.1f} s:"
                f" {word:11s} {found['verdict']} {told} [{near}]",
                flush=True,
            )
    for kind, words in counted.items():
        whole = sum(words.values())
        for word in WORDS:
            if words[word]:
                low, high = wilson(words[word], whole)
                print(f"{kind}: {word} {words[word]} of {whole} [{100 * low:.0f}, {100 * high:.0f} %]")


if __name__ == "__main__":
    main()
