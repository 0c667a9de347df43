"""What a calibration takes of a model: its bench, for the angles given, and its laws of the sensor, for the record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import wrap_signed
from highside.calibration.sensor_laws import BENCH_PLACES, BY_LOAD, GIVEN, SENSOR_PLACES
from highside.config.model import Model, ToolTable
from highside.errors import InputError
from highside.physics.covariates import COVARIATES
from highside.physics.effect import Stage
from highside.physics.forward import ForwardModel
from highside.physics.law import PREFIX, Law, LawEffect
from highside.physics.state import ChainState

__all__ = ["bench_columns", "bench_of", "laws_of_the_sensor", "notes_on", "true_references"]

KNOWN_OF_POSES = frozenset({*BY_LOAD, "temp", "rate", "rate_sign"})
"""covariates that a table of poses gives; a law of the bench that depends on others is not taken off"""
UPRIGHT_SIN = 1e-3
"""Where sin(inclination) is less (0.06 deg), a tool has no toolface to correct."""


def laws_of_the_sensor(knows: Model, where: str | None = None) -> tuple[Law, ...]:
    """Laws that a record keeps, with the digits that it keeps. Raises InputError where the model maps axes."""
    laws = tuple(Law.from_dict(law.to_dict()) for law in knows.known_laws if law.place in SENSOR_PLACES)
    if laws and knows.tool.axes != ToolTable().axes:
        raise InputError(
            "the laws are of the tool's axes, the poses of the maker's",
            where=where,
            field="tool.axes",
            remedy="map the axes in the codec's configuration (`highside decode --config`), and diagnose again",
        )
    return laws


def bench_of(knows: Model) -> ForwardModel:
    """What a model knows of the bench: its effects, and such laws as follow from what a pose table says."""
    usable = {law.id for law in knows.known_laws if law.place in BENCH_PLACES and _of_poses(law)}
    return ForwardModel(
        tuple(
            (effect, p)
            for effect, p in knows.forward().effects
            if effect.stage in (Stage.POSE, Stage.GRAVITY)
            and not effect.random
            and (effect.id in usable or not effect.id.startswith(PREFIX))
        )
    )


def _of_poses(law: Law) -> bool:
    """Whether a table of poses can say what a law depends on: no time, and nothing that came before."""
    return not any(name in COVARIATES and name not in KNOWN_OF_POSES for name in law.depends_on)


def bench_columns(bench: ForwardModel) -> list[str]:
    """Columns that the laws of a bench need beside the angles given."""
    needed = {name for effect, _ in bench.effects if isinstance(effect, LawEffect) for name in effect.law.depends_on}
    own = sorted(name for name in needed if name not in COVARIATES)
    return [*own, *(["temp_c"] if "temp" in needed else [])]


def true_references(bench: ForwardModel, columns: Mapping[str, Array]) -> tuple[Array, Array]:
    """Where the bench truly stood, inclination and toolface (K,) deg, at the settings that it gives (K,) deg."""
    inc_ref, tf_ref = columns["inc_ref_deg"], columns["tf_ref_deg"]
    given = {"t_s": np.arange(inc_ref.size, dtype=float), **columns, "pose": np.arange(inc_ref.size, dtype=float)}
    inc, tf = bench.truth(ChainState.from_columns(given))
    # a table that was turned the other way stays so: which side a pose was set from tells how the bench leans
    inc, tf = np.where(inc_ref < 0.0, -inc, inc), np.where(inc_ref < 0.0, tf + np.pi, tf)
    upright = np.abs(np.sin(np.radians(inc_ref))) < UPRIGHT_SIN
    d_tf = np.where(upright, 0.0, wrap_signed(tf - np.radians(tf_ref)))
    return np.degrees(inc), np.asarray(tf_ref + np.degrees(d_tf))


def notes_on(name: str, knows: Model, bench: ForwardModel, laws: Sequence[Law]) -> Iterator[str]:
    """What a user must know of how a model was used."""
    used = {effect.id for effect, _ in bench.effects}
    left = [e.id for e, _ in knows.forward().effects if e.id not in used and not e.random]
    left = [effect_id for effect_id in left if not effect_id.startswith(PREFIX)]
    if left:
        only = "the bench and the laws are" if laws else "the bench is"
        yield f"of {name} only {only} used; estimated anew: {', '.join(left)}"
    if laws:
        yield f"of {name} the record keeps the laws {', '.join(law.slug for law in laws)}"
    for law in laws:
        unknown = [c for c in law.depends_on if c in COVARIATES and c not in BY_LOAD and c not in GIVEN]
        if unknown:
            yield (
                f"the law {law.slug} depends on {', '.join(unknown)}, which no single reading tells: it is never taken"
                " off, and its size is in every standard deviation"
            )
    known = {law.slug for law in laws}
    idle = [law.slug for law in knows.known_laws if law.slug not in known and law.id not in used]
    if idle:
        yield f"not used, for neither a pose nor a reading tells what they depend on or act on: {', '.join(idle)}"
