"""The `[codec]` table: which codec reads the wire, and how it is set up. Its kinds are those of the registry."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Union

from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from highside.codec.registry import CodecTable, codecs, faults, needed, path_fields
from highside.config.mistakes import UNKNOWN, Mistake, explained
from highside.errors import InputError
from highside.reading import parse_toml, read_document

CODEC_NAMES = tuple(codecs())


def _can_be_loaded(table: Any) -> Any:
    """Refuse the name of a codec whose package is installed and broken, with the reason."""
    name = table.get("name") if isinstance(table, dict) else None
    if isinstance(name, str) and name in faults():
        raise ValueError(f"name: the codec {faults()[name]} cannot be used: {faults()[name].fault}")
    return table


if TYPE_CHECKING:
    CodecConfig = CodecTable
else:
    CodecConfig = Annotated[
        Union[tuple(codecs().values())],  # noqa: UP007 - of as many as there are
        Field(discriminator="name"),
        BeforeValidator(_can_be_loaded),
    ]

_ADAPTER: TypeAdapter[CodecConfig] = TypeAdapter(CodecConfig)


def _known(name: str) -> type[CodecTable]:
    if name in faults():
        broken = faults()[name]
        raise InputError(
            f"the codec {broken} cannot be used: {broken.fault}", field="--codec", remedy="fix or remove that package"
        )
    if name not in CODEC_NAMES:
        raise InputError(f"no codec {name!r}", field="--codec", remedy=f"allowed: {', '.join(CODEC_NAMES)}")
    return codecs()[name]


def codec_from_name(name: str) -> CodecConfig:
    """The codec with its defaults. Raises InputError for an unknown name, or one that needs a configuration."""
    missing = needed(_known(name))
    if missing:
        raise InputError(
            f"codec {name!r} needs {', '.join(missing)}",
            field="--config",
            remedy="give a TOML file with a [codec] table; config/multi_imu-mapping.toml is an example",
        )
    return _ADAPTER.validate_python({"name": name})


def codec_from_file(path: Path, name: str) -> CodecConfig:
    """The `[codec]` table of a TOML file, which must be for the codec `name`; relative paths start at the file.

    Raises InputError with one line that names file, table and field.
    """
    known = _known(name)
    where = str(path)
    document = parse_toml(read_document(path), where=where)
    table = document.get("codec")
    if not isinstance(table, dict):
        raise InputError("has no [codec] table", where=where, remedy=f'add one with name = "{name}"')
    given = table.setdefault("name", name)
    if given in CODEC_NAMES and given != name:
        raise InputError(
            f"is {given!r}, but --codec says {name!r}", where=where, field="codec.name", remedy="make them agree"
        )
    for field in path_fields(known):
        if isinstance(table.get(field), str):
            table[field] = str(path.resolve().parent / table[field])
    try:
        return _ADAPTER.validate_python(table)
    except ValidationError as error:
        raise explained(error, where, _mistake) from None


def _mistake(detail: ErrorDetails) -> Mistake:
    keys = [str(key) for key in detail["loc"]]
    if keys and keys[0] in CODEC_NAMES:
        # the name of the kind stands in the location but not in the file
        del keys[0]
    what, remedy = detail["msg"].removeprefix("Value error, "), ""
    if detail["type"] == "union_tag_invalid":
        keys, what, remedy = ["name"], f"no codec {detail['ctx']['tag']!r}", f"allowed: {', '.join(CODEC_NAMES)}"
    elif detail["type"] == "missing":
        what, remedy = "is missing", "add it"
    elif detail["type"] == "extra_forbidden":
        what, remedy = UNKNOWN, "remove it or correct its spelling"
    return Mistake(".".join(["codec", *keys]), what, remedy)
