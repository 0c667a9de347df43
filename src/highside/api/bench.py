"""What is known of a bench is taken off its settings before they are used as references.

Of a model's laws those of the bench (`BENCH_PLACES`) are taken off the angles here, those of the sensor
(`SENSOR_PLACES`) are handed on: a record keeps them. Others say nothing of a pose of an accelerometer.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

from highside.errors import InputError
from highside.physics.forward import ForwardModel
from highside.physics.law import Law
from highside.reading import read_document
from highside.recording.table import Table

if TYPE_CHECKING:
    from highside.config.model import Model
    from highside.rotation import Compensation

__all__ = ["ModelLike", "load_compensation", "model_of", "on_true_bench"]

ModelLike: TypeAlias = "Model | str | os.PathLike[str] | Mapping[str, Any]"
"""a model, its file, or the tables of the file as a dict"""
CompensationLike: TypeAlias = "Compensation | str | os.PathLike[str]"
TableT = TypeVar("TableT", bound=Table)


def model_of(model: ModelLike) -> Model:
    """The model itself, of its file (TOML), or of the tables of such a file. Raises InputError that names the field."""
    from highside.config.model import Model, load_model, parse_model

    if isinstance(model, Model):
        return model
    if isinstance(model, Mapping):
        return parse_model(model, where="model")
    return load_model(Path(model))


def load_compensation(compensation: CompensationLike) -> Compensation:
    """A compensation, or that of its file. Raises InputError, or Refused for one that was changed."""
    from highside.rotation.compensation import Compensation

    if isinstance(compensation, Compensation):
        return compensation
    return Compensation.from_json(read_document(Path(compensation)), where=str(compensation))


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
        from highside.rotation.turntable import correct_settings

        known = load_compensation(turntable)
        inc_ref, tf_ref = table.require("inc_ref_deg", "tf_ref_deg")
        true_inc, true_tf = correct_settings(known, inc_ref, tf_ref, table.columns.get("rotor_deg"))
        table = _moved(table, {"inc_ref_deg": true_inc, "tf_ref_deg": true_tf})
        ids.append(known.id)
    if model is not None:
        from highside.config.model import as_toml
        from highside.config.model_bench import bench_of, laws_of_the_sensor, notes_on

        knows, where = model_of(model), str(model) if isinstance(model, str | os.PathLike) else None
        laws, bench = laws_of_the_sensor(knows, where), bench_of(knows)
        if not bench.effects and not laws:
            raise InputError(
                "knows no effect of the bench, and no law",
                where=where,
                field="effects.included",
                remedy="leave model= out: the joint method estimates the sensor's own terms itself",
            )
        if bench.effects:
            table = _by_bench(table, bench)
        content = as_toml(knows).encode() if where is None else read_document(Path(where))
        ids.append("model:" + hashlib.sha256(content).hexdigest())
        notes += notes_on(where or "the model", knows, bench, laws)
    return OnTrueBench(table, " ".join(ids) or None, tuple(notes), laws)


def _moved(table: TableT, columns: Mapping[str, Any]) -> TableT:
    return type(table)({**table.columns, **columns}, table.texts, table.order, table.source)


def _by_bench(table: Table, bench: ForwardModel) -> Table:
    """References where the bench truly stood."""
    from highside.config.model_bench import bench_columns, true_references

    table.require("inc_ref_deg", "tf_ref_deg")
    needed = bench_columns(bench)
    if needed:
        table.complete(*needed)
    names = ("inc_ref_deg", "tf_ref_deg", "direction", "temp_c", "t_s", *needed)
    inc, tf = true_references(bench, {name: table.columns[name] for name in names if name in table.columns})
    return _moved(table, {"inc_ref_deg": inc, "tf_ref_deg": tf})
