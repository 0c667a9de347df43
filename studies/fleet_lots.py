"""Effects that lots have in common, each far too small for one tool: found, with their class? How many are invented?

A fleet is five lots of tools, three with an effect in common of about one standard deviation of a single tool, drawn
at random from the library (or from the laws that stand beside it, `--hidden laws`), and two without; in one of those
one tool has a large effect of its own. Score and information are those of a real session (simulated and diagnosed once,
126 poses while the temperature rises by 10 C); the scores of each tool are drawn about its truth.

    python -m studies.fleet_lots --fleets 50 --tools 40
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import highside
from highside.arrays import Array
from highside.diagnosis.core.effect_scores import EffectScores
from highside.fleet.common import LotScores, ToolScores, judge
from highside.physics.effects import all_effects
from highside.physics.law import PREFIX

MODEL: dict[str, Any] = {
    "sensor": {"bias_g": [1e-3, -8e-4, 1e-3], "scale": [0.003, -0.004, 0.002]},
    "motion": {
        "kind": "poses",
        "inclinations_deg": [3, 15, 30, 45, 60, 75, 90],
        "toolfaces_deg": list(range(0, 360, 20)),
        "hold_s": 2,
        "temperatures_c": [20, 30],
    },
    "effects": {"included": ["reading_noise"], "reading_noise": {"density_ug": 50}},
}
KNOWN = {"sensor": {"noise_g": 5e-5}}
STRENGTH = (0.8, 1.6)
"""standard deviations of one tool: what a lot has in common"""
OUTLIER = 12.0
"""standard deviations: what one tool has for itself"""


def scores_of_a_session(seed: int) -> EffectScores:
    """Score and information of one session without anything left out."""
    data = highside.diagnose(highside.simulate(MODEL, seed=seed).recording, KNOWN).report_data
    scores = getattr(data, "scores", None)
    assert isinstance(scores, EffectScores)
    return scores


def amplitudes_of(scores: EffectScores) -> tuple[tuple[int, ...], ...]:
    """The places of each entry's amplitudes."""
    of = np.array(scores.entry_of)
    return tuple(tuple(np.flatnonzero(of == e).tolist()) for e in range(len(scores.entries)))


def drawn(rng: np.random.Generator, scores: EffectScores, entry: int, strength: float) -> Array:
    """(K,) amplitudes: one effect in a random direction, so large that one tool shows `strength` deviations."""
    own = list(amplitudes_of(scores)[entry])
    direction = rng.standard_normal(len(own))
    block = scores.information[np.ix_(own, own)]
    truth = np.zeros(len(scores.parameters))
    truth[own] = direction * strength / np.sqrt(direction @ block @ direction)
    return truth


def lot_of(
    rng: np.random.Generator, scores: EffectScores, name: str, tools: int, truth: Array, odd: Array | None = None
) -> LotScores:
    """Tools about one truth; the fourth may have more."""
    information = scores.information
    scale = np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    root = scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    made = []
    for i in range(tools):
        own = truth + (odd if odd is not None and i == 3 else 0.0)
        made.append(ToolScores(f"{name}-{i}", information @ own + root @ rng.standard_normal(len(own)), information))
    return LotScores(name, scores.entries, amplitudes_of(scores), tuple(made))


def main() -> None:
    """Print what was found, missed and invented."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleets", type=int, default=50)
    parser.add_argument("--tools", type=int, default=40, help="of a lot")
    parser.add_argument("--first-seed", type=int, default=70_000)
    parser.add_argument("--hidden", choices=["effects", "laws"], default="effects", help="what lots have in common")
    arguments = parser.parse_args()
    begun = time.perf_counter()
    scores = scores_of_a_session(1)
    library = [e for e, entry in enumerate(scores.entries) if entry.split("[")[0] in all_effects()]
    laws = [e for e, entry in enumerate(scores.entries) if entry.startswith(PREFIX)]
    among = library if arguments.hidden == "effects" else laws
    found = wrong = named_alone = invented = outliers = false_outliers = 0
    fleets_with_invention = 0
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.fleets):
        rng = np.random.default_rng(seed)
        hidden = rng.choice(among, size=3, replace=False)
        lots, wanted = [], {}
        for k, entry in enumerate(hidden.tolist()):
            truth = drawn(rng, scores, entry, float(rng.uniform(*STRENGTH)))
            lots.append(lot_of(rng, scores, f"lot {k}", arguments.tools, truth))
            wanted[f"lot {k}"] = scores.entries[entry]
        nothing = np.zeros(len(scores.parameters))
        odd = drawn(rng, scores, int(rng.choice(library)), OUTLIER)
        lots.append(lot_of(rng, scores, "odd", arguments.tools, nothing, odd))
        lots.append(lot_of(rng, scores, "plain", arguments.tools, nothing))
        before = invented + wrong
        for tested in judge(lots, scores.parameters):
            if tested.lot in wanted:
                right = [one for one in tested.common if wanted[tested.lot] in one.same]
                found += bool(right)
                named_alone += any(one.same == (wanted[tested.lot],) for one in right)
                wrong += len(tested.common) - len(right)
            else:
                invented += len(tested.common)
            outliers += any(one.tool == "odd-3" for one in tested.outliers)
            false_outliers += sum(one.tool != "odd-3" for one in tested.outliers)
        fleets_with_invention += invented + wrong > before
    n = arguments.fleets
    took = time.perf_counter() - begun
    print(f"{n} fleets of 5 lots of {arguments.tools} tools, {len(library)} effects, {len(laws)} laws, {took:.0f} s")
    print(
        f"effects invented or wrongly named: {invented + wrong} in {5 * n} lots, {fleets_with_invention} of the fleets"
    )
    print(f"common effects found, with the truth in the class: {found} of {3 * n}; named alone {named_alone}")
    print(f"tools that stand out named: {outliers} of {n}; others called out: {false_outliers}")


if __name__ == "__main__":
    main()
