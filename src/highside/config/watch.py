"""The table `[watch]`: whether the calibration in force still holds, judged from the stream."""

from __future__ import annotations

from dataclasses import replace
from typing import Self

from pydantic import Field, model_validator

from highside.reading.config_table import ConfigTable
from highside.watch import POLICY, STATED, StatedNoise, WatchPolicy


class WatchSettings(ConfigTable):
    """The table `[watch]`. It takes effect where a calibration record without zones of inclination is in force."""

    enabled: bool = True
    threshold: float = Field(
        default=POLICY.threshold,
        ge=25,
        le=1000,
        description="Twice the log-likelihood ratio from which a departure is said; 36 are six standard deviations.",
    )
    still_unseen_deg: float = Field(
        default=POLICY.still_unseen_deg,
        gt=0,
        le=10,
        description="`holds` is said where an error of the present inclination above this would have been seen.",
    )
    pull_deg: float = Field(
        default=POLICY.pull_deg, gt=0, le=90, description="Error of I or T from which the advice is to pull the tool."
    )
    most_onsets: int = Field(
        default=1000,
        ge=50,
        le=3000,
        description="Times, ten minutes or more apart, at which a departure may have begun; then the oldest goes.",
    )
    repeat_g: float = Field(
        default=STATED.repeat_g,
        gt=0,
        lt=0.1,
        description="Repeatability of an offset from one power-up to another, and from the bench to the hole, g, 1"
        " sigma; of an element of the matrix the same number.",
    )
    random_walk_g: float = Field(
        default=STATED.offset_random_walk,
        gt=0,
        lt=0.01,
        description="Random walk of an offset, g/sqrt(h); of an element of the matrix the same number.",
    )
    still_floor_g: float = Field(
        default=STATED.still_floor_g, gt=0, lt=0.1, description="1/f noise of the mean at rest, g, 1 sigma."
    )
    window_floor_g: float = Field(
        default=STATED.window_floor_g, gt=0, lt=0.1, description="The same of a harmonic while the tool turns."
    )
    whirl_m: float = Field(
        default=STATED.whirl_m, ge=0, lt=0.1, description="Sideways motion of the turning collar, m rms."
    )
    interval_s: float = Field(
        default=5.0, ge=0.1, le=3600, description="Seconds between two `watch` messages, at least; only what is new."
    )
    save_interval_s: float = Field(
        default=60.0, ge=0.1, le=3600, description="How often the state is put on disk, if it has changed."
    )

    @model_validator(mode="after")
    def _order(self) -> Self:
        if self.pull_deg < self.still_unseen_deg:
            raise ValueError("`pull_deg` must not be below `still_unseen_deg`")
        return self

    def policy(self) -> WatchPolicy:
        """The limits."""
        return replace(
            POLICY,
            threshold=self.threshold,
            still_unseen_deg=self.still_unseen_deg,
            pull_deg=self.pull_deg,
            most_onsets=self.most_onsets,
            most_traced=self.most_onsets,
        )

    def noise(self, gravity_std: float) -> StatedNoise:
        """What the tool may do. `gravity_std`: of the site's gravity, relative."""
        return replace(
            STATED,
            repeat_g=self.repeat_g,
            repeat=self.repeat_g,
            offset_random_walk=self.random_walk_g,
            matrix_random_walk=self.random_walk_g,
            still_floor_g=self.still_floor_g,
            window_floor_g=self.window_floor_g,
            whirl_m=self.whirl_m,
            gravity_g=max(STATED.gravity_g, gravity_std),
        )
