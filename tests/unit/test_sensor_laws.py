"""Laws in a calibration: found in one session, kept in a record, taken off what another reads, batch and live."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import highside
from highside.calibration.correction import Correction, IdentityCorrection
from highside.calibration.linear_correction import LinearCorrection
from highside.calibration.record import RecordError, RecordReason, content_id, correction_from_record, parse_record
from highside.calibration.remark import Reason
from highside.calibration.sensor_laws import (
    LawCorrection,
    SensorLaws,
    at_rest,
    knowing,
    size_of,
    without_laws,
)
from highside.cli.main import app
from highside.codec.frame import Counts, Frame
from highside.config.settings import MonitorSettings, PipelineSettings, RollingBiasTable, SurveySettings, ToolSettings
from highside.errors import InputError
from highside.physics.gravity import gravity_direction
from highside.physics.law import Law
from highside.service.outputs import AttitudeOutput, Survey
from highside.service.pipeline import Pipeline

NOISE_G = 2e-5
SENSOR = {
    "bias_g": [1.2e-3, -0.8e-3, 1.6e-3],
    "scale": [0.0031, -0.0042, 0.0018],
    "misalignment_deg": [0.12, -0.08, 0.15, 0.05, -0.17, 0.09],
    "noise_g": NOISE_G,
}
STEEP = {
    "slug": "steep", "place": "offset", "channels": ["x"], "formula": "tanh((temp - 38) / 5)",
    "coefficients": [[2e-3]],
    "axes": [{"covariate": "temp", "low": 15.0, "high": 65.0, "functions": [["saturation", 38.0, 5.0]]}],
}  # fmt: skip
"""no effect of the library, nor a polynomial of the third order, is like this"""
INCLINATIONS = ([20.0, 55.0, 90.0, 130.0], [45.0, 117.0, 189.0, 261.0, 333.0])


def session(inc: list[float], tf: list[float], temps: list[float], seed: int, *laws: Any) -> highside.Simulation:
    motion = {
        "kind": "poses", "inclinations_deg": inc, "toolfaces_deg": tf, "hold_s": 4.0, "row_s": 0.5, "move_s": 10.0,
        "temperatures_c": temps,
    }  # fmt: skip
    return highside.simulate({"sensor": SENSOR, "laws": list(laws), "motion": motion}, seed=seed)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model with the law, as a diagnosis wrote it."""
    seen = session([5, 30, 60, 90, 125], [45, 105, 165, 225, 285, 345], [18.0, 62.0, 20.0, 60.0], 1, STEEP)
    diagnosis = highside.diagnose(seen.recording, {"sensor": {"noise_g": NOISE_G}})
    assert [claim.place for claim in diagnosis.claims] == ["offset"]
    path = tmp_path_factory.mktemp("laws") / "found.toml"
    path.write_text(diagnosis.model_toml() if callable(diagnosis.model_toml) else diagnosis.model_toml)
    return path


@pytest.fixture(scope="module")
def calibrated(found: Path) -> highside.Calibration:
    return highside.calibrate(session(*INCLINATIONS, [20.0, 61.0], 2, STEEP).poses, tool="t", model=found)


@pytest.fixture(scope="module")
def other() -> highside.Simulation:
    """Another session: other poses, other temperatures in another order, other noise."""
    return session([12.0, 37.0, 72.0, 100.0], [20.0, 80.0, 140.0, 200.0, 260.0, 320.0], [59.0, 22.0, 50.0], 3, STEEP)


def errors(calibration: highside.Calibration, of: highside.Simulation) -> dict[str, float]:
    """Rms errors of I and T over the stops, deg, and the rms of both over what was stated."""
    rows = np.isfinite(of.recording["pose"])
    said, truth = calibration.correct(of.recording), of.rows_truth
    inc = (said["inc_deg"] - truth["inc_true_deg"])[rows]
    tf = (np.mod(said["tf_deg"] - truth["tf_true_deg"] + 180.0, 360.0) - 180.0)[rows]
    made = {"inc": inc, "tf": tf, "inc_z": inc / said["inc_std_deg"][rows], "tf_z": tf / said["tf_std_deg"][rows]}
    return {name: float(np.sqrt(np.mean(values**2))) for name, values in made.items()}


