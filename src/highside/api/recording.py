"""A recording, and what is done with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Unpack

from highside.api.bench import ModelLike
from highside.recording import table as tables
from highside.recording.frames import File
from highside.recording.table import Table

if TYPE_CHECKING:
    from highside.api.calibration import Calibration, CorrectOptions
    from highside.api.diagnosis import DiagnoseOptions, Diagnosis

__all__ = ["Recording"]


@dataclass(slots=True)
class Recording(tables.Recording):
    """N rows, one a frame: columns by name (`recording["ax_g"]` is an array), units in the names (`t_s`, `ax_g`,
    `gx_dps`, `temp_c`, `inc_ref_deg`).

    `read` and `simulate` give one. Every function of highside takes it, and its methods are these functions.
    """

    notes: tuple[str, ...] = ()
    """of a file of another program: what each column was taken for and why, and what was found in the rows"""

    @classmethod
    def of(cls, table: Table, notes: Sequence[str] = ()) -> Recording:
        """A table that has the times `t_s`, as a recording. Raises InputError where it lacks them."""
        return cls(table.columns, table.texts, table.order, table.source, tuple(notes))

    def diagnose(self, model: ModelLike | None = None, **options: Unpack[DiagnoseOptions]) -> Diagnosis:
        """Where this recording departs from what a model predicts, and what was left out of it: `highside.diagnose`.

        `model`: a model file (TOML), its tables, or a `Model`; None: nothing is known beside the sensor. Raises
        InputError.
        """
        from highside.api.diagnosis import diagnose

        return diagnose(self, model, **options)

    def correct(self, calibration: Calibration | File, **options: Unpack[CorrectOptions]) -> Recording:
        """This recording with `inc_deg, tf_deg, inc_std_deg, tf_std_deg`: `Calibration.correct`.

        `calibration`: a Calibration, or the file of a record. Raises InputError, and Refused for a record that is
        expired, tampered with or of another tool.
        """
        from highside.api.calibration import Calibration

        known = calibration if isinstance(calibration, Calibration) else Calibration.load(calibration)
        return Recording.of(known.correct(self, **options), self.notes)

    def _repr_html_(self) -> str:
        """What a notebook shows: the first and the last rows, and what was taken for what."""
        from highside.recording.shown import html_of

        return html_of(self, *self.notes)
