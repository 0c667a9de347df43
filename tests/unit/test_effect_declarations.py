"""Effects declare what they are: nothing is read from the spelling of a parameter, and nothing lists effects by id."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import highside.diagnosis
from highside.arrays import AnyArray
from highside.diagnosis.core.candidates import Candidate, pose_candidates
from highside.diagnosis.core.result import Verdict
from highside.diagnosis.engine import diagnose_poses, diagnose_rotation
from highside.diagnosis.poses.session import pose_session
from highside.diagnosis.rows.design import ChainDesign, Line
from highside.diagnosis.rows.session import RotationSession
from highside.errors import InputError
from highside.physics import effects
from highside.physics.effect import Effect, Parameter, Stage, across, pairs, runs, singles
from highside.physics.forward import ForwardModel
from highside.physics.outside_effects import check, tried_out, wave_of
from highside.physics.places import PLACES
from highside.physics.state import ChainState

FURTHER = pytest.mark.further

LIBRARY = list(effects.registry().values())
by_id = pytest.mark.parametrize("effect", LIBRARY, ids=lambda effect: effect.id)


def poses() -> ChainState:
    """Inclinations from both sides while the temperature goes up and down."""
    inc, tf = np.meshgrid(np.radians([5.0, 30, 60, 90, 120]), np.radians(np.arange(0, 360, 30)), indexing="ij")
    n = 2 * inc.size
    k = np.arange(n)
    return ChainState.build(
        np.tile(inc.ravel(), 2),
        np.tile(tf.ravel(), 2),
        t_s=25.0 * k,
        direction=np.where(k < n / 2, 1.0, -1.0),
        temp_c=25 + 20 * np.sin(np.pi * k / n),
        vibration_rms_g=0.1 + 0.001 * k,
        latitude_rad=0.7,
    )


def turning(n: int = 3000) -> RotationSession:
    t = np.arange(n) / 25.0
    rate = 3.0 * np.sign(np.sin(2 * np.pi * t / 60)) * (1 + 0.3 * np.sin(t / 9))
    state = ChainState.build(
        np.full(n, 1.1),
        np.cumsum(rate) / 25.0,
        t_s=t,
        direction=np.sign(rate),
        temp_c=25 + 10 * np.sin(t / 40),
        rotor_rate_radps=rate,
        rotor_accel_radps2=np.gradient(rate, t),
        vibration_rms_g=0.1 + 0.05 * np.sin(t / 11),
        latitude_rad=0.7,
        row_seconds=0.04,
    )
    accel = ForwardModel.of({}).predict(state) + 1e-4 * np.random.default_rng(1).standard_normal((3, n))
    gyro = ForwardModel.of({}).gyro(state) + 1e-3 * np.random.default_rng(2).standard_normal((3, n))
    return RotationSession(np.concatenate([accel, gyro]), state)


class Respelt:
    """The library with other names for every parameter: q0, q1, ..."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._known = {effect.id: effect for effect in LIBRARY}
        monkeypatch.setattr(effects, "registry", lambda: self._known)

    def respell(self) -> None:
        def respelt(effect: Effect) -> Effect:
            names = tuple(replace(p, name=f"q{k}") for k, p in enumerate(effect.parameters))
            kind = type(effect)
            made = type(kind.__name__, (kind,), {"parameters": names})()
            assert isinstance(made, Effect)
            return made

        self._known = {effect.id: respelt(effect) for effect in LIBRARY}


def described(candidates: list[Candidate]) -> Iterator[tuple[str, list[tuple[list[float], bool, np.ndarray]]]]:
    for candidate in candidates:
        yield candidate.id, [(list(v.shape.values()), v.whole, np.asarray(v.columns)) for v in candidate.variants]


def same(one: list[Candidate], other: list[Candidate]) -> None:
    for (own, variants), (again, respelt) in zip(described(one), described(other), strict=True):
        assert own == again
        assert len(variants) == len(respelt), own
        for a, b in zip(variants, respelt, strict=True):
            assert a[:2] == b[:2], own
            np.testing.assert_array_equal(a[2], b[2])


