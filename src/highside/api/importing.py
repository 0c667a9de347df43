"""Recordings of other programs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from highside.recording.table import Recording

if TYPE_CHECKING:
    from highside.importing.core.proposal import Proposal
    from highside.importing.core.wishes import Wishes

__all__ = ["import_recording", "propose_import", "write_imported"]


def import_recording(
    file: str | os.PathLike[str],
    *,
    mapping: Mapping[str, str] | None = None,
    units: Sequence[str] = (),
    axes: str | None = None,
    rate_hz: float | None = None,
    table: str | None = None,
    part: int | None = None,
    profile: str | None = None,
    accept: bool = False,
) -> Recording:
    """A Recording of N rows out of a file of another program: `t_s`, `ax_g`, ... whatever they are called there.

    `file`: CSV in any dialect, Excel, Parquet, Arrow, NumPy, MATLAB, HDF5, MCAP, ROS, PX4. `mapping`: column of ours
    to `COLUMN` or `COLUMN:unit` of the file, or `none`; `units`: units of the file, one a quantity, as
    `("m/s2", "rad/s")`; `axes`: the tool's axes in the file's (`"-yxz"`); `rate_hz`: rows/s where it has no time;
    `table`: which sheet, topic or length of arrays; `part`: which part, from 1, where its clock began again;
    `profile`: a mapping kept by `highside import`.
    What rests on values alone is used only with `accept`; what is open never. Raises InputError that says which
    argument (of the command: which option) decides it.
    """
    from highside.importing.core.wishes import Wishes
    from highside.importing.files import recording_of, refuse_open

    wishes = Wishes(dict(mapping or {}), tuple(units), axes, rate_hz, table, part)
    proposal, _, _ = propose_import(Path(file), wishes, profile)
    refuse_open(proposal, accepted=accept)
    return recording_of(proposal).recording


def propose_import(file: Path, wishes: Wishes, profile: str | None) -> tuple[Proposal, Wishes, bool]:
    """The proposal, the wishes with those of the profile, and whether there is such a profile already."""
    from highside.importing.files import open_foreign
    from highside.importing.profiles import load, merged

    kept = None if profile is None else load(profile)
    together = merged(kept, wishes)
    return open_foreign(file, together), together, kept is not None


def write_imported(recording: Recording, target: Path) -> None:
    """Write as the name of the file says: Parquet, or CSV. Raises InputError."""
    from highside.recording.export import export
    from highside.recording.export_format import ExportFormat

    kinds = {".parquet": ExportFormat.PARQUET, ".mcap": ExportFormat.MCAP}
    export(recording, target, kinds.get(target.suffix, ExportFormat.CSV))
