"""What of an answer to a case is right: names, classes, sizes, places, and whether it should have alarmed at all."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from . import deck

Row = dict[str, Any]

CLAIMING = ("named", "named_plus")
WALKS = ("walk", "sunsided", "tomisuarez", "vn100")
"""noise whose level wanders: one by construction, the others are sensors that were left alone for minutes"""


def judged(row: Row) -> Row:
    """What of an answer is right."""
    answer = row["answer"] or {"verdict": "failed", "claims": [], "not_testable": [], "location": [], "fit": {}}
    truth = list(row["truth"])
    claims = answer["claims"] if answer["verdict"] in CLAIMING else []
    classes = [set(c["equivalence_class"]) | {c["effect"]} for c in claims]
    known = row["group"] in ("single", "pair", "withheld")
    legit = set(row.get("legit", ()))
    # what a recording shows by itself is no finding of this case's, and no mistake
    kept = [not members & legit or c["effect"] in truth for c, members in zip(claims, classes, strict=True)]
    claims = [c for c, keep in zip(claims, kept, strict=True) if keep]
    classes = [members for members, keep in zip(classes, kept, strict=True) if keep]
    inside = [any(t in members for members in classes) for t in truth]
    wrong = [c["effect"] for c, members in zip(claims, classes, strict=True) if not (known and members & set(truth))]
    found: Row = {
        "verdict": answer["verdict"],
        "names": [c["effect"] for c in claims],
        "alarm": answer["verdict"] not in ("nothing_left_out", "not_testable"),
        "detected": answer["verdict"] not in ("nothing_left_out", "not_testable", "failed"),
        "wrong": bool(wrong),
        "exact": {c["effect"] for c in claims} == set(truth) and bool(claims),
        "first": bool(claims) and claims[0]["effect"] in truth,
        "in_class": bool(inside) and all(inside),
        "refused": not claims and answer["verdict"] in ("partial", "unknown", "wander", "implausible_fit"),
        "said_blind": any(t in {n["effect"] for n in answer["not_testable"]} for t in truth),
        "channels_f1": _f1(answer["location"], row["channels"]),
        "iou": _iou(answer["location"], row["interval"], row.get("settings")),
        "closed": _closed(answer["fit"] or {}),
        "errors": [], "covered": [],
    }  # fmt: skip
    if row["group"] == "null":
        # a walk is something that the noise does; to say so is right, to name a cause is not
        found["alarm"] = found["alarm"] and not (row["noise"] in WALKS and answer["verdict"] == "wander")
        found["alarm"] = found["alarm"] and not (legit and answer["verdict"] in CLAIMING and not claims)
    if row["group"] == "fault":
        found["seen"] = any(f["check"] in truth for f in answer.get("intake", ()))
        found["stopped"] = answer["verdict"] == "bad_data"
    for claim in claims:
        if known and row["group"] != "withheld" and claim["effect"] in row["truth"]:
            _parameters(claim, row["truth"][claim["effect"]], found)
    return found


def _parameters(claim: Row, truth: deck.Values, found: Row) -> None:
    sizes = {n: v for n, v in truth.items() if not deck._is_shape(n, truth) and n in claim["parameters"]}
    if not sizes:
        return
    reported = {name: claim["parameters"][name] for name in sizes}
    true = np.array(list(sizes.values()))
    factor = {n: _unit(reported[n].get("unit", "")) for n in sizes}
    value = np.array([reported[n]["value"] * factor[n] for n in sizes])
    if np.linalg.norm(true) > 0.0:
        found["errors"].append(float(np.linalg.norm(value - true) / np.linalg.norm(true)))
    for name, v in sizes.items():
        low, high = reported[name]["low"], reported[name]["high"]
        if low is not None and high is not None:
            found["covered"].append(bool(low * factor[name] <= v <= high * factor[name]))


def _unit(unit: str) -> float:
    """From the unit of a report to that of the deck (g, rad, s, m)."""
    return {"mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180, "ug": 1e-6, "mg": 1e-3, "ms": 1e-3, "mm": 1e-3}.get(
        unit, 1.0
    )


def _f1(location: list[Row], truth: list[str] | tuple[str, ...]) -> float | None:
    if not truth or not location:
        return None
    reported = {c for place in location for c in place["channels"]}
    both = len(reported & set(truth))
    return 2.0 * both / (len(reported) + len(truth))


def _iou(location: list[Row], interval: list[Any] | None, settings: list[float] | None) -> float | None:
    """What the told and the true interval have in common, of all that either has.

    Along a continuous covariate lengths are compared. Where the recording steps through a few settings (inclinations,
    stops of the toolface) there is nothing between them: an interval is then the set of settings inside, since where
    between two of them it ends is known to nobody. An inclination I that is off is (I - 0.1, I + 0.1) in truth; whoever
    says halfway to its neighbours has said the same, and whoever adds a neighbour has said twice as much. An end that
    touches a setting by rounding is inside.
    """
    if interval is None:
        return None
    covariate, low, high = interval
    best = 0.0
    for place in location:
        if place["covariate"] not in (covariate, {"tf_ref_deg": "rotor_deg"}.get(covariate)):
            continue
        reported = [(float(a), float(b)) for a, b in place["intervals"] or []]
        if settings is not None:
            true = {s for s in settings if low - 1e-3 <= s <= high + 1e-3}
            said = {s for s in settings if any(a - 1e-3 <= s <= b + 1e-3 for a, b in reported)}
            best = max(best, len(true & said) / max(len(true | said), 1))
            continue
        common = sum(max(min(b, high) - max(a, low), 0.0) for a, b in reported)
        union = sum(b - a for a, b in reported) + (high - low) - common
        best = max(best, common / union if union > 0 else 0.0)
    return best


def _closed(fit: Row) -> float | None:
    names = ("heldout_rmse_before", "heldout_rmse_after", "noise_floor")
    if any(fit.get(name) is None for name in names):
        return None
    before, after, floor = (float(fit[name]) for name in names)
    room = before**2 - floor**2
    return (before**2 - after**2) / room if room > 0.02 * before**2 else None
