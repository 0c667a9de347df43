"""The `[codec]` table: which codec reads the wire, and how it is set up.

Quantities are named by the columns of a Recording (`ax_g`, `gz_dps`, `temp_c`, ...); any other name makes an extra
column that is recorded and otherwise left alone. `axes` says which of the maker's axes gives the tool's x, y and z.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from highside.codec import can_dbc, delimited
from highside.codec.axes import AxisMap
from highside.codec.frame import FRAME_COLUMNS, ByteCodec, CanCodec
from highside.codec.tool import ToolCodec
from highside.codec.tool_can import ToolCanCodec
from highside.codec.vn100 import Vn100Codec
from highside.config.mistakes import UNKNOWN, Mistake, told_together
from highside.errors import InputError
from highside.reading import parse_toml, read_bytes
from highside.recording.table import RECORDING_COLUMNS

_NOT_MEASURED = frozenset(RECORDING_COLUMNS) - frozenset(FRAME_COLUMNS)
TOOL_DBC = "highside.dbc"


class _CodecTable(BaseModel):
    """What all codecs have."""

    model_config = ConfigDict(extra="forbid", frozen=True)

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


class ToolCodecConfig(_CodecTable):
    """The tool's own binary serial frame."""

    name: Literal["tool"]

    @property
    def carries(self) -> Literal["bytes"]:
        return "bytes"

    def build(self) -> ByteCodec:
        return ToolCodec(self.axis_map())


class Vn100CodecConfig(_CodecTable):
    """VectorNav VN-100 binary frames, possibly between text."""

    name: Literal["vn100"]
    time_line: bool = Field(
        default=True,
        description="A text line `M,<milliseconds>` behind each frame is its time; false for a bare sensor.",
    )

    @property
    def carries(self) -> Literal["bytes"]:
        return "bytes"

    def build(self) -> ByteCodec:
        return Vn100Codec(self.axis_map(), time_line=self.time_line)


class ColumnConfig(BaseModel):
    """A quantity in a line of text: the number in a column, times `scale`, plus `offset`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    column: int = Field(ge=0, le=255, description="Number of the column, from 0.")
    scale: float = Field(default=1.0, allow_inf_nan=False, description="Unit of the Recording per count.")
    offset: float = Field(default=0.0, allow_inf_nan=False, description="Added after scaling.")


class TimeConfig(BaseModel):
    """A part of the device's time; all parts are added up."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    column: int = Field(ge=0, le=255, description="Number of the column, from 0.")
    scale: float = Field(default=1.0, allow_inf_nan=False, description="Seconds per count.")
    divide_by_column: int | None = Field(default=None, ge=0, le=255, description="Column to divide by, if any.")


