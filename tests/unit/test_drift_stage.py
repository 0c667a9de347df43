"""The drift stage of the service: an azimuth only where one is known, its uncertainty, gaps, restarts, commands."""

from __future__ import annotations

import json
import math
import os
import random
import time
from pathlib import Path

import numpy as np
import pytest

from highside.config.drift import DriftSettings
from highside.errors import Refused
from highside.gyro.complementary import complementary
from highside.gyro.filter import FilterSettings
from highside.gyro.recording_filter import error_state_filter
from highside.papers.drift_scenarios import DriftData, Triad, curved_hole, drilling, record, turntable
from highside.service import saved_drift
from highside.service.damage import DamageLog
from highside.service.drift_keeper import DriftKeeper
from highside.service.drift_stage import DriftStage
from highside.service.messages import DriftCommand, DriftMessage, DriftReply
from highside.service.saved_drift import HeadingAlignment, SavedDrift, Stamp

LATITUDE = 35.2
ALIGNED = DriftSettings(azimuth_deg=60.0, azimuth_std_deg=0.1)


def feed(
    stage: DriftStage,
    data: DriftData,
    *,
    after_s: float = 0.0,
    until_s: float = 1e9,
    later_s: float = 0.0,
    mono_s: float = 1000.0,
) -> None:
    """The readings between two times; `later_s` is added to the tool's time, `mono_s` to that for the machine's."""
    t = data.experiment.t_s
    rates = np.degrees(data.rate)
    for i in np.flatnonzero((t >= after_s) & (t < until_s)):
        stage.add(*rates[:, i].tolist())
        stage.close(float(t[i]) + later_s, float(t[i]) + later_s + mono_s, tuple(data.accel[:, i].tolist()))


def error_deg(stage: DriftStage, t_s: float, true_deg: float) -> tuple[float, float]:
    azimuth = stage.azimuth(t_s)
    assert azimuth is not None
    assert azimuth.azi_deg is not None
    assert azimuth.azi_std_deg is not None
    return math.remainder(azimuth.azi_deg - true_deg, 360.0), azimuth.azi_std_deg


def test_it_gives_what_highside_drift_gives() -> None:
    experiment = drilling(120.0, 50.0, leg_s=60.0, stop_s=20.0, start_s=30.0)
    data = record(experiment, 1)
    stage = DriftStage(ALIGNED, LATITUDE)
    feed(stage, data)
    settings = ALIGNED.filter_settings(LATITUDE, first_start=True)
    assert settings == FilterSettings(latitude_rad=math.radians(LATITUDE), azimuth_rad=math.radians(60.0))
    batch = error_state_filter(experiment.t_s, data.rate, data.accel, settings)
    azimuth = stage.azimuth(120.0)
    assert azimuth is not None
    assert azimuth.azi_deg is not None
    # the last row stands alone in a block that is still open here
    assert math.radians(azimuth.azi_deg) == pytest.approx(batch.azi_rad[-1], abs=1e-5)
    assert azimuth.basis == ("zero_rate",)


def test_without_alignment_there_is_no_azimuth_and_a_command_gives_one() -> None:
    data = record(turntable(120.0, 20.0, Triad()), 1)
    stage = DriftStage(DriftSettings(), LATITUDE)
    assert stage.azimuth(0.0) is None
    assert stage.align(60.0, 0.2, None) is not None
    feed(stage, data, until_s=60.0)
    unknown = stage.azimuth(60.0)
    assert unknown is not None
    assert (unknown.azi_deg, unknown.azi_std_deg, unknown.basis) == (None, None, ("unaligned",))
    assert stage.reset_heading() is not None
    assert stage.align(60.0, 0.2, 5.0) is None
    error, std = error_deg(stage, 60.0, 60.0)
    assert abs(error) < 1e-9
    assert std == pytest.approx(0.2, rel=0.02)
    feed(stage, data, after_s=60.0)
    error, std = error_deg(stage, 120.0, 60.0)
    assert abs(error) < 3.0 * std < 1.5
    assert stage.basis == ("zero_rate",)
    # the biases found without an azimuth held the level part of the Earth's rotation: now they do not
    message = stage.message(0.0)
    assert message.bias_dph is not None
    assert message.bias_std_dph is not None
    errors = np.array(message.bias_dph) - np.degrees(data.bias_end) * 3600.0
    assert np.all(np.abs(errors) < 3.0 * np.array(message.bias_std_dph))