def test_another_session_falls_to_the_floor_with_the_law_in_the_record(
    calibrated: highside.Calibration, other: highside.Simulation
) -> None:
    bare = highside.calibrate(session(*INCLINATIONS, [20.0, 61.0], 2, STEEP).poses, tool="t")
    # the floor: the same poses and noise of a sensor that has no law, by a calibration that knows of none
    clean = highside.calibrate(session(*INCLINATIONS, [20.0, 61.0], 2).poses, tool="t")
    floor = errors(
        clean, session([12.0, 37.0, 72.0, 100.0], [20.0, 80.0, 140.0, 200.0, 260.0, 320.0], [59.0, 22.0, 50.0], 3)
    )
    without, with_law = errors(bare, other), errors(calibrated, other)
    print(f"without {without}, with {with_law}, floor {floor}")
    assert without["inc"] > 0.05 and without["tf"] > 0.2
    assert with_law["inc"] < 1.15 * floor["inc"] and with_law["tf"] < 1.15 * floor["tf"]
    # what is stated is what happens
    assert 0.5 < with_law["inc_z"] < 1.3 and 0.5 < with_law["tf_z"] < 1.3


class _Codec:
    """Hands over nothing: frames are given to the pipeline as they are."""

    name, seq_modulus = "list", 65536

    def __init__(self, extra_columns: tuple[str, ...] = ()) -> None:
        self.counts, self.extra_columns = Counts(), extra_columns


def live(correction: Correction, frames: list[Frame], *extra_columns: str) -> list[AttitudeOutput]:
    """The attitudes of frames, one of each: a window holds one reading."""
    out: list[AttitudeOutput | Survey] = []
    rate = 1.0 / (frames[1].t_s - frames[0].t_s)  # type: ignore[operator]
    pipeline = Pipeline(
        codec=_Codec(extra_columns),  # type: ignore[arg-type]
        tool=ToolSettings(noise_g=NOISE_G),
        pipeline=PipelineSettings(output_rate_hz=rate, averaging_s=0.5 / rate),
        monitor=MonitorSettings(),
        survey=SurveySettings(enabled=False),
        correction=correction,
        rolling_bias=RollingBiasTable(),
        emit=out.append,
    )
    for frame in frames:
        pipeline.on_frame(frame)
    return [one for one in out if isinstance(one, AttitudeOutput)]


def frames_of(a: np.ndarray, temp_c: np.ndarray | None, **more: Any) -> list[Frame]:
    return [
        Frame(k, 0.1 * k, 100.0 + 0.1 * k, *map(float, row), temp_c=None if temp_c is None else float(temp_c[k]),
              **{name: values[k] for name, values in more.items()})
        for k, row in enumerate(a.T)
    ]  # fmt: skip


def test_the_pipeline_says_of_each_reading_what_apply_says(
    calibrated: highside.Calibration, other: highside.Simulation
) -> None:
    rows = np.flatnonzero(np.isfinite(other.recording["pose"]))
    a = np.stack([other.recording[name][rows] for name in ("ax_g", "ay_g", "az_g")])
    # the first frame only opens the grid of outputs
    said = live(correction_from_record(calibrated.record), frames_of(a, other.recording["temp_c"][rows]))
    batch = calibrated.correct(other.recording, noise_g=NOISE_G)
    assert len(said) == rows.size - 1
    for name in ("inc_deg", "tf_deg", "inc_std_deg", "tf_std_deg"):
        mine = np.array([getattr(one, name) for one in said])
        assert np.max(np.abs(mine - batch[name][rows[1:]])) < 1e-9, name
    assert {flag for one in said for flag in one.flags if "law" in flag} == set()
    truth = other.rows_truth["inc_true_deg"][rows[1:]]
    assert np.sqrt(np.mean((np.array([one.inc_deg for one in said]) - truth) ** 2)) < 1.5e-3


