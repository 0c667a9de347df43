"""The tables `[sensor]` and `[effects]` of the model file: which effects a simulation has, and their parameters.

A parameter is written in its own unit, or with a suffix that says another; three parameters of the axes may be written
as one (see `model`).
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from highside.errors import InputError
from highside.physics import effects as library
from highside.physics.effect import AXES, Effect
from highside.physics.effects.misalignment import EFFECT as MISALIGNMENT
from highside.reading.config_table import ConfigTable

Finite = Annotated[float, Field(allow_inf_nan=False)]
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


class SensorTable(ConfigTable):
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
            known_effect(effect_id)
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
            known_effect(effect_id)
        if len(set(self.included)) != len(self.included):
            twice = next(effect_id for effect_id in self.included if self.included.count(effect_id) > 1)
            raise ValueError(f"included names '{twice}' twice")
        for name, table in (self.model_extra or {}).items():
            if not isinstance(table, Mapping):
                raise ValueError(f"'{name}' is not a known field; allowed: included, implausible and tables of effects")
            effect = known_effect(name)
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
        return {
            effect_id: _parameters(known_effect(effect_id), tables.get(effect_id, {})) for effect_id in self.included
        }


def known_effect(effect_id: str) -> Effect:
    """The effect of the library, or a ValueError (for pydantic) that names the nearest."""
    try:
        return library.get(effect_id)
    except InputError as error:
        raise ValueError(f"{error.what}; {error.remedy}") from None


def _parameters(effect: Effect, table: Mapping[str, Any]) -> dict[str, float]:
    """Values in the library's units from a table that may use suffixes of units and vectors of three."""
    known = {parameter.name: parameter for parameter in effect.parameters}
    known |= {parameter.formerly: parameter for parameter in effect.parameters if parameter.formerly}
    values: dict[str, float] = {}

    def put(name: str, value: object, factor: float, written: str) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"{effect.id}.{written} must be a finite number (given {value!r})")
        name = known[name].name
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
            remedy = f"did you mean {near[0]}?" if near else f"it has: {', '.join(p.name for p in effect.parameters)}"
            raise ValueError(f"the effect '{effect.id}' has no parameter '{written}'; {remedy}")
    return values


def _without_suffix(written: str, known: Mapping[str, Any]) -> tuple[str, float]:
    """Name and factor of a parameter as written: `tilt_x_deg` -> (`tilt_x`, pi/180)."""
    stem, _, suffix = written.rpartition("_")
    for name in (stem, f"{stem}_x"):
        if written not in known and name in known and suffix in UNITS.get(known[name].unit, {}):
            return stem, UNITS[known[name].unit][suffix]
    return written, 1.0