def test_a_reset_takes_the_azimuth_of_the_alignment_and_says_that_it_is_asserted() -> None:
    data = record(curved_hole(30.0, 100.0, 20.0, start_s=60.0), 1)
    stage = DriftStage(ALIGNED, LATITUDE)
    feed(stage, data)
    error, std = error_deg(stage, 160.0, 90.0)
    assert abs(error) < 3.0 * std + 0.1
    assert stage.reset_heading() is None
    assert error_deg(stage, 160.0, 60.0)[0] == pytest.approx(0.0, abs=1e-3)
    assert stage.basis[0] == "constraint"
    assert stage.align(90.0, 0.1, None) is None
    assert "constraint" not in stage.basis


@pytest.mark.parametrize("gap_s", [20.0, 2000.0])
def test_a_gap_of_a_moving_tool_widens_the_azimuth_and_a_long_one_ends_it(gap_s: float) -> None:
    data = record(drilling(200.0, 20.0, leg_s=1e6, start_s=60.0), 1)
    stage = DriftStage(ALIGNED, LATITUDE)
    feed(stage, data, until_s=100.0)
    feed(stage, data, after_s=100.0, later_s=gap_s)
    azimuth = stage.azimuth(200.0 + gap_s)
    assert azimuth is not None
    if gap_s > 600.0:
        assert azimuth.azi_deg is None
        assert azimuth.basis == ("unaligned",)
    else:
        assert azimuth.azi_std_deg == pytest.approx(20.0, rel=0.1)
    assert stage.restored is not None
    assert "gyro biases kept" in stage.restored


def test_a_gap_of_a_standing_tool_costs_nothing() -> None:
    data = record(turntable(200.0, 20.0, Triad()), 1)
    stage = DriftStage(ALIGNED, LATITUDE)
    feed(stage, data, until_s=100.0)
    before = error_deg(stage, 100.0, 60.0)
    feed(stage, data, after_s=100.0, later_s=60.0)
    after = error_deg(stage, 260.0, 60.0)
    assert after[1] < before[1] + 0.05
    assert stage.restored is not None
    assert "stood" in stage.restored


def test_a_tool_switched_on_anew_has_other_biases() -> None:
    data = record(turntable(200.0, 20.0, Triad()), 1)
    stage = DriftStage(ALIGNED, LATITUDE)
    feed(stage, data, until_s=100.0)
    stage.device_restarted()
    # its time begins again; three seconds have passed
    t = data.experiment.t_s
    for i in np.flatnonzero(t < 10.0):
        stage.add(*np.degrees(data.rate[:, i]).tolist())
        stage.close(float(t[i]), 1103.0 + float(t[i]), tuple(data.accel[:, i].tolist()))
    assert stage.restored is not None
    assert "biases forgotten: another power-up" in stage.restored
    assert error_deg(stage, 10.0, 60.0)[1] == pytest.approx(3.0, rel=0.2)


def kept(stage: DriftStage, folder: Path, *, age_s: float | None) -> SavedDrift:
    """Through the file, as after a restart."""
    state = stage.saved()
    assert state is not None
    path = folder / "drift.json"
    now = Stamp.now(synced=False)
    then = now.model_copy(update={"boot_s": now.boot_s - age_s} if age_s is not None else {"boot_id": "another"})
    saved_drift.write(path, "t1", then, state)
    found = saved_drift.read(path, "t1", now)
    assert found is not None
    return found


def test_the_state_survives_a_restart(tmp_path: Path) -> None:
    data = record(turntable(200.0, 20.0, Triad()), 1)
    stage = DriftStage(ALIGNED, LATITUDE)
    feed(stage, data, until_s=100.0)
    found = kept(stage, tmp_path, age_s=5.0)
    assert found.age_s == pytest.approx(5.0, abs=1e-6)
    again = DriftStage(ALIGNED, LATITUDE, found, loaded_mono=1105.0)
    feed(again, data, after_s=100.0, later_s=5.0)
    whole = DriftStage(ALIGNED, LATITUDE)
    feed(whole, data)
    assert error_deg(again, 205.0, 60.0)[0] == pytest.approx(error_deg(whole, 200.0, 60.0)[0], abs=0.02)
    assert error_deg(again, 205.0, 60.0)[1] == pytest.approx(error_deg(whole, 200.0, 60.0)[1], rel=0.1)
    assert again.alignment == HeadingAlignment(azimuth_deg=60.0, std_deg=0.1, by="configuration", t=None)


