"""A survey list for other programs: CSV, LAS 2.0 (by lasio), a WITSML 2.0 trajectory (by energyml-witsml2-0)."""

from __future__ import annotations

import io
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from highside.errors import InputError
from highside.recording.files import write_whole
from highside.recording.survey_formats import SurveyFormat
from highside.recording.survey_list import SurveyList
from highside.version import __version__

__all__ = ["SurveyFormat", "Wellbore", "write_survey_list"]

NULL = -999.25
"""a value that is missing, in LAS"""
_WITSML = "http://www.energistics.org/energyml/data/witsmlv2"
_COMMON = "http://www.energistics.org/energyml/data/commonv2"
LAS_CURVES = (
    ("md_m", "DEPT", "M", "measured depth"),
    ("inc_deg", "INCL", "DEG", "inclination from vertical"),
    ("azi_deg", "AZIM", "DEG", "azimuth"),
    ("tf_deg", "GTF", "DEG", "gravity toolface"),
    ("tvd_m", "TVD", "M", "true vertical depth from the first station, minimum curvature"),
    ("north_m", "NS", "M", "north of the first station"),
    ("east_m", "EW", "M", "east of the first station"),
    ("dls_deg_30m", "DLS", "DEG/30M", "dogleg severity"),
    ("inc_std_deg", "INCLS", "DEG", "standard deviation of inclination"),
    ("g_total", "GTOT", "G", "magnitude of the corrected acceleration, local g of the bench"),
    ("temp_c", "TEMP", "DEGC", "temperature"),
)
"""column, mnemonic, unit, description"""


@dataclass(frozen=True, slots=True)
class Wellbore:
    """What a list is of; `datum`: what measured depth counts from; `north`: what azimuths refer to."""

    name: str = "unknown"
    datum: str = "unknown"
    north: str = "true"


def write_survey_list(table: SurveyList, target: Path, to: SurveyFormat, wellbore: Wellbore = Wellbore()) -> None:
    """Write a list as a whole. Raises InputError where the library is not installed or the place cannot be written."""
    if to is SurveyFormat.CSV:
        table.write(target)
    else:
        write_whole(target, _las(table, wellbore) if to is SurveyFormat.LAS else _witsml(table, wellbore))


def _not_installed(what: str, library: str) -> InputError:
    return InputError(f"{what} needs {library}, which is not installed", remedy="pip install 'highside[survey]'")


def _las(table: SurveyList, wellbore: Wellbore) -> bytes:
    try:
        import lasio
    except ImportError:
        raise _not_installed("LAS", "lasio") from None
    las = lasio.LASFile()
    las.well["WELL"].value = wellbore.name
    las.well["NULL"].value = NULL
    las.params["DREF"] = lasio.HeaderItem("DREF", value=wellbore.datum, descr="datum of measured depth")
    las.params["PROG"] = lasio.HeaderItem("PROG", value=f"highside {__version__}", descr="made by")
    for name, mnemonic, unit, words in LAS_CURVES:
        if table.has(name) and not np.isnan(table.columns[name]).all():
            las.append_curve(mnemonic, table.columns[name], unit=unit, descr=words)
    text = io.StringIO()
    # depths of surveys are uneven: LAS 2.0 wants a step of zero
    las.write(text, version=2.0, STEP=0, fmt="%.6f", wrap=False)
    return text.getvalue().encode()


