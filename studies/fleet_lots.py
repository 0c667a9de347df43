"""Effects that lots have in common, each far too small for one tool: found, with their class? How many are invented?

A fleet is five lots of tools, three with an effect in common of about one standard deviation of a single tool, drawn
at random from the library (or from the laws that stand beside it, `--hidden laws`), and two without; in one of those
one tool has a large effect of its own. Score and information are those of a real session (simulated and diagnosed once,
126 poses while the temperature rises by 10 C); the scores of each tool are drawn about its truth.

    python -m studies.fleet_lots --fleets 50 --tools 40 [--workers 0 --parts DIR]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any

import numpy as np

import highside
from highside.arrays import Array
from highside.diagnosis.core.effect_scores import EffectScores
from highside.fleet.common import Common, LotScores, ToolScores, judge
from highside.physics.effects import all_effects
from highside.physics.law import PREFIX
from studies import over_seeds

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


@cache
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


@dataclass
class Count:
    """What a number of fleets came to."""

    found: int = 0
    alone: int = 0
    """of these, by their only name"""
    wrong: int = 0
    """named in a lot that has another effect in common"""
    invented: int = 0
    """named in a lot that has none"""
    fleets: int = 0
    """with any of these two"""
    outliers: int = 0
    others: int = 0
    """tools called out that are like their lot"""
    proofs: list[float] = field(default_factory=list)
    """of what was rightly named: the gain of its proof, in its own standard deviations"""
    false_proofs: list[float] = field(default_factory=list)
    foretold: int = 0
    """rightly named whose mean foretells as many further tools, which no figure before has seen"""
    false_foretold: int = 0


def foretells(lot: LotScores, one: Common) -> bool:
    """Whether the mean explains tools that it was not made of better than nothing does (log likelihood)."""
    score, information, _ = lot.of(lot.entries.index(one.effect))
    mean = one.pooled.mean
    return bool(np.sum(score @ mean - 0.5 * np.einsum("nij,i,j->n", information, mean, mean)) > 0.0)


def counted(count: Count, seed: int, scores: EffectScores, among: Sequence[int], odd_of: Sequence[int], n: int) -> None:
    """One fleet: three lots of `n` tools with an effect `among` those, two without, one tool with one of `odd_of`."""
    rng, later = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    hidden = rng.choice(among, size=3, replace=False)
    nothing = np.zeros(len(scores.parameters))
    lots: list[LotScores] = []
    truths: list[Array] = []
    wanted: dict[str, str] = {}
    further: dict[str, LotScores] = {}
    for k, entry in enumerate(hidden.tolist()):
        truths.append(drawn(rng, scores, entry, float(rng.uniform(*STRENGTH))))
        lots.append(lot_of(rng, scores, f"lot {k}", n, truths[-1]))
        wanted[f"lot {k}"] = scores.entries[entry]
    odd = drawn(rng, scores, int(rng.choice(odd_of)), OUTLIER)
    lots.append(lot_of(rng, scores, "odd", n, nothing, odd))
    lots.append(lot_of(rng, scores, "plain", n, nothing))
    for lot, truth in zip(lots, [*truths, nothing, nothing], strict=True):
        further[lot.lot] = lot_of(later, scores, lot.lot, n, truth)
    before = count.invented + count.wrong
    for tested in judge(lots, scores.parameters):
        right = [one for one in tested.common if wanted.get(tested.lot) in one.same]
        false = [one for one in tested.common if one not in right]
        count.found += bool(right)
        count.alone += any(one.same == (wanted[tested.lot],) for one in right)
        if tested.lot in wanted:
            count.wrong += len(false)
        else:
            count.invented += len(false)
        count.proofs += [one.proof.gain / one.proof.std for one in right]
        count.false_proofs += [one.proof.gain / one.proof.std for one in false]
        count.foretold += sum(foretells(further[tested.lot], one) for one in right)
        count.false_foretold += sum(foretells(further[tested.lot], one) for one in false)
        count.outliers += any(one.tool == "odd-3" for one in tested.outliers)
        count.others += sum(one.tool != "odd-3" for one in tested.outliers)
    count.fleets += count.invented + count.wrong > before


def entries_of(scores: EffectScores, hidden: str) -> list[int]:
    """Numbers of the entries that are `effects` of the library, or `laws`."""
    if hidden == "laws":
        return [e for e, entry in enumerate(scores.entries) if entry.startswith(PREFIX)]
    return [e for e, entry in enumerate(scores.entries) if entry.split("[")[0] in all_effects()]


def one_fleet(seed: int, hidden: str, tools: int) -> dict[str, Any]:
    """What one fleet comes to, as `Count`."""
    scores, count = scores_of_a_session(1), Count()
    counted(count, seed, scores, entries_of(scores, hidden), entries_of(scores, "effects"), tools)
    return asdict(count)


def together(counts: Sequence[dict[str, Any]]) -> Count:
    """What a number of fleets came to: numbers and lists are added."""
    total = Count()
    for own in counts:
        for name, value in own.items():
            setattr(total, name, getattr(total, name) + value)
    return total


def main() -> None:
    """Print what was found, missed and invented."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleets", type=int, default=50)
    parser.add_argument("--tools", type=int, default=40, help="of a lot")
    parser.add_argument("--first-seed", type=int, default=70_000)
    parser.add_argument("--hidden", choices=["effects", "laws"], default="effects", help="what lots have in common")
    over_seeds.add_options(parser)
    arguments = parser.parse_args()
    begun = time.perf_counter()
    scores, n = scores_of_a_session(1), arguments.fleets
    library, laws = entries_of(scores, "effects"), entries_of(scores, "laws")
    seeds = range(arguments.first_seed, arguments.first_seed + n)
    over = over_seeds.chosen(arguments)
    count = together(over(one_fleet, [(seed, arguments.hidden, arguments.tools) for seed in seeds]))
    took = time.perf_counter() - begun
    print(f"{n} fleets of 5 lots of {arguments.tools} tools, {len(library)} effects, {len(laws)} laws, {took:.0f} s")
    print(
        f"effects invented in the {2 * n} lots without one: {count.invented}; "
        f"wrongly named in the {3 * n} others: {count.wrong}; {count.fleets} of the fleets have either"
    )
    print(f"common effects found, with the truth in the class: {count.found} of {3 * n}; named alone {count.alone}")
    print(
        f"proof by tools left out, in its standard deviations: {_spread(count.proofs)}; "
        f"of what is false {_spread(count.false_proofs)}"
    )
    print(
        f"that foretell {arguments.tools} further tools each: {count.foretold} of {len(count.proofs)} rightly named, "
        f"{count.false_foretold} of {len(count.false_proofs)} falsely"
    )
    print(f"tools that stand out named: {count.outliers} of {n}; others called out: {count.others}")


def _spread(values: Sequence[float]) -> str:
    if not values:
        return "none"
    low, middle, high = np.quantile(values, [0.0, 0.5, 1.0])
    return f"{low:.1f} to {high:.1f}, median {middle:.1f}"


if __name__ == "__main__":
    main()
