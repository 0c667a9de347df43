"""Is it the bench or the sensor? What a session's poses say about both, beyond the calibration itself.

Two looks at the same poses. The joint calibration estimates the bench's tilt and how well its settings repeat. And the
engine of `highside diagnose` asks which effects of the library the plain affine sensor on a perfect bench omits:
effects of the pose or of the vertical belong to the bench, those of the triad or of temperature to the sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from highside.calibration.method import Solution
from highside.calibration.record import PoseColumns
from highside.diagnosis.core.floor import floor_of_table
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import ReportData, diagnose_poses
from highside.diagnosis.poses.policy import POSE_SESSIONS
from highside.diagnosis.poses.session import PoseSession
from highside.errors import HighsideError
from highside.physics.effect import Stage
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from highside.report.diagnosis_claims import claim_title
from highside.report.diagnosis_words import sizes as sizes_of
from highside.units import STANDARD_GRAVITY_MPS2
from highside.version import __version__
from highside.words import Said, said, said_later

FREE = ("bias", "scale", "misalignment")
"""What a calibration fits anyway."""
SIGNIFICANT = 3.0
POSES_APART_S = 60.0
"""A pose table knows no times; the poses stand in their order."""

_WHERE = {
    Stage.POSE: said_later("bench"),
    Stage.GRAVITY: "bench",
    Stage.MOUNTING: said_later("clamping"),
    Stage.SENSOR: said_later("sensor"),
    Stage.THERMAL: "sensor",
    Stage.KINEMATIC: said_later("motion"),
    Stage.TIMING: said_later("acquisition"),
    Stage.NOISE: said_later("noise"),
    Stage.DIGITAL: "acquisition",
}


@dataclass(frozen=True, slots=True)
class ErrorOrigin:
    """One thing found: `where` is bench, sensor, clamping, motion, acquisition or noise."""

    where: str
    text: str


@dataclass(frozen=True, slots=True)
class Findings:
    """The answer, one sentence, and what it rests on. `diagnosis` None: not possible, for `why_not`."""

    answer: str
    findings: tuple[ErrorOrigin, ...]
    diagnosis: DiagnosisResult | None
    report_data: ReportData | None
    why_not: str = ""


def bench_or_sensor(columns: PoseColumns, joint: Solution | None, *, gravity_mps2: float | None = None) -> Findings:
    """Look at the poses of a session. `joint`: their joint calibration, if there is one."""
    found = [] if joint is None else bench_findings(joint)
    diagnosis, report_data, why_not = _diagnose(columns, gravity_mps2)
    if diagnosis is not None:
        effects = all_effects()
        for claim in diagnosis.claims:
            if claim.effect == "base_tilt" and any("not level" in finding.text for finding in found):
                continue  # the joint calibration has said so already
            if claim.effect not in effects:
                # a law, of the poses that have a place in the library's chain
                text = said("%(effect)s: %(sizes)s", effect=claim_title(claim), sizes=sizes_of(claim))
                found.append(ErrorOrigin(_WHERE[Stage(claim.stage)], text))
                continue
            effect = effects[claim.effect]
            sizes = ", ".join(f"{name} = {p.value:.3g} ± {p.std:.1g} {p.unit}" for name, p in claim.parameters.items())
            alike = [name for name in claim.equivalence_class if name != claim.effect]
            one = {"effect": Said(effect.title), "sizes": sizes}
            text = said("%(effect)s: %(sizes)s", **one)
            if alike:
                text = said(
                    "%(effect)s: %(sizes)s; cannot be distinguished from %(others)s here",
                    **one,
                    others=", ".join(alike),
                )
            found.append(ErrorOrigin(_WHERE[effect.stage], text))
    return Findings(_answer(found, diagnosis, why_not), tuple(found), diagnosis, report_data, why_not)


def bench_findings(joint: Solution) -> list[ErrorOrigin]:
    """Tilt and repeatability of the bench as the joint calibration estimates them."""
    result = joint.result
    parameters = result.main.parameters
    out = []
    for name, words in (("tilt_x", said("in the plane of inclination")), ("tilt_y", said("across it"))):
        if name not in parameters:
            continue
        value, std = math.degrees(parameters.get(name)), math.degrees(parameters.std(name))
        if abs(value) > SIGNIFICANT * std:
            tilt = {"tilt": f"{value:+.4f} ± {std:.4f}", "where": words}
            out.append(ErrorOrigin("bench", said("it is not level: tilt %(tilt)s deg %(where)s; taken off", **tilt)))
    spread = {
        "station_inc_rad": said("settings of inclination (common to an inclination station)"),
        "station_tf_rad": said("settings of toolface (the encoder, station by station)"),
        "pose_inc_rad": said("inclination from pose to pose"),
        "pose_tf_rad": said("toolface from pose to pose"),
    }
    for name, words in spread.items():
        value = math.degrees(float(result.variance.get(name, 0.0)))
        if value > 0.01:
            text = said("%(what)s scatter by %(size)s deg (one standard deviation)", what=words, size=f"{value:.4f}")
            out.append(ErrorOrigin("bench", text))
    return out


def _diagnose(
    columns: PoseColumns, gravity_mps2: float | None
) -> tuple[DiagnosisResult | None, ReportData | None, str]:
    if "inc_ref_deg" not in columns:
        return None, None, said("the poses have no reference attitude")
    count = len(columns["ax"])
    if count < POSE_SESSIONS.min_poses:
        return (
            None,
            None,
            said(
                "%(count)s poses are too few to tell bench and sensor apart (at least %(least)s)",
                count=count,
                least=POSE_SESSIONS.min_poses,
            ),
        )
    table = {
        name: np.asarray(columns[name], dtype=float)
        for name in ("inc_ref_deg", "tf_ref_deg", "temp_c", "direction")
        if name in columns
    }
    table["t_s"] = POSES_APART_S * np.arange(count)
    table["pose"] = np.arange(count, dtype=float)
    try:
        state = ChainState.from_columns(table, gravity_mps2=gravity_mps2 or STANDARD_GRAVITY_MPS2)
        mean = np.stack([np.asarray(columns[name], dtype=float) for name in ("ax", "ay", "az")])
        readings = np.asarray(columns.get("n", [1.0] * count), dtype=float)
        session = PoseSession(mean, readings, state, floor=floor_of_table(columns))
        diagnosis, report_data = diagnose_poses(session, ForwardModel.of({}), FREE, version=__version__)
    except HighsideError as error:
        return None, None, str(error)
    return diagnosis, report_data, ""


def _answer(found: list[ErrorOrigin], diagnosis: DiagnosisResult | None, why_not: str) -> str:
    places = {finding.where for finding in found}
    if diagnosis is None:
        why = why_not if isinstance(why_not, Said) else str(why_not)
        if "bench" in places:
            return said(
                "The bench: see what the calibration found of it. Effects were not searched for: %(why)s.", why=why
            )
        return said("Nothing stands out. Effects were not searched for: %(why)s.", why=why)
    if places == {"bench"}:
        return said("It is the bench: what was found beyond the plain sensor belongs to it.")
    if places == {"sensor"}:
        return said("It is the sensor: what was found beyond scale, misalignment and offset belongs to it.")
    if len(places) > 1:
        fields = {place: Said(place) for place in sorted(places)}
        named = Said(", ".join(f"%({place})s" for place in fields), fields)
        return said("Found in more than one place: %(places)s.", places=named)
    if places:
        return said("It is neither bench nor sensor: %(place)s.", place=Said(places.pop()))
    if diagnosis.verdict == "nothing_left_out":
        return said("Neither: sensor and bench are as the plain model has them, to within the noise.")
    return said("Something is left that has no name here: neither bench nor sensor can be blamed.")
