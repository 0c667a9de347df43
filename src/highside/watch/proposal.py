"""From what the watch says to a record that a person may put in force.

Nothing is proposed unless a departure stands, and unless the hole has named it: what attitudes seen so far cannot tell
apart, a correction would get right where the tool is and wrong where it goes. The whole posterior is proposed, not the
one parameter: the filter has also learnt a little of all others, and their covariance says how much.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from highside.arrays import Array
from highside.calibration.in_hole import IN_HOLE, moved
from highside.calibration.record import CalibrationRecord, canonical, content_id, parse_record, to_utc
from highside.errors import InputError
from highside.reading import parse_json
from highside.version import __version__
from highside.watch.claims import SECOND
from highside.watch.parameters import CALIBRATION, MATRIX, NAMES, OFFSETS, global_zone

__all__ = ["WatchOutcome", "propose", "read_outcome", "state_sha256"]

STATE = "highside.watch-state/1"
"""the form of a service's state (`service.saved_watch`)"""
LARGEST = 0.05
"""g or ratio: a deviation beyond it is no small error, and no number of a record"""


class _Part(BaseModel):
    """Of `watch.json`: what is needed of it; the rest is ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class SaidParameter(_Part):
    """One parameter."""

    value: float
    std: float = Field(ge=0)


class SaidClaim(_Part):
    """A departure."""

    effect: str
    parameter: str
    parameters: dict[str, SaidParameter]
    equivalence_class: list[str] = Field(min_length=1)
    evidence: float | None


class WatchOutcome(_Part):
    """What a watch says, as `watch.json` or the service's state has it."""

    form: Literal["highside.watch/1"] = Field(alias="schema")
    verdict: Literal["learning", "holds", "departs"]
    cal_id: str
    tool: str | None = None
    """whose state of the service it is; None: `watch.json` of a recording, which goes by its record"""
    claims: list[SaidClaim]
    parameters: dict[str, SaidParameter]
    covariance: list[list[float]] = Field(min_length=CALIBRATION, max_length=CALIBRATION)
    advice: list[str] = []
    duration_s: float = Field(ge=0)


def state_sha256(value: Mapping[str, Any]) -> str:
    """Of what a state of the service holds beside this sum, as JSON: a state goes on only as it was written."""
    held = {name: member for name, member in value.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(held, sort_keys=True).encode()).hexdigest()


def read_outcome(data: bytes, where: str) -> WatchOutcome:
    """From the bytes of `watch.json`, or of the state that the service keeps. Raises InputError."""
    value = parse_json(data, where=where)
    if isinstance(value, dict) and isinstance(value.get("said"), dict):
        if value.get("sha256") not in (None, state_sha256(value)):
            raise InputError("is damaged: its content is not what was written", where=where, remedy="watch again")
        if value.get("format") != STATE:
            raise InputError(
                f"is a state of another version than {STATE}",
                where=where,
                field="format",
                remedy="use the highside that wrote it, or give watch.json of `highside watch`",
            )
        value = value["said"] | {"tool": value.get("tool")}
    if not isinstance(value, dict) or "schema" not in value:
        remedy = "give DIR/watch.json of `highside watch`, or watch.json of the service's state directory"
        raise InputError("is nothing that a watch said", where=where, remedy=remedy)
    try:
        return WatchOutcome.model_validate(value)
    except ValueError as error:
        raise InputError(_first(error), where=where, remedy="watch again") from None


def _first(error: ValueError) -> str:
    errors = getattr(error, "errors", None)
    if errors is None:
        return str(error)
    first = errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"