class SelectConfig(BaseModel):
    """Which lines are ours."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    column: int = Field(ge=0, le=255, description="Number of the column, from 0.")
    equals: str = Field(description="The text in that column.")


def _only_measured(fields: Mapping[str, Any]) -> None:
    wrong = sorted(set(fields) & _NOT_MEASURED)
    if wrong:
        raise ValueError(
            f"{wrong[0]!r} is no quantity that a sensor gives; allowed: {', '.join(FRAME_COLUMNS)}, or a new name"
        )
    unfit = [name for name in fields if not name or any(c in name for c in ',"\r\n') or name != name.strip()]
    if unfit:
        raise ValueError(f"{unfit[0]!r} cannot be the name of a column")


class DelimitedCodecConfig(_CodecTable):
    """Lines of delimited text."""

    name: Literal["delimited"]
    delimiter: str = Field(default=",", min_length=1, max_length=4, description="What stands between two columns.")
    prefix: str = Field(default="", max_length=64, description="A reading begins with this; removed before cutting.")
    columns: int | None = Field(default=None, ge=2, le=256, description="Exact number of columns of a reading.")
    select: SelectConfig | None = Field(default=None, description="Take only lines with this text in this column.")
    time: tuple[TimeConfig, ...] = Field(default=(), description="Columns that add up to the device's time in s.")
    time_wrap_s: float | None = Field(default=None, gt=0, description="The device's time starts anew after this.")
    seq_column: int | None = Field(default=None, ge=0, le=255, description="Column of the device's frame counter.")
    seq_modulus: int | None = Field(default=None, ge=2, description="Period of that counter.")
    checksum: Literal["nmea"] | None = Field(default=None, description="`*HH` at the end of a line.")
    max_line_bytes: int = Field(default=512, ge=16, le=65536, description="A longer line is junk.")
    fields: dict[str, ColumnConfig] = Field(min_length=1, description="Quantity -> column, scale, offset.")

    @field_validator("fields")
    @classmethod
    def _fields(cls, fields: dict[str, ColumnConfig]) -> dict[str, ColumnConfig]:
        _only_measured(fields)
        return fields

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.seq_column is None) != (self.seq_modulus is None):
            raise ValueError("give seq_column and seq_modulus together")
        used = {f"fields.{name}": column.column for name, column in self.fields.items()}
        used |= {f"time[{i}]": max(t.column, t.divide_by_column or 0) for i, t in enumerate(self.time)}
        if self.seq_column is not None:
            used["seq_column"] = self.seq_column
        if self.select is not None:
            used["select"] = self.select.column
        for name, index in used.items():
            if self.columns is not None and index >= self.columns:
                raise ValueError(f"{name}: column {index} is beyond the {self.columns} columns (counted from 0)")
        return self

    @property
    def carries(self) -> Literal["bytes"]:
        return "bytes"

    def build(self) -> ByteCodec:
        layout = delimited.Layout(
            fields={n: delimited.Column(c.column, c.scale, c.offset) for n, c in self.fields.items()},
            delimiter=self.delimiter,
            prefix=self.prefix,
            columns=self.columns,
            select=None if self.select is None else (self.select.column, self.select.equals),
            time=tuple(delimited.TimeTerm(t.column, t.scale, t.divide_by_column) for t in self.time),
            time_wrap_s=self.time_wrap_s,
            seq_index=self.seq_column,
            seq_modulus=self.seq_modulus,
            checksum=self.checksum,
            max_line_bytes=self.max_line_bytes,
            axes=self.axis_map(),
        )
        return delimited.DelimitedCodec(layout)


class SignalConfig(BaseModel):
    """A quantity on a CAN bus: a signal in the DBC file's unit, times `scale`, plus `offset`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    signal: str = Field(pattern=r"^[^.\s]+\.[^.\s]+$", description="MESSAGE.SIGNAL as named in the DBC file.")
    scale: float = Field(default=1.0, allow_inf_nan=False, description="Unit of the Recording per unit of the DBC.")
    offset: float = Field(default=0.0, allow_inf_nan=False, description="Added after scaling.")


class DbcCodecConfig(_CodecTable):
    """CAN frames laid out by a DBC file: the tool's own, or any other's with a mapping in `fields`."""

    name: Literal["dbc"]
    dbc: Path | None = Field(default=None, description="The DBC file; that of the tool's own messages if absent.")
    fields: dict[str, SignalConfig] | None = Field(
        default=None, min_length=1, description="Quantity -> signal; absent for the tool's own messages."
    )
    emit_on: str | None = Field(default=None, description="Last message of a cycle, where several are mapped.")

    @field_validator("fields")
    @classmethod
    def _fields(cls, fields: dict[str, SignalConfig] | None) -> dict[str, SignalConfig] | None:
        _only_measured(fields or {})
        return fields

    @model_validator(mode="after")
    def _emit_on_needs_fields(self) -> Self:
        if self.emit_on is not None and self.fields is None:
            raise ValueError("emit_on: belongs to a mapping in `fields`; the tool's own messages need none")
        return self

    @property
    def carries(self) -> Literal["can"]:
        return "can"

    def build(self) -> CanCodec:
        path = self.dbc or _shipped(TOOL_DBC)
        where = str(path)
        messages = can_dbc.compile_dbc(read_bytes(path).decode("cp1252", errors="replace"), where=where)
        if self.fields is None:
            return ToolCanCodec(messages, axes=self.axis_map(), where=where)
        sources = {}
        for name, field in self.fields.items():
            message, _, signal = field.signal.partition(".")
            sources[name] = can_dbc.Source(message, signal, field.scale, field.offset)
        return can_dbc.SignalCodec(messages, sources, emit_on=self.emit_on, axes=self.axis_map(), where=where)


