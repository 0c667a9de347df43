"""From a law to an effect of one's own, and from one session's answer to another session that confirms it or not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from highside.api.diagnosis import Diagnosis
from highside.errors import InputError
from highside.physics.effects import all_effects, registry
from highside.physics.law import PREFIX, Law
from highside.physics.learnt_source import Words, effect_source
from highside.physics.outside_effects import IDENTIFIER, effect_of_file
from highside.reading import parse_json, read_document
from highside.recording.files import write_whole
from highside.recording.frames import File

__all__ = ["new_effect"]


def new_effect(
    diagnosis: File | Mapping[str, Any] | Diagnosis, effect_id: str, folder: File, *, law: str | None = None
) -> Path:
    """Write a law that a diagnosis found as an effect file, `folder/effect_id.py`, and try it out; its path.

    `diagnosis`: a file `diagnosis.json`, its values, or the answer of `diagnose`. `law`: which of its laws, where it
    has several. Raises InputError where there is no such law, for an id that is no name or is taken, and for a file
    that is there already.
    """
    where, answer = _answer(diagnosis)
    claim = _claim(answer, law, where)
    if not IDENTIFIER.fullmatch(effect_id):
        raise InputError(f"'{effect_id}' is no name of an effect", field="id", remedy="a-z, 0-9 and _, a letter first")
    if effect_id in registry():
        raise InputError(f"there is an effect '{effect_id}' already", field="id", remedy="give another id")
    path = Path(folder) / f"{effect_id}.py"
    if path.exists():
        raise InputError("is there already", where=str(path), remedy="give another id, or remove it")
    # an effect of other recordings: what set in during this one acts all the time there
    found = _as_it_acts(Law.from_dict(claim["law"], where).lasting())
    known = [name for name in claim.get("resembles") or [] if name in all_effects()]
    words = Words(
        source=where or "a diagnosis",
        confused_with=tuple(dict.fromkeys(known)),
        splitter=str(claim.get("confirm") or ""),
        readings=tuple(str(reading) for reading in claim.get("readings") or ()),
    )
    text = effect_source(found, effect_id, words)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", where=str(path.parent)) from None
    write_whole(path, text.encode())
    try:
        effect_of_file(path)
    except InputError:
        path.unlink(missing_ok=True)
        raise
    return path


def _as_it_acts(law: Law) -> Law:
    """The law without the functions that are there for its band alone: their coefficients are 0."""
    acting = [k for k, each in enumerate(zip(*law.coefficients, strict=True)) if any(each)]
    if len(law.axes) > 1 or not acting:
        return law
    axis = replace(law.axes[0], functions=tuple(law.axes[0].functions[k] for k in acting))
    coefficients = tuple(tuple(row[k] for k in acting) for row in law.coefficients)
    return replace(law, axes=(axis,), coefficients=coefficients, covariance=())


def _answer(diagnosis: File | Mapping[str, Any] | Diagnosis) -> tuple[str | None, Mapping[str, Any]]:
    """Where it stands, and the values of `diagnosis.json`."""
    if isinstance(diagnosis, Diagnosis):
        return diagnosis.source, diagnosis.to_dict()
    if isinstance(diagnosis, Mapping):
        return None, diagnosis
    where = str(diagnosis)
    remedy = "give DIR/diagnosis.json of a diagnosis"
    answer = parse_json(read_document(Path(diagnosis)), where=where, kind="JSON", remedy=remedy)
    if not isinstance(answer, Mapping):
        raise InputError("is no diagnosis", where=where, remedy="give DIR/diagnosis.json of a diagnosis")
    return where, answer


def _claim(answer: Mapping[str, Any], wanted: str | None, where: str | None) -> Mapping[str, Any]:
    """The claim of a law: the one that is asked for, or the only one."""
    claims = answer.get("claims")
    if not isinstance(claims, list):
        raise InputError("is missing", where=where, field="claims", remedy="give DIR/diagnosis.json of a diagnosis")
    laws = [c for c in claims if isinstance(c, Mapping) and isinstance(c.get("law"), Mapping)]
    names = [str(claim.get("effect")) for claim in laws]
    if not laws:
        raise InputError(
            f"claims no law (its verdict is {answer.get('verdict')!r})",
            where=where,
            remedy="an effect is made of a claim 'law:...'; what has a name is in the library already",
        )
    if wanted is None:
        if len(laws) > 1:
            raise InputError(f"claims {len(laws)} laws", where=where, field="law", remedy=f"one of {', '.join(names)}")
        return laws[0]
    full = wanted if wanted.startswith(PREFIX) else PREFIX + wanted
    if full not in names:
        raise InputError(f"claims no '{full}'", where=where, field="law", remedy=f"one of {', '.join(names)}")
    return laws[names.index(full)]