def propose(parent: CalibrationRecord, said: WatchOutcome, *, now_s: float, where: str = "watch") -> CalibrationRecord:
    """The record that corrects what departs. `now_s`: UTC epoch seconds.

    Raises InputError in one line where nothing is to be proposed: nothing departs, the hole has not named what does,
    or it is nothing that a record corrects; and for a `parent` of another tool, or that is not what was watched.
    """
    if said.tool is not None and said.tool != parent.tool_id:
        raise InputError(
            f"is the state of tool {said.tool}; record {parent.id[:12]} is of tool {parent.tool_id}",
            where=where,
            field="tool",
            remedy="give the state and the record of one tool",
        )
    if said.cal_id != parent.id:
        raise InputError(
            f"watched record {said.cal_id[:12]}, not {parent.id[:12]}",
            where=where,
            field="cal_id",
            remedy="give the record that was in force",
        )
    if said.verdict != "departs" or not said.claims:
        raise InputError(f"nothing departs ({said.verdict}): there is nothing to propose", where=where)
    claim = said.claims[0]
    if SECOND in claim.equivalence_class:
        raise InputError(
            "one departure does not explain what was seen: nothing is proposed",
            where=where,
            remedy="calibrate anew at surface",
        )
    if len(claim.equivalence_class) > 1:
        raise InputError(
            f"{', '.join(claim.equivalence_class)} are not told apart by the attitudes seen: nothing is proposed",
            where=where,
            remedy="take roll tests at inclinations 10 to 30 deg apart, then propose again",
        )
    if claim.parameter not in NAMES[:CALIBRATION]:
        raise InputError(
            f"{claim.parameter} departs, which no offset or matrix of a record corrects: nothing is proposed",
            where=where,
            remedy="diagnose the recording, and calibrate anew at surface",
        )
    global_zone(parent)
    values = {name: said.parameters[name].value for name in NAMES[:CALIBRATION] if name in said.parameters}
    if len(values) < CALIBRATION or max(map(abs, values.values())) > LARGEST:
        raise InputError("the parameters are not those of a small deviation", where=where, field="parameters")
    return _record(parent, said, np.array([values[name] for name in NAMES[:CALIBRATION]]), now_s, where)


def _record(parent: CalibrationRecord, said: WatchOutcome, state: Array, now_s: float, where: str) -> CalibrationRecord:
    offset, matrix = state[: len(OFFSETS)], state[len(OFFSETS) :].reshape(3, 3)
    result = moved(parent.result, offset, matrix, _covariance(said, where))
    claim = said.claims[0]
    evidence: dict[str, Any] = {
        "effect": claim.effect,
        "parameter": claim.parameter,
        "size": {name: {"value": one.value, "std": one.std} for name, one in claim.parameters.items()},
        "log_likelihood_ratio_x2": claim.evidence,
        "watched_s": said.duration_s,
        "deviation": {"offset_g": offset.tolist(), "matrix": matrix.tolist(), "order": [*OFFSETS, *MATRIX]},
    }
    content = {
        **parent.content,
        "created": to_utc(now_s),
        "valid_from": to_utc(now_s),
        "software": {"name": "highside", "version": __version__},
        "result": result.to_dict(),
        "fallback": None,
        "guide": None,
        "valid": IN_HOLE,
        "parent": parent.id,
        "evidence": evidence,
    }
    content = parse_json(canonical(content))
    return parse_record(canonical({"id": content_id(content), **content}), where=where)


def _covariance(said: WatchOutcome, where: str) -> Array:
    try:
        P = np.array(said.covariance, dtype=float)
    except ValueError:
        P = np.zeros(0)
    if P.shape != (CALIBRATION, CALIBRATION) or not np.allclose(P, P.T, rtol=1e-6, atol=1e-30):
        raise InputError("is no covariance of twelve parameters", where=where, field="covariance")
    scale = np.sqrt(np.diag(P)) if (np.diag(P) > 0.0).all() else np.zeros(CALIBRATION)
    if not scale.all() or np.linalg.eigvalsh(P / np.outer(scale, scale)).min() < -1e-9:
        raise InputError("is no covariance of twelve parameters", where=where, field="covariance")
    return np.asarray(0.5 * (P + P.T))