def test_a_state_too_old_of_unknown_age_or_of_another_power_up_gives_no_azimuth(tmp_path: Path) -> None:
    data = record(drilling(200.0, 20.0, leg_s=1e6, start_s=60.0), 1)
    stage = DriftStage(ALIGNED, LATITUDE)
    feed(stage, data, until_s=100.0)
    unknown = DriftStage(ALIGNED, LATITUDE, kept(stage, tmp_path, age_s=None), loaded_mono=1100.0)
    feed(unknown, data, after_s=100.0)
    old = DriftStage(ALIGNED, LATITUDE, kept(stage, tmp_path, age_s=3600.0), loaded_mono=4700.0)
    feed(old, data, after_s=100.0, later_s=3600.0)
    # the file is twenty seconds old, the tool's time went back: it was switched off
    other = DriftStage(ALIGNED, LATITUDE, kept(stage, tmp_path, age_s=20.0), loaded_mono=1000.0)
    feed(other, data, until_s=100.0)
    for each, why in ((unknown, "unknown age"), (old, "too old"), (other, "another power-up")):
        assert each.restored is not None
        assert why in each.restored
    for each, at in ((unknown, 200.0), (old, 3800.0)):
        # the configured azimuth was that of the very first start
        azimuth = each.azimuth(at)
        assert azimuth is not None
        assert azimuth.basis == ("unaligned",)
    error, std = error_deg(other, 100.0, 60.0)
    assert 10.0 < std < 21.0
    assert abs(error) < 3.0 * std


@pytest.mark.parametrize(
    "spoil",
    [
        lambda d: d["state"]["memory"]["q"].pop(),
        lambda d: d["state"]["memory"]["P"].__setitem__(0, -1.0),
        lambda d: d["state"].pop("azi_deg"),
        lambda d: d.__setitem__("tool", "t2"),
        lambda d: d.__setitem__("format", "highside.drift/9"),
    ],
)
def test_a_damaged_or_foreign_file_is_refused(tmp_path: Path, spoil: object) -> None:
    stage = DriftStage(ALIGNED, LATITUDE)
    feed(stage, record(turntable(30.0, 20.0, Triad()), 1))
    kept(stage, tmp_path, age_s=1.0)
    path = tmp_path / "drift.json"
    content = json.loads(path.read_bytes())
    spoil(content)  # type: ignore[operator]
    path.write_text(json.dumps(content))
    with pytest.raises(Refused, match="align anew"):
        saved_drift.read(path, "t1", Stamp.now(synced=True))
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(Refused, match="align anew"):
        saved_drift.read(path, "t1", Stamp.now(synced=True))


def test_a_declared_connection_measures_the_gyros_until_the_tool_turns_for_all_to_see() -> None:
    settings = ALIGNED.model_copy(update={"detect_stops": False})
    data = record(drilling(200.0, 20.0, leg_s=100.0, start_s=60.0, turning_dps=60.0, stop_s=40.0), 1)
    stage = DriftStage(settings, LATITUDE)
    feed(stage, data, until_s=101.0)
    assert stage.basis == ("nothing",)
    assert stage.connection(1000.0) is None
    feed(stage, data, after_s=101.0, until_s=139.0)
    assert stage.message(0.0).motion == "still"
    assert "zero_rate" in stage.basis
    feed(stage, data, after_s=139.0)
    assert stage.message(0.0).motion != "still"
    assert not stage.message(0.0).connection


