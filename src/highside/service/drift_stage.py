"""The drift stage of the pipeline: azimuth from gyros and corrected gravity, its uncertainty and what it rests on.

Synchronous, on device time, without clock or file: `drift_keeper` stores what it knows and brings commands. Readings
come as means over some ten milliseconds (the pipeline's own micro-batches) and go through `gyro.filter`, the form that
`highside drift` runs over recordings.

An azimuth is never guessed. Until it is configured or set by the command `align` there is none ("unaligned"). While no
reading came (a gap, a restart of tool or service) it is not followed: it is taken up again with the turn that may have
gone unseen (`unseen_turn_dps`), or as it was if the tool stood before and stands now with the same gravity; after
`max_age_s` it is dropped. Gyro biases outlive that, but not another power-up of the tool.

The filter follows the package of the sensors. Where a rotor-angle compensation says that the package looks elsewhere
than the hole, an azimuth that is given is that of the hole: the compensation's error at that moment is added.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from highside.attitude.quaternion import to_angles, up_direction
from highside.calibration.correction import Vector
from highside.config.drift import DriftSettings
from highside.gyro import filter_state
from highside.gyro.blocks import MAX_GAP_S, Block
from highside.gyro.checks import UnitWatch
from highside.gyro.complementary import ComplementaryFilter
from highside.gyro.filter import ErrorStateFilter, azimuth_basis
from highside.gyro.frames import DEG_PER_HOUR, std_to_tool, to_tool
from highside.gyro.gates import NO_REST_LIVE, MotionState
from highside.gyro.literal import AzimuthPolicy, Literal
from highside.gyro.result import AzimuthBasis
from highside.service.messages import DriftMessage, LiteralAzimuth, RecursiveAzimuth
from highside.service.outputs import Azimuth
from highside.service.saved_drift import SAVED, HeadingAlignment, SavedDrift

STALE_S = 1.0
"""Without gyros for so long there is no azimuth."""
LONGEST_CONNECTION_S = 1800.0
WORTHLESS_STD_DEG = 30.0
"""An azimuth less certain is none: and the filter is linear."""
_NO_ROTOR = (
    "the rotor angle is not known, and the compensation of the azimuth needs it: give it, or leave [rotation] out"
)
_SAME_TILT_RAD = math.radians(0.1)
_VERTICAL_COS = 0.05


class DriftStage:
    """`add` takes the rates of each frame, `close` ends a micro-batch, `azimuth` is read for each output."""

    def __init__(
        self,
        settings: DriftSettings,
        latitude_deg: float | None,
        saved: SavedDrift | None = None,
        *,
        loaded_mono: float = 0.0,
        first_start: bool = True,
    ) -> None:
        """`saved`: what is known from before, its age as at `loaded_mono`. `first_start`: nothing was ever kept."""
        self.settings, self.latitude_deg = settings, latitude_deg
        self.alignment: HeadingAlignment | None = None
        self.constrained = False
        """the azimuth was reset to that of the alignment: an assertion"""
        self.saturated = False
        self.restored: str | None = None
        self._before = saved
        self._age_s: float | None = None
        self._loaded_mono = loaded_mono
        self._first_start = first_start and saved is None
        self._t: float | None = None
        self._t_mono = 0.0
        self._sum = [0.0, 0.0, 0.0]
        self._n = 0
        self._sample: tuple[float, Vector, Vector] | None = None
        self._rotor_error_rad: float | None = 0.0
        """by which the package's azimuth exceeds the hole's, at the last reading; None: the rotor angle is not known"""
        self._connection: tuple[float, float] | None = None
        """declared to stand, from and to"""
        self._units = UnitWatch()
        self._literal: Literal | None = None
        self._recursive: ComplementaryFilter | None = None
        self.filter = self._new_filter()

    def _new_filter(self) -> ErrorStateFilter:
        first = self._first_start and self._before is None
        return ErrorStateFilter(self.settings.filter_settings(self.latitude_deg, first_start=first))

    # --- readings ----------------------------------------------------------------------------------------------

    def add(self, gx_dps: float, gy_dps: float, gz_dps: float) -> None:
        """The rates of one frame, tool frame."""
        if not math.isfinite(gx_dps + gy_dps + gz_dps):
            return
        limit = self.settings.gyro_range_dps
        if limit is not None and max(abs(gx_dps), abs(gy_dps), abs(gz_dps)) >= limit:
            self.saturated = True
        self._sum[0] += gx_dps
        self._sum[1] += gy_dps
        self._sum[2] += gz_dps
        self._n += 1

    def close(self, t_s: float, t_mono: float, a: Vector, rotor_error_rad: float | None = 0.0) -> None:
        """The frames added since the last call end at the device time `t_s`; `a` is their corrected mean reading, g.

        `rotor_error_rad`: what a compensation of the azimuth would take off there; None: it needs a rotor angle.
        """
        self._rotor_error_rad = rotor_error_rad
        n = self._n
        if not n:
            return
        # rad/s in the body frame: (x, y, z)_body = (-y, -z, x)_tool
        x, y, z = (math.radians(value / n) for value in self._sum)
        self._sum, self._n = [0.0, 0.0, 0.0], 0
        ax, ay, az = a if math.isfinite(a[0] + a[1] + a[2]) else (0.0, 0.0, 0.0)
        if self.filter.estimate is None and self._t is None and not ax * ax + ay * ay + az * az > 0.25:
            return
        before = self._t
        if before is not None and (t_s - before > MAX_GAP_S or t_s < before):
            restarted = t_s < before
            self._leave_off(t_mono - self._t_mono if restarted else t_s - before, repowered=restarted)
        elif before is None and self._before is not None:
            self._date(self._before, t_s, t_mono)
        self._t, self._t_mono = t_s, t_mono
        body_w, body_a = (-y, -z, x), (-ay, -az, ax)
        self._sample = t_s, body_w, body_a
        if self._recursive is not None:
            self._recursive.update(*self._sample)
        block = self.filter.gather(t_s, body_w, body_a)
        if block is not None:
            self._on_block(block, t_s)
        if self._literal is not None and before is not None:
            self._literal.update(t_s - before, body_w, body_a, self.filter.motion > MotionState.VIBRATING)

    def _leave_off(self, age_s: float, *, repowered: bool) -> None:
        """Nothing came for a while: begin anew, and take up afterwards what still holds."""
        saved = self.saved()
        if saved is not None:
            self._before = saved.model_copy(update={"repowered": repowered, "age_s": max(age_s, 0.0)})
            self._age_s = max(age_s, 0.0)
            # until it is taken up
            self.alignment = None
        self._literal = self._recursive = self._connection = None
        self.filter = self._new_filter()

    def _date(self, before: SavedDrift, t_s: float, t_mono: float) -> None:
        """How old the saved state is at the first reading, and whether the tool's own time went on since."""
        if before.age_s is None:
            return
        age = before.age_s + max(t_mono - self._loaded_mono, 0.0)
        went_on = abs(t_s - before.t_device_s - age) < 5.0 + 0.02 * age
        self._age_s = age
        self._before = before.model_copy(update={"repowered": before.repowered or not went_on})

    def device_restarted(self) -> None:
        """The tool's time began again: `close` sees it; micro-batches do not go on across it."""
        self._sum, self._n = [0.0, 0.0, 0.0], 0

    def _on_block(self, block: Block, t_s: float) -> None:
        connection = self._connection
        # a block that began before the word was given may hold the end of the motion
        declared = connection is not None and connection[0] <= block.start_s and t_s <= connection[1]
        first = self.filter.estimate is None
        self.filter.add_block(block, declared_still=declared)
        if connection is not None and (t_s > connection[1] or (declared and self.filter.motion is MotionState.TURNING)):
            self._connection = None
        self._units.add(block)
        if not first or self.filter.estimate is None:
            return
        if self._before is not None:
            self._take_up(self._before, block)
            self._before = None
        elif self._first_start and self.settings.azimuth_deg is not None:
            std = self.settings.azimuth_std_deg
            if self._rotor_error_rad:
                azimuth_rad = math.radians(self.settings.azimuth_deg) + self._rotor_error_rad
                self.filter.set_azimuth(azimuth_rad, math.radians(std))
            self.alignment = HeadingAlignment(
                azimuth_deg=self.settings.azimuth_deg, std_deg=std, by="configuration", t=None
            )
        self._begin_literal()

    # --- what holds from before --------------------------------------------------------------------------------

    def _take_up(self, before: SavedDrift, block: Block) -> None:
        """The rule of validity, at the first block after a gap or a restart."""
        age, m = self._age_s, self.filter.estimate
        assert m is not None
        settings = self.settings
        if age is None:
            self.restored = "not taken up: of unknown age"
            return
        words = [f"{age:.1f} s old"]
        stood, same_earth = False, before.latitude_deg == self.latitude_deg
        if not before.repowered and same_earth and age <= settings.bias_max_age_s:
            self.filter.gate.know(before.still_statistics())
            stood = before.motion == MotionState.STILL and self._stands_as_before(before, block)
            if stood and age <= settings.max_age_s:
                for name, values in before.memory.items():
                    getattr(m, name).flat[:] = values
                words.append("the tool stood all the time")
            else:
                m.bias[:], m.scale[:] = before.memory["bias"], before.memory["scale"]
                for i in range(3, 7):
                    m.P[i, i] = before.memory["P"][11 * i]
            for i in range(3, 6):
                m.P[i, i] += self.filter.settings.rrw**2 * age
            words.append("gyro biases kept")
        else:
            why = "another power-up" if before.repowered else "too old" if same_earth else "another latitude"
            words.append(f"gyro biases forgotten: {why}")
        if before.alignment is None:
            words.append("no azimuth")
        elif age > settings.max_age_s:
            words.append("azimuth dropped: too old")
        else:
            unseen = 0.0 if stood else settings.unseen_turn_dps * age
            std = math.hypot(before.azi_std_deg, unseen)
            if std > WORTHLESS_STD_DEG:
                words.append(f"azimuth dropped: it may have turned by {std:.0f} deg")
            else:
                self.filter.know_azimuth(math.radians(before.azi_deg), math.radians(std))
                if not stood:
                    self.filter.set_azimuth(math.radians(before.azi_deg), math.radians(std), biases_hold=True)
                self.alignment, self.constrained = before.alignment, before.constrained
                self.saturated = before.saturated
                words.append(f"azimuth kept, uncertain by {std:.2g} deg")
        self.restored = ", ".join(words)

    def _stands_as_before(self, before: SavedDrift, block: Block) -> bool:
        still = before.still_statistics()
        if still is None or block.norm_std > 5.0 * still.norm_std_g or block.rate_noise > 5.0 * still.rate_std:
            return False
        q = np.array(before.memory["q"])
        up = up_direction(q)
        # what the filter took for tilt error of the accelerometers stays as it was
        g = block.accel - np.array(before.memory["accel_bias"])
        g = g / math.sqrt(float(g @ g))
        return float(np.linalg.norm(np.cross(g, up))) < _SAME_TILT_RAD + 4.0 * block.accel_std / math.sqrt(block.n)

    def saved(self) -> SavedDrift | None:
        """What is to be kept, without the time of its keeping; None before the first block."""
        m = self.filter.estimate
        if m is None or self._t is None:
            # what an earlier run left is not replaced by nothing
            return None
        still = self.filter.gate.still
        return SavedDrift(
            latitude_deg=self.latitude_deg,
            t_device_s=self._t,
            motion=int(self.filter.motion),
            memory={name: getattr(m, name).ravel().tolist() for name in SAVED},
            still=None if still is None else still.as_list(),
            alignment=self.alignment,
            azi_deg=math.degrees(filter_state.azimuth_of(filter_state.attitude_of(m))) % 360.0,
            azi_std_deg=math.degrees(self.filter.azimuth_std_rad),
            constrained=self.constrained,
            saturated=self.saturated,
        )

    # --- commands ----------------------------------------------------------------------------------------------

    def align(self, azimuth_deg: float, std_deg: float, t: float | None) -> str | None:
        """The hole's azimuth is this now; returns why it cannot be taken, if so."""
        if self.filter.estimate is None:
            return "no second of gyro readings has come yet: align again when the tool sends"
        if self._rotor_error_rad is None:
            return _NO_ROTOR
        self.filter.set_azimuth(math.radians(azimuth_deg) + self._rotor_error_rad, math.radians(std_deg))
        self.alignment = HeadingAlignment(azimuth_deg=azimuth_deg % 360.0, std_deg=std_deg, by="command", t=t)
        self.constrained = self.saturated = False
        self._begin_literal()
        return None

    def reset_heading(self) -> str | None:
        """The azimuth is that of the alignment again: the assertion that the hole went straight on."""
        if self.alignment is None or self.filter.estimate is None:
            return "there is no alignment to go back to: give the command align"
        if self._rotor_error_rad is None:
            return _NO_ROTOR
        azimuth_rad = math.radians(self.alignment.azimuth_deg) + self._rotor_error_rad
        self.filter.set_azimuth(azimuth_rad, math.radians(self.alignment.std_deg))
        self.constrained, self.saturated = True, False
        self._begin_literal()
        return None

    def connection(self, seconds: float) -> str | None:
        """The tool stands from now on, for so long at most (0: it does not any more)."""
        if self._t is None:
            return "no gyro readings have come yet"
        until = self._t + min(seconds, LONGEST_CONNECTION_S)
        self._connection = (self._t, until) if seconds > 0.0 else None
        return None

    def restart(self) -> str | None:
        """Forget everything."""
        self.alignment, self.constrained, self.saturated, self.restored = None, False, False, None
        self._before, self._first_start, self._connection = None, True, None
        self._literal = self._recursive = None
        self._t = self._age_s = None
        self._units = UnitWatch()
        self.filter = self._new_filter()
        return None

    # --- what it says ------------------------------------------------------------------------------------------

    def azimuth(self, t_s: float) -> Azimuth | None:
        """At the device time of an output; None for a tool without gyros."""
        if self._t is None:
            return None
        m = self.filter.estimate
        if t_s - self._t > STALE_S:
            return Azimuth(None, None, ("no_gyros",))
        if self._units.verdict is not None:
            return Azimuth(None, None, ("gyro_units",))
        if m is None or self.alignment is None:
            return Azimuth(None, None, ("unaligned",))
        flags = ("gyro_saturated",) if self.saturated else ()
        if self.settings.method in ("literal", "literal_block"):
            return self._literal_azimuth(flags)
        if self.settings.method == "recursive":
            return self._recursive_azimuth(flags)
        theta, _, psi = to_angles(self.filter.attitude_now())
        if math.cos(float(theta)) < _VERTICAL_COS:
            return Azimuth(None, None, ("vertical",), flags)
        std = math.degrees(self.filter.azimuth_std_rad)
        return Azimuth(math.degrees(float(psi)) % 360.0, std, self.basis, flags)

    @property
    def basis(self) -> tuple[str, ...]:
        """Where the filter's azimuth comes from, by name."""
        m = self.filter.estimate
        if m is None or self.alignment is None:
            return ("unaligned",)
        found = azimuth_basis(self.filter.settings, m.tally[filter_state.STILL_S], m.tally[filter_state.TURNED])
        names = tuple(basis.name.lower() for basis in found)
        return ("constraint", *names) if self.constrained and "constraint" not in names else names

    def _begin_literal(self) -> None:
        m, settings = self.filter.estimate, self.settings
        self._literal = self._recursive = None
        if m is None or self.alignment is None:
            return
        if settings.method == "recursive":
            self._begin_recursive()
        if not (settings.compare_literal or settings.method in ("literal", "literal_block")):
            return
        self._literal = Literal(
            settings.policy, filter_state.attitude_of(m), average=settings.method == "literal_block"
        )

    def _begin_recursive(self) -> None:
        own = self.filter.settings
        azimuth = filter_state.azimuth_of(tuple(self.filter.attitude_now().tolist()))
        std = self.filter.azimuth_std_rad
        engine = ComplementaryFilter(
            replace(own, azimuth_rad=azimuth, azimuth_std_rad=std), hold=self.settings.straight_hole
        )
        engine.q = self.filter.attitude_now()
        if self._sample is not None:
            # the next sample is integrated from this one on
            engine.update(*self._sample)
        self._recursive = engine

    def _recursive_azimuth(self, flags: tuple[str, ...]) -> Azimuth:
        engine = self._recursive
        if engine is None:
            return Azimuth(None, None, ("unaligned",), flags)
        theta, _, psi = to_angles(engine.attitude_now())
        if math.cos(float(theta)) < _VERTICAL_COS:
            return Azimuth(None, None, ("vertical",), flags)
        basis = AzimuthBasis.CONSTRAINT if engine.hold else AzimuthBasis.NOTHING
        return Azimuth(
            math.degrees(float(psi)) % 360.0, math.degrees(engine.azimuth_std_rad), (basis.name.lower(),), flags
        )

    def _literal_azimuth(self, flags: tuple[str, ...]) -> Azimuth:
        if self._literal is None:
            return Azimuth(None, None, ("unaligned",), flags)
        psi = float(to_angles(np.array(self._literal.q))[2])
        held = self._literal.policy is not AzimuthPolicy.GYRO
        return Azimuth(math.degrees(psi) % 360.0, None, ("constraint" if held else "nothing",), flags)

    @property
    def has_gyro_data(self) -> bool:
        """Whether gyro readings came at all."""
        return self._t is not None

    def message(self, t: float) -> DriftMessage:
        """The retained message `drift`."""
        now = self._t if self._t is not None else 0.0
        azimuth = self.azimuth(now)
        state = self.filter.state
        bias = std = None
        if state is not None:
            bias = [round(float(v) / DEG_PER_HOUR, 4) for v in to_tool(state.bias)]
            std = [round(float(v) / DEG_PER_HOUR, 4) for v in std_to_tool(state.bias_std)]
        literal = None
        if self._literal is not None:
            drift = to_tool(np.array(self._literal.drift)) / DEG_PER_HOUR
            own = self._literal_azimuth(())
            literal = LiteralAzimuth(
                policy=self.settings.azimuth_policy,
                azi_deg=own.azi_deg,
                bias_dph=[round(float(v), 4) for v in drift],
            )
        recursive = None
        if self._recursive is not None:
            own = self._recursive_azimuth(())
            drift = to_tool(self._recursive.bias) / DEG_PER_HOUR
            recursive = RecursiveAzimuth(
                azi_deg=own.azi_deg, azi_std_deg=own.azi_std_deg, bias_dph=[round(float(v), 4) for v in drift]
            )
        notes = {
            "no latitude in [site]: the Earth's rotation counts as gyro bias": self.latitude_deg is None,
            self._units.verdict or "": self._units.verdict is not None,
            "a gyro was at its range since the alignment: turns beyond it are lost": self.saturated,
            NO_REST_LIVE: self.settings.detect_stops and self.filter.gate.without_rest,
        }
        return DriftMessage(
            t=round(t, 6),
            method=self.settings.method,
            motion="none" if state is None else self.filter.motion.name.lower(),
            azi_deg=None if azimuth is None else azimuth.azi_deg,
            azi_std_deg=None if azimuth is None else azimuth.azi_std_deg,
            azi_basis=["no_gyros"] if azimuth is None else list(azimuth.basis),
            alignment=self.alignment,
            connection=self._connection is not None,
            bias_dph=bias,
            bias_std_dph=std,
            scale_ppm=None if state is None else round(1e6 * state.scale, 2),
            refused={} if state is None else state.refused,
            literal=literal,
            recursive=recursive,
            restored=self.restored,
            notes=[note for note, stands in notes.items() if stands],
        )
