"""A filter's lag and channels that are late: each is taken where it alone would delay a kind of channels by as much.

To first order the two are one, so a fit shares a delay out between them as noise will have it. What parts them is of
second order: of a delay t a lag differs by t^2 / 2 times the second derivative. It shows only where each is made about
the whole of the delay; about a part of it, each lacks what the other is given, and a wrong one stands or both do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.policy import RIVALS
from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.diagnosis.simulation.design import About
from highside.physics.effects.bandwidth_lag import EFFECT as BANDWIDTH_LAG
from highside.physics.effects.late_channel import EFFECT as LATE_CHANNEL


def taken_alike(about: About, kinds: Mapping[str, Sequence[int]], in_time: int, channels: int) -> About:
    """Where effects are taken, with lag and lateness of each kind of channels about the sum of the two.

    `kinds`: the channels of each; `in_time`: the channel by which the clock is told, which is not late. Channels of
    which one is in time, or earlier where another is later, have no delay in common.
    """
    others = [c for c in range(channels) if c != in_time]
    lag_s = np.array(about.get(BANDWIDTH_LAG.id, (0.0,) * len(kinds)), dtype=float)
    late_s = np.zeros(channels)
    late_s[others] = about.get(LATE_CHANNEL.id, (0.0,) * len(others))
    for k, own in enumerate(kinds.values()):
        members = np.array(own, dtype=np.intp)
        if in_time in own:
            continue
        least = max(float(late_s[members].min()), 0.0)
        late_s[members] += lag_s[k]
        lag_s[k] += least
    found = dict(about)
    for name, sizes in ((BANDWIDTH_LAG.id, lag_s), (LATE_CHANNEL.id, late_s[others])):
        if np.any(sizes):
            found[name] = tuple(sizes.tolist())
    return found


def with_the_other(diagnosis: DiagnosisResult, kinds: Sequence[Sequence[str]], size: float) -> DiagnosisResult:
    """The diagnosis with lag and lateness as one class where what they leave does not part them.

    A kind of channels that is late takes a delay each, a lag one for all; the rest is alike to first order. So that the
    one has more parameters, each of them log `size` of BIC, is no reason against it: what the two leave counts.
    """
    claims = tuple(_with_the_other(claim, kinds, size) for claim in diagnosis.claims)
    return diagnosis if claims == diagnosis.claims else replace(diagnosis, claims=claims)


def _with_the_other(claim: Claim, kinds: Sequence[Sequence[str]], size: float) -> Claim:
    if claim.effect not in (BANDWIDTH_LAG.id, LATE_CHANNEL.id):
        return claim
    other = LATE_CHANNEL.id if claim.effect == BANDWIDTH_LAG.id else BANDWIDTH_LAG.id
    behind = next((one.delta_bic for one in claim.rivals_ruled_out if one.effect == other), None)
    own = next((own for own in kinds if set(own) == set(claim.channels)), ())
    if behind is None or not own:
        return claim
    more = (len(own) - 1) * float(np.log(size))
    left = behind - more if claim.effect == BANDWIDTH_LAG.id else behind + more
    if left >= RIVALS.same_class_evidence:
        return claim
    return replace(
        claim,
        equivalence_class=(*claim.equivalence_class, other),
        rivals_ruled_out=tuple(one for one in claim.rivals_ruled_out if one.effect != other),
    )