def test_a_tool_that_moved_when_it_was_first_heard_says_that_no_stop_is_found() -> None:
    data = record(drilling(200.0, 20.0, leg_s=100.0, start_s=60.0, turning_dps=60.0, stop_s=40.0), 1)
    reported = "the tool did not rest in the first 20 s, so that no stop is found"
    rested, moved = DriftStage(ALIGNED, LATITUDE), DriftStage(ALIGNED, LATITUDE)
    feed(rested, data, until_s=90.0)
    assert not any(reported in note for note in rested.message(0.0).notes)
    feed(moved, data, after_s=70.0, until_s=85.0)
    assert not any(reported in note for note in moved.message(0.0).notes), "it is not known yet"
    feed(moved, data, after_s=85.0, until_s=95.0)
    (note,) = [note for note in moved.message(0.0).notes if reported in note]
    assert "the command connection" in note
    # what the note asks for ends it
    assert moved.restart() is None
    feed(moved, data, after_s=105.0, until_s=139.0)
    assert not any(reported in note for note in moved.message(0.0).notes)
    # asked to find none, it has nothing to say
    silent = DriftStage(ALIGNED.model_copy(update={"detect_stops": False}), LATITUDE)
    feed(silent, data, after_s=70.0, until_s=95.0)
    assert not any(reported in note for note in silent.message(0.0).notes)


def test_gyros_in_the_wrong_unit_or_silent_or_at_their_range_are_reported() -> None:
    turning = record(drilling(100.0, 20.0, leg_s=1e6, start_s=30.0, turning_dps=20.0, vibration_rms_g=0.01), 1)
    wrong = DriftStage(ALIGNED, LATITUDE)
    t, rates = turning.experiment.t_s, turning.rate
    for i in range(t.size):
        wrong.add(*rates[:, i].tolist())  # rad/s
        wrong.close(float(t[i]), 0.0, tuple(turning.accel[:, i].tolist()))
    azimuth = wrong.azimuth(100.0)
    assert azimuth is not None
    assert (azimuth.azi_deg, azimuth.basis) == (None, ("gyro_units",))
    assert any("rad/s" in note for note in wrong.message(0.0).notes)

    limited = DriftStage(ALIGNED.model_copy(update={"gyro_range_dps": 19.0}), LATITUDE)
    feed(limited, turning, until_s=60.0)
    found = limited.azimuth(60.0)
    assert found is not None
    assert found.flags == ("gyro_saturated",)
    silent = limited.azimuth(62.0)
    assert silent is not None
    assert (silent.azi_deg, silent.basis) == (None, ("no_gyros",))


def test_readings_that_no_correction_holds_for_do_not_poison_the_azimuth() -> None:
    data = record(turntable(100.0, 20.0, Triad()), 1)
    stage = DriftStage(ALIGNED, LATITUDE)
    feed(stage, data, until_s=50.0)
    for i in np.flatnonzero((data.experiment.t_s >= 50.0) & (data.experiment.t_s < 60.0)):
        stage.add(*np.degrees(data.rate[:, i]).tolist())
        stage.close(float(data.experiment.t_s[i]), 0.0, (math.nan, math.nan, math.nan))
    feed(stage, data, after_s=60.0)
    error, std = error_deg(stage, 100.0, 60.0)
    assert abs(error) < 3.0 * std < 1.0


@pytest.mark.parametrize("method", ["kinematic", "literal", "literal_block"])
def test_the_literal_algorithm_can_be_chosen_or_run_beside(method: str) -> None:
    settings = DriftSettings(azimuth_deg=60.0, method=method, compare_literal=True, azimuth_policy="gyro")
    stage = DriftStage(settings, LATITUDE)
    feed(stage, record(turntable(120.0, 20.0), 1))
    azimuth, message = stage.azimuth(120.0), stage.message(0.0)
    assert azimuth is not None
    assert message.literal is not None
    assert message.literal.azi_deg is not None
    # what the gyros show of the Earth and their bias about Up turns it: 4.6 deg/h
    drift = math.remainder(message.literal.azi_deg - 60.0, 360.0) * 3600.0 / 119.0
    assert abs(drift) == pytest.approx(4.6, abs=2.5)
    if method == "kinematic":
        assert azimuth.azi_std_deg is not None
    else:
        assert (azimuth.azi_deg, azimuth.azi_std_deg) == (message.literal.azi_deg, None)
        assert azimuth.basis == ("nothing",)
    DriftMessage.model_validate_json(message.model_dump_json())


