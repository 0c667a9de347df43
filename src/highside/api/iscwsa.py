"""Error-model weights: the accelerometer terms of the ISCWSA MWD model, of one tool."""

from __future__ import annotations

import json
import math
import uuid
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from highside.api.calibration import Calibration
from highside.errors import InputError
from highside.reading import parse_json, read_document
from highside.recording.calibration_store import read_record
from highside.recording.files import write_whole
from highside.recording.frames import File
from highside.units import STANDARD_GRAVITY_MPS2
from highside.version import __version__
from highside.watch import prior_of_record
from highside.watch.iscwsa import IscwsaTerm, IscwsaTerms, accelerometer_terms, covariance_of_watch, in_use
from highside.watch.parameters import KT

__all__ = ["ErrorModel", "error_model"]

MOST_HOURS, MOST_WARMER_C = 10_000.0, 400.0


@dataclass(frozen=True)
class ErrorModel:
    """Accelerometer terms of one tool as weights of the ISCWSA MWD model."""

    found: IscwsaTerms
    tool: str
    cal_id: str
    basis: str
    """what the sigmas hold, in a sentence"""

    def to_dict(self, into: dict[str, Any] | None = None) -> dict[str, Any]:
        """A tool model in the JSON form of ISCWSA, as welleng takes it for `error_model`; `into`: one whose
        accelerometer terms are replaced. The member `highside` says the rest. Raises InputError where `into` has none.
        """
        ours = {
            "schema": "highside.iscwsa/1", "cal_id": self.cal_id, "basis": self.basis, "version": __version__,
            "by_axis": self.found.by_axis, "not_held": list(self.found.not_held),
            "sigma_inclination_deg": [
                {"inc_deg": inc, "by_terms": terms, "by_covariance": whole} for inc, terms, whole in self.found.check
            ],
        }  # fmt: skip
        terms = [_term(self.cal_id, one) for one in self.found.terms]
        if into is not None:
            # a list: a name of another type than text is none of ours, and cannot be looked up in a set
            ours_by_name = [term["name"] for term in terms]
            kept = [one for one in into["terms"] if one.get("name") not in ours_by_name]
            standard = sum(one.standard for one in self.found.terms)
            if len(into["terms"]) - len(kept) < standard:
                raise InputError(
                    "lacks accelerometer terms of these names",
                    field="terms",
                    remedy="give a Rev 4 or 5 MWD model (with axial=True, one of axially corrected azimuths)",
                )
            return into | {"terms": kept + terms, "highside": ours}
        name = f"{self.tool} accelerometers"
        metadata = {"short_name": name, "long_name": f"{name}, calibration {self.cal_id[:12]}", "tool_type": "Magnetic",
                    "source": self.basis, "revision_number": 5, "framework": "ISCWSA Rev5"}  # fmt: skip
        return {"metadata": metadata, "parameters": {"inc_min": 0, "inc_max": 180}, "terms": terms, "highside": ours}

    def save(self, file: File, *, into: File | None = None) -> None:
        """Write the JSON; `into`: a tool model (JSON) whose accelerometer terms are replaced in what is written. Raises
        InputError for one that is no tool model, and for a place that cannot be written."""
        base = None if into is None else _tool_model(Path(into))
        try:
            text = json.dumps(self.to_dict(base), indent=1, allow_nan=False)
        except InputError as error:
            raise InputError(error.what, where=str(into), field=error.field, remedy=error.remedy) from None
        write_whole(Path(file), (text + "\n").encode())


def error_model(
    calibration: Calibration | File,
    *,
    watch: File | None = None,
    hours: float = 100.0,
    warmer_c: float = 0.0,
    axial: bool = False,
) -> ErrorModel:
    """The accelerometer terms of the ISCWSA MWD model for one tool, one sigma, with what they do to `inc_deg`.

    `calibration`: its record, whose covariance with the repeatability and random walk of the tool's class over `hours`,
    and the temperature coefficients' over `warmer_c` degC, is what they hold. `watch`: `watch.json` or `surveys.json`
    of the same calibration; then they hold what that left, size and standard deviation together. `axial`: the forms for
    azimuths corrected for axial interference. Raises InputError for a file that is not in order, for a watch of another
    calibration, and for a record by zones of inclination.
    """
    record = calibration.record if isinstance(calibration, Calibration) else read_record(Path(calibration))
    for name, value, most in (("hours", hours, MOST_HOURS), ("warmer_c", warmer_c, MOST_WARMER_C)):
        if not (math.isfinite(value) and 0.0 <= value <= most):
            raise InputError(f"{value:g} is out of range", field=name, remedy=f"0 to {most:g}")
    prior = prior_of_record(record)
    unit = record.content["environment"].get("gravity_mps2") or STANDARD_GRAVITY_MPS2
    if watch is None:
        noise = prior.noise
        drift = float(np.sqrt(prior.covariance[KT, KT])) * warmer_c
        covariance = in_use(
            prior.stated, noise.repeat_g, noise.repeat, noise.offset_random_walk, noise.matrix_random_walk, hours, drift
        )
        basis = (
            f"record, repeatability of the tool, random walk over {hours:g} h, temperature over {warmer_c:g} degC; the"
            " last three by the class of the tool"
        )
    else:
        covariance = covariance_of_watch(_watched(Path(watch), record.id), str(watch))
        basis = "what the watch left of each parameter, size and standard deviation"
    found = accelerometer_terms(covariance, axial=axial, unit_mps2=unit)
    return ErrorModel(found, record.tool_id, record.id, basis)


def _watched(path: Path, cal_id: str) -> dict[str, Any]:
    document = parse_json(read_document(path), where=str(path), remedy="give watch.json or surveys.json")
    parameters = document.get("parameters") if isinstance(document, dict) else None
    if not isinstance(parameters, dict) or not all(isinstance(one, dict) for one in parameters.values()):
        raise InputError("is no result of a watch", where=str(path), remedy="give watch.json or surveys.json")
    if document.get("cal_id") != cal_id:
        raise InputError("is of another calibration", where=str(path), field="cal_id", remedy="give its own record")
    return parameters


def _tool_model(path: Path) -> dict[str, Any]:
    document = parse_json(read_document(path), where=str(path), remedy="give a tool model in the JSON form of ISCWSA")
    terms = document.get("terms") if isinstance(document, dict) else None
    if not isinstance(terms, list) or not all(isinstance(one, dict) for one in terms):
        raise InputError(
            "is no tool model", where=str(path), field="terms", remedy="give one in the JSON form of ISCWSA"
        )
    found: dict[str, Any] = document
    return found


def _term(cal_id: str, term: IscwsaTerm) -> dict[str, Any]:
    plain = {name: value for name, value in asdict(term).items() if name in ("name", "value")}
    return plain | {
        "uuid": str(uuid.uuid5(uuid.NAMESPACE_URL, f"urn:highside:{cal_id}:{term.name}")),
        "units": term.unit,
        "propagation_mode": "Systematic",
        "depth_factor": 0,
        "inclination_factor": 0,
        "azimuth_factor": 0,
        "depth_formula": "0",
        "inclination_formula": term.inclination,
        "azimuth_formula": term.azimuth,
        "north_singularity": term.north,
        "east_singularity": term.east,
        "vertical_singularity": None,
        "x_highside_standard": term.standard,
    }
