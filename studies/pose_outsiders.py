"""Pose tables of 72 poses as a laboratory keeps them, with what people meet: is the answer right?

    python -m studies.pose_outsiders [orders] [outlying] [sizes] [nulls] --seeds 30 --first-seed 100

`orders`: an offset of one whole order of toolface, 3 to 8, of 0.5 to 100 mg, at 12, 18 or 24 toolfaces. `outlying`: one
pose 25 sigma off. `sizes`: a law over temperature beside a tilt that the simulation has at a wrong size. `nulls`:
nothing, in seven noises. Readings scatter by 0.2 mg; offsets, scale factors and the matrix are drawn. Deliberately not
made with the product's simulator.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.api.diagnosis import Diagnosis, diagnose
from highside.config.model import Model
from studies.sealed.table import wilson

Array = NDArray[np.float64]
SIGMA_G = 2e-4
N = 72
MODEL: dict[str, Any] = {"sensor": {"noise_g": SIGMA_G}}
TILT_DEG = 0.05
NOISES = ("white", "uniform", "Student 3", "AR 0.7", "unequal channels", "random walk", "quantised")


def load_of(inc_deg: Array, tf_deg: Array) -> Array:
    """(3, N) gravity along the tool's axes, g."""
    inc, tf = np.radians(inc_deg), np.radians(tf_deg)
    return np.vstack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])


def tilted(inc_deg: Array, tf_deg: Array, tilt_deg: float) -> Array:
    """(3, N) gravity where the bench's vertical leans by `tilt_deg` to x and by as much to the other side of y."""
    v = np.array([np.radians(tilt_deg), -np.radians(tilt_deg), 1.0])
    v /= np.linalg.norm(v)
    i, t = np.radians(inc_deg), np.radians(tf_deg)
    x = np.cos(i) * v[0] + np.sin(i) * v[2]
    z = -np.sin(i) * v[0] + np.cos(i) * v[2]
    return np.vstack([np.cos(t) * x - np.sin(t) * v[1], np.sin(t) * x + np.cos(t) * v[1], z])


def table(rng: np.random.Generator, inc: Array, tf: Array, temp: Array, added: Array, noise: Array) -> dict[str, Array]:
    """Columns of a pose table of an instrument that is drawn."""
    load = (np.eye(3) + rng.normal(0, 2e-3, (3, 3))) @ load_of(inc, tf) + rng.normal(0, 3e-3, (3, 1))
    read = load + added + noise
    return {"inc_ref_deg": inc, "tf_ref_deg": tf, "temp_c": temp, "ax": read[0], "ay": read[1], "az": read[2]}


def white(rng: np.random.Generator, n: int = N) -> Array:
    return SIGMA_G * rng.standard_normal((3, n))


