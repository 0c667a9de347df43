"""The uncertainty budget of a calibrated tool, after the GUM (JCGM 100).

The measurand is the inclination, or the toolface, that the tool indicates at rest with the corrections of one record.
Sources are uncorrelated with one another; what is correlated (the parameters of the correction) is one source, carried
with its full covariance. Every other source is an error of the corrected vector, in g, or of the angle itself. With an
error e across the line of sight, `dI = e` and `dT = e / sin I` (rad): the sensitivity coefficients (equation 3 of the
balance-correction paper). The combined standard uncertainty is their root sum of squares, U = k u with k = 2; the
effective degrees of freedom follow Welch and Satterthwaite.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from highside.attitude.scalar import UNIFORM_ANGLE_STD_RAD
from highside.calibration.comparison import holds_at, uncertainty_over
from highside.calibration.method import Solution
from highside.calibration.record import CalibrationRecord
from highside.config.certificate import CertificateFields
from highside.physics.gravity import gravity_direction
from highside.words import said, said_later

K = 2.0
NORMAL, RECTANGULAR = said_later("normal"), said_later("rectangular")
UNIFORM_DEG = math.degrees(UNIFORM_ANGLE_STD_RAD)


@dataclass(frozen=True, slots=True)
class BudgetLine:
    """One line of the budget: standard uncertainty of the source and what it contributes to I and T, in degrees.

    `value`: as known, in words with its unit; `distribution`: of that value; `divisor`: from value to standard
    uncertainty. A `note` says what it stands for, or why it contributes nothing.
    """

    name: str
    kind: str
    value: str
    distribution: str
    divisor: str
    inc_deg: float
    tf_deg: float
    freedom: float
    note: str = ""


@dataclass(frozen=True, slots=True)
class UncertaintyBudget:
    """All sources at one inclination."""

    inclination_deg: float
    sources: tuple[BudgetLine, ...]

    @property
    def inc_deg(self) -> float:
        """Combined standard uncertainty of I."""
        return math.sqrt(math.fsum(source.inc_deg**2 for source in self.sources))

    @property
    def tf_deg(self) -> float:
        """Combined standard uncertainty of T; never more than that of an angle of which nothing is known."""
        return min(math.sqrt(math.fsum(source.tf_deg**2 for source in self.sources)), UNIFORM_DEG)

    @property
    def expanded(self) -> tuple[float, float]:
        """U of I and T with k = 2, degrees."""
        return K * self.inc_deg, K * self.tf_deg

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom for I (Welch-Satterthwaite); infinite where no source has finite ones."""
        part = math.fsum(s.inc_deg**4 / s.freedom for s in self.sources if math.isfinite(s.freedom) and s.freedom > 0)
        return self.inc_deg**4 / part if part > 0 else math.inf


def freedom_of(record: CalibrationRecord) -> float:
    """Degrees of freedom of the fit: three readings a pose less the parameters estimated."""
    used = int(np.count_nonzero(record.result.poses.used))
    held = len(record.result.zones) * record.result.main.parameters.estimated
    return float(max(3 * used - held, 1))


def budget_at(record: CalibrationRecord, fields: CertificateFields, inclination_deg: float) -> UncertaintyBudget | None:
    """The budget at one inclination; None where the calibration does not hold."""
    solution = Solution(record.result, record.fallback, record.guide)
    inc = math.radians(inclination_deg)
    held = holds_at(solution, inc)
    if held is None:
        return None
    result, _ = held
    stated = uncertainty_over(solution, (inclination_deg,))
    noise, use = result.reading_noise_g, fields.use
    sources = [
        BudgetLine(
            said("Parameters of the correction"),
            "A",
            said("covariance of %(count)s parameters", count=result.main.parameters.estimated),
            NORMAL,
            "1",
            float(stated.inc_std_deg[0]),
            float(stated.tf_std_deg[0]),
            freedom_of(record),
            _inside(record),
        ),
        _of_vector(
            inc,
            said("Noise of the indication"),
            "A",
            said("%(noise)s µg, mean of %(count)s", noise=f"{1e6 * noise:.1f}", count=use.readings),
            NORMAL,
            f"√{use.readings}",
            noise / math.sqrt(use.readings),
            said("of a reading at rest, as measured in the poses"),
        ),
    ]
    sources += [*_lines_of_bench(fields), *_lines_of_use(fields, inc)]
    if fields.thermometer is not None and fields.thermometer.expanded_c is not None:
        sources.append(_thermometer(record, fields, inc, fields.thermometer.expanded_c))
    gravity = record.content["environment"]["gravity_std_mps2"]
    if gravity is not None:
        sources.append(
            BudgetLine(
                said("Local gravity"),
                "B",
                f"{gravity:g} m/s²",
                NORMAL,
                "1",
                0.0,
                0.0,
                math.inf,
                said("I and T follow from directions: sensitivity 0"),
            )
        )
    return UncertaintyBudget(inclination_deg, tuple(sources))


