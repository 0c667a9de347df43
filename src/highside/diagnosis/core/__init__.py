"""What every kind of recording shares. The way in is `scene.Scene`, the interface that a kind of recording fills.

A candidate is what an effect of the library would add to the readings, per unit, to first order (`candidates`).
Whitened and with the base projected off (`regression`), it is tested by F against what the family of all candidates
reaches by chance when the signs of blocks are flipped (`pool`). Of those that pass, held-out likelihood chooses
(`held_out`, `selection`); a noise with memory is a rival of everything slow (`markov`, `memory`, `suspicion`). What
is chosen is refitted on the full model (`fit`), compared with what it cannot be told from (`rivals`, `exchange`),
placed (`location`, `support`, `causes`) and given its verdict (`conclusion`); `untestable` says what to do where the
recording shows too little. `result` is the form of the answer, `policy` and `numerics` hold every number that was
decided.
"""

from __future__ import annotations

__all__ = [
    "candidates",
    "conclusion",
    "fit",
    "location",
    "memory",
    "method",
    "policy",
    "pool",
    "result",
    "rivals",
    "scene",
    "selection",
]
"""the ways in: modules, loaded when they are asked for"""