@pytest.mark.parametrize("hold", [False, True])
def test_the_recursive_filter_can_be_chosen_and_is_the_one_of_highside_drift(hold: bool) -> None:
    experiment = drilling(150.0, 50.0, leg_s=60.0, stop_s=20.0, start_s=30.0)
    data = record(experiment, 2)
    settings = DriftSettings(azimuth_deg=60.0, azimuth_std_deg=0.1, method="recursive", straight_hole=hold)
    stage = DriftStage(settings, LATITUDE)
    feed(stage, data)
    bulk = complementary(
        experiment.t_s, data.rate, data.accel, settings.filter_settings(LATITUDE, first_start=True), hold=hold
    )
    azimuth, message = stage.azimuth(150.0), stage.message(0.0)
    assert azimuth is not None
    assert azimuth.azi_deg is not None
    assert azimuth.azi_std_deg is not None
    # its blocks begin a sample after those of the recording
    assert math.remainder(azimuth.azi_deg - math.degrees(bulk.azi_rad[-1]), 360.0) == pytest.approx(0.0, abs=0.01)
    assert azimuth.azi_std_deg == pytest.approx(math.degrees(bulk.azi_std_rad[-1]), rel=0.05, abs=0.01)
    assert azimuth.basis == (("constraint",) if hold else ("nothing",))
    assert message.method == "recursive"
    assert message.recursive is not None
    assert (message.recursive.azi_deg, message.recursive.azi_std_deg) == (azimuth.azi_deg, azimuth.azi_std_deg)
    assert message.recursive.bias_dph == pytest.approx(np.degrees(bulk.bias_radps[:, -1]) * 3600.0, abs=0.5)
    assert DriftMessage.model_validate_json(message.model_dump_json()) == message


def test_the_recursive_filter_is_aligned_by_command_while_the_tool_turns() -> None:
    stage = DriftStage(DriftSettings(method="recursive"), LATITUDE)
    data = record(turntable(40.0, 20.0), 1)
    feed(stage, data, until_s=20.345)
    assert stage.azimuth(20.34) == (None, None, ("unaligned",), ())
    assert stage.align(123.0, 0.2, 0.0) is None
    for until_s in (20.5, 40.0):
        feed(stage, data, after_s=20.345 if until_s < 21 else 20.5, until_s=until_s)
        azimuth = stage.azimuth(until_s - 0.02)
        assert azimuth is not None
        assert azimuth.azi_deg == pytest.approx(123.0, abs=0.1)
    assert stage.restart() is None
    assert stage.message(0.0).recursive is None


def test_an_azimuth_is_reported_of_the_hole_and_kept_of_the_package() -> None:
    data = record(turntable(10.0, 20.0), 1)
    t, rates = data.experiment.t_s, np.degrees(data.rate)

    def run(stage: DriftStage, error_rad: float | None, since_s: float, until_s: float) -> float | None:
        for i in np.flatnonzero((t >= since_s) & (t < until_s)):
            stage.add(*rates[:, i].tolist())
            stage.close(float(t[i]), float(t[i]), tuple(data.accel[:, i].tolist()), error_rad)
        found = stage.azimuth(until_s)
        assert found is not None
        return found.azi_deg

    stage = DriftStage(ALIGNED, LATITUDE)
    assert run(stage, math.radians(0.5), 0.0, 2.0) == pytest.approx(60.5, abs=0.02)
    assert stage.align(70.0, 0.1, 0.0) is None
    assert run(stage, math.radians(-0.25), 2.0, 4.0) == pytest.approx(70.5, abs=0.02)
    assert stage.reset_heading() is None
    assert run(stage, None, 4.0, 6.0) == pytest.approx(69.75, abs=0.02)
    for refused in (stage.align(1.0, 0.1, 0.0), stage.reset_heading()):
        assert refused is not None
        assert "rotor angle is not known" in refused


class Desk:
    """A keeper with its wires in hand."""

    def __init__(self, folder: Path, tables: str = "") -> None:
        from highside.config.settings import load

        folder.mkdir(exist_ok=True)
        path = folder / "highside.toml"
        path.write_text(
            '[tool]\nid = "t1"\n[link]\nkind = "simulated"\n[codec]\nname = "tool"\n'
            f"[site]\nlatitude_deg = 35.2\n{tables}"
        )
        self.replies: list[dict[str, object]] = []
        self.reported: list[bytes] = []
        self.keeper = DriftKeeper(
            folder,
            lambda payload, _: self.replies.append(json.loads(payload)),
            self.reported.append,
            lambda: self.parts,
            DamageLog(),
        )
        self.parts = self.keeper.build(load(path))

    def say(self, **command: object) -> dict[str, object]:
        self.keeper.on_command(json.dumps(command).encode(), retained=False)
        return self.replies[-1]


