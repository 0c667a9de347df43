"""Diagnosis: where a recording departs from the simulation, what physics was left out, and how sure that is.

The way in is `recording.diagnose_columns`: a table of the kinds of reference, each from the columns of a recording to
its session, and so to `engine`: `diagnose_poses`, `diagnose_rotation`, `diagnose_magnitudes`, `diagnose_simulation`.
Each prepares a `Problem` of its kind and hands it to the one procedure; the answer is a `core.result.Diagnosis`. Rooms:

    core         candidates, tests, choice, rivals, memory, fits, verdict: the same for all kinds
    rows         what is looked at row by row: columns in chunks, inner products, coloured noise
    poses        a stepped session, attitudes known          rotation     a continuous rotation, attitudes known
    magnitude    attitudes unknown, |g| known                simulation   another program's output as the reference
    intake       before all: is the recording what it claims to be?
    table        published error tables, which hold statistics and no readings: an engine of their own
    laws         laws found from readings that no effect explains

`core` knows none of the others, `rows` only `core`; the kinds know nothing of one another. Theory and derivations:
docs/theory/diagnosis.md.
"""

from __future__ import annotations

__all__ = [
    "core",
    "engine",
    "intake",
    "laws",
    "magnitude",
    "poses",
    "recording",
    "rotation",
    "rows",
    "simulation",
    "table",
]
"""the ways in: modules, loaded when they are used"""