CodecConfig = Annotated[
    ToolCodecConfig | Vn100CodecConfig | DelimitedCodecConfig | DbcCodecConfig, Field(discriminator="name")
]


def speaks_as_the_tool(codec: CodecConfig) -> bool:
    """Whether the codec reads what the tool itself sends, over a serial line or a CAN bus."""
    # a DBC file without a mapping is read as one of the tool's own messages (a copy of ours, say)
    return isinstance(codec, ToolCodecConfig) or (isinstance(codec, DbcCodecConfig) and codec.fields is None)


CODEC_NAMES = ("tool", "vn100", "delimited", "dbc")
NEEDS_CONFIG = frozenset({"delimited"})
"""codecs that cannot be built from their name alone"""

_ADAPTER: TypeAdapter[CodecConfig] = TypeAdapter(CodecConfig)


def codec_from_name(name: str) -> CodecConfig:
    """The codec with its defaults. Raises InputError for an unknown name, or one that needs a configuration."""
    if name not in CODEC_NAMES:
        raise InputError(f"no codec {name!r}", field="--codec", remedy=f"allowed: {', '.join(CODEC_NAMES)}")
    if name in NEEDS_CONFIG:
        raise InputError(
            f"codec {name!r} must be told which column is what",
            field="--config",
            remedy="give a TOML file with a [codec] table; config/multi_imu-mapping.toml is an example",
        )
    return _ADAPTER.validate_python({"name": name})


def codec_from_file(path: Path, name: str) -> CodecConfig:
    """The `[codec]` table of a TOML file, which must be for the codec `name`; relative paths start at the file.

    Raises InputError with one line that names file, table and field.
    """
    if name not in CODEC_NAMES:
        raise InputError(f"no codec {name!r}", field="--codec", remedy=f"allowed: {', '.join(CODEC_NAMES)}")
    where = str(path)
    document = parse_toml(read_bytes(path), where=where)
    table = document.get("codec")
    if not isinstance(table, dict):
        raise InputError("has no [codec] table", where=where, remedy=f'add one with name = "{name}"')
    given = table.setdefault("name", name)
    if given in CODEC_NAMES and given != name:
        raise InputError(
            f"is {given!r}, but --codec says {name!r}", where=where, field="codec.name", remedy="make them agree"
        )
    if isinstance(table.get("dbc"), str):
        table["dbc"] = str(path.resolve().parent / table["dbc"])
    try:
        return _ADAPTER.validate_python(table)
    except ValidationError as error:
        raise _one_line(error, where) from None


def _one_line(error: ValidationError, where: str) -> InputError:
    """All of pydantic's errors, as the user knows the file."""
    return told_together([_mistake(detail) for detail in error.errors(include_url=False)], where)


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
        what, remedy = UNKNOWN, "remove it or mend its spelling"
    return Mistake(".".join(["codec", *keys]), what, remedy)


def _shipped(name: str) -> Path:
    """A file of the folder `config`: beside the package's sources, or inside an installed package."""
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "data" / "config", package.parent.parent / "config"):
        if (folder / name).is_file():
            return folder / name
    raise InputError(f"the shipped file {name} is not installed", remedy="name a DBC file in codec.dbc")