def test_commands_are_answered_whatever_they_contain(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    assert desk.say(id="1", command="align", azimuth_deg=12.0)["error"] is not None
    stage = desk.keeper.stage
    assert stage is not None
    feed(stage, record(turntable(20.0, 20.0, Triad()), 1))
    for wrong, word in (
        ({"id": "2", "command": "align"}, "azimuth_deg"),
        ({"id": "3", "command": "fly"}, "align"),
        ({"id": "4", "command": "align", "azimuth_deg": 400}, "360"),
        ({"id": "5", "command": "restart", "seconds": 4}, "connection"),
        ({"id": "6", "command": "reset_heading"}, "alignment"),
        ({"command": "restart"}, "id"),
    ):
        reply = desk.say(**wrong)
        assert reply["ok"] is False
        assert word in str(reply["error"])
        assert reply["id"] == wrong.get("id", "")
    for garbage in (b"", b"{", b"[]", b"\xff\xfe", b"[" * 3000, b"x" * 10_000, b'{"id": 3}', b"null"):
        before = len(desk.replies)
        desk.keeper.on_command(garbage, retained=False)
        assert len(desk.replies) == before + 1
        assert desk.replies[-1]["ok"] is False
    desk.keeper.on_command(b'{"id":"7","command":"align","azimuth_deg":12}', retained=True)
    assert "retained" in str(desk.replies[-1]["error"])
    assert stage.alignment is None
    assert desk.say(id="8", command="align", azimuth_deg=12.0)["ok"] is True
    feed(stage, record(turntable(20.0, 20.0, Triad()), 2), later_s=20.05)
    moved = stage.azimuth(40.0)
    # the same command again was delivered twice; another one under its id is not done, and not called done
    assert desk.say(id="8", command="align", azimuth_deg=12.0)["ok"] is True
    assert stage.azimuth(40.0) == moved
    other = desk.say(id="8", command="align", azimuth_deg=99.0)
    assert other["ok"] is False
    assert "an id of its own" in str(other["error"])
    assert stage.azimuth(40.0) == moved
    assert desk.say(id="9", command="restart")["ok"] is True
    assert stage.azimuth(40.0) is None
    assert desk.reported


async def test_what_is_kept_is_taken_up_by_the_next_service_and_damage_is_reported(tmp_path: Path) -> None:
    desk = Desk(tmp_path, "[drift]\nazimuth_deg = 60.0\n")
    assert desk.keeper.stage is not None
    feed(desk.keeper.stage, record(turntable(20.0, 20.0, Triad()), 1))
    await desk.keeper.stop()
    assert desk.keeper.saves == 1
    again = Desk(tmp_path, "[drift]\nazimuth_deg = 60.0\n").keeper
    assert again.error is None
    assert again.stage is not None
    # a keeper reads the age of what it loads from the machine's clock, which begins with the machine
    feed(again.stage, record(turntable(20.0, 20.0, Triad()), 1), later_s=20.05, mono_s=time.monotonic())
    health = again.health()
    assert health is not None
    assert health["aligned"] is True
    (tmp_path / "drift.json").write_text("{}")
    spoilt = Desk(tmp_path, "[drift]\nazimuth_deg = 60.0\n").keeper
    assert spoilt.error is not None
    assert "align anew" in spoilt.error
    assert spoilt.stage is not None
    feed(spoilt.stage, record(turntable(20.0, 20.0, Triad()), 1))
    # a configured azimuth is that of the first start; what was there since is lost
    assert spoilt.stage.basis == ("unaligned",)


def test_an_id_that_no_reply_can_hold_does_not_end_the_answers(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    assert desk.keeper.stage is not None
    feed(desk.keeper.stage, record(turntable(20.0, 20.0, Triad()), 1))
    desk.keeper.on_command(b'{"command":"align","id":"\\ud800","azimuth_deg":10}', retained=False)
    assert desk.replies[-1]["ok"] is False
    for given, answered in ((5, "5"), ("x" * 1000, "x" * 64), (None, ""), ([1], ""), (True, "True"), (10**30, "")):
        reply = desk.say(id=given, command="align", azimuth_deg=10.0)
        assert (reply["ok"], reply["id"]) == (False, answered), given
    # a number is a number: neither true nor a text
    for wrong in (True, "10", [10], None):
        assert desk.say(id="n", command="align", azimuth_deg=wrong)["ok"] is False
    assert desk.say(id="good", command="align", azimuth_deg=10)["ok"] is True


def test_a_command_that_fails_inside_is_answered_and_the_next_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk = Desk(tmp_path)
    stage = desk.keeper.stage
    assert stage is not None
    feed(stage, record(turntable(20.0, 20.0, Triad()), 1))

    def fails(*_: object) -> None:
        raise ZeroDivisionError("inside")

    with monkeypatch.context() as patch:
        patch.setattr(stage, "align", fails)
        reply = desk.say(id="1", command="align", azimuth_deg=10.0)
        assert (reply["id"], reply["ok"]) == ("1", False)
        assert "ZeroDivisionError" in str(reply["error"])
    with monkeypatch.context() as patch:
        patch.setattr(DriftCommand, "model_validate", fails)
        assert desk.say(id="2", command="align", azimuth_deg=10.0)["ok"] is False
    # one that failed was not done: the same id may be tried again
    assert desk.say(id="1", command="align", azimuth_deg=10.0)["ok"] is True


def mutated(rng: random.Random) -> bytes:
    """A command, whole or spoilt in one of the ways in which messages are."""
    command: dict[str, object] = {
        "id": rng.choice(("a", "b" * rng.randrange(200), "\ud800", "\x00\x1b[2J", rng.randrange(10**9), None, [], {})),
        "command": rng.choice(("align", "reset_heading", "connection", "restart", "fly", "", 7)),
    }
    number = (0, 12.5, -1, 1e308, 10**400, True, "12", None, float("nan"), float("inf"), [], {"a": 1})
    for name in ("azimuth_deg", "std_deg", "seconds", "\udfff", "x" * rng.randrange(300)):
        if rng.random() < 0.3:
            command[name] = rng.choice(number)
    data = bytearray(json.dumps(command, ensure_ascii=rng.random() < 0.7).encode("utf-8", "surrogatepass"))
    for _ in range(rng.randrange(4)):
        at = rng.randrange(len(data) + 1)
        what = rng.randrange(7)
        if what == 0 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif what == 1:
            del data[at:]
        elif what == 2:
            data[at:at] = data[: rng.randrange(len(data) + 1)]
        elif what == 3:
            data[at:at] = rng.choice((b"[", b'{"a":', b"9", b"\\ud800")) * rng.randrange(1, 900)
        elif what == 4:
            data[at:at] = rng.choice((b"NaN", b"1e999", b"-Infinity", b"\x00", b"\xff", b"\xed\xa0\x80", b"\\u0000"))
        elif what == 5:
            data[at:at] = rng.randbytes(rng.randrange(40))
        else:
            data = bytearray(rng.randbytes(rng.randrange(100)))
    return bytes(data)


@pytest.mark.slow
def test_a_hundred_thousand_spoilt_commands_are_each_answered(tmp_path: Path) -> None:
    """`HIGHSIDE_FUZZ` is another count."""
    desk = Desk(tmp_path)
    assert desk.keeper.stage is not None
    feed(desk.keeper.stage, record(turntable(20.0, 20.0, Triad()), 1))
    rng = random.Random(20)
    count, done = int(os.environ.get("HIGHSIDE_FUZZ", "100000")), 0
    for i in range(count):
        payload = mutated(rng)
        desk.keeper.on_command(payload, retained=rng.random() < 0.02)
        assert len(desk.replies) == 1, payload
        reply = DriftReply.model_validate(desk.replies.pop())
        assert len(reply.id) <= 64 and len(reply.error or "") <= 400
        done += reply.ok
        desk.reported.clear()
        assert desk.keeper.commands == i + 1
    print(f"{count} commands, {done} of them done")
    assert done > count / 1000
    stage = desk.keeper.stage
    assert stage is not None
    feed(stage, record(turntable(20.0, 20.0, Triad()), 1), later_s=100.0)
    assert desk.say(id="at the end", command="align", azimuth_deg=10.0)["ok"] is True
