"""What is known of a bench is taken off its settings before they are used as references.

Of a model's laws those of the bench (`BENCH_PLACES`) are taken off the angles here, those of the sensor
(`SENSOR_PLACES`) are handed on: a record keeps them. Others say nothing of a pose of an accelerometer.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np

from highside.attitude.angles import wrap_signed
from highside.calibration.sensor_laws import BENCH_PLACES, BY_LOAD, GIVEN, SENSOR_PLACES
from highside.config.model import Model, ToolTable, as_toml, load_model, parse_model
from highside.errors import InputError
from highside.physics.covariates import COVARIATES
from highside.physics.effect import Stage
from highside.physics.forward import ForwardModel
from highside.physics.law import PREFIX, Law, LawEffect
from highside.physics.state import ChainState
from highside.reading import read_bytes
from highside.recording.table import Table
from highside.rotation import Compensation
from highside.rotation.turntable import correct_settings

__all__ = ["ModelLike", "load_compensation", "model_of", "on_true_bench"]

ModelLike: TypeAlias = Model | str | os.PathLike[str] | Mapping[str, Any]
"""a model, its file, or the tables of the file as a dict"""
CompensationLike: TypeAlias = Compensation | str | os.PathLike[str]
TableT = TypeVar("TableT", bound=Table)

TOLD_BY_POSES = frozenset({*BY_LOAD, "temp", "rate", "rate_sign"})
"""covariates that a table of poses gives; a law of the bench that depends on others is not taken off"""
UPRIGHT_SIN = 1e-3
"""Where sin(inclination) is less (0.06 deg), a tool has no toolface to correct."""


def model_of(model: ModelLike) -> Model:
    """The model itself, of its file (TOML), or of the tables of such a file. Raises InputError that names the field."""
    if isinstance(model, Model):
        return model
    if isinstance(model, Mapping):
        return parse_model(model, where="model")
    return load_model(Path(model))


def load_compensation(compensation: CompensationLike) -> Compensation:
    """A compensation, or that of its file. Raises InputError, or Refused for one that was changed."""
    if isinstance(compensation, Compensation):
        return compensation
    return Compensation.from_json(read_bytes(Path(compensation)), where=str(compensation))


class OnTrueBench(NamedTuple):
    """A pose table with references where the bench truly stood, and what goes with it."""

    table: Any
    taken_off: str | None
    """ids of what was taken off"""
    notes: tuple[str, ...]
    laws: tuple[Law, ...]
    """of the sensor, not taken off yet"""


def on_true_bench(table: Table, turntable: CompensationLike | None, model: ModelLike | None) -> OnTrueBench:
    """A pose table freed of what is known of its bench, by the fit of its turntable and by a model.

    Raises InputError where the table lacks its references or what a law depends on, or where a model knows nothing of
    the bench and no law of the sensor.
    """
    ids: list[str] = []
    notes: list[str] = []
    laws: tuple[Law, ...] = ()
    if turntable is not None:
        known = load_compensation(turntable)
        inc_ref, tf_ref = table.require("inc_ref_deg", "tf_ref_deg")
        true_inc, true_tf = correct_settings(known, inc_ref, tf_ref, table.columns.get("rotor_deg"))
        table = _moved(table, {"inc_ref_deg": true_inc, "tf_ref_deg": true_tf})
        ids.append(known.id)
    if model is not None:
        knows, where = model_of(model), None if isinstance(model, Model | Mapping) else str(model)
        laws, idle = _laws_of_the_sensor(knows, where)
        bench = _bench_of(knows)
        if not bench.effects and not laws:
            raise InputError(
                "knows no effect of the bench, and no law",
                where=where,
                field="effects.included",
                remedy="leave model= out: the joint method estimates the sensor's own terms itself",
            )
        if bench.effects:
            table = _by_bench(table, bench, where)
        content = as_toml(knows).encode() if where is None else read_bytes(Path(where))
        ids.append("model:" + hashlib.sha256(content).hexdigest())
        notes += _notes(where or "the model", knows, bench, laws, idle)
    return OnTrueBench(table, " ".join(ids) or None, tuple(notes), laws)


def _moved(table: TableT, columns: Mapping[str, Any]) -> TableT:
    return type(table)({**table.columns, **columns}, table.texts, table.order, table.source)


def _laws_of_the_sensor(knows: Model, where: str | None) -> tuple[tuple[Law, ...], tuple[str, ...]]:
    """Laws that a record keeps, and the slugs of those that neither a record nor the references can use."""
    laws = tuple(law for law in knows.known_laws if law.place in SENSOR_PLACES)
    if laws and knows.tool.axes != ToolTable().axes:
        raise InputError(
            "the laws are of the tool's axes, the poses of the maker's",
            where=where,
            field="tool.axes",
            remedy="map the axes in the codec's configuration (`highside decode --config`), and diagnose again",
        )
    known = (*SENSOR_PLACES, *BENCH_PLACES)
    idle = [law.slug for law in knows.known_laws if law.place not in known or (law not in laws and not _of_poses(law))]
    return laws, tuple(idle)


def _of_poses(law: Law) -> bool:
    """Whether a table of poses can say what a law depends on: no time, and nothing that came before."""
    return not any(name in COVARIATES and name not in TOLD_BY_POSES for name in law.depends_on)


def _bench_of(knows: Model) -> ForwardModel:
    """What a model knows of the bench: its effects, and such laws as follow from what a pose table says."""
    forward = knows.forward()
    usable = {law.id for law in knows.known_laws if law.place in BENCH_PLACES and _of_poses(law)}
    return ForwardModel(
        tuple(
            (effect, p)
            for effect, p in forward.effects
            if effect.stage in (Stage.POSE, Stage.GRAVITY)
            and not effect.random
            and (effect.id in usable or not effect.id.startswith(PREFIX))
        )
    )


def _by_bench(table: TableT, bench: ForwardModel, where: str | None) -> TableT:
    """References where the bench truly stood."""
    inc_ref, tf_ref = table.require("inc_ref_deg", "tf_ref_deg")
    laws = [effect.law for effect, _ in bench.effects if isinstance(effect, LawEffect)]
    needed = {name for law in laws for name in law.depends_on}
    own = sorted(name for name in needed if name not in COVARIATES)
    complete = [*own, *(["temp_c"] if "temp" in needed else [])]
    if complete:
        table.complete(*complete)
    names = ("inc_ref_deg", "tf_ref_deg", "direction", "temp_c", "t_s", *own)
    columns = {name: table.columns[name] for name in names if name in table.columns}
    columns.setdefault("t_s", np.arange(inc_ref.size, dtype=float))
    columns["pose"] = np.arange(inc_ref.size, dtype=float)
    inc, tf = bench.truth(ChainState.from_columns(columns))
    upright = np.abs(np.sin(np.radians(inc_ref))) < UPRIGHT_SIN
    d_tf = np.where(upright, 0.0, wrap_signed(tf - np.radians(tf_ref)))
    return _moved(table, {"inc_ref_deg": np.degrees(inc), "tf_ref_deg": tf_ref + np.degrees(d_tf)})


def _notes(name: str, knows: Model, bench: ForwardModel, laws: Sequence[Law], idle: Sequence[str]) -> Iterator[str]:
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
        blind = [c for c in law.depends_on if c in COVARIATES and c not in BY_LOAD and c not in GIVEN]
        if blind:
            yield (
                f"the law {law.slug} depends on {', '.join(blind)}, which no single reading tells: it is never taken"
                " off, and its size is in every standard deviation"
            )
    if idle:
        yield f"not used, for neither a pose nor a reading tells what they depend on or act on: {', '.join(idle)}"