def _witsml(table: SurveyList, wellbore: Wellbore) -> bytes:
    try:
        from energyml.eml.v2_1 import commonv2 as eml
        from energyml.witsml.v2_0 import witsmlv2 as witsml
        from xsdata.formats.dataclass.serializers import XmlSerializer
        from xsdata.formats.dataclass.serializers.config import SerializerConfig
        from xsdata.models.datatype import XmlDateTime
    except ImportError:
        raise _not_installed("WITSML", "energyml-witsml2-0") from None
    space = uuid.uuid5(uuid.NAMESPACE_URL, f"urn:highside:wellbore:{wellbore.name}")
    times = table.columns["t"]
    of_well = eml.DataObjectReference(
        content_type="application/x-witsml+xml;version=2.0;type=Wellbore", title=wellbore.name, uuid=str(space)
    )
    depth = _depth(witsml, eml, wellbore.datum)
    trajectory = trajectory_class()(
        schema_version="2.0",
        uuid=str(uuid.uuid5(space, f"{table.n} {times.min():.3f} {times.max():.3f}")),
        citation=eml.Citation(
            title=f"Surveys of {wellbore.name}",
            originator="highside",
            creation=XmlDateTime.from_datetime(datetime.fromtimestamp(float(times.max()), UTC)),
            format=f"highside {__version__}",
        ),
        growing_status=witsml.ChannelStatus.INACTIVE,
        md_mn=depth(float(table.columns["md_m"][0])),
        md_mx=depth(float(table.columns["md_m"][-1])),
        definitive=False,
        azi_ref=witsml.AziRef(f"{wellbore.north} north"),
        trajectory_station=[_station(table, row, witsml, eml, wellbore) for row in range(table.n)],
        wellbore=of_well,
    )
    text = XmlSerializer(config=SerializerConfig(indent="  ")).render(
        trajectory,
        ns_map={"witsml": _WITSML, "eml": _COMMON},
    )
    return str(text).encode()


def trajectory_class() -> Any:
    """The library's `Trajectory` with what every top-level object of WITSML has (schemaVersion, uuid, Citation).

    Release 1.12.0 lost these: its base class is the empty `gml:AbstractObject`, which has the same name as that of
    Energistics. Raises ImportError where the library is not installed."""
    from dataclasses import field, make_dataclass

    from energyml.eml.v2_1 import commonv2 as eml
    from energyml.witsml.v2_0 import witsmlv2 as witsml

    citation = {"name": "Citation", "type": "Element", "namespace": _COMMON, "required": True}
    version = {"name": "schemaVersion", "type": "Attribute", "required": True}
    first = make_dataclass(
        "EnergisticsObject",
        [
            ("citation", eml.Citation | None, field(default=None, metadata=citation)),
            ("schema_version", str | None, field(default=None, metadata=version)),
            ("uuid", str | None, field(default=None, metadata={"type": "Attribute", "required": True})),
        ],
    )
    meta = type("Meta", (), {"name": "Trajectory", "namespace": _WITSML})
    # the bases in this order put Citation before the elements of the trajectory, as the schema does
    return make_dataclass("WholeTrajectory", [], bases=(witsml.Trajectory, first), namespace={"Meta": meta})


def _depth(witsml: Any, eml: Any, datum: str) -> Any:
    return lambda value: witsml.MeasuredDepthCoord(value=value, uom=eml.LengthUom.M, datum=datum)


def _station(table: SurveyList, row: int, witsml: Any, eml: Any, wellbore: Wellbore) -> Any:
    """One station; what is not known is absent."""

    def value(name: str) -> float | None:
        found = table.columns.get(name)
        return None if found is None or np.isnan(found[row]) else float(found[row])

    def angle(name: str) -> Any:
        found = value(name)
        return None if found is None else eml.PlaneAngleMeasure(value=found, uom=eml.PlaneAngleUom.DEGA)

    def length(name: str) -> Any:
        found = value(name)
        return None if found is None else eml.LengthMeasure(value=found, uom=eml.LengthUom.M)

    azimuth, tvd, at = angle("azi_deg"), value("tvd_m"), value("t")
    kind = witsml.TrajStationType.MD_AND_INCL if azimuth is None else witsml.TrajStationType.MD_INCL_AND_AZI
    return witsml.TrajectoryStation(
        uid=f"s{row + 1}",
        dtim_stn=None if at is None else datetime.fromtimestamp(at, UTC).isoformat(timespec="milliseconds"),
        type_traj_station=kind,
        calc_algorithm=None if tvd is None else witsml.TrajStnCalcAlgorithm.MINIMUM_CURVATURE,
        md=_depth(witsml, eml, wellbore.datum)(value("md_m")),
        tvd=None
        if tvd is None
        else witsml.WellVerticalDepthCoord(value=tvd, uom=eml.LengthUom.M, datum="first station"),
        incl=angle("inc_deg"),
        azi=azimuth,
        gtf=angle("tf_deg"),
        disp_ns=length("north_m"),
        disp_ew=length("east_m"),
        status_traj_station=witsml.TrajStationStatus.OPEN,
    )
