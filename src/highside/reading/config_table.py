"""What every table of a TOML file of ours has in common."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

HostName = Annotated[str, Field(pattern=r"^[^\s/\p{C}]+$")]
"""Name or address of a machine: no URL, and nothing in it that no name has."""
_HOST_NAME: TypeAdapter[str] = TypeAdapter(HostName)


def is_host_name(text: str) -> bool:
    """For a field that holds something else, too."""
    try:
        _HOST_NAME.validate_python(text)
    except ValidationError:
        return False
    return True


class ConfigTable(BaseModel):
    """A table of the file: unknown fields are refused, numbers are finite, true and false are no numbers, values are
    fixed once read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _true_is_no_number(cls, table: Any) -> Any:
        """Pydantic takes true for 1: `output_rate_hz = true` would be one a second."""
        if not isinstance(table, dict):
            return table
        fields = cls.model_fields
        return {name: _seen(value, _kinds_of(cls, name)) if name in fields else value for name, value in table.items()}


class _Truth:
    """Stands in the place of true or false where a number has to be: no field takes it, its error names the field."""

    def __init__(self, value: bool) -> None:
        self._value = value

    def __repr__(self) -> str:
        return str(self._value).lower()


def _seen(value: Any, kinds: frozenset[type]) -> Any:
    """A value without true and false in the place of numbers; a table inside looks at its own fields."""
    if isinstance(value, bool):
        return value if bool in kinds or kinds.isdisjoint((int, float)) else _Truth(value)
    if type(value) in (list, tuple):
        return type(value)(_seen(one, kinds) for one in value)
    if type(value) is not dict or any(issubclass(kind, BaseModel) for kind in kinds):
        return value
    rows = [kind for kind in kinds if dataclasses.is_dataclass(kind)]
    if rows:
        hints = _hints(rows[0])
        return {name: _seen(one, hints[name]) if name in hints else one for name, one in value.items()}
    return {name: _seen(one, kinds) for name, one in value.items()}


@cache
def _kinds_of(table: type[BaseModel], name: str) -> frozenset[type]:
    return _kinds(table.model_fields[name].annotation)


@cache
def _hints(row: type) -> dict[str, frozenset[type]]:
    return {name: _kinds(annotation) for name, annotation in get_type_hints(row).items()}


def _kinds(annotation: Any) -> frozenset[type]:
    """All types in an annotation, those inside of lists and unions too."""
    if get_origin(annotation) is Literal:
        return frozenset(type(value) for value in get_args(annotation))
    if isinstance(annotation, type) and not get_args(annotation):
        return frozenset({annotation})
    return frozenset[type]().union(*(_kinds(part) for part in get_args(annotation)))
