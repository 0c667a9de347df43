"""A session of full turns fits the bench's own encoder; later calibrations on that bench are the better for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rehearsal import Rehearsal

from highside.bench.session import plans, turntable
from highside.bench.session.entries import Ended
from highside.bench.session.journal import encode_all, read_journal
from highside.bench.session.plans import Limits, SessionPlan
from highside.bench.session.snapshot import SessionState
from highside.bench.session.view import View
from highside.bench.setup import header_of, turntable_path
from highside.bench.store import keep_turntable
from highside.config.bench import BenchFile
from highside.errors import InputError
from highside.rotation.compensation import Compensation

QUICK = Limits(std_error_g=3e-5, min_hold_s=1.0, max_hold_s=4.0)
ENCODER_DEG = ((0.04, -0.02), (0.015, 0.03), (0.0, 0.01))
TURNS = plans.turntable_plan((20.0, 50.0, 90.0), 16, QUICK)
# what a bench offers in the shipped example: four toolfaces
JOINT = plans.joint_plan(16, QUICK, inclinations_deg=(-45, 5, 45, 90, 120), toolfaces_deg=(45.0, 135.0, 225.0, 315.0))


def session(plan: SessionPlan, seed: int = 1) -> Rehearsal:
    """On a bench whose encoder errs by up to 0.07 deg."""
    bench = {"encoder_deg": ENCODER_DEG, "settle_s": 0.5, "turn_rate_dps": 120.0}
    done = Rehearsal(plan, seed=seed, rate_hz=20.0, gyros=False, bench_options=bench).run(look_s=0.4)
    assert done.state is SessionState.ACCEPTED
    return done


@pytest.fixture(scope="module")
def turned() -> Rehearsal:
    return session(TURNS)


def fitted(done: Rehearsal) -> Compensation:
    assert done.session.solved is not None and done.session.solved.turntable is not None
    return done.session.solved.turntable


def test_the_encoder_is_found(turned: Rehearsal) -> None:
    theta = np.arange(0.0, 360.0, 7.0)
    _, tf = turntable.correct_settings(fitted(turned), np.full(theta.size, 45.0), theta)
    angle = np.deg2rad(theta)
    truth = sum(c * np.cos(k * angle) + s * np.sin(k * angle) for k, (c, s) in enumerate(ENCODER_DEG, start=1))
    left = tf - theta - truth
    left -= left.mean()
    assert np.sqrt(np.mean(truth**2)) > 0.03
    assert np.sqrt(np.mean(left**2)) < 0.004, "a bench of settings to 0.0052 deg each"
    snapshot = View(turned.session).snapshot()
    assert snapshot.result is not None and snapshot.result.turntable_id == fitted(turned).id
    assert any("harmonics of encoder" in text for text in snapshot.result.remarks)
    # the same session calibrates the tool
    assert turned.session.record is not None and turned.within(2.0)


def test_the_journal_tells_the_same_fit(turned: Rehearsal) -> None:
    _, solved, record = turned.replayed()
    assert solved.turntable is not None and solved.turntable.to_json() == fitted(turned).to_json()
    assert record is not None and turned.session.record is not None and record.id == turned.session.record.id
    altered = [replace(e, turntable="0" * 64) if isinstance(e, Ended) else e for e in turned.entries]
    from highside.bench.session import outcome

    with pytest.raises(InputError, match="turntable"):
        outcome.replay(read_journal(encode_all(turned.header, [(entry, 1.0) for entry in altered])))


def test_toolface_is_better_calibrated_with_the_turntable(turned: Rehearsal) -> None:
    """Over sensors and settings at random: the joint calibration of that bench with its turntable and without."""
    known = turntable.at_true_settings(JOINT, fitted(turned))
    without, with_it, within = [], [], 0
    for seed in range(3):
        without.append(session(JOINT, seed).errors_deg())
        done = session(known, seed)
        with_it.append(done.errors_deg())
        within += done.within(2.0)
    worse, better = np.sqrt(np.mean(np.square(without), axis=0)), np.sqrt(np.mean(np.square(with_it), axis=0))
    print(f"T {worse[1]:.4f} -> {better[1]:.4f} deg, I {worse[0]:.4f} -> {better[0]:.4f} deg; {within} of 3 within")
    assert better[1] < 0.4 * worse[1]
    assert within == 3


def file(tmp_path: Path, kind: str, **bench: object) -> BenchFile:
    return BenchFile.model_validate(
        {
            "simulated": {},
            "plan": {"kind": kind} | ({"poses": 6} if kind == "joint" else {}),
            "bench": {"name": "bench 1"} | bench,
            "store": {"directory": tmp_path / "store", "sessions": tmp_path / "sessions"},
        }
    )


def test_later_sessions_on_that_bench_use_it_and_say_so(turned: Rehearsal, tmp_path: Path) -> None:
    settings = file(tmp_path, "joint")
    assert header_of(settings, "s", 1.0, None).environment.turntable is None
    keep_turntable(turntable_path(settings), fitted(turned))
    header = header_of(settings, "s", 1.0, None)
    assert header.environment.turntable == fitted(turned).id
    moved = [abs(pose.reference[1] - pose.tf_deg) for pose in header.plan.poses]
    assert 0.02 < max(moved) < 0.1
    assert SessionPlan.from_dict(header.plan.to_dict()) == header.plan
    # another bench, another file, or told not to
    for other in (
        file(tmp_path, "joint", name="bench 2"),
        file(tmp_path, "joint", use_turntable=False),
        file(tmp_path, "turntable"),
    ):
        assert header_of(other, "s", 1.0, None).environment.turntable is None
    keep_turntable(tmp_path / "own.json", fitted(turned))
    own = file(tmp_path, "joint", name=None, turntable=tmp_path / "own.json")
    assert header_of(own, "s", 1.0, None).environment.turntable == fitted(turned).id


def test_what_cannot_be_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="under the name of its bench"):
        header_of(file(tmp_path, "turntable", name=None), "s", 1.0, None)
    with pytest.raises(InputError, match="no such file"):
        header_of(file(tmp_path, "joint", turntable=tmp_path / "none.json"), "s", 1.0, None)
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(InputError, match="no compensation"):
        header_of(file(tmp_path, "joint", turntable=tmp_path / "broken.json"), "s", 1.0, None)
    for inclinations in ((30.0, 150.0, 1.0), (45.0, 45.0), (-45.0, 30.0)):
        with pytest.raises(InputError):
            plans.turntable_plan(inclinations)
    with pytest.raises(InputError):
        plans.turntable_plan(stations=7)