def design(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Poses at random and a temperature that wanders."""
    return rng.uniform(5, 170, N), rng.uniform(0, 360, N), 25 + 20 * np.cumsum(rng.normal(0, 0.2, N)) / 3


def orders(seed: int) -> tuple[str, bool]:
    rng = np.random.default_rng([seed, 1])
    order, count, size = int(rng.integers(3, 9)), int(rng.choice([12, 18, 24])), 10 ** rng.uniform(-3.3, -1)
    inc, tf = np.tile(np.arange(6) * 30.0, count), np.repeat(np.arange(count) * 360.0 / count, 6)
    added = np.zeros((3, inc.size))
    added[0] = size * np.sin(order * np.radians(tf) + 1.0)
    temp = 20 + 40 * ((np.arange(inc.size) * 5) % inc.size) / inc.size
    made = diagnose(table(rng, inc, tf, temp, added, white(rng, inc.size)), Model.model_validate(MODEL))
    right = len(made.claims) == 1 and f" cos({order} tf)" in (made.claims[0].formula or "")
    return f"order {order} at {count} toolfaces, {1e3 * size:.2g} mg: {said(made)}", right


def outlying(seed: int) -> tuple[str, bool]:
    rng = np.random.default_rng([seed, 2])
    inc, tf, temp = design(rng)
    noise, channel, pose = white(rng), int(rng.integers(3)), int(rng.integers(N))
    noise[channel, pose] += 25 * SIGMA_G * rng.choice([-1, 1])
    made = diagnose(table(rng, inc, tf, temp, np.zeros((3, N)), noise), Model.model_validate(MODEL))
    named = [finding.remedy.split(" of ")[0] for finding in made.intake if finding.check == "outlying_pose"]
    return f"pose {pose + 1}: {said(made)}; {named}", made.verdict == "nothing_left_out" and named == [
        f"pose {pose + 1}"
    ]


def sizes(seed: int) -> tuple[str, bool]:
    rng = np.random.default_rng([seed, 3])
    inc, tf, temp = design(rng)
    true = float(rng.choice([0.0, 0.02, 0.1, 0.2]))
    added = tilted(inc, tf, true) - load_of(inc, tf)
    middle = float(np.median(temp))
    added[1] += 3e-3 * np.tanh((temp - middle) / 2)
    tilt = {"tilt_x_deg": TILT_DEG, "tilt_y_deg": -TILT_DEG}
    knows = Model.model_validate(MODEL | {"effects": {"included": ["base_tilt"], "base_tilt": tilt}})
    made = diagnose(table(rng, inc, tf, temp, added, white(rng)), knows)
    names = [claim for claim in made.claims if not claim.effect.startswith("law:")]
    laws = [claim for claim in made.claims if claim.effect.startswith("law:")]
    right = [claim.effect for claim in names] == ["base_tilt"] and all(
        abs(p.value - sign * np.radians(true)) < max(4 * p.std, 1e-4)
        for p, sign in zip(names[0].parameters.values(), (1, -1), strict=True)
    )
    return f"tilt {true:g} deg: {said(made)}", right and [claim.depends_on for claim in laws] == [("temp",)]


def nulls(seed: int) -> tuple[str, bool]:
    rng = np.random.default_rng([seed, 4])
    inc, tf, temp = design(rng)
    kind = NOISES[seed % len(NOISES)]
    noise = white(rng)
    if kind == "uniform":
        noise = rng.uniform(-np.sqrt(3), np.sqrt(3), (3, N)) * SIGMA_G
    elif kind == "Student 3":
        noise = SIGMA_G * rng.standard_t(3, (3, N)) / np.sqrt(3)
    elif kind == "AR 0.7":
        for k in range(1, N):
            noise[:, k] = 0.7 * noise[:, k - 1] + np.sqrt(0.51) * noise[:, k]
    elif kind == "unequal channels":
        noise *= np.array([[1.0], [5.0], [0.3]])
    elif kind == "random walk":
        noise += np.cumsum(rng.normal(0, 0.2 * SIGMA_G, (3, N)), axis=1)
    columns = table(rng, inc, tf, temp, np.zeros((3, N)), noise)
    if kind == "quantised":
        columns |= {name: np.round(columns[name] / 5e-4) * 5e-4 for name in ("ax", "ay", "az")}
    made = diagnose(columns, Model.model_validate(MODEL))
    quiet = made.verdict == "nothing_left_out" or (kind == "random walk" and made.verdict == "wander")
    return f"{kind}: {said(made)}", quiet and not made.claims


def said(made: Diagnosis) -> str:
    claims = ", ".join(f"{claim.effect} ({claim.formula})" if claim.law else claim.effect for claim in made.claims)
    return f"{made.verdict} {claims}".rstrip()


GROUPS: dict[str, Callable[[int], tuple[str, bool]]] = {
    "orders": orders,
    "outlying": outlying,
    "sizes": sizes,
    "nulls": nulls,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("groups", nargs="*", metavar="|".join(GROUPS))
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--first-seed", type=int, default=100)
    args = parser.parse_args()
    for name in args.groups or GROUPS:
        if name not in GROUPS:
            parser.error(f"{name!r} is none of {', '.join(GROUPS)}")
        right = 0
        for seed in range(args.first_seed, args.first_seed + args.seeds):
            words, good = GROUPS[name](seed)
            right += good
            if not good:
                print(f"  {name} {seed}: {words}", flush=True)
        low, high = wilson(right, args.seeds)
        print(f"{name}: {right} of {args.seeds} right [{100 * low:.0f}, {100 * high:.0f} %]", flush=True)


if __name__ == "__main__":
    main()
