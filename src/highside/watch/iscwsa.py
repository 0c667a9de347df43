"""Accelerometer terms of the ISCWSA MWD error model, from what is known of one tool.

The model states one sigma for a fleet (0.004 m/s2 and 0.0005); a record, the class of the tool and a watch know more of
this tool. With the corrected reading `c = (1 + S) f + b`, an error of c moves inclination by

    dI = cos I (b_x cos T + b_y sin T) - sin I b_z
         + sin I cos I [ (S_xx + S_yy)/2 - S_zz + (S_xx - S_yy)/2 cos 2T + (S_xy + S_yx)/2 sin 2T ]
         + (cos^2 I S_xz - sin^2 I S_zx) cos T + (cos^2 I S_yz - sin^2 I S_zy) sin T.

Over all toolfaces the terms of T and 2T have half their square as a mean. The toolface-independent weights of the model
(Rev 4 and 5) are the same decomposition for x and y of equal sigma: `cos I/G` for the bias on the high side,
`sin I cos I/sqrt 2` for the common part of both scale factors, `sin I cos I/2` for the part in 2T. What of S has no
term in the model (within the triad it knows no misalignment) is given apart, under names of our own: half the
difference and half the sum of `S_xz` and `S_zx`, a turn and a shear of the triad.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.errors import InputError
from highside.units import STANDARD_GRAVITY_MPS2
from highside.watch.parameters import CALIBRATION, NAMES
from highside.watch.present import gradients

__all__ = ["IscwsaTerm", "IscwsaTerms", "accelerometer_terms", "covariance_of_watch", "in_use"]

MOST = 10.0
"""g, or share: no accelerometer departs by more, and a watch holds its own state to that"""


@dataclass(frozen=True, slots=True)
class IscwsaTerm:
    """One term: `value` its one sigma; formulas in the notation of the model's tool files (Inc, AzM, Dip, Gfield)."""

    name: str
    value: float
    unit: str
    """m/s2 or - (a ratio, or rad)"""
    inclination: str
    azimuth: str
    standard: bool = True
    """whether the model has a term of this name; else it is one of ours, and belongs into no other tool's file"""
    north: str | None = None
    """weight of north where the hole is vertical, and azimuth has no meaning"""
    east: str | None = None


@dataclass(frozen=True, slots=True)
class IscwsaTerms:
    """All terms of one tool; how the sum of them compares with the whole covariance; what is not in them."""

    terms: tuple[IscwsaTerm, ...]
    by_axis: dict[str, float]
    """toolface-dependent form: one sigma of each axis; ABX, ABY, ABZ in m/s2, ASX, ASY, ASZ ratios"""
    check: tuple[tuple[float, float, float], ...]
    """inclination in deg; sigma of inclination in deg by the terms; by the whole covariance, rms over toolfaces"""
    not_held: tuple[str, ...]


NOT_HELD = (
    "XYM1 to XYM4E, MX, MY, SAG: how the tool lies in the hole is nothing that its calibration or a watch can show",
    "DSFR, DREF and other terms of depth: not of the accelerometers",
    "magnetometer and gyro terms: not in a record of accelerometers",
    "azimuth by AMXY-TI: it depends on how the magnetometers are aligned with the accelerometers",
)
_AX = "(1 - Sin(Inc) * Sin(Inc) * Sin(AzM) * Sin(AzM))"
_DIPPED = "(Tan(Dip) * Cos(Inc) + Sin(Inc) * Cos(AzM))"
INCLINATIONS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
TOOLFACES = 24


def in_use(
    calibration: Array,
    repeat_g: float,
    repeat: float,
    random_walk_g: float,
    random_walk: float,
    hours: float,
    drift_g: float,
) -> Array:
    """(12, 12) of b and S in the hole: the record's, the repeatability of the tool, its random walk over `hours`, and
    `drift_g`, what temperature leaves on each offset. In the order of `watch.parameters.NAMES`."""
    offset = repeat_g**2 + random_walk_g**2 * hours + drift_g**2
    ratio = repeat**2 + random_walk**2 * hours
    return np.asarray(calibration + np.diag([offset] * 3 + [ratio] * (CALIBRATION - 3)))


