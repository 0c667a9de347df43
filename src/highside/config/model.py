"""The model file (TOML): what a simulation knows of a tool, its bench, its site and its motion.

    [tool]       axes = "xyz"                                  maker's axes, a signed permutation
    [sensor]     noise_g, bias_g, scale, misalignment_deg, free
    [effects]    included = ["base_tilt", ...], and a table for each:  [effects.base_tilt] tilt_x_deg = 0.02
    [motion]     kind = "poses" | "turns" | "rotation" | "legs"   (for `highside simulate`)
    [site]       gravity_mps2, latitude_deg, azimuth_deg
    [reference]  kind = "pose" | "magnitude" | "simulation"

All keys are optional. A parameter of an effect is written in its own unit, or with a suffix that says another
(`tilt_x_deg`, `r_x_mm`, `b_x_mg`, `density_ug`); three parameters `b_x, b_y, b_z` may be written as one `b`, a number
or a list of three. A value outside of an effect's plausible range is refused unless `[effects] implausible = true`.
"""

from __future__ import annotations

import difflib
import itertools
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from highside.codec.axes import AxisMap
from highside.config.mistakes import UNKNOWN, Mistake, told_together
from highside.config.settings import read_toml
from highside.errors import InputError
from highside.physics import effects as library
from highside.physics.effect import AXES, Effect
from highside.physics.effects.misalignment import EFFECT as MISALIGNMENT
from highside.physics.forward import ForwardModel
from highside.physics.gravity import normal_gravity_mps2
from highside.physics.motion import Leg
from highside.physics.plan import LegPlan, Plan, Pose, PosePlan, Profile, RotationPlan, Session, Site, full_turns, rings
from highside.units import STANDARD_GRAVITY_MPS2

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Inclination = Annotated[float, Field(ge=-180, le=180)]
Triple = tuple[Finite, Finite, Finite]

UNITS: dict[str, dict[str, float]] = {
    "rad": {"deg": math.radians(1), "arcmin": math.radians(1 / 60), "arcsec": math.radians(1 / 3600), "mrad": 1e-3},
    "g": {"mg": 1e-3, "ug": 1e-6},
    "g/sqrt(Hz)": {"mg": 1e-3, "ug": 1e-6},
    "g/C": {"mg": 1e-3, "ug": 1e-6},
    "m": {"mm": 1e-3},
    "s": {"ms": 1e-3},
    "1": {"ppm": 1e-6},
    "1/C": {"ppm": 1e-6},
    "rad/s": {"dps": math.radians(1), "dph": math.radians(1 / 3600)},
    "rad/s/g": {"dps": math.radians(1), "dph": math.radians(1 / 3600)},
    "rad/s/sqrt(Hz)": {"dps": math.radians(1)},
}
"""Suffixes that a parameter of a unit may carry in the file, and what one of them is in that unit."""

MAX_ROWS = 20_000_000


