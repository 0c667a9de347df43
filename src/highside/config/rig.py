"""The tables around I and T that a rig expects: job site, toolface, survey acceptance, shocks, WITS, metrics.

`[site]`, `[toolface]`, `[survey.accept]`, `[vibration]`, `[[wits]]`, `[metrics]`, `[home_assistant]`.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from highside.physics.gravity import (
    GRAVITATION,
    gravity_below_mps2,
    normal_gravity_mps2,
    normal_gravity_std_mps2,
)
from highside.reading.config_table import ConfigTable, HostName

Level = Annotated[float, Field(gt=0, le=100_000)]


class SiteSettings(ConfigTable):
    """The table `[site]`: gravity and latitude where the tool works."""

    gravity_mps2: float | None = Field(
        default=None,
        gt=9.6,
        lt=10.0,
        description="Local gravity in m/s2, at the surface where `depth_m` is given; where absent that of"
        " `latitude_deg` and `height_m`, else unknown.",
    )
    gravity_std_mps2: float = Field(default=0.0005, ge=0, lt=0.1, description="Its standard deviation, m/s2.")
    latitude_deg: float | None = Field(
        default=None, ge=-90, le=90, description="For the Earth's rotation in the gyros; absent: counts as their bias."
    )
    height_m: float | None = Field(
        default=None, ge=-500, le=9000, description="Of the ground above sea level, for gravity."
    )
    depth_m: float = Field(
        default=0.0, ge=0, le=15_000, description="True vertical depth of the tool below the ground, for gravity."
    )
    density_kgpm3: float = Field(
        default=2450.0, ge=1000, le=4000, description="Mean of the rock above: 2,200 (clay) to 2,700 (limestone)."
    )
    density_std_kgpm3: float = Field(default=250.0, ge=0, le=1000, description="Its standard deviation.")

    def local_gravity(self) -> tuple[float, float] | None:
        """Gravity at the tool and its standard deviation, m/s2; None: unknown.

        Measured, or normal gravity of latitude and height (WGS84) with the anomalies of an unknown place (0.3 mm/s2);
        below ground by Poincare and Prey. A measured one without a latitude takes the free-air growth at 45 deg (it
        differs by 0.1 % over the Earth)."""
        latitude = math.radians(45.0 if self.latitude_deg is None else self.latitude_deg)
        height = self.height_m or 0.0
        if self.gravity_mps2 is not None:
            surface, std = self.gravity_mps2, self.gravity_std_mps2
        elif self.latitude_deg is not None and self.height_m is not None:
            surface, std = normal_gravity_mps2(latitude, height), normal_gravity_std_mps2()
        else:
            return None
        rock = 4.0 * math.pi * GRAVITATION * self.density_std_kgpm3 * self.depth_m
        return gravity_below_mps2(surface, latitude, height, self.depth_m, self.density_kgpm3), math.hypot(std, rock)


class ToolfaceSettings(ConfigTable):
    """The table `[toolface]`: toolface as the rig means it. The offset itself is set by `highside toolface`."""

    low_inclination_deg: float = Field(
        default=3.0, ge=0, le=90, description="Below this (and above 180 minus this) toolface is flagged."
    )


class AcceptSettings(ConfigTable):
    """The table `[survey.accept]`: what a survey must keep to be accepted."""

    g_total_mg: float = Field(
        default=3.0, gt=0, description="Largest departure of Gtotal from the site's gravity, uncertainty aside."
    )
    min_temp_c: float = Field(default=-40.0, description="Coldest at which surveys are accepted.")
    max_temp_c: float = Field(default=175.0, description="Hottest at which surveys are accepted.")
    shock_g: float = Field(default=1.0, gt=0, description="A peak above this during the survey refuses it.")
    max_inc_std_deg: float | None = Field(default=None, gt=0, description="Largest standard deviation of I.")
    min_still_share: float = Field(
        default=0.5, ge=0, le=1, description="Of `survey.still_s`: a stop cut short after that is kept as refused."
    )

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.max_temp_c <= self.min_temp_c:
            raise ValueError("`max_temp_c` must be above `min_temp_c`")
        return self


class VibrationSettings(ConfigTable):
    """The table `[vibration]`: shock and vibration counted from the raw stream, gravity and turning taken off."""

    corner_hz: float = Field(default=5.0, gt=0, le=1000, description="What is slower is gravity and turning.")
    rms_levels_g: tuple[Level, ...] = Field(
        default=(0.1, 0.5, 1.0, 2.0, 5.0), description="Seconds at or above each of these are counted, an axis each."
    )
    shock_levels_g: tuple[Level, ...] = Field(
        default=(1.0, 5.0, 10.0, 25.0, 50.0), description="Shocks at or above each of these are counted, an axis each."
    )
    shock_gap_s: float = Field(default=0.1, ge=0, le=10, description="Peaks closer than this are one shock.")

    @model_validator(mode="after")
    def _rising(self) -> Self:
        for name in ("rms_levels_g", "shock_levels_g"):
            levels = getattr(self, name)
            if list(levels) != sorted(set(levels)):
                raise ValueError(f"`{name}` must rise")
        return self


WitsValue = Literal[
    "inc_deg",
    "azi_deg",
    "motor_toolface_deg",
    "tf_deg",
    "g_total",
    "temp_c",
    "inc_std_deg",
    "tf_std_deg",
    "azi_std_deg",
    "watch_verdict",
    "watch_inc_error_deg",
    "watch_tf_sin_inc_error_deg",
    "depth",
    "date",
    "time",
]


def _present_name(value: object) -> object:
    """Of a value that was named otherwise before."""
    return "motor_toolface_deg" if value == "toolface_deg" else value


class WitsItem(ConfigTable):
    """One item of a record."""

    code: str = Field(pattern=r"^[0-9]{4}$", description="Record type and item, four digits.")
    value: Annotated[WitsValue, BeforeValidator(_present_name)] = Field(
        description="`watch_verdict`: 0 learning, 1 holds, 2 departs; `watch_..._error_deg`: what departs does to"
        " inclination, and to toolface times sin I, now."
    )
    source: Literal["attitude", "survey"] = Field(
        default="attitude", description="The latest attitude, or the last accepted survey."
    )
    digits: int = Field(default=2, ge=0, le=6, description="Decimals.")


DEFAULT_ITEMS = (
    WitsItem(code="0705", value="date"),
    WitsItem(code="0706", value="time"),
    WitsItem(code="0708", value="depth"),
    WitsItem(code="0713", value="inc_deg"),
    WitsItem(code="0715", value="azi_deg"),
    WitsItem(code="0717", value="motor_toolface_deg", digits=1),
)


class _Wits(ConfigTable):
    interval_s: float = Field(default=5.0, ge=0.1, le=3600, description="Seconds between two records.")
    items: tuple[WitsItem, ...] = Field(default=DEFAULT_ITEMS, min_length=1, description="What a record holds.")
    depth_codes: tuple[str, ...] = Field(
        default=("0110", "0108"), description="Items in which the rig tells us the depth, first wins."
    )
    greeting: tuple[tuple[str, str], ...] = Field(
        default=(), description='Items sent once to a new peer, as some rigs request: [["1984", "..."]].'
    )
    stale_after_s: float = Field(default=30.0, gt=0, description="Older readings are not sent any more.")

    @model_validator(mode="after")
    def _once(self) -> Self:
        codes = [item.code for item in self.items]
        if len(set(codes)) != len(codes):
            raise ValueError("an item code is given twice")
        return self


class WitsSerial(_Wits):
    """WITS over a serial line."""

    kind: Literal["serial"]
    port: str = Field(min_length=1, description="Device, best below /dev/serial/by-id.")
    baud: int = Field(default=9600, gt=0, le=4_000_000)
    parity: Literal["N", "E", "O"] = "N"


class WitsServer(_Wits):
    """Rigs connect to us."""

    kind: Literal["tcp_server"]
    host: HostName = Field(default="127.0.0.1", min_length=1, description="Address listened on; loopback unless given.")
    port: int = Field(ge=0, le=65_535)
    max_peers: int = Field(default=8, ge=1, le=256)


class WitsClient(_Wits):
    """We connect to the rig."""

    kind: Literal["tcp_client"]
    host: HostName = Field(min_length=1)
    port: int = Field(ge=1, le=65_535)


WitsConfig = Annotated[WitsSerial | WitsServer | WitsClient, Field(discriminator="kind")]


class MetricsSettings(ConfigTable):
    """The table `[metrics]`: figures for Prometheus; present, even if empty: they are served."""

    host: HostName = Field(default="127.0.0.1", min_length=1, description="Address listened on; loopback unless given.")
    port: int = Field(default=9479, ge=0, le=65_535)


class HomeAssistantSettings(ConfigTable):
    """The table `[home_assistant]`; present, even if empty: the tool announces itself."""

    prefix: str = Field(default="homeassistant", pattern=r"^[A-Za-z0-9_/-]+$", description="Discovery prefix.")
