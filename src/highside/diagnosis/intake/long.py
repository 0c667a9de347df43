"""Is a recording that is not in the memory what it claims to be? The checks of `checks`, stretch by stretch.

Each stretch is a recording of its own to them, and a finding says of how many it is true; its probability by chance is
multiplied by the number of stretches. What only all rows together show (a clock whose rate changes over the days, a
limit that is reached a few times in a million rows) is not seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.result import Finding
from highside.diagnosis.intake.checks import Intake, check
from highside.diagnosis.intake.policy import CHECKS
from highside.long_arrays import runs_of


def check_stretches(columns: Mapping[str, Array], needed: Sequence[str], axes: Sequence[tuple[int, float]]) -> Intake:
    """As `checks.check`, of columns (N,) that are read run by run. A fault of any stretch that spoils it spoils all."""
    n = columns["t_s"].shape[-1]
    parts = list(runs_of(n, CHECKS.stretch))
    if len(parts) > 1 and parts[-1].stop - parts[-1].start < CHECKS.stretch // 2:
        # too short a rest belongs to the stretch before it
        parts[-2:] = [slice(parts[-2].start, n)]
    found: dict[tuple[str, tuple[str, ...]], list[Finding]] = {}
    spoiling: set[str] = set()
    clipped: dict[int, tuple[float, float]] = {}
    impulses = []
    for part in parts:
        own = check({name: values[part] for name, values in columns.items()}, needed, axes)
        for finding in own.findings:
            begin, end = (float(columns["t_s"][row]) for row in (part.start, part.stop - 1))
            told = replace(finding, remedy=f"from {begin:g} to {end:g} s: {finding.remedy}")
            found.setdefault((finding.check, finding.channels), []).append(told)
        if own.spoiled:
            spoiling.add(own.findings[0].check)
        share = (part.stop - part.start) / n
        for channel, (of_stretch, limit) in own.clipped.items():
            before = clipped.get(channel, (0.0, limit))
            clipped[channel] = (before[0] + of_stretch * share, min(before[1], limit))
        impulses.append(part.start + own.impulses)
    findings = [_of_all(every, len(parts)) for every in found.values()]
    findings.sort(key=lambda one: one.check not in spoiling)
    return Intake(tuple(findings), bool(spoiling), clipped, np.concatenate(impulses))


def _of_all(every: Sequence[Finding], stretches: int) -> Finding:
    """What is said of a fault that some stretches have."""
    surest = min(every, key=lambda one: one.p)
    words = surest.remedy if stretches == 1 else f"in {len(every)} of {stretches} stretches, {surest.remedy}"
    return replace(surest, p=float(min(1.0, surest.p * stretches)), remedy=words)
