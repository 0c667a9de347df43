"""Noise whose memory is long beside the recording: what that leaves open is said, and no random walk or effect claimed
that is none."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.memory_policy import MEMORY
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.core.serial_correlation import RANDOM_WALK
from highside.diagnosis.core.unexplained import hinted
from highside.diagnosis.rows.policy import COLOUR
from highside.diagnosis.rows.segments import block_seconds
from highside.diagnosis.rows.session import RotationSession


def with_long_memory(diagnosis: DiagnosisResult, session: RotationSession) -> DiagnosisResult:
    """The diagnosis of a session, where its noise remembers long: how few independent stretches it holds, or that in
    so few of them a random walk cannot be told from noise that forgets, nor a small effect from either. That is no
    finding: it is not testable."""
    noise, block_s = diagnosis.noise, block_seconds(session)
    seconds = float(session.state.t_s[-1] - session.state.t_s[0])
    names = ("memory_evidence", "memory_poses", "memory_lead")
    found = list(zip(session.channels, *(noise.get(name, ()) for name in names), strict=False))
    known = [(channel, length, lead) for channel, gain, length, lead in found if gain > MEMORY.found]
    leads = [lead for _, length, lead in known if length == RANDOM_WALK]
    if diagnosis.verdict == "wander" and leads and sum(leads) < COLOUR.lead:
        words = (
            f"in {seconds:.0f} s a random walk of the zero offsets and noise that is correlated over seconds cannot be "
            "distinguished, nor slow effects from either: record ten times as long"
        )
        return hinted(replace(diagnosis, verdict="not_testable"), words)
    # independent stretches lie two memories apart
    long = {channel: length * block_s for channel, length, _ in known if length != RANDOM_WALK}
    long = {channel: memory for channel, memory in long.items() if seconds < 2 * COLOUR.stretches * memory}
    if not long:
        return _beside_filter(diagnosis, session, seconds)
    memory = max(long.values())
    stretches = max(1, round(seconds / (2 * memory)))
    words = (
        f"the noise of {', '.join(long)} is correlated over some {memory:.2g} s, of which the {seconds:.0f} s hold "
        f"{stretches} independent stretches"
    )
    if diagnosis.verdict == "nothing_left_out":
        evidence = dict(zip(session.channels, noise["memory_evidence"], strict=False))
        if stretches < COLOUR.few and _of_some_alone(evidence, long):
            words = f"{words}: what is left cannot be distinguished from such noise; record ten times as long"
            return hinted(replace(diagnosis, verdict="not_testable"), words)
        return hinted(
            diagnosis, f"{words}: what is as slow shows only where it is large; a longer recording shows more"
        )
    if stretches >= COLOUR.few or not is_doubtful(diagnosis):
        return diagnosis
    claimed = tuple(claim.effect for claim in diagnosis.claims)
    like = f"what looks like {' and '.join(claimed)}" if claimed else "what is left"
    remainder = replace(diagnosis.remainder, resembles=(*claimed, *diagnosis.remainder.resembles))
    doubted = replace(diagnosis, verdict="not_testable", claims=(), location=(), remainder=remainder)
    return hinted(doubted, f"{words}: {like} cannot be distinguished from such noise; record ten times as long")


def _of_some_alone(evidence: Mapping[str, float], long: Collection[str]) -> bool:
    """Whether some axes certainly remember and others of their kind do not: sensors of one triad have noise alike."""
    kinds = {name[:1] for name in long if evidence[name] > COLOUR.alone}
    return any(name[:1] in kinds and found <= MEMORY.found for name, found in evidence.items())


def _beside_filter(diagnosis: DiagnosisResult, session: RotationSession, seconds: float) -> DiagnosisResult:
    """The same where what remembers is the filter of the rows: a small remainder may be an error of its colour."""
    roots = [float(np.abs(np.roots(one)).max(initial=0.0)) for one in diagnosis.noise.get("filters", ())]
    memory = session.step_s / max(1.0 - max(roots, default=0.0), 1e-9)
    if diagnosis.claims or seconds > 2 * COLOUR.filtered * memory or not is_doubtful(diagnosis):
        return diagnosis
    words = (
        f"the noise is correlated over some {memory:.2g} s, and {seconds:.0f} s were recorded: what is left cannot be "
        "distinguished from an error of its colour; record ten times as long"
    )
    return hinted(replace(diagnosis, verdict="not_testable", location=()), words)


def is_doubtful(diagnosis: DiagnosisResult) -> bool:
    """Whether all that was found is so little that noise of a colour that is hardly known may make it."""
    if diagnosis.claims:
        return all(
            claim.p_familywise > (COLOUR.chance if claim.law is None else COLOUR.law_chance)
            for claim in diagnosis.claims
        )
    found = [place.p for place in diagnosis.location]
    return diagnosis.verdict in ("unknown", "partial") and bool(found) and min(found) > COLOUR.chance
