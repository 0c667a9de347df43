"""`highside diagnose --summary TABLE.csv`: a published error table instead of a recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from highside.config.model import Model
    from highside.diagnosis.core.result import Diagnosis
    from highside.diagnosis.table.engine import SummaryPicture


def diagnose_table(
    table: Path,
    knows: Model,
    *,
    corrected_by: str,
    stations: int,
    readings: int,
    seed: int,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[Diagnosis, SummaryPicture]:
    """Read the table and diagnose it. Raises InputError that names the option or the column that is wrong."""
    import numpy as np

    from highside import __version__
    from highside.diagnosis.table.chain import CELLS, CORRECTIONS, Procedure
    from highside.diagnosis.table.engine import diagnose_summary
    from highside.errors import InputError
    from highside.physics.noise import std_of_average
    from highside.recording.table import SummaryTable

    correction = next((known for known in CORRECTIONS if known == corrected_by), None)
    if correction is None:
        raise InputError(
            f"{corrected_by!r} is unknown", field="--corrected-by", remedy=f"one of {', '.join(CORRECTIONS)}"
        )
    read = SummaryTable.read(table)
    inc = read.complete("inc_ref_deg")[0]
    wrong = np.flatnonzero((inc <= 0) | (inc >= 180))
    if wrong.size:
        raise InputError(
            f"{inc[wrong[0]]:g} is not between 0 and 180", where=f"{table}: line {wrong[0] + 2}", field="inc_ref_deg",
            remedy="at 0 and 180 deg there is no toolface",
        )  # fmt: skip
    noise = knows.sensor.noise_g
    effects = knows.effects.values()
    if "reading_noise" in effects:
        noise = float(np.mean([std_of_average(v, 1.0) for v in effects["reading_noise"].values()]))
    told = np.column_stack([read.columns[name] for name in CELLS])
    try:
        found = diagnose_summary(
            inc, told, Procedure(correction, stations, readings), knows.forward(), knows.sensor.free,
            noise_g=noise or None, seed=seed, version=__version__, progress=progress,
        )  # fmt: skip
    except InputError as error:
        raise InputError(error.what, where=str(table), field=error.field, remedy=error.remedy) from None
    return found.diagnosis, found.picture
