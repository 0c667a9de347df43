"""The watch itself: measurements in, verdict out.

Two filters run beside the bank of departures. One starts at the record's covariance: its innovations are tested. The
other starts with the calibration nearly unknown and is never tested: its covariance is what the hole *alone* says, and
only where that is small at the present attitude is a calibration said to hold (`holds`, else `learning`).
"""

from __future__ import annotations

from collections import deque
from dataclasses import astuple, replace

import numpy as np

from highside.arrays import Array
from highside.watch.axis_noise import AxisNoise
from highside.watch.bank import Bank, Filter, Scored
from highside.watch.broken import AT_REST, Beyond
from highside.watch.claims import broken, departed, sizes_of, unexplained
from highside.watch.hold import Hold, noise_evidence, rests_of
from highside.watch.measurement import Still, Surroundings, Turning, linear_still, linear_turning
from highside.watch.memory import TRACE_WIDTH, WatchMemory, checked
from highside.watch.noise_level import NoiseLevel
from highside.watch.parameters import CALIBRATION, GROWTH, KT, NAMES, SIZE, UNITS, B, Prior
from highside.watch.policy import POLICY, StatedNoise, WatchPolicy
from highside.watch.present import error_of, sight_of
from highside.watch.result import (
    AttitudeError,
    Counts,
    Deviation,
    Size,
    TakenBack,
    Trace,
    Verdict,
    WatchClaim,
    WatchResult,
)
from highside.watch.words import advice, noise_advice, not_observable, state_advice, taken_back_advice

__all__ = ["Watch"]

HOUR_S = 3600.0


