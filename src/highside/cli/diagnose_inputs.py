"""What `highside diagnose` takes: a Recording, a pose table of a calibration, or a wire recording to be decoded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from highside.recording.table import PoseTable, Recording, Table

MINUTE_S = 60.0


def read_rows(
    path: Path, codec: str | None, config: Path | None, first_s: float | None, last_s: float | None
) -> Recording:
    """The rows to diagnose. A pose table becomes a recording of one row a pose, a minute apart where it has no times.

    With a codec the file is a wire recording. `first_s` and `last_s` cut a stretch out of it. Raises InputError.
    """
    import numpy as np

    from highside.errors import InputError
    from highside.recording.table import PoseTable, Recording, Table

    if codec is not None or config is not None:
        from highside.cli.decode import decode_recording

        rows = decode_recording(path, codec, config)
    else:
        table = Table.read(path)
        if "t_s" not in table.columns and table.has("inc_ref_deg", "tf_ref_deg", "ax", "ay", "az"):
            table = _of_poses(PoseTable(table.columns, table.texts, table.order, table.source))
        rows = Recording(table.columns, table.texts, table.order, table.source)
    if first_s is None and last_s is None:
        return rows
    t_s = rows.t_s
    keep = (t_s >= (-np.inf if first_s is None else first_s)) & (t_s <= (np.inf if last_s is None else last_s))
    if not keep.any():
        raise InputError(
            f"has no rows in that stretch; it runs from {np.nanmin(t_s):g} to {np.nanmax(t_s):g} s", where=str(path),
            field="--from, --to", remedy="give times of the recording",
        )  # fmt: skip
    return rows.select(keep)


def _of_poses(poses: PoseTable) -> Table:
    import numpy as np

    from highside.recording.table import Table

    mean = poses.accel()
    inc, tf = poses.reference_deg()
    n = poses.n
    columns = {
        "t_s": MINUTE_S * np.arange(n),
        **dict(zip(("ax_g", "ay_g", "az_g"), mean, strict=True)),
        "inc_ref_deg": inc,
        "tf_ref_deg": tf,
        "pose": np.arange(n, dtype=float),
    }
    columns |= {name: poses.columns[name] for name in ("temp_c", "direction", "t_s") if name in poses.columns}
    return Table(columns, source=poses.source)
