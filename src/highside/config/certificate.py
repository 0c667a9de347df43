"""What a certificate says beyond its record: one TOML file, `highside calibrate certificate --fields FILE`.

Nothing here is made up where it is absent: the certificate then says that it was not stated, or leaves the line out. A
date of the next calibration is printed only with the name of the customer's person who agreed to it.
"""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from highside.config.mistakes import input_error
from highside.errors import InputError
from highside.reading import read_toml
from highside.reading.config_table import ConfigTable
from highside.words import LANGUAGES, said_later

Line = Annotated[str, Field(min_length=1, max_length=200)]
Note = Annotated[str, Field(min_length=1, max_length=2000)]
Degrees = Annotated[float, Field(gt=0, le=180)]
Celsius = Annotated[float, Field(gt=0, le=1000)]
RoomC = Annotated[float, Field(ge=-100, le=1000)]
Percent = Annotated[float, Field(ge=0, le=100)]
Hectopascal = Annotated[float, Field(ge=0, le=10_000)]
G = Annotated[float, Field(gt=0, le=100)]


class IssueTable(ConfigTable):
    """Who issues the certificate, to whom, under which number."""

    number: Line | None = Field(default=None, description="Number of the certificate; absent: made from the record.")
    laboratory: Line | None = None
    address: Line | None = None
    country: str | None = Field(
        default=None,
        pattern=r"^[A-Z]{2}$",
        description="Of the laboratory (ISO 3166-1); for a digital certificate.",
    )
    language: Literal["en", "de", "nb", "es"] | None = Field(
        default=None, description="Of the printed certificate; absent: that of the reader of the page, else English."
    )
    logo: Path | None = Field(default=None, description="The laboratory's logo: PNG or JPEG, 1 MB at most.")
    verify_url: str | None = Field(
        default=None,
        pattern=r"^https?://[!-~]{1,180}$",
        description="Where certificates are verified: in the QR code, with the record's id behind it.",
    )
    customer: Line | None = None
    performed_at: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] = Field(
        default="laboratory", description="In the words of the digital certificate."
    )
    place: Line | None = Field(default=None, description="Where the calibration was made.")
    signatory: Line | None = Field(default=None, description="Who authorises the certificate.")
    role: Line | None = None


class ItemTable(ConfigTable):
    """The item, beyond tool and serial number."""

    description: Line = said_later("Directional sensor, triaxial accelerometer")
    maker: Line | None = None
    model: Line | None = None
    condition: Note | None = Field(default=None, description="Condition on receipt.")


class ReferenceInstrument(ConfigTable):
    """An instrument that the result rests on."""

    description: Line
    certificate: Line | None = Field(default=None, description="Number of its own calibration certificate.")
    issued_by: Line | None = None
    valid_until: date | None = None


class BenchReference(ReferenceInstrument):
    """The turntable."""

    inc_expanded_deg: Degrees | None = Field(default=None, description="U (k = 2) of a setting of inclination.")
    tf_expanded_deg: Degrees | None = Field(default=None, description="U (k = 2) of a setting of toolface.")


class Thermometer(ReferenceInstrument):
    """The thermometer."""

    expanded_c: Celsius | None = Field(default=None, description="U (k = 2) of a temperature.")


class EnvironmentTable(ConfigTable):
    """The room."""

    temp_c: tuple[RoomC, RoomC] | None = Field(default=None, description="Lowest and highest.")
    humidity_percent: tuple[Percent, Percent] | None = None
    pressure_hpa: tuple[Hectopascal, Hectopascal] | None = None
    remark: Note | None = None


class UseTable(ConfigTable):
    """How the item is used, where the uncertainty of an indication depends on it. Absent: omitted, and stated so."""

    readings: int = Field(default=1, ge=1, description="Readings averaged for one indication.")
    toolface_zero_deg: Degrees | None = Field(default=None, description="Standard deviation of the toolface zero.")
    turn_on_g: G | None = Field(default=None, description="Repeatability of the offset from power-up to power-up.")
    step_g: G | None = Field(default=None, description="Resolution of a reading.")
    offset_g_per_c: G | None = Field(
        default=None, description="Change of offset with temperature, where the record does not hold it."
    )
    temp_half_width_c: Celsius | None = Field(
        default=None, description="With offset_g_per_c: use within this much of the calibration's temperature."
    )


class DecisionTable(ConfigTable):
    """Limits of error that the item is judged by."""

    limit_inc_deg: Degrees
    limit_tf_deg: Degrees
    agreed_with: Line | None = Field(default=None, description="Who agreed to limits and decision rule.")


class NextTable(ConfigTable):
    """A date of the next calibration is the customer's."""

    next_calibration: date
    agreed_with: Line = Field(description="Who of the customer agreed to it.")


class CertificateFields(ConfigTable):
    """The whole file; every table may be absent."""

    issue: IssueTable = IssueTable()
    item: ItemTable = ItemTable()
    bench: BenchReference | None = None
    thermometer: Thermometer | None = None
    gravity_source: Line | None = Field(default=None, description="Where the value of local gravity comes from.")
    environment: EnvironmentTable = EnvironmentTable()
    use: UseTable = UseTable()
    decision: DecisionTable | None = None
    next: NextTable | None = None
    remarks: tuple[Note, ...] = ()

    @model_validator(mode="after")
    def _temperature_whole(self) -> Self:
        if (self.use.offset_g_per_c is None) != (self.use.temp_half_width_c is None):
            raise ValueError("use.offset_g_per_c and use.temp_half_width_c belong together: give both, or neither")
        return self


def in_language_of(fields: CertificateFields, language: str) -> CertificateFields:
    """The same fields for a certificate in that language. Raises InputError for one that there is not."""
    if language not in LANGUAGES:
        raise InputError(
            f"{language!r} is no language of a certificate", field="language", remedy=f"one of {', '.join(LANGUAGES)}"
        )
    issue = fields.issue.model_copy(update={"language": language})
    return fields.model_copy(update={"issue": issue})


def load_certificate_fields(path: Path) -> CertificateFields:
    """Read and validate. Raises InputError in one line that names file and field."""
    tables: dict[str, Any] = read_toml(path)
    issue = tables.get("issue")
    if isinstance(issue, dict) and isinstance(issue.get("logo"), str):
        # a relative name starts at the file's directory
        issue["logo"] = str(path.resolve().parent / issue["logo"])
    try:
        return CertificateFields.model_validate(tables)
    except ValidationError as error:
        raise input_error(error, str(path), {}, CertificateFields) from None