class Watch:
    """Follow one tool under one calibration. Measurements come in the order of time."""

    def __init__(self, prior: Prior, cal_id: str = "none", policy: WatchPolicy = POLICY) -> None:
        self._prior, self._policy, self._cal_id = prior, policy, cal_id
        self._filter = Filter(np.zeros(SIZE), prior.covariance.copy(), prior.process_noise)
        self._alone = Filter(np.zeros(SIZE), prior.wide.copy(), prior.process_noise)
        self._bank = Bank(policy)
        self._ref_c = prior.ref_c
        self._start_s: float | None = None
        self._last_s = 0.0
        self._onset_s = -np.inf
        self._depth_km: float | None = None
        self._deeper_km = 0.0
        self._level = NoiseLevel(policy)
        self._axes = AxisNoise(policy)
        self._alarm_s: float | None = None
        self._f: Array | None = None
        self._at_rest = False
        self._counts = {"stills": 0, "turns": 0}
        self._left_out: dict[str, int] = {}
        self._warmer_c = 0.0
        self._trace: deque[tuple[float, Array, Array, float, float]] = deque(maxlen=policy.most_traced)
        self._beyond = Beyond()
        self._hold: Hold | None = None
        self._taken_back: TakenBack | None = None

    def still(self, still: Still) -> None:
        """Take a mean at rest."""
        if not self._is_warm(still.temp_c) or self._is_beyond(
            still.t_s, float(np.linalg.norm(still.mean_g)) - 1.0, np.append(still.mean_g, [AT_REST] * 3)
        ):
            return
        self._counts["stills"] += 1
        times = None
        if still.scatter_g is not None:
            times = self._axes.times(still.scatter_g)
            self._axes.take(still.t_s, still.scatter_g)
        # waits even where its rows scatter as ever: what is constant within a rest shows from rest to rest alone
        self._measure(still, times)

    def shaken(self, still: Still) -> None:
        """A rest in which the tool shakes: its mean is not used, what its axes scatter is."""
        self.leave_out("rest in which the tool shakes")
        if still.scatter_g is not None:
            self._axes.take(still.t_s, still.scatter_g)

    def turning(self, turn: Turning) -> None:
        """Take a window of rotation."""
        M = turn.harmonics_g
        across = 0.5 * np.hypot(M[0, 1] + M[1, 2], M[1, 1] - M[0, 2])
        if not self._is_warm(turn.temp_c) or self._is_beyond(
            turn.t_s, float(np.hypot(across, M[2, 0])) - 1.0, np.append(M[:, 0], np.hypot(M[:, 1], M[:, 2]))
        ):
            return
        self._counts["turns"] += 1
        self._measure(turn)

    def _is_warm(self, temp_c: float | None) -> bool:
        """Whether a temperature is one that a tool may have: a broken thermometer would make coefficients."""
        if temp_c is None or self._policy.coldest_c <= temp_c <= self._policy.hottest_c:
            return True
        self.leave_out("temperature is none of a tool")
        return False

    def _is_beyond(self, t_s: float, excess_g: float, axes: Array) -> bool:
        """Whether a length is no gravity with small errors; such readings are kept apart."""
        if abs(excess_g) <= self._policy.largest:
            return False
        self.leave_out("length is not that of gravity")
        if len(self._beyond.lengths) < self._policy.most_beyond:
            self._beyond.add(t_s, excess_g, axes)
        return True

    def power_up(self) -> None:
        """The tool was switched off and on: its offsets may repeat no better than is stated."""
        self._hold = None
        noise = self._noise
        for one in (self._filter, self._alone):
            one.covariance[range(CALIBRATION), range(CALIBRATION)] += [noise.repeat_g**2] * 3 + [noise.repeat**2] * 9

    def leave_out(self, reason: str, count: int = 1) -> None:
        """Count something that was not used."""
        self._left_out[reason] = self._left_out.get(reason, 0) + count

    def information_of(self, name: str, since_s: float) -> float:
        """What has been seen so far of a hypothesis from its first onset at `since_s` or later: 1 / variance."""
        return self._bank.information_of(name, since_s)

    @property
    def alarm_s(self) -> float | None:
        """When a departure was first said; None: never."""
        return self._alarm_s

    def memory(self) -> WatchMemory:
        """All it knows, for `recall`."""
        held = None if self._hold is None else self._hold.rests()
        if self._hold is None or held is None:
            return self._now()
        before = self._before(self._hold)
        return replace(before, arrays={**before.arrays, "held": held})

    def _before(self, hold: Hold) -> WatchMemory:
        """What was known before what is held, and what has been counted since."""
        now = self._now()
        counted = {name: now.arrays[name] for name in ("beyond", "beyond_axes", "noise_rests", "noise_changed")}
        arrays = {**hold.before.arrays, **counted}
        return replace(hold.before, arrays=arrays, stills=now.stills, turns=now.turns, left_out=now.left_out)

    def _now(self) -> WatchMemory:
        trace = [np.concatenate([[t], value, std, [inc, evidence]]) for t, value, std, inc, evidence in self._trace]
        arrays = {
            "state": self._filter.state.copy(),
            "covariance": self._filter.covariance.copy(),
            "walked": self._filter.walked.copy(),
            "alone_state": self._alone.state.copy(),
            "alone_covariance": self._alone.covariance.copy(),
            "squares": self._level.memory(),
            "jump": self._level.memory_of_jump(),
            "f": np.zeros(0) if self._f is None else np.array(self._f, dtype=float),
            "trace": np.array(trace, dtype=float).reshape(-1, TRACE_WIDTH),
            "taken_back": np.array([astuple(one) for one in (self._taken_back,) if one], dtype=float).reshape(-1, 2),
        }
        arrays |= {f"bank_{name}": values for name, values in self._bank.memory().items()}
        arrays |= self._axes.memory() | self._beyond.memory()
        return WatchMemory(
            arrays,
            start_s=self._start_s,
            last_s=self._last_s,
            onset_s=self._onset_s if np.isfinite(self._onset_s) else None,
            depth_km=self._depth_km,
            deeper_km=self._deeper_km,
            ref_c=self._ref_c,
            warmer_c=self._warmer_c,
            alarm_s=self._alarm_s,
            at_rest=self._at_rest,
            stills=self._counts["stills"],
            turns=self._counts["turns"],
            left_out=dict(self._left_out),
        )

    def recall(self, memory: WatchMemory) -> None:
        """Go on from a memory under the same record. Raises ValueError or KeyError for one that is none."""
        arrays = memory.arrays
        checked(memory)
        if memory.start_s is not None and memory.start_s > memory.last_s:
            raise ValueError("it ends before it begins")
        self._bank.recall(
            {name.removeprefix("bank_"): values for name, values in arrays.items() if name.startswith("bank_")}
        )
        self._filter.state, self._filter.covariance = arrays["state"].copy(), arrays["covariance"].copy()
        self._alone.state, self._alone.covariance = arrays["alone_state"].copy(), arrays["alone_covariance"].copy()
        self._level.recall(arrays["squares"], arrays.get("jump"))
        # a memory of before the noise of axes was followed has none
        if "noise_rests" in arrays:
            self._axes.recall(arrays["noise_rests"], arrays["noise_changed"])
        self._f = arrays["f"].copy() if arrays["f"].size else None
        self._beyond = Beyond.recall(arrays)
        self._taken_back = next((TakenBack(*row) for row in arrays.get("taken_back", np.zeros((0, 2))).tolist()), None)
        self._trace.clear()
        split = np.cumsum([1, CALIBRATION, CALIBRATION, 1])
        for row in arrays["trace"]:
            t, value, std, inclination, evidence = np.split(row, split)
            self._trace.append((float(t[0]), value, std, float(inclination[0]), float(evidence[0])))
        self._filter.walked = arrays["walked"].copy()
        self._start_s, self._last_s = memory.start_s, memory.last_s
        self._depth_km, self._deeper_km = memory.depth_km, memory.deeper_km
        self._onset_s = -np.inf if memory.onset_s is None else memory.onset_s
        self._ref_c, self._warmer_c = memory.ref_c, memory.warmer_c
        self._alarm_s, self._at_rest = memory.alarm_s, memory.at_rest
        self._counts = {"stills": memory.stills, "turns": memory.turns}
        self._left_out = dict(memory.left_out)
        self._hold = None
        for one, times in rests_of(arrays["held"]) if "held" in arrays else ():
            self._measure(one, times)

    @property
    def _noise(self) -> StatedNoise:
        return self._prior.noise

    def _measure(self, one: Still | Turning, times: Array | None = None, *, waits: bool = True) -> None:
        """One measurement, with what its rows say of its noise (`linear_still`); `waits`: where it is so far off that
        noise may have grown, the next ones are waited for."""
        t_s, level = one.t_s, self._level.level
        if self._start_s is None:
            self._start_s = self._last_s = t_s
        hours = max(t_s - self._last_s, 0.0) / HOUR_S
        self._last_s = max(t_s, self._last_s)
        for part in (self._filter, self._alone, self._bank):
            part.wait(hours)
        if t_s > self._onset_s:
            self._bank.begin(t_s)
            self._onset_s = t_s
        around = self._surroundings(t_s, one.temp_c, one.depth_km)
        if isinstance(one, Still):
            linear = linear_still(one, around, self._noise, level, times)
        else:
            linear = linear_turning(one, around, self._noise, level)
        y, H, self._f, self._at_rest, share = linear
        if waits and self._hold is None and self._alarm_s is None and self._is_odd(y, H):
            self._hold = Hold(self._now(), level)
            self._bank.mark()
        update = self._filter.take(y, H)
        self._alone.take(y, H)
        self._bank.take(update)
        if self._alarm_s is None:
            self._level.take(update, share, level)
        evidence = self._bank.largest()
        inclination = float(np.degrees(np.arctan2(np.hypot(self._f[0], self._f[1]), self._f[2])))
        state, covariance = self._believed()
        std = np.sqrt(np.diag(self._widened(covariance))[:CALIBRATION])
        self._trace.append((t_s, state[:CALIBRATION].copy(), std, inclination, evidence))
        if self._alarm_s is None:
            self._judge(one, times, update.innovations, evidence)
        elif self._bank.speaks_against():
            self._taken_back, self._alarm_s = TakenBack(self._alarm_s, t_s), None

    def _is_odd(self, y: Array, H: Array) -> bool:
        """Whether a measurement is far from what is expected of it."""
        left = self._filter.innovations(y, H)
        return noise_evidence(float(left @ left), left.size) > self._policy.jump

    def _judge(self, one: Still | Turning, times: Array | None, innovations: Array, evidence: float) -> None:
        """Whether something departs: at once, or where noise may have grown as soon as that can be told."""
        over, hold = evidence > self._threshold(), self._hold
        if hold is not None:
            hold.add(one, innovations, times)
            found = hold.judged(self._bank.explained(), self._policy, over=over)
            if found != "undecided":
                self._hold = None
            if found == "noise":
                self.recall(self._before(hold))
                self._level.jumped(hold.scale)
                for taken, by_rows in hold.taken:
                    self._measure(taken, by_rows, waits=False)
            over = found == "departure"
        if over:
            self._alarm_s = one.t_s

    def _surroundings(self, t_s: float, temp_c: float | None, depth_km: float | None) -> Surroundings:
        if temp_c is not None and self._ref_c is None:
            self._ref_c = temp_c
        warmer = self._warmer_c = 0.0 if temp_c is None or self._ref_c is None else temp_c - self._ref_c
        assert self._start_s is not None
        if depth_km is None:
            if self._depth_km is None:
                return Surroundings(warmer, (t_s - self._start_s) / HOUR_S, 0.0)
            # as deep as at last
            return Surroundings(warmer, self._deeper_km, self._deeper_km * self._noise.gravity_per_km)
        if self._depth_km is None:
            # per km from here on, not per hour
            self._depth_km = depth_km
            for one in (self._filter, self._alone):
                one.covariance[GROWTH, GROWTH] = self._noise.gravity_per_km_std**2
        self._deeper_km = depth_km - self._depth_km
        return Surroundings(warmer, self._deeper_km, self._deeper_km * self._noise.gravity_per_km)

    def _threshold(self) -> float:
        """Of the evidence: grown with the noise beyond what measurements were weighted with, of some hours or, where
        that is more, of the last few: noise that grows within hours would else be read as a departure. By what is more
        than chance alone, which would else hold back every departure in half of all wells."""
        of_hours, of_last = (self._level.surely_expected_ratio(over) for over in (None, self._policy.scale_from))
        return self._policy.threshold * max(1.0, of_hours, of_last) ** 2

    def _grown(self) -> float:
        """How much wider thresholds and standard deviations stand than the filter has them: noise may have grown, and
        never shrinks them: the a-posteriori factor of unit weight (Birge, Phys. Rev. 40, 207, 1932)."""
        return max(1.0, self._level.expected_ratio())

    def _widened(self, covariance: Array) -> Array:
        """A covariance (N, N) as it is stated, correlations kept: grown by what innovations scatter, or, where that is
        more, by a random walk larger than stated, which they hardly show. Not by both: what is seen is all there is."""
        own = np.diag(covariance)
        # a tool that is noisier than its class may walk more, too; as much more as it is noisier would be too wide
        allowed = self._policy.walk * np.sqrt(max(1.0, self._level.stated_ratio()))
        walked = (allowed**2 - 1.0) * np.diag(self._filter.walked)
        factor = np.sqrt(np.maximum(self._grown() ** 2, 1.0 + walked / np.maximum(own, 1e-300)))
        return np.asarray(covariance * np.outer(factor, factor))

    def result(self, now_s: float | None = None) -> WatchResult:
        """What is said at a time of the watch; None: right after the last measurement. Before the first measurement:
        learning, of nothing."""
        inc, tf = self._attitude()
        sight = sight_of(inc, tf, self._alone.covariance, self._prior, self._grown())
        claims = self._claims(inc, tf)
        measured_s = None if self._start_s is None else self._last_s
        age_s = 0.0 if now_s is None or measured_s is None else max(now_s - measured_s, 0.0)
        stale, dead = age_s > self._policy.stale_s, any(one.error is None for one in claims)
        misfit_g = None if claims else self._beyond.last_g(measured_s)
        holds = not stale and misfit_g is None and self._holds(sight.unseen)
        verdict: Verdict = "departs" if claims else "holds" if holds else "learning"
        deviations, undecided = self._deviations(), 0 if claims else self._undecided()
        ratio = self._level.stated_ratio()
        return WatchResult(
            verdict=verdict,
            claims=claims,
            parameters=deviations,
            not_observable=not_observable(deviations, self._counts["turns"]),
            advice=(
                *state_advice(None if dead or not stale else age_s, misfit_g, undecided),
                *advice(verdict, claims, sight, inc, self._policy),
                *taken_back_advice(self._taken_back),
                *noise_advice(self._axes.changes()),
            ),
            cal_id=self._cal_id,
            inclination_deg=None if inc is None else float(np.degrees(inc)),
            toolface_deg=None if tf is None else float(np.degrees(tf) % 360.0),
            measured_s=measured_s,
            age_s=age_s,
            stale=stale,
            still_unseen=sight.unseen,
            never_seen=sight.never,
            stated=sight.stated,
            taken_back=self._taken_back,
            noise_grown=ratio > self._policy.grown,
            noise_ratio=ratio,
            undecided=undecided,
            noise_changes=self._axes.changes(),
            threshold=self._threshold(),
            duration_s=0.0 if self._start_s is None else self._last_s - self._start_s,
            counts=Counts(self._counts["stills"], self._counts["turns"], dict(self._left_out)),
            covariance=self._widened(self._believed()[1])[:CALIBRATION, :CALIBRATION],
            departure=self._departure(),
            trace=Trace.of(self._trace),
        )

    def _claims(self, inc: float | None, tf: float | None) -> tuple[WatchClaim, ...]:
        claims: tuple[WatchClaim, ...]
        claims = () if self._alarm_s is None or inc is None else (self._departs(inc, tf, self._alarm_s),)
        if len(self._beyond.lengths) >= self._policy.fewest_beyond:
            dead = broken(self._beyond, self._policy)
            # a dead axis in an attitude where it hardly shows is no small departure beside that
            before = dead.since_s - self._policy.recent_s
            claims = (dead, *(one for one in claims if one.alarm_s < before))
        return claims

    def _attitude(self) -> tuple[float | None, float | None]:
        """Present inclination, and the toolface where the tool lies still, rad."""
        if self._f is None:
            return None, None
        x, y, z = (float(value) for value in self._f)
        return float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x)) if self._at_rest else None

    def _undecided(self) -> int:
        """How many measurements are waited with that noise or a departure has made."""
        hold = self._hold
        return 0 if hold is None or self._bank.largest() < self._threshold() else len(hold.taken)

    def _holds(self, unseen: AttitudeError | None) -> bool:
        most = self._policy.still_unseen_deg
        return not self._undecided() and unseen is not None and max(unseen.inc_deg, unseen.tf_sin_inc_deg) < most

    def _believed(self) -> tuple[Array, Array]:
        """State and covariance: the filter's, and once something departs those with all that may have departed."""
        state, covariance = self._filter.state, self._filter.covariance
        mixture = None if self._alarm_s is None else self._bank.mixture()
        return (state, covariance) if mixture is None else mixture.corrected(state, covariance)

    def _likeliest(self) -> Scored | None:
        """Of what departs; None where nothing does, or no hypothesis of a reasonable size explains it any more."""
        scored = [] if self._alarm_s is None else self._bank.best()
        return scored[0] if scored else None

    def _deviations(self) -> dict[str, Deviation]:
        before = np.diag(self._prior.covariance)
        state, covariance = self._believed()
        after, stated = np.diag(covariance), np.sqrt(np.diag(self._widened(covariance)))
        return {
            name: Deviation(
                value=float(state[k]),
                std=float(stated[k]),
                unit=UNITS[name],
                stated_std=float(np.sqrt(before[k])),
                observable=bool(after[k] < self._policy.seen * before[k]),
            )
            for k, name in enumerate(NAMES)
        }

    def _departs(self, inc: float, tf: float | None, alarm_s: float) -> WatchClaim:
        scored, mixture = self._bank.best(), self._bank.mixture()
        if not scored or mixture is None:
            # what was a departure of a small parameter needs more by now than any may have
            least = self._policy.largest
            return unexplained("deviation", Size(least, 0.0, least, least, "g"), ("no small error",), alarm_s, alarm_s)
        near = [one for one in scored if one.ratio >= scored[0].ratio - self._policy.same_class]
        onsets = self._bank.onsets_of(near[0], self._policy.same_class)
        # what began after the alarm did not raise it; what was just taken for noise may be part of what departs
        second = onsets[0] > alarm_s or near[0].leaves_more(self._policy) or self._level.jumps
        error = error_of(self._deviation_of(near[0]), inc, tf)
        return departed(near, sizes_of(near, mixture, self._grown()), onsets, alarm_s, error, second=second)

    def _deviation_of(self, scored: Scored) -> Array:
        """(N,) what the hypothesis says of the state now."""
        grown = (self._last_s - scored.since_s) / HOUR_S if scored.hypothesis.drifts else 1.0
        deviation = np.array(scored.hypothesis.direction) * scored.size * grown
        # a coefficient of temperature is an offset at the present one
        deviation[B : B + 3] += deviation[KT : KT + 3] * self._warmer_c
        return deviation

    def _departure(self) -> Array:
        """(12,) of the calibration's parameters, by the likeliest departure."""
        likeliest = self._likeliest()
        return np.zeros(CALIBRATION) if likeliest is None else self._deviation_of(likeliest)[:CALIBRATION]
