"""Noise whose memory is long beside the recording: what that leaves open is said, and no walk claimed that is none."""

from __future__ import annotations

from dataclasses import replace

from highside.diagnosis.core.policy import MEMORY
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.core.serial_correlation import RANDOM_WALK
from highside.diagnosis.core.unexplained import hinted
from highside.diagnosis.rows.gram import block_seconds
from highside.diagnosis.rows.policy import COLOUR
from highside.diagnosis.rows.session import RotationSession


def with_long_memory(diagnosis: DiagnosisResult, session: RotationSession) -> DiagnosisResult:
    """The diagnosis of a session, where its noise remembers long: how few independent stretches it holds, or that in
    so few of them a random walk cannot be told from noise that forgets. That is no finding: it is not testable."""
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
    if diagnosis.verdict != "nothing_left_out" or not long:
        return diagnosis
    memory = max(long.values())
    words = (
        f"the noise of {', '.join(long)} is correlated over some {memory:.2g} s, of which the {seconds:.0f} s hold "
        f"{max(1, round(seconds / (2 * memory)))} independent stretches: what is as slow shows only where it is large; "
        "a longer recording shows more"
    )
    return hinted(diagnosis, words)
