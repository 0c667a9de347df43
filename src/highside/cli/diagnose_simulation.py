"""`highside diagnose --simulation SIM.csv`: a recording beside another program's output."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from highside.cli.say import echo

if TYPE_CHECKING:
    from highside.config.model import Model
    from highside.diagnosis.core.result import Diagnosis
    from highside.diagnosis.core.scene import Picture
    from highside.recording.table import Recording


def diagnose_beside(rows: Recording, simulation: Path, knows: Model, seed: int) -> tuple[Diagnosis, Picture | None]:
    """Align, compare, diagnose. Without a model that names `free` effects, nothing is refitted beforehand."""
    from highside import __version__
    from highside.diagnosis.core.result import Diagnosis
    from highside.diagnosis.engine import diagnose_simulation
    from highside.diagnosis.simulation.intake import check_prediction
    from highside.diagnosis.simulation.session import simulation_session
    from highside.errors import InputError
    from highside.recording.table import read_recording

    predicted = read_recording(simulation)
    try:
        session = simulation_session(rows.columns, predicted.columns)
    except InputError as error:
        raise InputError(error.what, where=str(simulation), field=error.field, remedy=error.remedy) from None
    a = session.alignment
    said = f"shifted by {a.shift_s:.4g} s" if a.shift_s else f"lag {a.lag_s:.4f} s, left in"
    echo(
        f"{', '.join(session.names)}: {session.n * session.step_s:.1f} s compared, {1 / session.step_s:.3g} rows/s, "
        f"up to {session.band_hz:.3g} Hz; prediction {said} (correlation {a.correlation:.3f})"
    )  # fmt: skip
    found = check_prediction(session)
    if found:
        return Diagnosis("bad_data", intake=found, seed=seed, version=__version__), None
    free = knows.sensor.free if "free" in knows.sensor.model_fields_set else ()
    return diagnose_simulation(session, free, seed=seed, version=__version__)
