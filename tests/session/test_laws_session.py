"""A session on the bench uses what a model knows: laws of the bench at the settings, laws of the sensor of records."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rehearsal import Rehearsal

from highside.bench.session import plans
from highside.bench.session.plans import Limits, SessionPlan
from highside.bench.session.snapshot import SessionState
from highside.bench.setup import by_model, header_of
from highside.config.bench import BenchFile
from highside.config.model import as_toml, parse_model
from highside.errors import InputError

QUICK = Limits(std_error_g=3e-5, min_hold_s=1.0, max_hold_s=4.0, soak_s=20.0)
PER_C = (2e-5, -1e-5, 3e-5)
ENCODER_DEG = ((0.04, -0.02),)
WARM = {
    "slug": "warm", "place": "offset", "channels": ["x", "y", "z"], "formula": "(temp - 25)",
    "coefficients": [[value] for value in PER_C],
    "axes": [{"covariate": "temp", "low": 15.0, "high": 80.0, "functions": [["linear", 25.0]]}],
}  # fmt: skip
DIAL = {
    "slug": "dial", "place": "toolface", "channels": ["tf"], "formula": "",
    "coefficients": [[float(np.radians(0.04)), float(np.radians(-0.02))]],
    "axes": [{"covariate": "tf", "low": 0.0, "high": 360.0, "functions": [["cos", 1], ["sin", 1]]}],
}  # fmt: skip


def model(folder: Path, *laws: object) -> Path:
    path = folder / "found.toml"
    path.write_text(as_toml(parse_model({"laws": list(laws)}, where="model")))
    return path


def test_an_oven_session_keeps_the_law_and_its_journal_makes_the_same_record(tmp_path: Path) -> None:
    oven = plans.soak_plan([25.0, 70.0, 25.0], (5.0, 45.0, 90.0), (45.0, 135.0, 225.0, 315.0), QUICK)
    plan = by_model(oven, model(tmp_path, WARM))
    assert SessionPlan.from_dict(plan.to_dict()) == plan
    assert "laws" not in oven.to_dict()
    bench = {"offset_per_c": PER_C, "oven_tau_s": 15.0}
    done = Rehearsal(plan, rate_hz=20.0, bench_options=bench).run(limit_s=20_000.0)
    assert done.state is SessionState.ACCEPTED
    record = done.session.record
    assert record is not None and [law.slug for law in record.laws] == ["warm"]
    # all that temperature does, the law does
    assert not [name for name in record.result.main.parameters.names if "@" in name]
    assert done.within(2.0), (done.errors_deg(), done.stated_deg())
    _, _, again = done.replayed()
    assert again is not None and again.id == record.id


def file(folder: Path, path: Path) -> BenchFile:
    return BenchFile.model_validate(
        {
            "simulated": {},
            "plan": {"kind": "joint", "poses": 12},
            "bench": {"name": "bench 1", "model": path},
            "store": {"directory": folder / "store", "sessions": folder / "sessions"},
        }
    )


def test_laws_of_the_bench_are_in_the_settings_of_the_plan(tmp_path: Path) -> None:
    header = header_of(file(tmp_path, model(tmp_path, DIAL)), "s", 1.0, None)
    assert (header.environment.turntable or "").startswith("model:") and not header.plan.laws
    tf = np.array([pose.tf_deg for pose in header.plan.poses])
    moved = np.array([pose.reference[1] for pose in header.plan.poses]) - tf
    angle = np.radians(tf)
    assert moved == pytest.approx(0.04 * np.cos(angle) - 0.02 * np.sin(angle), abs=1e-9)
    assert [pose.reference[0] for pose in header.plan.poses] == pytest.approx([p.inc_deg for p in header.plan.poses])


@pytest.mark.parametrize(
    ("law", "what"),
    [
        ({**WARM, "axes": [{**WARM["axes"][0], "covariate": "mud bar"}]}, "depends on mud bar"),
        ({**DIAL, "axes": [{**WARM["axes"][0], "functions": [["cos", 1], ["sin", 1]]}]}, "depends on temp_c"),
        (None, "no law"),
    ],
)
def test_what_a_session_cannot_know_is_refused_before_it_begins(tmp_path: Path, law: object, what: str) -> None:
    with pytest.raises(InputError, match=what):
        header_of(file(tmp_path, model(tmp_path, *([law] if law else []))), "s", 1.0, None)
