"""What every kind of recording shares. The way in is `problem.Problem`, the interface that a kind of recording fills.

A candidate is what an effect of the library would add to the readings, per unit, to first order (`candidates`).
Whitened and with the base projected off (`regression`), it is tested by F against what the family of all candidates
reaches by chance when the signs of blocks are flipped (`candidate_set`). Of those that pass, held-out likelihood
chooses (`held_out`, `selection`); noise with serial correlation is a rival of everything slow (`markov`, `memory`,
`serial_correlation`). What is selected is refitted on the full model (`fit`), compared with its confounded
alternatives (`rivals`, `rival_refit`), located (`location`, `support`, `causes`) and given its verdict
(`conclusion`); `untestable` says what to do where the recording shows too little. `result` is the form of the answer,
`policy` holds every number that was decided.
"""

from __future__ import annotations

__all__ = [
    "candidate_set",
    "candidates",
    "conclusion",
    "fit",
    "location",
    "memory",
    "method",
    "policy",
    "problem",
    "result",
    "rivals",
    "selection",
]
"""the ways in: modules, loaded when they are used"""
