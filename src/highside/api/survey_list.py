"""Survey lists: the accepted surveys of a tool by depth, for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from highside.errors import InputError
from highside.recording.frames import File
from highside.recording.kept_surveys import read_surveys
from highside.recording.survey_files import Wellbore, write_survey_list
from highside.recording.survey_formats import SurveyFormat
from highside.recording.survey_list import SurveyList, list_of

__all__ = ["ListedSurveys", "list_surveys"]


@dataclass(frozen=True)
class ListedSurveys:
    """Surveys by measured depth, with what could not be listed and why."""

    table: SurveyList
    """`md_m, inc_deg, azi_deg, tf_deg` and, where every azimuth is known, `tvd_m, north_m, east_m, dls_deg_30m`"""
    left_out: dict[str, int]
    """surveys that are not in it, by reason"""
    notes: tuple[str, ...] = ()

    def save(
        self,
        file: File,
        to: str | None = None,
        *,
        wellbore: str = "unknown",
        datum: str = "unknown",
        north: str = "true",
    ) -> None:
        """Write the list as `csv`, `las` (LAS 2.0) or `witsml` (a WITSML 2.0 trajectory); by the name of the file where
        `to` is not given. `wellbore`: its name; `datum`: what measured depth counts from; `north`: what azimuths refer
        to, `true`, `magnetic` or `grid`. Raises InputError for another format or where the extra `survey` lacks."""
        target = Path(file)
        word = to or {".las": "las", ".xml": "witsml"}.get(target.suffix.lower(), "csv")
        if word not in set(SurveyFormat):
            raise InputError(f"{word!r} is no format of survey lists", field="to", remedy="csv, las or witsml")
        if north not in ("true", "magnetic", "grid"):
            raise InputError(f"{north!r} is no north", field="north", remedy="true, magnetic or grid")
        write_survey_list(self.table, target, SurveyFormat(word), Wellbore(wellbore, datum, north))

    def _repr_html_(self) -> str:
        """What a notebook shows: the first and the last stations."""
        return self.table._repr_html_()


def list_surveys(
    surveys: File, *, depths: File | None = None, azimuths: File | None = None, sensor_offset_m: float = 0.0
) -> ListedSurveys:
    """The accepted surveys of a tool by measured depth, with positions by minimum curvature where azimuth is known.

    `surveys`: `surveys.jsonl` of the tool's state directory. `depths`: a table with `md_m` and what joins it, `seq` or
    `t` (UTC epoch seconds, at most 120 s apart); else the members `md_m` of the surveys. `azimuths`: a table with
    `azi_deg` (and `azi_std_deg`) and `seq`, `t` or `md_m` (at most 0.5 m apart), as of a gyro survey; else the members
    `azi_deg` of a tool with gyros. Nothing is interpolated. `sensor_offset_m`: how far the sensor is behind the depth
    that `depths` gives. Positions need the extra `survey`. Raises InputError for a file that is not in order, and where
    no survey has a depth.
    """
    found = list_of(
        read_surveys(Path(surveys)),
        None if depths is None else Path(depths),
        None if azimuths is None else Path(azimuths),
        sensor_offset_m=sensor_offset_m,
    )
    return ListedSurveys(found.table, found.left_out, found.notes)
