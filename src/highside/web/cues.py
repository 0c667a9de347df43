"""What the technician hears: he stands at the table, and looks at the tool.

The page's script (`bench.js`) has a tone for each, and vibrates a phone; it sounds only where its reader has turned
that on.
"""

from __future__ import annotations

from enum import StrEnum

from highside.bench.session.snapshot import SessionState, Snapshot


class Cue(StrEnum):
    """What has just happened."""

    HANDS_OFF = "hands-off"
    """a measurement has begun"""
    DONE = "done"
    """a pose is taken"""
    ALL = "all"
    """the last pose is taken, and there is a result to judge"""
    KNOCK = "knock"
    """a measurement was spoilt, or its pose refused"""
    NO_DATA = "no-data"
    """nothing comes from the tool"""


def cue(before: Snapshot, after: Snapshot) -> Cue | None:
    """What is to be heard of the step from one snapshot to another that was seen later, the most important alone."""
    if after.state is SessionState.NO_DATA and before.state is not SessionState.NO_DATA:
        return Cue.NO_DATA
    if after.state is SessionState.REVIEW and before.state is not SessionState.REVIEW:
        return Cue.ALL
    if after.plan.done > before.plan.done:
        return Cue.DONE
    measured = before.state is SessionState.CAPTURING and after.state in (SessionState.GUIDING, SessionState.SETTLING)
    refused = _attempts(after) > _attempts(before)
    if refused or (measured and after.last_rejection is not None and after.plan.done == before.plan.done):
        return Cue.KNOCK
    if after.state is SessionState.CAPTURING and before.state is not SessionState.CAPTURING:
        return Cue.HANDS_OFF
    return None


def _attempts(snapshot: Snapshot) -> int:
    """How often a pose was measured, whatever became of it."""
    return sum(row.attempts for row in snapshot.poses)
