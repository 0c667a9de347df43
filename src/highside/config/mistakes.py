"""What is wrong with a file of settings, in one line: every mistake with its field, what is allowed, what was meant."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from highside.errors import InputError

ENVIRONMENT_PREFIX = "HIGHSIDE__"
"""Two underscores: HIGHSIDE_DEBUG and the like are no settings of the service."""
MOST_REPORTED = 8
"""mistakes in one line; more are counted"""


class Mistake(NamedTuple):
    """One of them. `where`: the source, if it is not the file."""

    field: str
    what: str
    remedy: str
    where: str | None = None


def reported_together(mistakes: Sequence[Mistake], where: str) -> InputError:
    """One line for all mistakes; names that are not known come first: a name misspelt is also a name missing."""
    first, *others = sorted(mistakes, key=lambda mistake: mistake.what != UNKNOWN)
    source = first.where or where
    remedy, remedies = first.remedy, {first.remedy, ""}
    for other in others[: MOST_REPORTED - 1]:
        place = other.where or where
        text = ": ".join(part for part in (place if place != source else "", other.field, other.what) if part)
        remedy += f" | also {text}" if other.remedy in remedies else f" | also {text}; {other.remedy}"
        remedies |= {other.remedy}
    if len(others) >= MOST_REPORTED:
        remedy += f" | and {len(others) - MOST_REPORTED + 1} more"
    return InputError(first.what, where=source, field=first.field or None, remedy=remedy.strip() or None)


UNKNOWN = "is not a known field"


def explained(error: ValidationError, where: str, mistake: Callable[[ErrorDetails], Mistake]) -> InputError:
    """One line for what pydantic found; `mistake` says each as the user knows the file."""
    return reported_together([mistake(detail) for detail in error.errors(include_url=False)], where)


def input_error(error: ValidationError, where: str, overrides: dict[str, Any], root: type[BaseModel]) -> InputError:
    """One line for what pydantic found: source, field, what is allowed. `root` is the model of the whole file."""
    mistakes = []
    for detail in error.errors(include_url=False):
        field, what, remedy = _explain(detail, root)
        mistakes.append(Mistake(field, what, remedy, _source(field, overrides)))
    return reported_together(mistakes, where)


def _source(field: str, overrides: dict[str, Any]) -> str | None:
    """Where a field was given, if not in the file."""
    keys = field.split(".")
    table: Any = overrides
    for key in keys:
        table = table.get(key) if isinstance(table, dict) else None
    if table is not None:
        return "--set"
    wanted = (ENVIRONMENT_PREFIX + "__".join(keys)).upper()
    return f"environment variable {wanted}" if wanted in {name.upper() for name in os.environ} else None


def _explain(detail: ErrorDetails, root: type[BaseModel]) -> tuple[str, str, str]:
    keys = [str(key) for key in detail["loc"]]
    # the tag of a discriminated union stands in the location but not in the file
    if len(keys) > 1 and keys[0] in ("link", "codec", "plan"):
        keys = [keys[0], *keys[2:]]
    if len(keys) > 2 and keys[0] == "wits":
        keys = [*keys[:2], *keys[3:]]
    field = ".".join(keys)
    kind, context = detail["type"], detail.get("ctx", {})
    given = detail.get("input")
    if kind == "missing":
        return field, "is missing", "add it"
    if kind == "extra_forbidden":
        return field, UNKNOWN, nearest(keys, root)
    if kind == "union_tag_invalid":
        tag = str(context.get("discriminator", "")).strip("'")
        return f"{field}.{tag}", f"{context.get('tag')!r} is unknown", f"allowed: {context.get('expected_tags')}"
    if kind == "union_tag_not_found":
        tag = str(context.get("discriminator", "")).strip("'")
        return f"{field}.{tag}", "is missing", "add it: it says which kind the table describes"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return field, "must be a table", ""
    message = detail["msg"].removeprefix("Value error, ")
    shown = "" if isinstance(given, dict | list) or given is None or kind == "value_error" else f" (given {given!r})"
    return field, message[0].lower() + message[1:] + shown, ""


def nearest(keys: list[str], root: type[BaseModel]) -> str:
    """What may have been meant by an unknown field: the nearest, or all that its table allows."""
    known = _fields_of(root, keys[:-1])
    near = difflib.get_close_matches(keys[-1], known, n=1)
    if near:
        return f"did you mean {near[0]!r}?"
    return f"allowed: {', '.join(known)}" if known else "remove it"


def _fields_of(model: type[BaseModel], keys: list[str]) -> list[str]:
    """Names of the fields of the table `keys`; of all its kinds where it has several."""
    if not keys:
        return list(model.model_fields)
    found: dict[str, None] = {}
    if keys[0] in model.model_fields:
        for part in _models_in(model.model_fields[keys[0]].annotation):
            found |= dict.fromkeys(_fields_of(part, keys[1:]))
    return list(found)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]
