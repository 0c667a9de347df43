"""What of an answer is right: places, covariates, names, "nothing was left out", what another session confirms."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from . import world
from .world import Session

Row = dict[str, Any]
Key = tuple[str, frozenset[str]]

OUTSIDE = 40.0
"""units of strength of what is hidden that must lie outside of a name for that name to be wrong: below, no margin of
any evidence can tell the two apart (trial of about 1,500 sessions)"""
STRONG = 400.0
WEAK = 30.0
"""below it nothing need be seen"""
SILENT = ("nothing_left_out",)
NOISE_NAMES = {
    "jitter": ("sampling_jitter", "pose_error"), "walk": ("wander", "gyro_wander"), "quantised": ("quantisation",),
    "one_over_f": ("wander", "gyro_wander", "coloured_noise"), "coloured": ("coloured_noise", "wander", "gyro_wander"),
}  # fmt: skip
"""what the library calls each noise"""
PLACES = (
    "offset", "scale", "scale_all", "matrix", "inclination", "toolface", "timing", "level", "gyro_offset", "gyro_scale",
    "channel_offset", "channel_factor", "channel_delay",
)  # fmt: skip
"""where an answer may put a law"""
OF_NOTES = {"kink of load": "law:offset_*load*"}
"""what is right of cases whose sealed answer does not say it, by the beginning of its note"""
COVARIATES_OF_LABEL = re.compile(r"((?:previous_)?load_[xyz]|.+?)(?:_x_(.+))?")
"""one name or two; that of a load may end as the word between two begins"""
LAGGING = re.compile(r"temp_filtered_[0-9]+")
QUIET = ("nothing_left_out", "not_testable")


# --- what another session confirms ---------------------------------------------------------------------------------


def closed(s: Session, truth: np.ndarray, predicted: np.ndarray, sigma: tuple[float, ...]) -> float | None:
    """Share of a true contribution (C, n) that predicted readings (C, n) have, off offset, scale and misalignment.

    1 - |truth - predicted|^2 / |truth|^2 in units of each channel's noise; negative where the prediction is worse than
    none. Rows without a number in either are left away.
    """
    rows = np.isfinite(truth).all(axis=0) & np.isfinite(predicted).all(axis=0)
    if rows.sum() < 20:
        return None
    part = s.rows(rows)
    weight = 1.0 / np.array(sigma)[:, None]
    true = weight * world.off_base(part, truth[:, rows])
    missed = true - weight * world.off_base(part, predicted[:, rows])
    whole = float(np.sum(true**2))
    return 1.0 - float(np.sum(missed**2)) / whole if whole > 0.0 else None


def outside(s: Session, hidden: np.ndarray, columns: np.ndarray, sigma: tuple[float, ...]) -> float:
    """Strength of what is hidden (C, n; in noise units, off the base) that columns (P, C, n) of named effects leave."""
    target = hidden.ravel()
    rows = [(world.off_base(s, column) / np.array(sigma)[:, None]).ravel() for column in columns]
    if not rows:
        return float(target @ target)
    matrix = np.array(rows).T
    norms = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, norms > 1e-12 * max(norms.max(), 1e-300)]
    u, size, _ = np.linalg.svd(matrix / np.linalg.norm(matrix, axis=0), full_matrices=False)
    q = u[:, size > 1e-9 * size[0]]
    left = target - q @ (q.T @ target)
    return float(left @ left)


# --- place and covariates ------------------------------------------------------------------------------------------


def accepted(law: Row, design: str) -> set[Key]:
    """The places and covariates that say the same as a law does, in the words of `diagnosis.json`."""
    channels = {axis for axis, weight in zip("xyz", law["weights"], strict=False) if weight}
    places = {law["place"]}
    if law["place"] == "scale" and len(channels) == 3:
        places |= {"scale_all"}
    if law["place"] == "matrix":
        channels = {"xyz"[law["element"][0]]}
    options: list[set[str]] = []
    for name in law["covariates"]:
        same = {name}
        if name.startswith("load_"):
            if channels == {name[-1]}:
                same.add("load")
            if name == "load_z":
                same.add("inc")  # the cosine of it
            if design == "rotation":
                same.add("tf")  # at one inclination a load on x or y is a function of the toolface
        if name.startswith("previous_load"):
            same.add("previous_load")
        if name == "tf":
            same.add("tf_fraction")
        if name == "inc" and design == "poses":
            same.add("load_z")
            if channels == {"z"}:
                same.add("load")
        if name == "rate":
            same.add("rate_sign") if law["shape"]["kind"] in ("threshold_tanh", "saturation") else None
        options.append(same)
    chosen = [frozenset()]
    for same in options:
        chosen = [kept | {one} for kept in chosen for one in sorted(same)]
    keys = {(place, covariates) for place in places for covariates in chosen}
    if law["place"] == "timing":
        # an angle read late is wrong by the rate times the delay; on accelerometers the two are one
        keys |= {("toolface", covariates | {"rate"}) for _, covariates in keys}
    if law["place"] == "toolface" and "rate" in law["covariates"]:
        keys |= {("timing", covariates) for _, covariates in keys}
    if leans_as_inclined(law):
        keys |= {("inclination", covariates) for _, covariates in keys}
    if law["onset_s"] is not None:
        keys |= {(place, covariates | {"time"}) for place, covariates in keys}
    return keys


def leans_as_inclined(law: Row) -> bool:
    """Whether a law is a lean of the bench about the axis of the inclination: that is an error of the inclination, and
    its readings are those of one to the third order of the lean."""
    return bool(law["place"] == "level" and [bool(weight) for weight in law["weights"]] == [True, False, False])


def wider(truth: set[Key], claim: Key) -> bool:
    """Whether a claim holds a law in other words: as an offset that follows the load as well, or one covariate more."""
    place, covariates = claim
    for true_place, true_covariates in truth:
        if place == true_place and covariates > true_covariates:
            return True
        if place == "offset" and true_place in ("scale", "scale_all", "matrix") and covariates > true_covariates:
            return True
    return False


def key_of(claim: Row) -> Key:
    return claim.get("place") or "", _covariates(claim.get("depends_on") or ())


def key_of_label(label: str) -> Key | None:
    """Place and covariates of `law:place_channels_covariate_x_covariate`, as classes tell their members."""
    own = label.removeprefix("law:").partition("--")[0]
    place = max((p for p in PLACES if own.startswith(f"{p}_")), key=len, default="")
    if not label.startswith("law:") or not place:
        return None
    follows = own.removeprefix(f"{place}_").partition("_")[2]
    names = COVARIATES_OF_LABEL.fullmatch(follows)
    return place, _covariates(name for name in names.groups() if name) if names else frozenset()


def _covariates(names: Iterable[str]) -> frozenset[str]:
    """Names of covariates; of temperatures that lag the time constant does not count."""
    return frozenset(LAGGING.sub("temp_filtered", name) for name in names)


def is_law(claim: Row) -> bool:
    return claim["effect"].startswith("law")


# --- the whole answer ----------------------------------------------------------------------------------------------


def judged(row: Row) -> Row:
    """What of an answer is right. `row` holds the sealed truth, the command's answer and what was measured of it."""
    truth = row["truth"]
    answer = row["answer"] or {"verdict": "failed", "claims": []}
    claims = answer["claims"] if answer["verdict"] not in (*QUIET, "bad_data", "failed") else []
    # what the noise itself is, told as that, is neither an alarm nor a wrong name
    claims = [c for c in claims if c["effect"] not in NOISE_NAMES.get(truth["noise"], ())]
    only_noise = bool(answer["claims"]) and not claims
    names = [c["effect"] for c in claims if not is_law(c)]
    reported = [c for c in claims if is_law(c)]
    known = truth["effects"]
    allowed = [pattern for pattern in truth["right"] if not pattern.startswith("verdict:")]
    allowed += [law for note, law in OF_NOTES.items() if truth["note"].startswith(note)]
    verdicts = [pattern.removeprefix("verdict:") for pattern in truth["right"] if pattern.startswith("verdict:")]
    classes = [set(c["equivalence_class"]) | {c["effect"]} for c in claims if not is_law(c)]
    right_names = [any(k in known or _matches(k, allowed) for k in members) for members in classes]
    keys = [accepted(law, truth["design"]) for law in truth["laws"]]
    exact = [any(key_of(c) in options for c in reported) for options in keys]
    in_class = [hit or any(_in_class(options, c) for c in reported) for hit, options in zip(exact, keys, strict=True)]
    stray = [c for c in reported if not any(key_of(c) in o or _in_class(o, c) for o in keys)]
    left = row.get("outside")
    # beside nothing at all every name is wrong
    beside = not all(right_names) and (left is None or left >= OUTSIDE or bool(known) or not keys)
    if beside and left is not None and truth["laws"] and any(exact) and row.get("captured", 0.0) > 0.1:
        beside = False  # part of the law has a name, the rest is told as the law that it is
    named_known = bool(known) and all(any(k in m for m in classes) for k in known)
    laws = [set(c["equivalence_class"]) | {c["effect"]} for c in reported]
    covered = _covered(known, laws, classes, allowed, exact, in_class, verdicts, answer["verdict"])
    found: Row = {
        "verdict": answer["verdict"], "names": names,
        "told": [f"{p}({', '.join(sorted(c))})" for p, c in map(key_of, reported)],
        "alarm": answer["verdict"] not in (*QUIET, "failed") and not _walks(truth, answer) and not only_noise,
        "false_law": bool(reported) and not keys, "wrong_name": bool(names) and beside,
        "exact": bool(keys) and all(exact) and not stray, "in_class": bool(keys) and all(in_class) and not stray,
        "first_exact": bool(keys) and all(exact), "nothing": answer["verdict"] in SILENT,
        "closed": row.get("closed"), "named": named_known, "right": covered,
        "known_exact": bool(known) and set(names) == set(known) and not reported,
        "known_law": bool(known) and bool(reported) and not names,
        "weak": bool(0.0 < truth["strength"] < WEAK), "failed": row["answer"] is None,
        "bad_data": answer["verdict"] == "bad_data",
    }  # fmt: skip
    found["bucket"] = _bucket(found)
    return found