class Table(BaseModel):
    """A table of the file: unknown fields are refused, values are fixed once read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ToolTable(Table):
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


class SensorTable(Table):
    """What is known of the triad: a short way to write the effects `bias`, `scale`, `misalignment`, `reading_noise`."""

    noise_g: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = Field(
        default=None, description="Standard deviation of one row in g."
    )
    bias_g: Triple | None = None
    scale: Triple | None = Field(default=None, description="Deviation of each scale factor from 1.")
    misalignment_deg: tuple[Finite, Finite, Finite, Finite, Finite, Finite] | None = Field(
        default=None, description="Share of axis j in axis i, as an angle, in the order xy, xz, yx, yz, zx, zy."
    )
    free: tuple[str, ...] = Field(
        default=("bias", "scale", "misalignment"), description="Effects that may be refitted."
    )

    @field_validator("free")
    @classmethod
    def _known(cls, ids: tuple[str, ...]) -> tuple[str, ...]:
        for effect_id in ids:
            _effect(effect_id)
        return ids

    def effects(self) -> dict[str, dict[str, float]]:
        """The effects that this table stands for; the noise apart."""
        result: dict[str, dict[str, float]] = {}
        if self.bias_g is not None:
            result["bias"] = {f"b_{axis}": value for axis, value in zip(AXES, self.bias_g, strict=True)}
        if self.scale is not None:
            result["scale"] = {f"s_{axis}": value for axis, value in zip(AXES, self.scale, strict=True)}
        if self.misalignment_deg is not None:
            names = [parameter.name for parameter in MISALIGNMENT.parameters]
            angles = [math.radians(value) for value in self.misalignment_deg]
            result["misalignment"] = dict(zip(names, angles, strict=True))
        return result


class EffectsTable(BaseModel):
    """Which effects the simulation has, and their parameters (one table for each effect)."""

    model_config = ConfigDict(extra="allow", frozen=True)

    included: tuple[str, ...] = ()
    implausible: bool = Field(default=False, description="Accept parameters outside of their plausible range.")

    @model_validator(mode="after")
    def _tables(self) -> Self:
        for effect_id in self.included:
            _effect(effect_id)
        if len(set(self.included)) != len(self.included):
            twice = next(effect_id for effect_id in self.included if self.included.count(effect_id) > 1)
            raise ValueError(f"included names '{twice}' twice")
        for name, table in (self.model_extra or {}).items():
            if not isinstance(table, Mapping):
                raise ValueError(f"'{name}' is not a known field; allowed: included, implausible and tables of effects")
            effect = _effect(name)
            if name not in self.included:
                raise ValueError(f"the table of '{name}' has no use: add '{name}' to included, or remove the table")
            values = _parameters(effect, table)
            outside = effect.outside_gate(effect.vector(values))
            if outside and not self.implausible:
                parameter = next(p for p in effect.parameters if p.name == outside[0])
                low, high = parameter.gate
                raise ValueError(
                    f"{name}.{parameter.name} = {values.get(parameter.name)} {parameter.unit} is not plausible; the"
                    f" range is {low:g} to {high:g} (implausible = true accepts it)"
                )
        return self

    def values(self) -> dict[str, dict[str, float]]:
        """{effect id: {parameter: value in the library's unit}} of the effects included."""
        tables = self.model_extra or {}
        return {effect_id: _parameters(_effect(effect_id), tables.get(effect_id, {})) for effect_id in self.included}


class _Motion(Table):
    """What all kinds of motion have."""

    temperatures_c: tuple[Finite, ...] = Field(default=(), description="Temperatures, joined by straight lines.")
    temperature_times_s: tuple[Finite, ...] = Field(default=(), description="Their times; evenly spread where absent.")
    gyros: bool = Field(default=False, description="Write gyro channels even if no effect of gyros is included.")

    @model_validator(mode="after")
    def _profile(self) -> Self:
        times = self.temperature_times_s
        if times and len(times) != len(self.temperatures_c):
            raise ValueError("temperature_times_s and temperatures_c must have the same length")
        if any(later <= earlier for earlier, later in itertools.pairwise(times)):
            raise ValueError("temperature_times_s must rise")
        return self

    @property
    def temperature(self) -> Profile | None:
        return Profile(self.temperatures_c, self.temperature_times_s) if self.temperatures_c else None

    @property
    def vibration(self) -> Profile | None:
        return None


class _Stops(_Motion):
    hold_s: Positive = Field(default=10.0, description="How long a pose is held.")
    row_s: Positive = Field(default=1.0, description="Averaging time of one row.")
    move_s: Annotated[float, Field(ge=0)] = Field(default=20.0, description="Time to reach a pose.")
    record_moves: bool = Field(default=False, description="Also write the rows on the way from pose to pose.")
    plateaus_c: tuple[Finite, ...] = Field(default=(), description="Repeat the whole session at each temperature.")
    soak_s: Annotated[float, Field(ge=0)] = Field(default=3600.0, description="Time for the oven to change.")
    vibration_rms_g: tuple[Annotated[float, Field(ge=0)], ...] = Field(
        default=(), description="Spread evenly over time."
    )

    @property
    def vibration(self) -> Profile | None:
        return Profile(self.vibration_rms_g) if self.vibration_rms_g else None

    def _plan(self, poses: tuple[Pose, ...], hold_s: float) -> PosePlan:
        return PosePlan(poses, hold_s, self.row_s, self.move_s, self.record_moves, self.plateaus_c, self.soak_s)


class PosesMotion(_Stops):
    """A stepped session: rings (inclinations times toolfaces) and single poses."""

    kind: Literal["poses"]
    inclinations_deg: tuple[Inclination, ...] = ()
    toolfaces_deg: tuple[Finite, ...] = ()
    poses: tuple[tuple[Inclination, Finite] | tuple[Inclination, Finite, Literal[-1, 1]], ...] = Field(
        default=(), description="Further poses [inclination, toolface] or [inclination, toolface, direction]."
    )
    returns: bool = Field(default=False, description="Each ring a second time backwards, from the other side.")
    closure_every: int = Field(default=0, ge=0, description="Return to the first pose after so many poses; 0: never.")

    @model_validator(mode="after")
    def _some(self) -> Self:
        if bool(self.inclinations_deg) != bool(self.toolfaces_deg):
            raise ValueError("inclinations_deg and toolfaces_deg go together: give both or none")
        if not self.inclinations_deg and not self.poses:
            raise ValueError("has no poses: give inclinations_deg and toolfaces_deg, or poses")
        return self

    def plan(self) -> Plan:
        on_rings = (
            rings(self.inclinations_deg, self.toolfaces_deg, returns=self.returns, closure_every=self.closure_every)
            if self.inclinations_deg
            else ()
        )
        return self._plan((*on_rings, *(Pose(*pose) for pose in self.poses)), self.hold_s)


class TurnsMotion(_Stops):
    """Full turns: stations from 0 to 360 deg inclusive at each inclination, some readings at each."""

    kind: Literal["turns"]
    inclinations_deg: Annotated[tuple[Inclination, ...], Field(min_length=1)]
    stations: int = Field(default=73, ge=2)
    readings: int = Field(default=4, ge=1)

    def plan(self) -> Plan:
        return self._plan(full_turns(self.inclinations_deg, self.stations), self.readings * self.row_s)


class RotationMotion(_Motion):
    """Continuous rotation at one inclination, in steps of the rate."""

    kind: Literal["rotation"]
    inclination_deg: Inclination = 60.0
    toolface_deg: Finite = 0.0
    rates_hz: tuple[Finite, ...] = ()
    rates_dps: tuple[Finite, ...] = ()
    hold_s: Positive = 20.0
    ramp_s: Annotated[float, Field(ge=0)] = 2.0
    sample_hz: Positive = 50.0
    vibration_rms_g: tuple[Annotated[float, Field(ge=0)], ...] = Field(default=(), description="One for each rate.")

    @model_validator(mode="after")
    def _rates(self) -> Self:
        if bool(self.rates_hz) == bool(self.rates_dps):
            raise ValueError("give either rates_hz or rates_dps")
        if len(self.vibration_rms_g) not in (0, 1, len(self.rates_hz or self.rates_dps)):
            raise ValueError("vibration_rms_g needs one value, or one for each rate")
        return self

    def plan(self) -> Plan:
        rates = [2 * math.pi * rate for rate in self.rates_hz] or [math.radians(rate) for rate in self.rates_dps]
        return RotationPlan(
            self.inclination_deg,
            tuple(rates),
            self.hold_s,
            self.ramp_s,
            self.sample_hz,
            self.toolface_deg,
            self.vibration_rms_g,
        )


class LegTable(Table):
    """A piece of a drilling leg."""

    duration_s: Positive
    inclination_to_deg: Annotated[float, Field(ge=0, le=180)] | None = None
    turn_deg: Finite = 0.0
    vibration_g: Annotated[float, Field(ge=0)] = 0.0


class LegsMotion(_Motion):
    """A programme of legs: standing, turning, inclining, shaking."""

    kind: Literal["legs"]
    legs: Annotated[tuple[LegTable, ...], Field(min_length=1)]
    inclination_deg: Annotated[float, Field(ge=0, le=180)] = 5.0
    toolface_deg: Finite = 0.0
    sample_hz: Positive = 50.0

    def plan(self) -> Plan:
        legs = tuple(Leg(leg.duration_s, leg.inclination_to_deg, leg.turn_deg, leg.vibration_g) for leg in self.legs)
        return LegPlan(legs, self.inclination_deg, self.toolface_deg, self.sample_hz)


KINDS: dict[str, type[BaseModel]] = {
    "poses": PosesMotion,
    "turns": TurnsMotion,
    "rotation": RotationMotion,
    "legs": LegsMotion,
}
Motion = Annotated[PosesMotion | TurnsMotion | RotationMotion | LegsMotion, Field(discriminator="kind")]


class SiteTable(Table):
    """Where it stands. Gravity not given follows from the latitude, or is the standard value."""

    gravity_mps2: Annotated[float, Field(ge=9.7, le=9.9)] | None = None
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    azimuth_deg: Finite = Field(default=0.0, description="Azimuth of the hole's down direction.")

    @property
    def site(self) -> Site:
        latitude = math.radians(self.latitude_deg or 0.0)
        gravity = self.gravity_mps2
        if gravity is None:
            gravity = STANDARD_GRAVITY_MPS2 if self.latitude_deg is None else normal_gravity_mps2(latitude)
        return Site(gravity, latitude, math.radians(self.azimuth_deg))


class ReferenceTable(Table):
    """What says where the tool was."""

    kind: Literal["pose", "magnitude", "simulation"] = "pose"


class Model(Table):
    """What a simulation knows of a tool, its bench, its site and its motion: the model file, each table a field."""

    tool: ToolTable = ToolTable()
    sensor: SensorTable = SensorTable()
    effects: EffectsTable = EffectsTable()
    motion: Motion | None = None
    site: SiteTable = SiteTable()
    reference: ReferenceTable = ReferenceTable()

    @model_validator(mode="after")
    def _once(self) -> Self:
        for effect_id in self.sensor.effects():
            if effect_id in self.effects.included:
                raise ValueError(f"'{effect_id}' is given both in [sensor] and in [effects]: keep one")
            effect = _effect(effect_id)
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
        without `row_seconds` it is left out.
        """
        effects = {**self.sensor.effects(), **self.effects.values()}
        if self.sensor.noise_g and row_seconds is not None:
            density = self.sensor.noise_g * math.sqrt(2 * row_seconds)
            effects["reading_noise"] = {f"density_{axis}": density for axis in AXES}
        return ForwardModel.of(effects)

    def with_effects(self, effects: Mapping[str, Mapping[str, float]]) -> Model:
        """With these effects (parameters in the library's units) in place of those of the same ids.

        Effects that `[sensor]` stands for move to `[effects]`. Raises InputError for an implausible parameter.
        """
        kept = {**self.sensor.effects(), **self.effects.values(), **effects}
        sensor = self.sensor.model_copy(update={"bias_g": None, "scale": None, "misalignment_deg": None})
        tables = {
            **self.model_dump(mode="json", exclude={"sensor", "effects"}, exclude_none=True),
            "sensor": sensor.model_dump(mode="json", exclude_none=True),
            "effects": {
                "included": list(kept),
                "implausible": self.effects.implausible,
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
    """The model as a file that `load_model` reads back equal; what has its default is left out."""
    tables = model.model_dump(mode="json", exclude_defaults=True)
    if model.motion is not None:
        tables["motion"] = {"kind": model.motion.kind, **tables["motion"]}
    lines: list[str] = []
    for name, table in tables.items():
        inner = {key: value for key, value in table.items() if isinstance(value, dict)}
        lines += [f"[{name}]", *(f"{key} = {_toml(v)}" for key, v in table.items() if key not in inner), ""]
        for key, values in inner.items():
            lines += [f"[{name}.{key}]", *(f"{k} = {_toml(v)}" for k, v in values.items()), ""]
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
    return parse_model(read_toml(path), where=str(path))


def parse_model(tables: Mapping[str, Any], *, where: str) -> Model:
    """As `load_model`, from parsed tables."""
    try:
        return Model.model_validate(dict(tables))
    except ValidationError as error:
        raise _one_line(error, where) from None


def _effect(effect_id: str) -> Effect:
    """The effect of the library, or a ValueError (for pydantic) that names the nearest."""
    try:
        return library.get(effect_id)
    except InputError as error:
        raise ValueError(f"{error.what}; {error.remedy}") from None


def _parameters(effect: Effect, table: Mapping[str, Any]) -> dict[str, float]:
    """Values in the library's units from a table that may use suffixes of units and vectors of three."""
    known = {parameter.name: parameter for parameter in effect.parameters}
    values: dict[str, float] = {}

    def put(name: str, value: object, factor: float, written: str) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"{effect.id}.{written} must be a finite number (given {value!r})")
        if name in values:
            raise ValueError(f"{effect.id}.{name} is given twice")
        values[name] = float(value) * factor

    for written, value in table.items():
        stem, factor = _without_suffix(written, known)
        if stem in known:
            put(stem, value, factor, written)
        elif all(f"{stem}_{axis}" in known for axis in AXES):
            three = value if isinstance(value, list | tuple) else [value] * 3
            if len(three) != 3:
                raise ValueError(f"{effect.id}.{written} needs one number or three (x, y, z)")
            for axis, one in zip(AXES, three, strict=True):
                put(f"{stem}_{axis}", one, factor, written)
        else:
            near = difflib.get_close_matches(written, known, n=1)
            remedy = f"did you mean {near[0]}?" if near else f"it has: {', '.join(known)}"
            raise ValueError(f"the effect '{effect.id}' has no parameter '{written}'; {remedy}")
    return values


def _without_suffix(written: str, known: Mapping[str, Any]) -> tuple[str, float]:
    """Name and factor of a parameter as written: `tilt_x_deg` -> (`tilt_x`, pi/180)."""
    stem, _, suffix = written.rpartition("_")
    for name in (stem, f"{stem}_x"):
        if written not in known and name in known and suffix in UNITS.get(known[name].unit, {}):
            return stem, UNITS[known[name].unit][suffix]
    return written, 1.0


def _one_line(error: ValidationError, where: str) -> InputError:
    return told_together([_mistake(detail) for detail in error.errors(include_url=False)], where)


def _mistake(detail: ErrorDetails) -> Mistake:
    # the kind of motion stands in the location but not in the file
    keys = [str(key) for key in detail["loc"]]
    if len(keys) > 1 and keys[0] == "motion":
        keys = [keys[0], *keys[2:]]
    message = detail["msg"].removeprefix("Value error, ")
    remedy = ""
    if detail["type"] == "extra_forbidden":
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
    model: type[BaseModel] = Model
    if len(keys) > 1:
        if keys[0] == "motion":
            model = LegTable if "legs" in keys[1:-1] else KINDS[str(location[1])]
        else:
            annotation = Model.model_fields[keys[0]].annotation
            if isinstance(annotation, type) and issubclass(annotation, BaseModel):
                model = annotation
    near = difflib.get_close_matches(keys[-1], model.model_fields, n=1)
    return f"did you mean {near[0]}?" if near else f"allowed: {', '.join(model.model_fields)}"
