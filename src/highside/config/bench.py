"""The configuration of a bench session: one TOML file for `highside calibrate bench --config FILE`.

Where the tool is read from (`[link]`, `[codec]`, as for the service; or `[simulated]`, a whole bench inside the
process), which poses are taken (`[plan]`), when a pose is good enough (`[session]`), what the record must say of the
bench (`[bench]`), and where journal and records are kept (`[store]`). Errors name the field and what is allowed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from highside.calibration.method import NO_FALLBACK
from highside.calibration.methods import get, solves_by_inclination
from highside.calibration.methods.joint import METHOD as JOINT
from highside.codec.registry import codecs, path_fields
from highside.codec.tool import ToolCodecConfig
from highside.config import places
from highside.config.codecs import CodecConfig
from highside.config.links import LinkConfig
from highside.config.merge import merged
from highside.config.mistakes import input_error
from highside.config.mqtt import MqttSettings
from highside.config.settings import ToolSettings, anchor_paths, parse_overrides
from highside.config.web import WebTable
from highside.errors import InputError
from highside.reading import read_toml
from highside.reading.config_table import ConfigTable


def _a_method(name: str) -> str:
    try:
        return get(name, field="").name
    except InputError as error:
        raise ValueError(str(error)) from None


MethodName = Annotated[str, AfterValidator(_a_method)]
"""Of a calibration method, ours or of an installed package."""


def _a_fallback(name: str) -> str:
    if name != NO_FALLBACK and solves_by_inclination(_a_method(name)):
        raise ValueError(f"method {name!r} holds near its own inclinations only")
    return name


Fallback = Annotated[str, AfterValidator(_a_fallback)]
Inclination = Annotated[float, Field(ge=-180, le=180)]
Toolface = Annotated[float, Field(ge=-360, le=360)]
Celsius = Annotated[float, Field(ge=-100, le=400)]


class BalancePlan(ConfigTable):
    """Four toolfaces (45, 135, 225, 315 deg) at each inclination."""

    kind: Literal["balance"]
    inclinations_deg: tuple[Inclination, ...] = Field(min_length=1)
    triples: Literal["1-2-3", "2-3-4", "3-4-1", "4-1-2", "average", "least-squares"] = "average"
    fallback: Fallback = NO_FALLBACK


class ConventionalPlan(ConfigTable):
    """Every axis in turn along gravity."""

    kind: Literal["conventional"]
    positions: Literal[3, 6, 8, 12, 24] = 12


class JointPlan(ConfigTable):
    """Poses chosen by advice, solved with the bench's own errors."""

    kind: Literal["joint"]
    poses: int = Field(default=24, ge=5, le=500, description="How many.")
    inclinations_deg: tuple[Inclination, ...] | None = Field(
        default=None, description="What the bench can set; negative: turned the other way. Absent: -120 to 150."
    )
    toolfaces_deg: tuple[Toolface, ...] | None = Field(default=None, description="Absent: every 45 deg.")


class TurntablePlan(ConfigTable):
    """Full turns in equal steps: the bench's own encoder and axis, fitted and kept for later sessions on it."""

    kind: Literal["turntable"]
    inclinations_deg: tuple[Inclination, ...] = Field(default=(20.0, 50.0, 90.0), min_length=2)
    stations: int = Field(default=24, ge=8, le=360, description="Steps of a turn.")


class OvenPlan(ConfigTable):
    """The poses repeated at each step of temperature, when it is steady."""

    kind: Literal["oven"]
    temperatures_c: tuple[Celsius, ...] = Field(min_length=2, description="The way up and the way down.")
    inclinations_deg: tuple[Inclination, ...] = (5.0, 45.0, 90.0)
    toolfaces_deg: tuple[Toolface, ...] = (45.0, 135.0, 225.0, 315.0)


class HeatedRollPlan(ConfigTable):
    """The tool rolled at one inclination while it warms or cools."""

    kind: Literal["heated_roll"]
    temperatures_c: tuple[Celsius, ...] = Field(min_length=2)
    inclination_deg: Inclination = 90.0
    toolfaces_deg: tuple[Toolface, ...] = (0.0, 90.0, 180.0, 270.0)


class CustomPlan(ConfigTable):
    """Poses from a table (CSV with inc_ref_deg, tf_ref_deg)."""

    kind: Literal["custom"]
    file: Path
    method: MethodName = JOINT.name


class UnguidedPlan(ConfigTable):
    """No bench: attitudes by hand, found by themselves, calibrated by |g|."""

    kind: Literal["unguided"]
    min_poses: int = Field(default=12, ge=10, le=1000)


