"""Names that a law beside them could do nearly all of: they are cases of it."""

from __future__ import annotations

import numpy as np

from highside.diagnosis.core.regression import flattened, projected
from highside.diagnosis.laws.curves import slice_of
from highside.diagnosis.laws.evidence import raw_columns
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.policy import LAW_REPORT


def cases_of_laws(found: Found) -> set[str]:
    """Names among the terms of which a law among them could do nearly all: functions of the same, in the same place."""
    white, terms = found.whitened(), list(found.terms)
    mean, _ = white.posterior(terms)
    free = flattened(white.free)
    cases = set()
    for k, term in enumerate(terms):
        if not term.group.effect:
            continue
        does = np.tensordot(mean[slice_of(found, terms, k)], raw_columns(found.problem, [term]), 1)
        target = white.whitener.white(does[None]).reshape(-1)
        for law in terms:
            if law.group.effect:
                continue
            own = white.whitener.white(raw_columns(found.problem, [law])).reshape(law.group.size, -1)
            left = target - projected(np.concatenate([free, own]), target, LAW_REPORT.ridge)
            alone = target - projected(free, target, LAW_REPORT.ridge)
            if float(left @ left) < LAW_REPORT.case * float(alone @ alone):
                cases.add(term.group.effect)
    return cases
