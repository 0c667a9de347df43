"""`calibrate solve --model`: what a model file knows of the bench is taken off the poses before they are solved."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from highside.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from highside.recording.table import Table

    Floats = NDArray[np.float64]


def correct_poses_by_model(table: Table, path: Path) -> tuple[Table, str, tuple[str, ...]]:
    """The pose table with references where the model's bench truly stood, an id of that model, and the ids of the
    effects of the sensor that the model has beside (a calibration estimates those itself).

    Raises InputError where the model knows nothing of the bench.
    """
    import hashlib

    import numpy as np

    from highside.attitude.angles import wrap_signed
    from highside.config.model import load_model
    from highside.physics.effect import Stage
    from highside.physics.forward import ForwardModel
    from highside.physics.state import ChainState
    from highside.reading import read_bytes

    forward = load_model(path).forward()
    bench = {e.id: p for e, p in forward.effects if e.stage in (Stage.POSE, Stage.GRAVITY) and not e.random}
    if not bench:
        raise InputError(
            "knows no effect of the bench", where=str(path), field="effects.included",
            remedy="leave --model out: the joint method estimates the sensor's own terms itself",
        )  # fmt: skip
    inc_ref, tf_ref = table.require("inc_ref_deg", "tf_ref_deg")
    names = ("inc_ref_deg", "tf_ref_deg", "direction", "temp_c", "t_s")
    columns: dict[str, Floats] = {str(name): table.columns[name] for name in names if name in table.columns}
    columns.setdefault("t_s", np.arange(inc_ref.size, dtype=float))
    columns["pose"] = np.arange(inc_ref.size, dtype=float)
    state = ChainState.from_columns(columns)
    known = ForwardModel.of({name: values for name, values in forward.parameters().items() if name in bench})
    inc, tf = known.truth(state)
    # a vertical tool has no toolface to correct
    upright = np.abs(np.sin(np.radians(inc_ref))) < 1e-3
    d_tf = np.where(upright, 0.0, wrap_signed(tf - np.radians(tf_ref)))
    moved = {"inc_ref_deg": np.degrees(inc), "tf_ref_deg": tf_ref + np.degrees(d_tf)}
    corrected = type(table)({**table.columns, **moved}, table.texts, table.order, table.source)
    sensor = tuple(e.id for e, _ in forward.effects if e.id not in bench and not e.random)
    return corrected, "model:" + hashlib.sha256(read_bytes(path)).hexdigest(), sensor
