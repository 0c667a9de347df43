"""Rivals of a strong effect, fitted to the readings as they are: what they differ by may be beyond first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.fit import JointFit
from highside.diagnosis.core.policy import EXCHANGE, RIVALS
from highside.diagnosis.core.pool import Member
from highside.diagnosis.core.rivals import Refitted, Rivalry, rivalry
from highside.diagnosis.core.scene import Judged, N, Scene


def refitted(scene: Scene[N], judged: Judged[N], claim: Member, fit: JointFit, found: Rivalry) -> list[Refitted]:
    """The nearest rivals of a claim, each fitted beside the other claims; `fit` is that of the claims themselves."""
    others = [m for m in judged.members if m != claim]
    candidates, pool = scene.candidates, judged.selector.pool
    if any(not candidates[m.candidate].named for m in judged.members):
        return []
    taken = {m.candidate for m in judged.members}
    nearest = [int(k) for k in np.argsort(found.delta_bic) if candidates[k].named and k not in taken][
        : EXCHANGE.refitted
    ]
    own = scene.glance([*others, claim])
    result = []
    for rival in (found.best[k] for k in nearest):
        more = (len(pool.columns(rival)) - len(pool.columns(claim))) * float(np.log(judged.selector.size))
        some = scene.glance([*others, rival])
        if own is not None and some is not None and some - own > RIVALS.same_class_evidence:
            # what some of the readings rule out all of them rule out
            result.append(Refitted(rival, some - own + more))
            continue
        one = scene.fit([*others, rival], judged.noise, bends=False)
        result.append(Refitted(rival, one.chi_square - fit.chi_square + more))
    return result


def exchanged(scene: Scene[N], judged: Judged[N], fit: JointFit) -> Judged[N]:
    """What was chosen, or that with one member exchanged for a rival that explains the readings better when both are
    fitted in full; with its fit, and with the refits of the rivals of what stays."""
    slow = scene.slow_ids
    best: tuple[float, list[Member]] | None = None
    refits = {}
    for m in judged.members:
        candidate = scene.candidates[m.candidate]
        if not candidate.named or candidate.id in slow or m in judged.selector.fixed:
            continue
        refits[m] = refitted(scene, judged, m, fit, rivalry(judged.selector, judged.members, m))
        for one in refits[m]:
            allowed = one.rival.candidate not in judged.selector.banned
            if allowed and one.delta_bic < (best[0] if best else 0.0):
                best = (one.delta_bic, [one.rival if o == m else o for o in judged.members])
    if best is None:
        return replace(judged, fit=fit, refits=refits)
    return replace(judged, members=best[1], fit=scene.fit(best[1], judged.noise))


def kept(scene: Scene[N], judged: Judged[N], taken_out: Sequence[str]) -> Judged[N]:
    """What was chosen, with effects of which the bend was taken out in the place of what is the same to first order.

    Where two differ only beyond that, which of them it is has been decided before, by fits in full.
    """
    for name in taken_out:
        names = [scene.candidates[m.candidate].id for m in judged.members]
        if name in names:
            continue
        for m, own in zip(judged.members, names, strict=True):
            found = rivalry(judged.selector, judged.members, m)
            k = next((k for k in found.same if scene.candidates[k].id == name), None)
            if own not in taken_out and k is not None and found.delta_bic[k] < EXCHANGE.alike:
                judged = replace(judged, members=[found.best[k] if o == m else o for o in judged.members])
                break
    return judged


def beside_refits(found: Rivalry, refits: Sequence[Refitted]) -> Rivalry:
    """The rivalry with what refits say instead of what it says to first order."""
    delta, same = found.delta_bic.copy(), list(found.same)
    for one in refits:
        k = one.rival.candidate
        delta[k] = one.delta_bic
        if delta[k] < RIVALS.same_class_bic and k not in same:
            same.append(k)
        elif delta[k] > RIVALS.same_class_evidence and k in same:
            same.remove(k)
    return replace(found, delta_bic=delta, same=tuple(same))