def covariance_of_watch(parameters: Mapping[str, Mapping[str, float]], where: str) -> Array:
    """(12, 12), diagonal: mean square of what a watch left of each parameter, `value^2 + std^2`: nothing corrects a
    deviation that was found. Raises InputError for a document without them."""
    out = []
    for name in NAMES[:CALIBRATION]:
        one = parameters.get(name)
        if one is None or not all(isinstance(one.get(key), int | float) for key in ("value", "std")):
            raise InputError(
                f"has no value and std of {name}", where=where, field="parameters", remedy="give watch.json as written"
            )
        if any(isinstance(one[key], bool) or not abs(one[key]) <= MOST for key in ("value", "std")) or one["std"] < 0:
            raise InputError(
                f"value and std of {name} cannot be",
                where=where,
                field="parameters",
                remedy="give watch.json as written",
            )
        out.append(float(one["value"]) ** 2 + float(one["std"]) ** 2)
    return np.diag(out)


def accelerometer_terms(
    covariance: Array, *, axial: bool = False, unit_mps2: float = STANDARD_GRAVITY_MPS2
) -> IscwsaTerms:
    """Terms by the covariance (12, 12) of b in units of `unit_mps2` and S. `axial`: the forms of a tool whose magnetic
    azimuth is corrected for axial interference (ABIXY, ABIZ, ASIXY, ASIZ)."""
    var = np.diag(covariance)

    def of(weights: Mapping[str, float]) -> float:
        row = np.array([weights.get(name, 0.0) for name in NAMES[:CALIBRATION]])
        return float(row @ covariance @ row)

    across = np.sqrt(0.5 * (var[0] + var[1])) * unit_mps2
    common = np.sqrt(2.0 * of({"S_xx": 0.5, "S_yy": 0.5}))
    twice = np.sqrt(2.0 * (of({"S_xx": 0.5, "S_yy": -0.5}) + of({"S_xy": 0.5, "S_yx": 0.5})))
    along, scale = np.sqrt(var[2]) * unit_mps2, np.sqrt(of({"S_zz": 1.0}))
    turned = np.sqrt(0.5 * (of({"S_xz": 0.5, "S_zx": -0.5}) + of({"S_yz": 0.5, "S_zy": -0.5})))
    sheared = np.sqrt(0.5 * (of({"S_xz": 0.5, "S_zx": 0.5}) + of({"S_yz": 0.5, "S_zy": 0.5})))
    build = _axial if axial else _plain
    terms = (
        *build(float(across), float(common), float(twice), float(along), float(scale)),
        IscwsaTerm("AMXY-TI1", float(turned), "-", "1", "0", standard=False),
        IscwsaTerm("AMXY-TI2", float(sheared), "-", "Cos(Inc) * Cos(Inc) - Sin(Inc) * Sin(Inc)", "0", standard=False),
    )
    by_axis = {f"AB{axis}": float(np.sqrt(var[k]) * unit_mps2) for k, axis in enumerate("XYZ")}
    by_axis |= {f"AS{axis}": float(np.sqrt(var[3 + 4 * k])) for k, axis in enumerate("XYZ")}
    values = (float(across) / unit_mps2, float(common), float(twice), float(along) / unit_mps2, float(scale))
    check = tuple(_check(covariance, values, float(turned), float(sheared), deg) for deg in INCLINATIONS_DEG)
    return IscwsaTerms(terms, by_axis, check, NOT_HELD)