def _matches(name: str, patterns: list[str]) -> bool:
    return any(fnmatch.fnmatch(name, pattern) for pattern in patterns)


def _in_class(options: set[Key], claim: Row) -> bool:
    members = {key_of(claim)} | {key_of_label(m) for m in claim.get("equivalence_class", ())} - {None}
    return any(m in options or (m is not None and wider(options, m)) for m in members)


def _walks(truth: Row, answer: Row) -> bool:
    """That a level wanders is right where it does."""
    return truth["noise"] in ("walk", "one_over_f", "coloured") and answer["verdict"] == "wander"


def _covered(
    known: Row, laws: list[set[str]], classes: list[set[str]], allowed: list[str], exact: list[bool],
    in_class: list[bool], verdicts: list[str], verdict: str,
) -> bool:  # fmt: skip
    """Whether all that is hidden is told, by a name or a law or by the verdict that is right, and no wrong name."""
    if verdict in verdicts:
        return True
    members = set().union(*classes) if classes else set()
    if any(not (m & set(known)) and not any(_matches(k, allowed) for k in m) for m in classes):
        return False
    if known and set(known) <= members:
        return True
    if allowed and any(_matches(name, allowed) for name in members):
        return True
    # where no law was drawn, one that fits is right if none stands beside it that does not
    if not exact and laws and all(any(_matches(k, allowed) for k in m) for m in laws):
        return True
    return bool(in_class) and all(in_class)


def _bucket(found: Row) -> str:
    """One word for an answer."""
    if found["failed"]:
        return "error"
    if found["right"]:
        return "right"
    if found["weak"] and not found["names"] and not found["told"]:
        return "too weak"
    if found["wrong_name"]:
        return "wrong name"
    if found["nothing"]:
        return "nothing"
    if found["bad_data"]:
        return "bad data"
    if found["names"]:
        return "near name"  # less than OUTSIDE of what is hidden lies beyond it
    if found["told"]:
        return "other law"
    return "refused"
