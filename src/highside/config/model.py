"""The model file (TOML): what a simulation knows of a tool, its bench, its site and its motion.

    [tool]       axes = "xyz"                                  maker's axes, a signed permutation
    [sensor]     noise_g, bias_g, scale, misalignment_deg, free
    [effects]    included = ["base_tilt", ...], and a table for each:  [effects.base_tilt] tilt_x_deg = 0.02
    [motion]     kind = "poses" | "turns" | "rotation" | "legs"   (for `highside simulate`)
    [site]       gravity_mps2, latitude_deg, azimuth_deg
    [reference]  kind = "pose" | "magnitude" | "simulation"
    [[laws]]     what was learnt without a name (`highside.physics.law`)

All keys are optional. A parameter of an effect is written in its own unit, or with a suffix that says another
(`tilt_x_deg`, `r_x_mm`, `b_x_mg`, `density_ug`); three parameters `b_x, b_y, b_z` may be written as one `b`, a number
or a list of three. A value outside of an effect's plausible range is refused unless `[effects] implausible = true`.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from highside.codec.axes import AxisMap
from highside.config.mistakes import UNKNOWN, Mistake, explained
from highside.config.model_effects import EffectsTable, SensorTable, known_effect
from highside.config.model_motion import KINDS, Motion
from highside.errors import InputError
from highside.physics.effect import AXES
from highside.physics.forward import ForwardModel
from highside.physics.gravity import normal_gravity_mps2
from highside.physics.law import Law, effect_of
from highside.physics.motion import Leg
from highside.physics.plan import Session, Site
from highside.reading import parse_toml, read_bytes
from highside.reading.config_table import ConfigTable
from highside.units import STANDARD_GRAVITY_MPS2

MAX_ROWS = 20_000_000
MAX_MODEL_BYTES = 16 << 20
"""Longest model file: a law of two covariates on two channels has a covariance of 462 by 462 numbers, 3 MB."""


class ToolTable(ConfigTable):
    """Which way the maker's axes point."""

    axes: str = Field(default="xyz", description="Which maker's axis gives the tool's x, y and z, as in a codec.")

    @field_validator("axes")
    @classmethod
    def _axes(cls, text: str) -> str:
        try:
            AxisMap.parse(text)
        except InputError as error:
            raise ValueError(f"{error.what}; {error.remedy}") from None
        return text

    @property
    def map(self) -> AxisMap:
        return AxisMap.parse(self.axes)


class SiteTable(ConfigTable):
    """Where it stands. Gravity not given follows from the latitude, or is the standard value."""

    gravity_mps2: Annotated[float, Field(ge=9.7, le=9.9)] | None = None
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    azimuth_deg: float = Field(default=0.0, description="Azimuth of the hole's down direction.")

    @property
    def site(self) -> Site:
        latitude = math.radians(self.latitude_deg or 0.0)
        gravity = self.gravity_mps2
        if gravity is None:
            gravity = STANDARD_GRAVITY_MPS2 if self.latitude_deg is None else normal_gravity_mps2(latitude)
        return Site(gravity, latitude, math.radians(self.azimuth_deg))


class ReferenceTable(ConfigTable):
    """What says where the tool was."""

    kind: Literal["pose", "magnitude", "simulation"] = "pose"


class Model(ConfigTable):
    """What a simulation knows of a tool, its bench, its site and its motion: the model file, each table a field."""

    tool: ToolTable = ToolTable()
    sensor: SensorTable = SensorTable()
    effects: EffectsTable = EffectsTable()
    motion: Motion | None = None
    site: SiteTable = SiteTable()
    reference: ReferenceTable = ReferenceTable()
    laws: tuple[dict[str, Any], ...] = Field(
        default=(), description="Laws that were learnt: place, channels, axes, coefficients of each."
    )

    @field_validator("laws")
    @classmethod
    def _laws(cls, tables: tuple[dict[str, Any], ...]) -> tuple[dict[str, Any], ...]:
        slugs: list[str] = []
        for table in tables:
            try:
                law = Law.from_dict(table)
                if law.at.stage is not None:
                    effect_of(law)
            except InputError as error:
                raise ValueError(str(error)) from None
            slugs.append(law.slug)
        twice = [slug for slug in slugs if slugs.count(slug) > 1]
        if twice:
            raise ValueError(f"two laws are called '{twice[0]}': give one another slug")
        return tables

    @model_validator(mode="after")
    def _once(self) -> Self:
        for effect_id in self.sensor.effects():
            if effect_id in self.effects.included:
                raise ValueError(f"'{effect_id}' is given both in [sensor] and in [effects]: keep one")
            effect = known_effect(effect_id)
            outside = effect.outside_gate(effect.vector(self.sensor.effects()[effect_id]))
            if outside and not self.effects.implausible:
                parameter = next(p for p in effect.parameters if p.name == outside[0])
                raise ValueError(
                    f"sensor: {effect_id} {parameter.name} is outside of the plausible range {parameter.gate[0]:g} to"
                    f" {parameter.gate[1]:g} {parameter.unit}"
                )
        if self.sensor.noise_g is not None and "reading_noise" in self.effects.included:
            raise ValueError("the noise is given both as sensor.noise_g and as the effect 'reading_noise': keep one")
        return self

    def forward(self, row_seconds: float | None = None) -> ForwardModel:
        """The forward model of the file.

        `sensor.noise_g` is the scatter of a row, so it becomes a noise density only with the averaging time of a row;
        without `row_seconds` it is omitted.
        """
        effects = {**self.sensor.effects(), **self.effects.values()}
        if self.sensor.noise_g and row_seconds is not None:
            density = self.sensor.noise_g * math.sqrt(2 * row_seconds)
            effects["reading_noise"] = {f"density_{axis}": density for axis in AXES}
        in_chain = [law for law in self.known_laws if law.at.stage is not None]
        return ForwardModel.of(effects).with_laws(in_chain)

    @property
    def known_laws(self) -> tuple[Law, ...]:
        """The laws of the file."""
        return tuple(Law.from_dict(table) for table in self.laws)

    def with_laws(self, laws: Sequence[Law]) -> Model:
        """With these laws in place of those of the same slugs."""
        added = {law.slug for law in laws}
        kept = tuple(table for table in self.laws if table["slug"] not in added)
        return self.model_copy(update={"laws": (*kept, *(law.to_dict() for law in laws))})

    def with_effects(self, effects: Mapping[str, Mapping[str, float]], *, as_found: bool = False) -> Model:
        """With these effects (parameters in the library's units) in place of those of the same ids.

        Effects that `[sensor]` stands for move to `[effects]`. `as_found`: a diagnosis stands behind them, and one
        beyond its plausible range by less than its error is accepted. Raises InputError for an implausible parameter.
        """
        beyond = as_found and any(
            (effect := known_effect(name)).outside_gate(effect.vector(values)) for name, values in effects.items()
        )
        kept = {**self.sensor.effects(), **self.effects.values(), **effects}
        sensor = self.sensor.model_copy(update={"bias_g": None, "scale": None, "misalignment_deg": None})
        tables = {
            **self.model_dump(mode="json", exclude={"sensor", "effects"}, exclude_none=True),
            "sensor": sensor.model_dump(mode="json", exclude_none=True),
            "effects": {
                "included": list(kept),
                "implausible": self.effects.implausible or beyond,
                **{effect_id: dict(values) for effect_id, values in kept.items() if values},
            },
        }
        return parse_model(tables, where="model")

    def session(self) -> Session:
        """The session that `[motion]` describes. Raises InputError if the file has no such table."""
        if self.motion is None:
            raise InputError("is missing", field="motion", remedy='add a table [motion] with kind = "poses"')
        return Session(self.motion.plan(), self.site.site, self.motion.temperature, self.motion.vibration)