def test_beyond_its_range_and_without_its_covariate_a_law_is_flagged_and_stated(
    calibrated: highside.Calibration,
) -> None:
    (law,) = calibrated.record.laws
    inside = 0.5 * (law.axes[0].low + law.axes[0].high)
    a = np.repeat(gravity_direction(np.array([0.9]), np.array([0.3])), 4, axis=1)
    temps = np.array([inside, inside, law.axes[0].high + 100.0, np.nan])
    columns = {"ax_g": a[0], "ay_g": a[1], "az_g": a[2]}
    done = calibrated.corrected({**columns, "temp_c": temps}, noise_g=NOISE_G)
    blind = calibrated.corrected(columns, noise_g=NOISE_G)
    size_deg = float(np.degrees(size_of(law)[0] * abs(np.cos(0.9) * np.cos(0.3))))
    std = done.data["inc_std_deg"]
    assert std[1] < 0.1 * size_deg < 0.9 * size_deg < std[3] < 1.2 * size_deg
    assert std[2] > 0.9 * size_deg
    assert (done.applied.law_outside, done.applied.law_not_applied) == (1, 1)
    assert (blind.applied.law_outside, blind.applied.law_not_applied) == (0, 4)
    correction = correction_from_record(calibrated.record)
    said = live(correction, frames_of(a[:, :3], temps[:3])) + live(correction, frames_of(a[:, :2], None))
    flags = [{flag for flag in one.flags if "law" in flag} for one in said]
    assert flags == [set(), {"law_outside_range"}, {"law_not_applied"}]
    assert said[1].inc_std_deg == pytest.approx(std[2], abs=1e-9)
    assert said[2].inc_std_deg == pytest.approx(std[3], abs=1e-9)


def test_a_record_with_laws_is_whole_or_refused(calibrated: highside.Calibration) -> None:
    text = calibrated.record.to_json()
    again = parse_record(text)
    assert again.laws == calibrated.record.laws and again.id == calibrated.id
    assert calibrated.recomputed() < 1e-9
    assert again.content["pose_table"]["ax"] != again.pose_columns["ax"]

    def reason(change: Any, *, hashed: bool) -> RecordReason:
        data = json.loads(text)
        change(data)
        if hashed:
            del data["id"]
            data["id"] = content_id(data)
        with pytest.raises(RecordError) as refused:
            parse_record(json.dumps(data))
        return refused.value.reason

    def stronger(data: dict[str, Any]) -> None:
        data["laws"][0]["coefficients"][0][0] += 1e-6

    assert reason(stronger, hashed=False) is RecordReason.TAMPERED
    assert reason(lambda d: d.update(schema="highside.calibration/1"), hashed=True) is RecordReason.MALFORMED
    assert reason(lambda d: d.pop("laws"), hashed=True) is RecordReason.MALFORMED
    assert reason(lambda d: d["laws"][0].update(place="inclination", channels=["inc"]), hashed=True) is (
        RecordReason.MALFORMED
    )


LOADED = (
    {
        "slug": "loaded", "place": "scale", "channels": ["x", "z"], "formula": "",
        "coefficients": [[4e-3, 1e-3], [-2e-3, 3e-3]], "covariance": (1e-10 * np.eye(4)).tolist(),
        "axes": [{"covariate": "load", "low": -1.0, "high": 1.0, "functions": [["linear", 0.0], ["cosine", 1]]}],
    },
    {
        "slug": "crossed", "place": "matrix", "channels": ["xy"], "formula": "", "coefficients": [[2e-3]],
        "axes": [{"covariate": "rate", "low": -90.0, "high": 90.0, "functions": [["saturation", 0.0, 30.0]]}],
    },
    {
        "slug": "pressed", "place": "scale_all", "channels": ["xyz"], "formula": "", "coefficients": [[1e-5]],
        "axes": [{"covariate": "mud bar", "low": 0.0, "high": 300.0, "functions": [["linear", 100.0]]}],
    },
)  # fmt: skip


