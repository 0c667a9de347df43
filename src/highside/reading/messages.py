"""A message of JSON that a pydantic model describes, read by the same rules as a file."""

from __future__ import annotations

import re
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from highside.errors import InputError
from highside.reading.documents import MAX_DOCUMENT_BYTES, parse_json

Model = TypeVar("Model", bound=BaseModel)


def parse_message(model: type[Model], data: bytes, *, max_bytes: int = MAX_DOCUMENT_BYTES) -> Model:
    """The message. Raises InputError: no JSON, or `field` and what is wrong with it (the first of them)."""
    value = parse_json(data, max_bytes=max_bytes)
    try:
        return model.model_validate(value)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        field = ".".join(map(str, first["loc"]))
        raise InputError(first["msg"].removeprefix("Value error, "), field=field or None) from None


def text_member(data: bytes, name: str, longest: int = 64) -> str:
    """A member of a message that is otherwise wrong (its id, for the answer), as far as it is readable; else empty."""
    try:
        found = parse_json(data)
        value = found.get(name) if isinstance(found, dict) else None
        return str(value)[:longest] if isinstance(value, str | int | float) else ""
    except InputError:
        # torn, or with a value that no message may have: what stands there plainly is still an answer's address
        plain = re.search(rb'"%s"\s*:\s*"([\x20-\x21\x23-\x5b\x5d-\x7e]{1,%d})"' % (name.encode(), longest), data)
        return plain[1].decode("ascii") if plain is not None else ""