def as_toml(model: Model) -> str:
    """The model as a file that `load_model` reads back equal; what has its default is omitted."""
    tables = model.model_dump(mode="json", exclude_defaults=True)
    if model.motion is not None:
        tables["motion"] = {"kind": model.motion.kind, **tables["motion"]}
    lines: list[str] = []
    laws = tables.pop("laws", ())
    for name, table in tables.items():
        inner = {key: value for key, value in table.items() if isinstance(value, dict)}
        lines += [f"[{name}]", *(f"{key} = {_toml(v)}" for key, v in table.items() if key not in inner), ""]
        for key, values in inner.items():
            lines += [f"[{name}.{key}]", *(f"{k} = {_toml(v)}" for k, v in values.items()), ""]
    for law in laws:
        lines += ["[[laws]]", *(f"{key} = {_toml(v)}" for key, v in law.items()), ""]
    return "\n".join(lines)


def _toml(value: Any) -> str:
    """A value in TOML: text, numbers, lists, inline tables."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(v)}" for key, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    # JSON and TOML write text, numbers and truth alike
    return json.dumps(value, ensure_ascii=False)


def load_model(path: Path) -> Model:
    """Read a model file. Raises InputError with one line that names file, table, field and what is allowed."""
    data = read_bytes(path, max_bytes=MAX_MODEL_BYTES)
    return parse_model(parse_toml(data, where=str(path), max_bytes=MAX_MODEL_BYTES), where=str(path))


def parse_model(tables: Mapping[str, Any], *, where: str) -> Model:
    """As `load_model`, from parsed tables."""
    try:
        return Model.model_validate(dict(tables))
    except ValidationError as error:
        raise explained(error, where, _mistake) from None


def _mistake(detail: ErrorDetails) -> Mistake:
    # the kind of motion stands in the location but not in the file
    keys = [str(key) for key in detail["loc"]]
    if len(keys) > 1 and keys[0] == "motion":
        keys = [keys[0], *keys[2:]]
    message = detail["msg"].removeprefix("Value error, ")
    remedy = ""
    if detail["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        message, remedy = UNKNOWN, _nearest(keys, detail["loc"])
    elif detail["type"] == "missing":
        message, remedy = "is missing", "add it"
    elif detail["type"] == "union_tag_not_found":
        keys, message, remedy = [*keys, "kind"], "is missing", 'add kind = "poses", "turns", "rotation" or "legs"'
    elif detail["type"] == "union_tag_invalid":
        keys, message = [*keys, "kind"], "is unknown"
        remedy = 'allowed: "poses", "turns", "rotation", "legs"'
    elif detail["type"] != "value_error" and not isinstance(detail.get("input"), dict | list):
        message = f"{message[0].lower()}{message[1:]} (given {detail.get('input')!r})"
    return Mistake(".".join(keys), message, remedy)


def _nearest(keys: list[str], location: tuple[int | str, ...]) -> str:
    """What may have been meant by an unknown field."""
    known = list(Model.model_fields)
    if len(keys) > 1:
        if keys[0] == "motion":
            in_leg = "legs" in keys[1:-1]
            known = [f.name for f in fields(Leg)] if in_leg else list(KINDS[str(location[1])].model_fields)
        else:
            annotation = Model.model_fields[keys[0]].annotation
            if isinstance(annotation, type) and issubclass(annotation, BaseModel):
                known = list(annotation.model_fields)
    near = difflib.get_close_matches(keys[-1], known, n=1)
    return f"did you mean {near[0]}?" if near else f"allowed: {', '.join(known)}"
