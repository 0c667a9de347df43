"""The table `[drift]`: azimuth from gyros and gravity. Latitude stands in `[site]`."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from highside.gyro.filter import FilterSettings
from highside.gyro.frames import DEG_PER_HOUR, DEG_PER_SQRT_HOUR
from highside.gyro.literal import AzimuthPolicy
from highside.reading.config_table import ConfigTable


class DriftSettings(ConfigTable):
    """The table `[drift]`. It takes effect for tools whose frames carry gyros."""

    enabled: bool = True
    method: Literal["kinematic", "literal", "literal_block", "recursive"] = Field(
        default="kinematic",
        description="What the published azimuth comes from, for comparison; literal and literal_block state no"
        " uncertainty, recursive (one gain for all directions) believes gravity alone.",
    )
    compare_literal: bool = Field(
        default=False, description="Run the literal algorithm beside, in the `drift` message."
    )
    azimuth_policy: Literal["gyro", "prev", "hold"] = Field(
        default="hold",
        description="Of the literal algorithm: gyro leaves the azimuth uncorrected, prev lets nothing turn about the"
        " vertical, hold keeps the azimuth (straight hole).",
    )
    azimuth_deg: float | None = Field(
        default=None,
        ge=0,
        lt=360,
        description="Azimuth at the very first start, from true north; absent: none until the command `align`.",
    )
    azimuth_std_deg: float = Field(default=0.5, ge=0, le=90, description="Its standard deviation.")
    straight_hole: bool = Field(
        default=False, description="Assert that the azimuth stays that of the alignment: a real change is not detected."
    )
    detect_stops: bool = Field(default=True, description="Measure the gyros at stops found in the data.")
    gyro_arw: float = Field(default=0.1, gt=0, le=100, description="Angle random walk, deg/sqrt(h).")
    gyro_rrw: float = Field(default=0.1, ge=0, le=1000, description="Rate random walk, deg/h/sqrt(h).")
    gyro_bias_std: float = Field(default=20.0, gt=0, le=1e5, description="Bias to be expected at power-up, deg/h.")
    gyro_scale_std: float = Field(default=1e-3, ge=0, le=0.1, description="Scale error along the tool axis.")
    gyro_range_dps: float | None = Field(
        default=None, gt=0, description="Range of the gyros; a reading at it is flagged: what it lost is not known."
    )
    unseen_turn_dps: float = Field(
        default=1.0,
        ge=0,
        description="How fast the azimuth may have turned while no reading came (a gap, a restart), 1 sigma.",
    )
    max_age_s: float = Field(
        default=600.0, ge=0, description="An azimuth that was not followed for longer (restart, gap) is dropped."
    )
    bias_max_age_s: float = Field(
        default=86400.0, ge=0, description="Gyro biases older than this are forgotten; those of another power-up too."
    )
    save_interval_s: float = Field(default=10.0, gt=0.1, le=3600, description="How often the state is put on disk.")

    @property
    def policy(self) -> AzimuthPolicy:
        return AzimuthPolicy(self.azimuth_policy)

    def filter_settings(self, latitude_deg: float | None, *, first_start: bool) -> FilterSettings:
        """What the error-state filter begins with; the configured azimuth counts at the first start alone."""
        azimuth = self.azimuth_deg if first_start else None
        return FilterSettings(
            latitude_rad=None if latitude_deg is None else math.radians(latitude_deg),
            azimuth_rad=None if azimuth is None else math.radians(azimuth),
            azimuth_std_rad=math.radians(self.azimuth_std_deg),
            bias_std_radps=self.gyro_bias_std * DEG_PER_HOUR,
            arw=self.gyro_arw * DEG_PER_SQRT_HOUR,
            rrw=self.gyro_rrw * DEG_PER_HOUR / 60.0,
            scale_std=self.gyro_scale_std,
            straight_hole_std_rad=math.radians(0.1) if self.straight_hole else None,
            detect_stops=self.detect_stops,
        )
