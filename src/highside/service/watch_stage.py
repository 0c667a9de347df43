"""The watch in the pipeline: collects readings, and flags attitudes once the calibration does not hold any more.

Synchronous, on device time, without clock or file: `watch_keeper` has the sums made in another thread, stores what is
known and brings commands. Readings come as means over some ten milliseconds (the pipeline's own micro-batches),
corrected as they are published but for the re-balance, which would hide the very offset that is watched for.

It flags, and never corrects: `calibration_departs` stands where the likeliest departure would move inclination or
toolface of that very attitude by more than two of its stated standard deviations.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from highside.calibration.correction import Vector
from highside.calibration.record import CalibrationRecord
from highside.config.watch import WatchSettings
from highside.errors import Refused
from highside.service.saved_watch import EarlierTrace, Numbers, SavedWatch, earlier_traces, facts_of
from highside.watch import Watch, WatchResult, prior_of_record
from highside.watch.live import NO_NUMBERS, LiveRows, LiveWatch, Stretch
from highside.watch.memory import LAYOUT
from highside.watch.result import WatchClaim
from highside.watch.turning import mean_span

DEPARTS = "calibration_departs"
"""the flag of attitudes and surveys, and the alarm"""
DEPTH = "tvd_m"
"""the column, as in a recording, in which a codec hands out the true vertical depth"""
DEPTHS_M = (-500.0, 15_000.0)
"""what is beyond these is no depth of a hole; markers of a missing value among them (-999.25, -9999)"""
COVERAGE = 2.0
"""standard deviations that an error must exceed to be flagged"""
WAITING = 64
"""stretches that wait for their sums: minutes each, sums take milliseconds; beyond, the oldest is dropped, counted"""
VERDICTS = ("learning", "holds", "departs")
"""as WITS has them: 0, 1, 2"""
SAME_CLOCK_S, SAME_CLOCK_SHARE = 5.0, 0.02
"""how far the tool's time may be from the host's over a break, for the tool not to have been switched off"""


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """What a watch is of. Two are equal where record (by its id) and gravity are: a record read again holds arrays."""

    record: CalibrationRecord
    gravity: float
    """of the site in units of the corrected readings"""
    gravity_std: float
    """the same units"""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Watched) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[str, float, float]:
        return self.record.id, self.gravity, self.gravity_std


@dataclass(frozen=True, slots=True)
class Carried:
    """What a running stage has that its state has not: stretches whose sums were not made, readings collected."""

    stage: WatchStage
    waiting: tuple[Stretch, ...]


def claim_key(claim: WatchClaim) -> str:
    """By which a claim is acknowledged: it is another one where another thing departs, or departs anew."""
    return f"{claim.effect} {claim.alarm_s:.3f}"


class WatchStage:
    """`add` takes the rates of each frame, `close` ends a micro-batch, `exceeds` judges an attitude."""

    def __init__(
        self,
        settings: WatchSettings,
        of: Watched,
        saved: SavedWatch | None = None,
        *,
        follows: SavedWatch | None = None,
        continues: Carried | None = None,
        loaded_mono: float = 0.0,
        began: str = "began from the record",
        on_stretch: Callable[[], None] = lambda: None,
    ) -> None:
        """`follows`: the state of a watch under another record, whose time and history go on, and nothing else of it.
        `continues`: a running stage of the same record, whose `saved` state this is, and what it has not used yet.
        Raises InputError for a record that cannot be watched, Refused for a `saved` state that is none."""
        self.of, self.cal_id = of, of.record.id
        self._settings = settings
        watch = self._new_watch()
        calmest: tuple[float | None, float] = (None, 0.0)
        if saved is not None:
            try:
                watch.recall(saved.memory())
                for one in saved.earlier:
                    one.rows()
            except (ValueError, KeyError) as error:
                raise Refused(f"is no saved watch: {error}") from None
            calmest = saved.calmest_g, saved.calmest_s
        self.core = LiveWatch(watch, *calmest)
        self.began = began
        self.acknowledged: set[str] = set() if saved is None else set(saved.acknowledged)
        self.waiting: deque[Stretch] = deque()
        self.working: Stretch | None = None
        """the one whose sums are being made"""
        self.dropped = 0
        before = follows if saved is None else saved
        self._rows = LiveRows(0.0 if before is None else before.t_s)
        self._before, self._loaded_mono = before, loaded_mono
        self._follows = follows is not None
        self.earlier: tuple[EarlierTrace, ...] = ()
        """what was seen under other calibrations within the last day"""
        if before is not None:
            self.earlier = tuple(before.earlier) if follows is None else earlier_traces(follows, began)
        self._on_stretch = on_stretch
        self._sum = [0.0, 0.0, 0.0]
        self._n = 0
        self._first_s = self._last_s = 0.0
        self._device_s: float | None = None
        self._t_mono = 0.0
        self._departure: tuple[float, ...] | None = None
        self._unusable = False
        if continues is not None:
            self._continue(continues)
        self.take_result(self.core.result())

    def _continue(self, of: Carried) -> None:
        """Readings that came before go on here: what waits, and the stretch that is being collected."""
        before = of.stage
        self.waiting.extend(of.waiting)
        self.dropped = before.dropped
        self._rows, self._before, self._loaded_mono = before._rows, before._before, before._loaded_mono
        self._sum, self._n = list(before._sum), before._n
        self._first_s, self._last_s = before._first_s, before._last_s
        self._device_s, self._t_mono = before._device_s, before._t_mono

    def carried(self) -> tuple[SavedWatch, Carried]:
        """The state, and what is not in it yet: for a stage of the same record that takes this one's place."""
        state, last = self._saved()
        working = [] if self.working is None or self.working is last else [self.working]
        return state.model_copy(update={"age_s": 0.0}), Carried(self, (*working, *self.waiting))

    def replaced_by(self, other: WatchStage) -> int:
        """Another record is watched by now: what was not used yet was corrected with this one, and counts as dropped
        there; returns the number of stretches."""
        waiting = self.carried()[1].waiting
        lost = len(waiting) + (self._rows.cut() is not None)
        other.dropped += self.dropped + lost
        return lost

    def _new_watch(self) -> Watch:
        of, policy = self.of, self._settings.policy()
        prior = prior_of_record(of.record, self._settings.noise(of.gravity_std / of.gravity), policy)
        return Watch(prior, self.cal_id, policy)

    def begin_again(self) -> None:
        """Forget what was seen; the record is all that is known."""
        self.core = LiveWatch(self._new_watch(), *self.core.calmest)
        self.waiting.clear()
        self.acknowledged, self.began = set(), "began anew, as was asked for"
        self.earlier = ()
        self.take_result(self.core.result())

    # --- readings ----------------------------------------------------------------------------------------------

    def add(self, t_s: float, gx_dps: float, gy_dps: float, gz_dps: float) -> None:
        """The rates of one frame, tool frame."""
        if not self._n:
            self._first_s = t_s
        self._last_s = t_s
        self._sum[0] += gx_dps
        self._sum[1] += gy_dps
        self._sum[2] += gz_dps
        self._n += 1

    def close(
        self,
        t_s: float,
        t_mono: float,
        c: Vector,
        temp_c: float | None,
        depth_m: float | None = None,
        vibration_g: float | None = None,
    ) -> None:
        """The frames added since the last call have the mean device time `t_s`; `c` is their corrected mean, g.
        `depth_m`: true vertical; `vibration_g`: rms of all axes over the last second."""
        n, rates, span = self._n, None, 0.0
        if n:
            span = mean_span(self._first_s, self._last_s, n)
            x, y, z = self._sum
            rates = (math.radians(x / n), math.radians(y / n), math.radians(z / n))
            self._sum, self._n = [0.0, 0.0, 0.0], 0
        if self._before is not None:
            self._go_on(self._before, t_s, t_mono)
            self._before = None
        since = t_mono - self._t_mono
        self._device_s, self._t_mono = t_s, t_mono
        if depth_m is not None and not DEPTHS_M[0] < depth_m < DEPTHS_M[1]:
            depth_m = None
        g = self.of.gravity
        done = self._rows.add(t_s, (c[0] / g, c[1] / g, c[2] / g), rates, temp_c, since, span, depth_m, vibration_g)
        if done is not None:
            self._put(done)

    def _go_on(self, before: SavedWatch, t_s: float, t_mono: float) -> None:
        """The first reading after a restart: how long nothing was seen, and whether the tool was switched off."""
        age, went_on = before.age_s, False
        if age is not None:
            age += max(t_mono - self._loaded_mono, 0.0)
            if before.t_device_s is not None:
                went_on = abs(t_s - before.t_device_s - age) < SAME_CLOCK_S + SAME_CLOCK_SHARE * age
        self._rows.unseen(age or 0.0)
        # a watch that begins with a record allows for another turn-on bias as it is
        if not went_on and not self._follows:
            self._rows.power_up = True

    def finish(self) -> None:
        """The input has ended, or the service: what was collected is used."""
        if (done := self._rows.cut()) is not None:
            self._put(done)

    def _put(self, stretch: Stretch) -> None:
        if len(self.waiting) >= WAITING:
            self.waiting.popleft()
            self.dropped += 1
        self.waiting.append(stretch)
        self._on_stretch()

    # --- what it says ------------------------------------------------------------------------------------------

    @property
    def t_s(self) -> float:
        """The watch's time at the last reading."""
        return self._rows.t_s

    def take_result(self, said: WatchResult) -> None:
        """What the sums have come to."""
        self.said = said
        self._unusable = any(claim.error is None for claim in said.claims)
        self._departure = tuple(said.departure.tolist()) if said.departure.any() else None

    def now_s(self, now_mono: float) -> float:
        """The watch's time at a time of the host's clock: it goes on where no reading comes."""
        if (before := self._before) is not None:
            return self.t_s + (before.age_s or 0.0) + max(now_mono - self._loaded_mono, 0.0)
        return self.t_s + (0.0 if self._device_s is None else max(now_mono - self._t_mono, 0.0))

    def grown_old(self, now_mono: float) -> bool:
        """Whether what is said has become too old to stand since it was said; if so, that is said from here on."""
        measured_s, now_s = self.said.measured_s, self.now_s(now_mono)
        if self.said.stale or measured_s is None or now_s - measured_s <= self._settings.policy().stale_s:
            return False
        self.take_result(self.core.result(now_s))
        return True

    @property
    def left_out(self) -> dict[str, int]:
        """What was not used, by reason; readings that no stretch has ended since are counted, too."""
        found = dict(self.said.counts.left_out)
        if self._rows.no_numbers:
            found[NO_NUMBERS] = found.get(NO_NUMBERS, 0) + self._rows.no_numbers
        return found

    @property
    def departs(self) -> bool:
        """Whether a departure stands that nobody has taken note of."""
        return any(claim_key(claim) not in self.acknowledged for claim in self.said.claims)

    def acknowledge(self) -> str | None:
        """Take note of what stands; returns why there is nothing to take note of, if so."""
        if not self.said.claims:
            return f"nothing departs ({self.said.verdict}): there is nothing to acknowledge"
        self.acknowledged = {claim_key(claim) for claim in self.said.claims}
        return None

    def exceeds(self, g: Vector, inc_std_rad: float, tf_std_rad: float) -> bool:
        """Whether the departure moves this attitude by more than is stated. `g`: corrected reading."""
        if self._unusable:
            return True
        d = self._departure
        if d is None:
            return False
        x, y, z = g
        across = math.hypot(x, y)
        size = math.hypot(across, z)
        if not size > 0.0:
            return False
        s, c = across / size, z / size
        ct, st = (x / across, y / across) if across > 0.0 else (1.0, 0.0)
        fx, fy, fz = s * ct, s * st, c
        dx = d[0] + d[3] * fx + d[4] * fy + d[5] * fz
        dy = d[1] + d[6] * fx + d[7] * fy + d[8] * fz
        dz = d[2] + d[9] * fx + d[10] * fy + d[11] * fz
        by_inc = c * (ct * dx + st * dy) - s * dz
        by_tf = ct * dy - st * dx
        return abs(by_inc) > COVERAGE * inc_std_rad or abs(by_tf) > COVERAGE * tf_std_rad * s

    def saved(self) -> SavedWatch:
        """What is to be kept, without the time of its keeping."""
        return self._saved()[0]

    def _saved(self) -> tuple[SavedWatch, Stretch | None]:
        """Beside it the last stretch that it is of."""
        memory, last = self.core.memory_and_last()
        calmest_g, calmest_s = self.core.calmest
        state = SavedWatch(
            cal_id=self.cal_id,
            layout=LAYOUT,
            gravity=self.of.gravity,
            t_s=self.t_s,
            t_device_s=self._device_s,
            calmest_g=calmest_g,
            calmest_s=calmest_s,
            acknowledged=sorted(self.acknowledged),
            facts=facts_of(memory),
            arrays={name: Numbers.of(values) for name, values in memory.arrays.items()},
            earlier=list(self.earlier),
        )
        return state, last

    def figures(self) -> dict[str, float | None]:
        """For WITS, by the names of `WitsValue`."""
        said = self.said
        error = said.claims[0].error if said.claims else None
        return {
            "watch_verdict": float(VERDICTS.index(said.verdict)),
            "watch_inc_error_deg": None if error is None else error.inc_deg,
            "watch_tf_sin_inc_error_deg": None if error is None else error.tf_sin_inc_deg,
        }

    def health(self) -> dict[str, Any]:
        """What the health message says of it."""
        said = self.said
        claim = said.claims[0] if said.claims else None
        error = None if claim is None else claim.error
        return {
            "verdict": said.verdict,
            "class": [] if claim is None else list(claim.equivalence_class),
            "inc_error_deg": None if error is None else error.inc_deg,
            "tf_sin_inc_error_deg": None if error is None else error.tf_sin_inc_deg,
            "acknowledged": claim is not None and not self.departs,
            "deviation": {name: one.value for name, one in said.parameters.items()},
            "std": {name: one.std for name, one in said.parameters.items()},
            "noise": {one.axis: one.factor for one in said.noise_changes},
            "stills": said.counts.stills,
            "turns": said.counts.turns,
            "left_out": self.left_out,
            "waiting": len(self.waiting),
            "dropped": self.dropped,
            "began": self.began,
        }