def test_laws_of_load_rate_and_a_further_column_are_inverted_live_as_in_batch() -> None:
    laws = SensorLaws(tuple(Law.from_dict(plain) for plain in LOADED))
    clean = highside.calibrate(session(*INCLINATIONS, [25.0, 25.0], 2).poses, tool="t")
    bare = correction_from_record(clean.record)
    assert isinstance(bare, LinearCorrection)
    rng = np.random.default_rng(3)
    inc, tf = rng.uniform(0.2, 2.9, 40), rng.uniform(0.0, 6.2, 40)
    g, rate, bar = gravity_direction(inc, tf), rng.uniform(-80, 80, 40), rng.uniform(0, 300, 40)
    given = {"rotor_rate_dps": rate, "mud bar": bar}
    k = bare.coefficients(25.0)
    inverse = np.linalg.inv(np.array(k.c).reshape(3, 3))
    raw = inverse @ (g + np.array(k.o)[:, None]) + laws.at(g, given).value
    correction = LawCorrection(bare, laws)
    done = correction.knowing(given).corrected_block(raw, NOISE_G, 25.0)
    assert np.max(np.abs(done.g - g)) < 2e-9
    assert done.law_unknown is not None and not done.law_unknown.any()
    # the band: of scale by sqrt(1e-10 (load^2 + cos^2)) times the load, in the frame of the sensor
    own = 1e-10 * g[0] ** 2 * (g[0] ** 2 + np.cos(np.pi * (g[0] + 1.0) / 2.0) ** 2)
    assert laws.at(g, given).cov[0] == pytest.approx(own, rel=1e-6)
    more = done.cov[0] - bare.corrected_block(raw - laws.at(g, given).value, NOISE_G, 25.0).cov[0]
    # the widening for few poses falls a little where something known is added
    assert np.all(more > 0.85 * own)
    frames = frames_of(raw, np.full(40, 25.0), rotor_rate_dps=rate.tolist(), extra=[(7.0, float(v)) for v in bar])
    said = live(correction, frames, "rpm", "mud bar")
    assert np.max(np.abs(np.array([one.accel for one in said]).T - done.g[:, 1:])) < 1e-12
    # a frame that carries neither
    lost = live(correction, frames_of(raw, np.full(40, 25.0)))
    assert all("law_not_applied" in one.flags for one in lost)


def test_poses_of_a_recording_keep_what_laws_depend_on() -> None:
    made = session(*INCLINATIONS, [20.0, 61.0], 2)
    pose = made.recording["pose"]
    columns = {**made.recording.columns, "mud bar": np.where(np.isfinite(pose), 10.0 * pose, np.nan)}
    # a gap of one pose leaves the column out: half a column would be refused later, without the reason
    gap = {**columns, "supply V": np.where(pose == 3.0, np.nan, 5.0)}
    found = highside.find_poses(gap)
    assert found["mud bar"] == pytest.approx(10.0 * found["pose"])
    assert "supply V" not in found


def test_what_no_single_reading_tells_is_never_taken_off_and_always_stated() -> None:
    plain = {**STEEP, "axes": [{**STEEP["axes"][0], "covariate": "time"}]}
    laws = SensorLaws((Law.from_dict(plain),))
    assert laws.columns == ()
    found = laws.at(np.array([[0.0], [0.0], [1.0]]), {"t_s": 40.0})
    assert found.unknown[0] and not found.value.any()
    assert found.cov[0, 0] == pytest.approx(size_of(laws.laws[0])[0] ** 2)
    columns = {"ax": [0.1, 0.2], "ay": [0.0, 0.1], "az": [1.0, 0.9]}
    assert without_laws(columns, laws.laws) == columns


