"""The codec `dbc`: CAN frames as a DBC file lays them out, the tool's own messages or mapped ones of any maker."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from highside.codec import can_dbc
from highside.codec.frame import CanCodec
from highside.codec.registry import CodecTable, only_measured
from highside.codec.tool_can import ToolCanCodec
from highside.errors import InputError
from highside.packaged import example_files
from highside.reading import read_document
from highside.reading.config_table import ConfigTable

TOOL_DBC = "highside.dbc"


class SignalConfig(ConfigTable):
    """A quantity on a CAN bus: a signal in the DBC file's unit, times `scale`, plus `offset`."""

    signal: str = Field(pattern=r"^[^.\s]+\.[^.\s]+$", description="MESSAGE.SIGNAL as named in the DBC file.")
    scale: float = Field(default=1.0, allow_inf_nan=False, description="Unit of the Recording per unit of the DBC.")
    offset: float = Field(default=0.0, allow_inf_nan=False, description="Added after scaling.")


class DbcCodecConfig(CodecTable):
    """CAN frames laid out by a DBC file: the tool's own, or any other's with a mapping in `fields`."""

    carries: ClassVar[Literal["bytes", "can"]] = "can"
    detectable: ClassVar[bool] = True

    name: Literal["dbc"]
    dbc: Path | None = Field(default=None, description="The DBC file; that of the tool's own messages if absent.")
    fields: dict[str, SignalConfig] | None = Field(
        default=None, min_length=1, description="Quantity -> signal; absent for the tool's own messages."
    )
    emit_on: str | None = Field(default=None, description="Last message of a cycle, where several are mapped.")

    @field_validator("fields")
    @classmethod
    def _fields(cls, fields: dict[str, SignalConfig] | None) -> dict[str, SignalConfig] | None:
        only_measured(fields or {})
        return fields

    @model_validator(mode="after")
    def _emit_on_needs_fields(self) -> Self:
        if self.emit_on is not None and self.fields is None:
            raise ValueError("emit_on: belongs to a mapping in `fields`; the tool's own messages need none")
        return self

    @property
    def speaks_as_the_tool(self) -> bool:
        # a DBC file without a mapping is read as one of the tool's own messages (a copy of ours, say)
        return self.fields is None

    def build(self) -> CanCodec:
        path = self.dbc or _shipped(TOOL_DBC)
        where = str(path)
        messages = can_dbc.compile_dbc(read_document(path).decode("cp1252", errors="replace"), where=where)
        if self.fields is None:
            return ToolCanCodec(messages, axes=self.axis_map(), where=where)
        sources = {}
        for name, field in self.fields.items():
            message, _, signal = field.signal.partition(".")
            sources[name] = can_dbc.SignalSource(message, signal, field.scale, field.offset)
        return can_dbc.SignalCodec(messages, sources, emit_on=self.emit_on, axes=self.axis_map(), where=where)


def _shipped(name: str) -> Path:
    """A file of the folder `config`: beside the package's sources, or inside an installed package."""
    try:
        return example_files()[name]
    except KeyError:
        raise InputError(f"the shipped file {name} is not installed", remedy="name a DBC file in codec.dbc") from None


CODEC = DbcCodecConfig