def _plain(across: float, common: float, twice: float, along: float, scale: float) -> tuple[IscwsaTerm, ...]:
    swing = "Sin(Inc) * Cos(Inc)"
    east = "Tan(Dip) * Sin(Inc) * Cos(Inc) * Sin(AzM)"
    return (
        IscwsaTerm("ABXY-TI1S", across, "m/s2", "-Cos(Inc) / Gfield", "Tan(Dip) * Cos(Inc) * Sin(AzM) / Gfield"),
        IscwsaTerm("ABXY-TI2S", across, "m/s2", "0", "(Tan(pi / 2 - Inc) - Tan(Dip) * Cos(AzM)) / Gfield",
                   north="-Sin(Az) / Gfield", east="Cos(Az) / Gfield"),
        IscwsaTerm("ABZ", along, "m/s2", "-Sin(Inc) / Gfield", "Tan(Dip) * Sin(Inc) * Sin(AzM) / Gfield"),
        IscwsaTerm("ASXY-TI1S", common, "-", f"{swing} / Sqr(2)", f"-{east} / Sqr(2)"),
        IscwsaTerm("ASXY-TI2S", twice, "-", f"{swing} / 2", f"-{east} / 2"),
        IscwsaTerm("ASXY-TI3S", twice, "-", "0", "(Tan(Dip) * Sin(Inc) * Cos(AzM) - Cos(Inc)) / 2"),
        IscwsaTerm("ASZ", scale, "-", f"-{swing}", east),
    )  # fmt: skip


def _axial(across: float, common: float, twice: float, along: float, scale: float) -> tuple[IscwsaTerm, ...]:
    swing = "Sin(Inc) * Cos(Inc)"
    east = f"{swing} * Cos(Inc) * Sin(AzM) * {_DIPPED} / {_AX}"
    return (
        IscwsaTerm("ABIXY-TI1S", across, "m/s2", "-Cos(Inc) / Gfield",
                   f"Cos(Inc) * Cos(Inc) * Sin(AzM) * {_DIPPED} / (Gfield * {_AX})"),
        IscwsaTerm("ABIXY-TI2S", across, "m/s2", "0",
                   f"-(Tan(Dip) * Cos(AzM) - Tan(pi / 2 - Inc)) / (Gfield * {_AX})",
                   north="-Sin(Az) / Gfield", east="Cos(Az) / Gfield"),
        IscwsaTerm("ABIZ", along, "m/s2", "-Sin(Inc) / Gfield",
                   f"{swing} * Sin(AzM) * {_DIPPED} / (Gfield * {_AX})"),
        IscwsaTerm("ASIXY-TI1S", common, "-", f"{swing} / Sqr(2)", f"-{east} / Sqr(2)"),
        IscwsaTerm("ASIXY-TI2S", twice, "-", f"{swing} / 2", f"-{east} / 2"),
        IscwsaTerm("ASIXY-TI3S", twice, "-", "0", f"(Tan(Dip) * Sin(Inc) * Cos(AzM) - Cos(Inc)) / (2 * {_AX})"),
        IscwsaTerm("ASIZ", scale, "-", f"-{swing}", east),
    )  # fmt: skip


def _check(
    covariance: Array, values: tuple[float, ...], turned: float, sheared: float, inc_deg: float
) -> tuple[float, float, float]:
    inc = np.radians(inc_deg)
    s, c = np.sin(inc), np.cos(inc)
    across, common, twice, along, scale = values
    terms = (c * across) ** 2 + (s * along) ** 2 + (s * c) ** 2 * (common**2 / 2.0 + twice**2 / 4.0 + scale**2)
    terms += turned**2 + (sheared * np.cos(2.0 * inc)) ** 2
    whole = 0.0
    for tf in np.linspace(0.0, 2.0 * np.pi, TOOLFACES, endpoint=False):
        row = gradients(inc, tf)[0, :CALIBRATION]
        whole += float(row @ covariance @ row) / TOOLFACES
    return inc_deg, float(np.degrees(np.sqrt(terms))), float(np.degrees(np.sqrt(whole)))