def test_the_variants_of_poses_do_not_hang_on_how_parameters_are_spelt(monkeypatch: pytest.MonkeyPatch) -> None:
    library, state = Respelt(monkeypatch), poses()
    before, blind = pose_candidates(ForwardModel.of({}), state, ("bias",))
    library.respell()
    after, blind_after = pose_candidates(ForwardModel.of({}), state, ("bias",))
    same(before, after)
    assert [b.effect.id for b in blind] == [b.effect.id for b in blind_after]


def test_the_variants_of_a_rotation_do_not_hang_on_how_parameters_are_spelt(monkeypatch: pytest.MonkeyPatch) -> None:
    library, session = Respelt(monkeypatch), turning()
    lines = [Line("tone", 3.3, 100), Line("aliased_vibration", 7.3, 100)]
    before = ChainDesign(session, ForwardModel.of({}), ("bias",), lines)
    library.respell()
    after = ChainDesign(session, ForwardModel.of({}), ("bias",), lines)
    same(before.candidates, after.candidates)
    for one, other in zip(before.functions(slice(100, 300)), after.functions(slice(100, 300)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_no_module_of_diagnosis_holds_the_id_of_an_effect() -> None:
    """An id as a literal is the beginning of a list of ids. A detector that speaks of one effect imports it."""
    # verdicts and places of laws are words of their own, which some effects are called by too
    ids = set(effects.registry()) - set(get_args(Verdict)) - set(PLACES)
    found = [
        f"{path.name}:{node.lineno}: {node.value}"
        for path in sorted(Path(highside.diagnosis.__path__[0]).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in ids
    ]
    assert found == []


@by_id
def test_the_declarations_of_the_library_stand(effect: Effect) -> None:
    assert check(effect, effect.id, "here") is effect
    tried_out(effect, "here")
    if effect.line is not None:
        assert len(wave_of(effect)) == len(effect.amplitudes)


@by_id
def test_what_is_slow_follows_time_or_temperature_alone(effect: Effect) -> None:
    """Declared, and true: the attitude, the rate and the load change nothing of what it adds."""
    if not effect.slow:
        return
    state = poses()
    other = replace(state, inc_rad=state.inc_rad[::-1], tf_rad=-state.tf_rad, rotor_rate_radps=state.t_s * 0.01)
    p = np.array([q.default or q.typical for q in effect.parameters])
    load = np.random.default_rng(0).standard_normal((3, state.n))
    np.testing.assert_array_equal(effect.delta(state, p, load), effect.delta(other, p, 0 * load))


@by_id
def test_nothing_of_an_onset_shows_before_it(effect: Effect) -> None:
    onsets = [k for k, p in enumerate(effect.parameters) if p.epoch]
    state = poses()
    for k in onsets:
        p = np.array([q.default or q.typical for q in effect.parameters])
        p[k] = 0.4 * np.ptp(state.t_s)
        added = effect.delta(state, p, np.zeros((3, state.n)))
        before = state.t_s - state.t_s[0] < p[k]
        assert np.all(added[:, before] == 0) and np.any(added[:, ~before] != 0)


@by_id
def test_counted_from_earlier_an_effect_does_the_same(effect: Effect) -> None:
    """`restarted` says how parameters read on a clock that began earlier: what it adds must not change."""
    if effect.random or not effect.follows_time_alone or effect.remembers:
        return
    state = poses()
    p = np.array([q.default or q.typical for q in effect.parameters])
    p = np.where([q.epoch for q in effect.parameters], 500.0, p)
    factor, more = effect.restarted(p, 250.0)
    if np.all(factor == 1) and not np.any(more):
        # a drift or a hum only gains an offset or a phase
        return
    earlier = replace(state, t_s=np.concatenate([[state.t_s[0] - 250.0], state.t_s[1:]]))
    was, now = (effect.delta(s, q, np.zeros((3, s.n))) for s, q in ((state, p), (earlier, factor * p + more)))
    np.testing.assert_allclose(now[:, 1:], was[:, 1:], rtol=1e-12)


def test_groups_are_written_by_how_amplitudes_stand() -> None:
    assert singles(3) == ((0,), (1,), (2,))
    assert runs(6, 2) == ((0, 1), (2, 3), (4, 5))
    assert across(6, 3) == ((0, 3), (1, 4), (2, 5))
    assert pairs(runs(6, 2)) == ((0, 1, 2, 3), (0, 1, 4, 5), (2, 3, 4, 5))
    assert effects.get("tone").parts == ((0, 1, 2, 3, 4, 5), (0, 3), (1, 4), (2, 5))


class Kick(Effect):
    """A jump that dies away: two shapes, when and how fast."""

    id = "kick"
    title = "Kick"
    stage = Stage.THERMAL
    formula = "a_i exp(-(t - t1) / decay) for t >= t1, else 0"
    story = "The offset jumps once, after a blow or a switch, and creeps back to where it was before."
    parameters = (
        *(Parameter(f"kick_{axis}", "g", 5e-4, (-0.05, 0.05)) for axis in "xyz"),
        Parameter("t1", "s", 300.0, (0.0, 1e9), shape=True, epoch=True),
        Parameter("decay", "s", 300.0, (10.0, 1e4), default=300.0, shape=True, grid=(100.0, 300.0, 900.0)),
    )
    groups = singles(3)
    slow = True
    needs = ("t_s",)
    depends_on_input = False

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        since = state.t_s - state.t_s[:1] - p[3].real
        return p[:3, None] * np.where(since >= 0, np.exp(-np.maximum(since, 0) / p[4]), 0.0)


class Ripple(Effect):
    """Two shapes, neither of time: a harmonic of the toolface that grows with some power of the inclination."""

    id = "ripple"
    title = "Ripple"
    stage = Stage.POSE
    formula = "dT = c |sin I|^power cos kT + s |sin I|^power sin kT"
    story = "An error of the toolface that repeats k times a turn, and depends on how far the tool leans over."
    parameters = (
        Parameter("c", "rad", 3e-4, (-0.02, 0.02)),
        Parameter("s", "rad", 3e-4, (-0.02, 0.02)),
        Parameter("k", "1", 3.0, (1.0, 50.0), default=3.0, shape=True, integer=True, grid=(2.0, 3.0, 4.0)),
        Parameter("power", "1", 3.0, (0.5, 6.0), default=3.0, shape=True, grid=(1.0, 2.0, 3.0, 4.0)),
    )
    depends_on_input = False

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        swing = np.abs(np.sin(state.inc_rad)) ** p[3]
        added = swing * (p[0] * np.cos(p[2] * state.tf_rad) + p[1] * np.sin(p[2] * state.tf_rad))
        return np.stack([0 * added, 0 * added, added])


def with_library(monkeypatch: pytest.MonkeyPatch, effect: Effect) -> None:
    check(effect, effect.id, "here")
    tried_out(effect, "here")
    known = {**{e.id: e for e in LIBRARY}, effect.id: effect}
    monkeypatch.setattr(effects, "registry", lambda: known)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (Kick(), {"kick_z": 9e-4, "t1": 1010.0, "decay": 500.0}),
        (Ripple(), {"c": 8e-4, "s": -5e-4, "k": 3.0, "power": 3.0}),
    ],
    ids=lambda found: found.id if isinstance(found, Effect) else "",
)
def test_an_effect_with_two_shapes_is_found_in_poses_with_both(
    monkeypatch: pytest.MonkeyPatch, effect: Effect, values: dict[str, float]
) -> None:
    with_library(monkeypatch, effect)
    state = poses()
    truth = ForwardModel.of({"bias": {"b_x": 1e-3}, effect.id: values})
    rng = np.random.default_rng(4)
    accel = truth.predict(state)[:, :, None] + 3e-5 * rng.standard_normal((3, state.n, 5))
    columns = {
        "t_s": (state.t_s[:, None] + np.arange(5.0)).ravel(),
        "inc_ref_deg": np.repeat(np.degrees(state.inc_rad), 5),
        "tf_ref_deg": np.repeat(np.degrees(state.tf_rad), 5),
        "direction": np.repeat(state.direction, 5),
        "temp_c": np.repeat(state.temp_c, 5),
        "pose": np.repeat(np.arange(float(state.n)), 5),
    }
    session = pose_session(columns, accel.reshape(3, -1), gravity_mps2=9.80665)
    diagnosis, _ = diagnose_poses(session, ForwardModel.of({}), ("bias",), seed=2)
    assert [claim.effect for claim in diagnosis.claims] == [effect.id]
    found = diagnosis.claims[0].parameters
    for name, value in values.items():
        near = 0.4 * abs(value) if effect.parameters[[p.name for p in effect.parameters].index(name)].shape else 0.0
        assert found[name].value == pytest.approx(value, abs=max(near, 4 * found[name].std)), name


@FURTHER
@pytest.mark.slow
def test_an_effect_with_two_shapes_is_found_in_a_rotation(monkeypatch: pytest.MonkeyPatch) -> None:
    with_library(monkeypatch, Kick())
    session = turning(1500)
    truth = ForwardModel.of({"kick": {"kick_y": 2e-3, "t1": 20.0, "decay": 100.0}})
    readings = session.readings.copy()
    readings[:3] += truth.predict(session.state) - ForwardModel.of({}).predict(session.state)
    diagnosis, _ = diagnose_rotation(replace(session, readings=readings), ForwardModel.of({}), ("bias",), seed=2)
    assert diagnosis.claims and diagnosis.claims[0].effect == "kick"


def test_shapes_that_are_too_many_are_refused() -> None:
    class Wild(Kick):
        parameters = (*Kick.parameters[:4], replace(Kick.parameters[4], grid=tuple(np.linspace(20.0, 900.0, 40))))

    with pytest.raises(InputError, match=f"{60 * 40} combinations, and 1000 can be tried"):
        check(Wild(), "kick", "wild.py")


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        ({"gate": (1.0, -1.0)}, "which holds nothing"),
        ({"default": 1e-4}, "default must be 0"),
        ({"typical": 1.0}, "typical size"),
        ({"grid": (1e-4,)}, "add shape=True"),
        ({"shape": True}, "say what is to be tried"),
        ({"shape": True, "time_constant": True, "epoch": True}, "give the grid to begin with"),
        ({"shape": True, "grid": (1.0,)}, "leaves its gate"),
        ({"name": "kick_y"}, "the same name"),
    ],
)
def test_a_parameter_that_contradicts_itself_is_refused(changed: dict[str, object], what: str) -> None:
    class Wrong(Kick):
        parameters = (replace(Kick.parameters[0], **changed), *Kick.parameters[1:])  # type: ignore[arg-type]

    with pytest.raises(InputError, match=what):
        check(Wrong(), "kick", "wrong.py")


