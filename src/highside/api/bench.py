"""What is known of a bench is taken off its settings before they are used as references."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np

from highside.attitude.angles import wrap_signed
from highside.config.model import Model, as_toml, load_model, parse_model
from highside.errors import InputError
from highside.physics.effect import Stage
from highside.physics.forward import ForwardModel
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


def on_true_bench(
    table: TableT, turntable: CompensationLike | None, model: ModelLike | None
) -> tuple[TableT, str | None, tuple[str, ...]]:
    """A pose table with references where the bench truly stood, the ids of what was taken off, and what to say of it.

    Raises InputError where the table lacks its references, or a model knows nothing of the bench.
    """
    ids: list[str] = []
    notes: list[str] = []
    if turntable is not None:
        known = load_compensation(turntable)
        inc_ref, tf_ref = table.require("inc_ref_deg", "tf_ref_deg")
        true_inc, true_tf = correct_settings(known, inc_ref, tf_ref, table.columns.get("rotor_deg"))
        table = _moved(table, {"inc_ref_deg": true_inc, "tf_ref_deg": true_tf})
        ids.append(known.id)
    if model is not None:
        table, model_id, left = _by_model(table, model)
        ids.append(model_id)
        if left:
            named = "the model" if isinstance(model, Model | Mapping) else model
            notes.append(f"of {named} only the bench is used; estimated anew: {', '.join(left)}")
    return table, " ".join(ids) or None, tuple(notes)


def _moved(table: TableT, columns: Mapping[str, Any]) -> TableT:
    return type(table)({**table.columns, **columns}, table.texts, table.order, table.source)


def _by_model(table: TableT, model: ModelLike) -> tuple[TableT, str, tuple[str, ...]]:
    """References where the model's bench truly stood, an id of that model, and the ids of the effects of the sensor
    that the model has beside (a calibration estimates those itself)."""
    knows = model_of(model)
    forward = knows.forward()
    bench = {e.id: p for e, p in forward.effects if e.stage in (Stage.POSE, Stage.GRAVITY) and not e.random}
    if not bench:
        raise InputError(
            "knows no effect of the bench",
            where=None if isinstance(model, Model | Mapping) else str(model),
            field="effects.included",
            remedy="leave model= out: the joint method estimates the sensor's own terms itself",
        )
    inc_ref, tf_ref = table.require("inc_ref_deg", "tf_ref_deg")
    names = ("inc_ref_deg", "tf_ref_deg", "direction", "temp_c", "t_s")
    columns = {name: table.columns[name] for name in names if name in table.columns}
    columns.setdefault("t_s", np.arange(inc_ref.size, dtype=float))
    columns["pose"] = np.arange(inc_ref.size, dtype=float)
    state = ChainState.from_columns(columns)
    known = ForwardModel.of({name: values for name, values in forward.parameters().items() if name in bench})
    inc, tf = known.truth(state)
    upright = np.abs(np.sin(np.radians(inc_ref))) < UPRIGHT_SIN
    d_tf = np.where(upright, 0.0, wrap_signed(tf - np.radians(tf_ref)))
    moved = {"inc_ref_deg": np.degrees(inc), "tf_ref_deg": tf_ref + np.degrees(d_tf)}
    content = as_toml(knows).encode() if isinstance(model, Model | Mapping) else read_bytes(Path(model))
    sensor = tuple(e.id for e, _ in forward.effects if e.id not in bench and not e.random)
    return _moved(table, moved), "model:" + hashlib.sha256(content).hexdigest(), sensor