class _JudgingPlan(ConfigTable):
    """Which calibration is judged."""

    record: str = Field(
        default="active", min_length=6, description="`active`: the one in force in [store]; or the id of one there."
    )
    record_file: Path | None = Field(default=None, description="A record's file instead.")
    limit_inc_deg: float = Field(gt=0, le=180, description="Limit on the error of I (roll test: on its range), deg.")


class VerificationPlan(_JudgingPlan):
    """A few poses to judge an existing calibration by."""

    kind: Literal["verification"]
    limit_tf_deg: float = Field(gt=0, le=180, description="Limit on the error of T, deg.")
    tilt_sigma_deg: float = Field(
        default=0.05, ge=0, lt=10, description="How well the bench is level, 1 sigma, where the poses do not tell."
    )
    same_bench: bool = Field(default=False, description="The bench of the record: its tilt is known from there.")
    toolface_zero_sigma_deg: float = Field(default=0.0, ge=0, lt=10, description="How well the tool is clamped in T.")
    free_toolface_zero: bool = Field(default=False, description="Estimate the toolface zero of this clamping.")
    inclinations_deg: tuple[Inclination, ...] = Field(
        default=(-45.0, 5.0, 45.0, 90.0),
        min_length=1,
        description="Negative: that inclination again with the table turned the other way, at the same attitudes of the"
        " tool (the toolfaces plus 180 are set); it tells how the bench leans.",
    )
    toolfaces_deg: tuple[Toolface, ...] = Field(default=(20.0, 140.0, 260.0), min_length=1)


class RollTestPlan(_JudgingPlan):
    """The field roll test: toolfaces all around at one inclination."""

    kind: Literal["roll_test"]
    limit_gtotal_mg: float = Field(default=2.5, gt=0, description="Limit on the range of Gtotal, mg.")
    inclination_deg: Inclination = 90.0
    toolfaces: int = Field(default=8, ge=8, le=72)


PlanConfig = Annotated[
    BalancePlan
    | ConventionalPlan
    | JointPlan
    | TurntablePlan
    | OvenPlan
    | HeatedRollPlan
    | CustomPlan
    | UnguidedPlan
    | VerificationPlan
    | RollTestPlan,
    Field(discriminator="kind"),
]


class SessionTable(ConfigTable):
    """When a pose is good enough, and what is known of the sensor beforehand. Absent fields: as the plan has them
    (`bench.session.plans.Limits`, which says what each is)."""

    std_error_g: float | None = Field(default=None, gt=0, description="A hold ends when its mean is this certain.")
    min_hold_s: float | None = Field(default=None, gt=0, le=600)
    max_hold_s: float | None = Field(default=None, gt=0, le=3600)
    align_deg: float | None = Field(default=None, gt=0, le=10)
    prior_offset_g: float | None = Field(default=None, gt=0, description="Offset of the sensor, 1 sigma.")
    prior_matrix: float | None = Field(default=None, gt=0, description="Scale and misalignment, 1 sigma.")
    outlier_sigmas: float | None = Field(default=None, gt=2)
    retakes: int | None = Field(default=None, ge=0, le=20)
    temp_tolerance_c: float | None = Field(default=None, gt=0)
    temp_rate_c_min: float | None = Field(default=None, gt=0)
    soak_s: float | None = Field(default=None, ge=0)
    remind_s: float | None = Field(default=None, gt=0)


class BenchTable(ConfigTable):
    """What the record must say of the bench."""

    name: str | None = Field(default=None, max_length=100)
    pose_sigma_deg: float = Field(default=0.0052, ge=1e-6, lt=10, description="Standard deviation of one setting, deg.")
    gravity_mps2: float | None = Field(default=None, gt=9.7, lt=9.9)
    gravity_std_mps2: float = Field(default=1e-4, ge=0)
    temp_c: Celsius | None = Field(default=None, description="Where the tool itself tells none.")
    turntable: Path | None = Field(
        default=None, description="The fit of this bench's turntable (plan `turntable`); absent: in [store], by `name`."
    )
    use_turntable: bool = Field(default=True, description="Take it off the settings, where there is one.")
    model: Path | None = Field(
        default=None,
        description="A model (`diagnose --write-model`): its bench is taken off the settings, its laws of the sensor"
        " off the poses, and the record keeps these.",
    )


class StoreTable(ConfigTable):
    """Where things are kept; relative names start at the directory of the file, the defaults are the user's own."""

    directory: Path = Field(default_factory=places.calibrations, description="The calibration store.")
    sessions: Path = Field(default_factory=places.sessions, description="The journals, one file a session.")
    expires_days: float | None = Field(default=None, gt=0, le=36_525)
    signing_key: Path | None = Field(
        default=None, description="Private key of the laboratory (`highside keys new`): the record is signed with it."
    )
    trusted_keys: Path | None = Field(
        default=None, description="Public keys, one a line: only records signed with one of them are put in force."
    )