@pytest.mark.parametrize(
    ("attributes", "what"),
    [
        ({"groups": ((0, 3),)}, "there are 3, numbered from 0"),
        ({"groups": ((0, 0),)}, "there are 3"),
        ({"needs": ("moon_phase",)}, "needs moon_phase, which no recording has"),
        ({"confused_with": ("bias",)}, "no splitter"),
        ({"title": None}, "lacks title"),
        ({"stage": "thermal"}, "lacks stage"),
        ({"parameters": [Kick.parameters[0]]}, "a tuple of Parameter"),
        ({"parameters": Kick.parameters[3:]}, "all are shapes"),
        ({"id": "Kick it"}, "one name"),
        ({"parameters": (*Kick.parameters[:4], replace(Kick.parameters[4], epoch=False, grid=(), line_over="time"))},
         "a line has one shape"),
    ],
)  # fmt: skip
def test_an_effect_that_contradicts_itself_is_refused(attributes: dict[str, object], what: str) -> None:
    wrong = type("Wrong", (Kick,), attributes)()
    with pytest.raises(InputError, match=what):
        check(wrong, "kick", "wrong.py")


def test_what_cannot_be_computed_is_refused() -> None:
    class Raises(Kick):
        def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
            raise KeyError("t9")

    class Flat(Kick):
        def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
            return p[:3]

    class Always(Kick):
        def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
            return super().delta(state, p, x) + 1e-3

    class Real(Kick):
        def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
            return np.abs(super().delta(state, p, x))

    for wrong, what in (
        (Raises(), "KeyError"), (Flat(), r"\(3, N\) is needed"), (Always(), "while all that gives it size is 0"),
        (Real(), "write delta for complex numbers"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=what):
            tried_out(wrong, "wrong.py")