def _of_vector(
    inc: float,
    name: str,
    kind: str,
    value: str,
    distribution: str,
    divisor: str,
    std_g: float,
    note: str = "",
) -> BudgetLine:
    """A source that acts on the vector of gravity by `std_g` in each axis, at inclination `inc` (rad)."""
    tf = min(std_g * math.degrees(1.0) / max(math.sin(inc), 1e-12), UNIFORM_DEG)
    return BudgetLine(name, kind, value, distribution, divisor, std_g * math.degrees(1.0), tf, math.inf, note)


def _lines_of_bench(fields: CertificateFields) -> list[BudgetLine]:
    """The bench's own calibration and the toolface zero of the clamping, where they are stated."""
    bench, use = fields.bench, fields.use
    sources: list[BudgetLine] = []
    if bench is not None and (bench.inc_expanded_deg or bench.tf_expanded_deg):
        inc_u, tf_u = bench.inc_expanded_deg or 0.0, bench.tf_expanded_deg or 0.0
        sources.append(
            BudgetLine(
                said("Calibration of the bench"),
                "B",
                f"U = {inc_u:g}° (I), {tf_u:g}° (T)",
                NORMAL,
                "2",
                inc_u / 2.0,
                tf_u / 2.0,
                math.inf,
                said("taken as common to all poses: no averaging"),
            )
        )
    if use.toolface_zero_deg is not None:
        name, value = said("Toolface zero of the clamping"), f"{use.toolface_zero_deg:g}°"
        sources.append(BudgetLine(name, "B", value, NORMAL, "1", 0.0, use.toolface_zero_deg, math.inf))
    return sources


def _lines_of_use(fields: CertificateFields, inc: float) -> list[BudgetLine]:
    """What the conditions of use add at inclination `inc` (rad): power-ups, resolution, temperature."""
    use = fields.use
    sources: list[BudgetLine] = []
    if use.turn_on_g is not None:
        sources.append(
            _of_vector(
                inc,
                said("Offset from power-up to power-up"),
                "B",
                f"{1e6 * use.turn_on_g:.0f} µg",
                NORMAL,
                "1",
                use.turn_on_g,
            )
        )
    if use.step_g is not None:
        step = use.step_g / (2.0 * math.sqrt(3.0))
        value = f"{1e6 * use.step_g:.2f} µg"
        sources.append(_of_vector(inc, said("Resolution"), "B", value, RECTANGULAR, "2√3", step))
    if use.offset_g_per_c is not None and use.temp_half_width_c is not None:
        half = use.offset_g_per_c * use.temp_half_width_c
        value = f"{1e6 * use.offset_g_per_c:.1f} µg/°C, ±{use.temp_half_width_c:g} °C"
        name = said("Temperature of use")
        sources.append(_of_vector(inc, name, "B", value, RECTANGULAR, "√3", half / math.sqrt(3.0)))
    return sources


def _inside(record: CalibrationRecord) -> str:
    """What the covariance of the parameters holds."""
    if record.result.frame == "gravity":
        return said("holds reading noise of the poses, scatter of the bench's settings, and its tilt as estimated")
    return said(
        "holds reading noise of the poses, scatter of the bench's settings, and its tilt (%(tilt)s deg, not estimated)",
        tilt="0.05",
    )


def _thermometer(record: CalibrationRecord, fields: CertificateFields, inc: float, expanded_c: float) -> BudgetLine:
    """What an error of the thermometer does: through the polynomials of the record, or the stated coefficient."""
    u = expanded_c / 2.0
    main = record.result.main
    span = main.temperature
    value = f"U = {expanded_c:g} °C"
    slope = 0.0
    if span is not None and main.max_power():
        middle = 0.5 * (span.min_c + span.max_c)
        tf = np.deg2rad(np.arange(0.0, 360.0, 15.0))
        g = gravity_direction(np.full_like(tf, inc), tf)
        raw = main.model(middle).forward(g)
        moved = main.model(middle + 0.5).correct(raw) - main.model(middle - 0.5).correct(raw)
        slope = float(np.sqrt((moved**2).sum(axis=0)).max())
        note = said("%(slope)s µg/°C by the record's own polynomials", slope=f"{1e6 * slope:.1f}")
    elif fields.use.offset_g_per_c is not None:
        slope = fields.use.offset_g_per_c
        note = said("with the stated change of offset")
    else:
        note = said("the record does not depend on temperature: sensitivity 0")
    tf_deg = min(math.degrees(u * slope) / max(math.sin(inc), 1e-12), UNIFORM_DEG)
    name = said("Thermometer")
    return BudgetLine(name, "B", value, NORMAL, "2", math.degrees(u * slope), tf_deg, math.inf, note)