class SimulatedTurntable(ConfigTable):
    """The faults of a simulated bench (one standard deviation where random); temperatures in deg C."""

    offset_per_c: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="Offset of the sensor, g per deg C."
    )
    temp_c: Celsius = 25.0
    oven_tau_s: float = Field(default=60.0, gt=0)
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    pose_sigma_deg: float = Field(default=0.0052, ge=0)
    overshoot_deg: float = Field(default=0.6, ge=0, le=10)
    settle_s: float = Field(default=1.0, ge=0, le=60, description="Time to come to rest after a move.")
    shake_g: float = Field(default=0.002, ge=0, le=0.5)
    turn_rate_dps: float = Field(default=45.0, gt=0, le=360)
    encoder_deg: tuple[tuple[float, float], ...] = Field(
        default=(), description="Error of the toolface encoder: cosine and sine of the 1st, 2nd, ... harmonic, deg."
    )
    axes: str = Field(default="xyz", description="Order in which the axes come out: a wrong mapping, if not xyz.")
    seed: int = Field(default=1, ge=0)


class SimulatedTable(SimulatedTurntable):
    """A bench inside the process: sensor, table and hands. The tool still speaks through a pty."""

    rate_hz: float = Field(default=100.0, ge=5, le=2000)
    speed: float = Field(default=1.0, gt=0, le=500, description="How much faster than the clock it runs.")
    matrix: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]] = (
        (0.9991, 0.0038, -0.0007),
        (-0.0019, 0.9989, 0.0001),
        (0.0009, 0.0003, 0.9982),
    )
    offset_g: tuple[float, float, float] = (0.0012, -0.0008, 0.0015)
    noise_density_g: float = Field(default=20e-6, ge=0, description="g per root hertz.")
    tilt_deg: tuple[float, float] = (0.02, -0.01)
    mistakes: dict[str, str] = Field(
        default_factory=dict,
        description="What the operator of --auto does wrong at the n-th pose set: wrong_tf, shock, tremor, move, ...",
    )


class BenchFile(ConfigTable):
    """The whole file."""

    tool: ToolSettings = ToolSettings()
    link: LinkConfig | None = None
    simulated: SimulatedTable | None = None
    codec: CodecConfig = ToolCodecConfig(name="tool")
    plan: PlanConfig
    session: SessionTable = SessionTable()
    bench: BenchTable = BenchTable()
    store: StoreTable = Field(default_factory=StoreTable)
    web: WebTable = WebTable()
    mqtt: MqttSettings | None = Field(default=None, description="Show the session at this broker and obey it.")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.link is None) == (self.simulated is None):
            raise ValueError("give either [link] (a real tool) or [simulated], not both and not neither")
        if self.link is not None and self.link.carries is not None and self.link.carries != self.codec.carries:
            raise ValueError(
                f"link.kind {self.link.kind!r} carries {self.link.carries}, but codec.name {self.codec.name!r} decodes"
                f" {self.codec.carries}"
            )
        return self


PATHS = (
    ("plan", "file"),
    ("plan", "record_file"),
    ("link", "path"),
    ("bench", "turntable"),
    ("bench", "model"),
    ("store", "directory"),
    ("store", "sessions"),
    ("store", "signing_key"),
    ("store", "trusted_keys"),
    ("web", "token_file"),
    ("web", "users"),
    ("web", "acts"),
    ("web", "certificate"),
    ("web", "tls", "certificate"),
    ("web", "tls", "key"),
    ("mqtt", "password_file"),
    ("mqtt", "tls", "ca"),
    ("mqtt", "tls", "cert"),
    ("mqtt", "tls", "key"),
    *(("codec", name) for name in path_fields(*codecs().values())),
)


def load_bench(path: Path, overrides: list[str] | None = None, *, plan_of: Path | None = None) -> BenchFile:
    """Read and validate a session's file; `overrides` are `key.path=value`, `plan_of` another such file whose plan is
    taken. Raises InputError in one line.

    Relative paths in the file start at its directory, those of overrides at the working directory.
    """
    tables, base = read_toml(path), path.resolve().parent
    anchor_paths(tables, base, PATHS)
    if plan_of is not None:
        others = read_toml(plan_of)
        anchor_paths(others, plan_of.resolve().parent, PATHS)
        if "plan" not in others:
            raise InputError("is missing", where=str(plan_of), field="plan", remedy="name a file with a plan")
        tables["plan"] = others["plan"]
    given = parse_overrides(overrides or [])
    try:
        return BenchFile.model_validate(merged(tables, given))
    except ValidationError as error:
        raise input_error(error, str(path), given, BenchFile) from None
    except InputError as error:
        raise InputError(error.what, where=str(path), field=error.field, remedy=error.remedy) from None
