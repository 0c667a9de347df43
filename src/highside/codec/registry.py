"""The codecs by name, and what the `[codec]` table of a configuration says of each.

A codec is one file: a decoder, a `CodecTable` with its name and its fields, and `CODEC = ` that table. Every module of
this package that holds a `CODEC` is one, found by itself; other installed packages add theirs by an entry point of the
group `highside.codecs`, named as the codec and pointing to its table. Configuration, `detect`, `decode`, `check` and
`schema` take them from here.

Quantities are named by the columns of a Recording (`ax_g`, `gz_dps`, `temp_c`, ...); any other name makes an extra
column that is recorded and otherwise left alone. `axes` says which of the maker's axes gives the tool's x, y and z.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from abc import abstractmethod
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, get_args

from pydantic import Field, model_validator
from pydantic.fields import FieldInfo

import highside.codec
from highside.codec.axes import AxisMap
from highside.codec.frame import ADDED_COLUMNS, FRAME_COLUMNS, ByteCodec, CanCodec
from highside.errors import InputError
from highside.plugins import Plugin, plugins
from highside.reading.config_table import ConfigTable

GROUP = "highside.codecs"
"""Entry points of this group are codecs."""
_NOT_MEASURED = frozenset({"t_s", *ADDED_COLUMNS})


class CodecTable(ConfigTable):
    """What all codecs have. A subclass gives `name` as the Literal of its name, its own fields, and `build`."""

    carries: ClassVar[Literal["bytes", "can"]] = "bytes"
    """what the decoder takes: a `ByteCodec` or a `CanCodec`"""
    detectable: ClassVar[bool] = False
    """`detect` tries it, with its defaults: its frames have a checksum, so noise does not pass for them"""

    name: str
    axes: str = Field(
        default="xyz",
        description="Which of the maker's axes gives the tool's x, y, z, each with a sign if negative: \"-yxz\".",
    )
    allow_mirror: bool = Field(default=False, description="Accept `axes` that turn a right-handed frame left-handed.")

    @model_validator(mode="after")
    def _axes_are_a_rotation(self) -> Self:
        try:
            self.axis_map()
        except InputError as error:
            raise ValueError(f"axes: {error.what}; {error.remedy}") from None
        return self

    def axis_map(self) -> AxisMap:
        return AxisMap.parse(self.axes, allow_mirror=self.allow_mirror)

    @property
    def speaks_as_the_tool(self) -> bool:
        """Whether it reads what the tool itself sends, over a serial line or a CAN bus."""
        return False

    @abstractmethod
    def build(self) -> ByteCodec | CanCodec:
        """A fresh decoder. Raises InputError where a file that it needs is not good."""


@cache
def _found() -> tuple[dict[str, type[CodecTable]], dict[str, Plugin]]:
    """The codecs by name, and the plugins that are none."""
    tables: dict[str, type[CodecTable]] = {}
    for module in pkgutil.iter_modules(highside.codec.__path__, "highside.codec."):
        table = getattr(importlib.import_module(module.name), "CODEC", None)
        if table is not None:
            tables[_name_of(table)] = table
    faults: dict[str, Plugin] = {}
    for plugin in plugins(GROUP):
        fault = plugin.fault or _unfit(plugin, tables)
        if fault:
            faults[plugin.name] = plugin.refused(fault)
        else:
            tables[plugin.name] = plugin.value
    return tables, faults


def codecs() -> Mapping[str, type[CodecTable]]:
    """The table of every codec by its name: ours, then those of other packages."""
    return _found()[0]


def faults() -> Mapping[str, Plugin]:
    """What other packages call a codec and is none, by its name: each says why."""
    return _found()[1]


def detectable(carries: Literal["bytes", "can"]) -> dict[str, type[CodecTable]]:
    """The codecs that `detect` tries on what a link carries."""
    return {name: table for name, table in codecs().items() if table.detectable and table.carries == carries}


def needed(table: type[CodecTable]) -> list[str]:
    """Fields without which the codec cannot be built; none: its name is enough."""
    return [name for name, field in table.model_fields.items() if field.is_required() and name != "name"]


def path_fields(*tables: type[CodecTable]) -> list[str]:
    """Fields of these tables that name a file; relative names start at the configuration's directory."""
    return sorted({name for table in tables for name, field in table.model_fields.items() if _holds_path(field)})


def _holds_path(field: FieldInfo) -> bool:
    return Path in (field.annotation, *get_args(field.annotation))


def only_measured(fields: Mapping[str, Any]) -> None:
    """Refuse (ValueError) names of quantities that no sensor gives, or that cannot be a column."""
    wrong = sorted(set(fields) & _NOT_MEASURED)
    if wrong:
        raise ValueError(
            f"{wrong[0]!r} is no quantity that a sensor gives; allowed: {', '.join(FRAME_COLUMNS)}, or a new name"
        )
    unfit = [name for name in fields if not name or any(c in name for c in ',"\r\n') or name != name.strip()]
    if unfit:
        raise ValueError(f"{unfit[0]!r} cannot be the name of a column")


def _name_of(table: type[CodecTable]) -> str:
    (name,) = get_args(table.model_fields["name"].annotation)
    return str(name)


def _unfit(plugin: Plugin, tables: Mapping[str, type[CodecTable]]) -> str:
    """Why what was loaded is no codec of that name; empty if it is one."""
    table = plugin.value
    if not (isinstance(table, type) and issubclass(table, CodecTable)):
        return "it is no subclass of highside.codec.registry.CodecTable"
    if get_args(table.model_fields["name"].annotation) != (plugin.name,):
        return f"its field `name` must be Literal[{plugin.name!r}]"
    if inspect.isabstract(table):
        return "it has no method `build` that makes the decoder"
    if plugin.name in tables:
        return "there is a codec of this name already"
    return ""