def test_a_law_of_the_bench_is_taken_off_the_angles_and_stays_with_the_bench(tmp_path: Path) -> None:
    lean = {
        "slug": "dial", "place": "inclination", "channels": ["inc"], "formula": "", "coefficients": [[1.5e-3]],
        "axes": [{"covariate": "inc", "low": -50.0, "high": 130.0, "functions": [["bump", 70.0, 12.0]]}],
    }  # fmt: skip
    # also with the table turned the other way: from which side a pose was set is kept
    made = session([-40.0, 10.0, 40.0, 65.0, 75.0, 90.0, 120.0], [45.0, 135.0, 225.0, 315.0], [25.0, 25.0], 4, lean)
    aware = highside.calibrate(made.poses, tool="t", model={"laws": [lean]})
    bare = highside.calibrate(made.poses, tool="t")
    assert not aware.record.laws and aware.record.content["environment"]["turntable"].startswith("model:")
    sides = np.sign([pose["inc_ref_deg"] for pose in made.truth["poses"]])
    true = sides * np.array([pose["inc_true_deg"] for pose in made.truth["poses"]])
    found = np.array(aware.record.pose_columns["inc_ref_deg"], dtype=float)
    given = np.array(bare.record.pose_columns["inc_ref_deg"], dtype=float)
    assert np.max(np.abs(found - true)) < 1e-6 < 0.05 < np.max(np.abs(given - true))
    rest = [one.summary()["rms_residual_g"] for one in (aware, bare)]
    assert rest[0] < 2e-5 < 2e-4 < rest[1]
    doubts = [{remark.reason for remark in one.remarks} for one in (aware, bare)]
    assert Reason.BENCH_SCATTER in doubts[1] - doubts[0]


def test_without_laws_nothing_is_asked_of_a_frame(calibrated: highside.Calibration) -> None:
    class Silent:
        @property
        def rotor_rate_dps(self) -> float:
            raise AssertionError("asked")

        extra = rotor_rate_dps

    for correction in (IdentityCorrection(), correction_from_record(calibrated.record).inner):  # type: ignore[union-attr]
        assert knowing(correction, Silent(), ()) is correction  # type: ignore[arg-type]
    bare = correction_from_record(calibrated.record).inner  # type: ignore[union-attr]
    assert at_rest(bare) is bare


@pytest.mark.parametrize(
    ("model", "lacks", "field"),
    [
        ({"laws": [STEEP]}, "temp_c", "temp_c"),
        ({"laws": [LOADED[2]]}, "", "mud bar"),
        ({"laws": [STEEP], "tool": {"axes": "z-x-y"}}, "", "tool.axes"),
        ({}, "", "effects.included"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(model: Any, lacks: str, field: str) -> None:
    poses = session(*INCLINATIONS, [20.0, 61.0], 2, STEEP).poses
    assert poses is not None
    columns = {name: values for name, values in poses.columns.items() if name != lacks}
    with pytest.raises(InputError) as refused:
        highside.calibrate(columns, tool="t", model=model)
    assert refused.value.field == field and refused.value.remedy


OWN = """
import numpy as np
from highside.physics.effect import LinearEffect, Parameter, Stage


class Dial(LinearEffect):
    id = "own_dial"
    title = "Own dial"
    stage = Stage.POSE
    formula = "inc = inc + a sin(3 inc)"
    story = "The scale of the inclination was engraved with an error of the third order."
    parameters = (Parameter("a", "rad", 1e-3, (-0.1, 0.1)),)

    def basis(self, state, x):
        return np.stack([np.stack([np.sin(3 * state.inc_rad), 0 * state.inc_rad, 0 * state.inc_rad])])


EFFECT = Dial()
"""


def test_solve_takes_effects_of_a_folder_for_the_bench(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "own_dial.py").write_text(OWN)
    model, poses = tmp_path / "model.toml", tmp_path / "poses.csv"
    model.write_text('[effects]\nincluded = ["own_dial"]\n[effects.own_dial]\na = 0.002\n')
    made = session(*INCLINATIONS, [25.0, 25.0], 2).poses
    assert made is not None
    made.write(poses)
    command = ["calibrate", "solve", str(poses), "--method", "joint", "-o", str(tmp_path / "cal.json"), "--tool", "t",
               "--model", str(model)]  # fmt: skip
    refused = CliRunner().invoke(app, command)
    assert refused.exit_code != 0
    done = CliRunner().invoke(app, [*command, "--effects", str(tmp_path / "own")])
    assert done.exit_code == 0, done.output
    record = parse_record((tmp_path / "cal.json").read_text())
    inc = np.array(record.pose_columns["inc_ref_deg"], dtype=float)
    given = np.array(made["inc_ref_deg"])
    assert inc - given == pytest.approx(np.degrees(0.002 * np.sin(3 * np.radians(given))), abs=1e-9)
