"""Stepped sessions with one effect, or a signal outside of the library, at sizes of six decades: does an answer once
right stay right as the size increases?

    python -m studies.pose_strengths [--only wobble warmup] [--first-seed 400] [--seeds 1] [--laws]

The 126 poses of `studies.diagnosis_deck`, white noise. A size is the root mean square of what the effect does outside
of offset, scale factor and misalignment, in standard deviations of the noise: 1 to 10^6. An answer is `named` (the
truth is in the class of a claim), `near` (it is not named, but among what the remainder resembles), `placed` (refused,
with a place), `refused`, `wander` (taken for a random walk, which none of these is), `wrong` (another name or law
alone) or `nothing`. A sweep is monotone if after `named` nothing but `named`, `near` or `placed` follows, and after any
alarm no `nothing`. Sizes beyond the plausible range of an effect are reported as such by the engine
(`implausible_fit`), which counts as `near` or `placed`.
"""

from __future__ import annotations

import argparse

from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_poses
from highside.diagnosis.poses.session import PoseSession
from highside.physics.forward import ForwardModel
from studies import diagnosis_deck as deck

SIZES = (1.0, 10.0, 37.0, 1e2, 1e3, 1e4, 1e5, 1e6)
STATE = deck.design()
OUTSIDE = tuple(deck.outsiders(STATE))


def session_of(name: str, size: float, seed: int) -> PoseSession:
    """One effect or outsider of a size, in standard deviations."""
    strength = size**2 * 3 * STATE.n
    if name in OUTSIDE:
        return deck.outsider(STATE, name, strength, seed)
    return deck.single(STATE, name, strength, seed)[0]


def judged(found: DiagnosisResult, truth: str) -> str:
    """The answer in a word."""
    names = {name for claim in found.claims for name in (claim.effect, *claim.equivalence_class)}
    if found.verdict == "nothing_left_out":
        return "nothing"
    if truth in names or (truth in OUTSIDE and found.claims and all(c.law is not None for c in found.claims)):
        return "named"
    if found.claims:
        return "wrong"
    if found.verdict == "wander":
        # none of these departures is a random walk, whatever the remainder resembles beside it
        return "wander"
    if truth in (*found.remainder.resembles, *found.remainder.changing):
        return "near"
    return "placed" if found.location else "refused"


def monotone(words: list[str]) -> bool:
    """Whether a sweep of growing sizes forgets nothing."""
    first = words.index("named") if "named" in words else len(words)
    alarm = next((k for k, word in enumerate(words) if word != "nothing"), len(words))
    return not {"wrong", "refused", "wander", "nothing"} & set(words[first:]) and "nothing" not in words[alarm:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", nargs="*", default=[*deck.SINGLES, *OUTSIDE])
    parser.add_argument("--first-seed", type=int, default=400)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--laws", action="store_true", help="search laws too")
    given = parser.parse_args()
    method = WHOLE if given.laws else ProcedureParts.without("laws")
    kept = count = 0
    for name in given.only:
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            words, said = [], []
            for size in SIZES:
                found = diagnose_poses(session_of(name, size, seed), ForwardModel.of({}), deck.FREE, method=method)[0]
                words.append(judged(found, name))
                said.append(f"{size:g} {words[-1]} ({deck.in_words(found)})")
            kept, count = kept + monotone(words), count + 1
            print(f"{'monotone' if monotone(words) else 'NOT'} {name} {seed}: {'; '.join(said)}", flush=True)
    print(f"monotone {kept} of {count}")


if __name__ == "__main__":
    main()
