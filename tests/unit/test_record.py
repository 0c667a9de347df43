"""The calibration record and its store: what is refused, by which name, and what a crash can do."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from highside.calibration.linear_correction import LinearCorrection
from highside.calibration.record import (
    CalibrationRecord,
    Environment,
    RecordError,
    RecordReason,
    SolveRequest,
    build_record,
    content_id,
    correction_from_record,
    from_utc,
    largest_difference,
    parse_record,
    recompute,
    solve_poses,
    temperature_trust,
    to_utc,
    verify,
)
from highside.calibration.schedule import ScheduledCorrection
from highside.errors import InputError
from highside.physics.gravity import gravity_direction
from highside.recording.calibration_store import CalibrationStore, load_active, load_record_file, read_record

NOW = from_utc("2026-11-21T12:00:00Z")
INCLINATIONS = (1.206, 5.0, 45.0)


def columns(seed: int = 0, inclinations: tuple[float, ...] = INCLINATIONS, **more: list[float]) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    inc = np.repeat(inclinations, 8)
    tf = np.tile(np.arange(0.0, 360.0, 45.0), len(inclinations))
    A = np.eye(3) + 2e-3 * rng.standard_normal((3, 3))
    m = A @ gravity_direction(np.deg2rad(inc), np.deg2rad(tf)) + 1e-3 + 1e-5 * rng.standard_normal((3, inc.size))
    names = ("ax", "ay", "az")
    out: dict[str, Any] = {"inc_ref_deg": inc.tolist(), "tf_ref_deg": tf.tolist(), "n": [100.0] * inc.size}
    return out | {name: row.tolist() for name, row in zip(names, m, strict=True)} | more


def make(
    method: str = "conventional",
    seed: int = 0,
    *,
    tool: str = "tool-7",
    serial: str | None = "42",
    days: float | None = 30.0,
    fallback: str = "none",
    reference: Literal["pose", "magnitude"] = "pose",
    environment: Environment = Environment("bench 1", "operator", 25.0, 9.81234, 2e-5),  # noqa: B008 - frozen
    **more: list[float],
) -> CalibrationRecord:
    table = columns(seed, **more)
    request = SolveRequest(method, reference=reference, fallback=fallback)
    found = solve_poses(table, request)
    return build_record(
        tool_id=tool,
        serial=serial,
        request=request,
        result=found.result,
        fallback=found.fallback,
        guide=found.guide,
        pose_columns=table,
        raw_sha256="0" * 64,
        raw_name="poses.csv",
        environment=environment,
        now_s=NOW,
        expires_s=None if days is None else NOW + days * 86400.0,
    )


def reason_of(act: Callable[[], object]) -> RecordReason:
    with pytest.raises(RecordError) as caught:
        act()
    assert caught.value.exit_status == 1
    assert caught.value.reason.value in str(caught.value)
    assert "\n" not in str(caught.value)
    return caught.value.reason


@pytest.mark.parametrize("method", ["conventional", "balance", "joint"])
def test_a_record_read_back_is_the_same_record(method: str) -> None:
    record = make(method)
    again = parse_record(record.to_json())
    assert again.id == record.id == content_id(again.content)
    assert again.content == record.content
    assert largest_difference(again, recompute(record)) == 0.0


@pytest.mark.parametrize("method", ["conventional", "balance", "joint"])
def test_a_record_recomputes_from_its_own_poses(method: str) -> None:
    record = parse_record(make(method).to_json())
    assert largest_difference(record, recompute(record)) <= 1e-12
    other = make(method, seed=5)
    assert largest_difference(record, recompute(other)) > 1e-6


def test_a_record_holds_what_it_must() -> None:
    content = make().content
    assert content["tool"] == {"id": "tool-7", "serial": "42"}
    assert content["environment"]["gravity_mps2"] == 9.81234
    assert content["environment"]["gravity_std_mps2"] == 2e-5
    assert content["units"]["reading"] == "g"
    assert content["raw"]["sha256"] == "0" * 64
    assert content["software"]["name"] == "highside"
    assert content["valid_from"] == "2026-11-21T12:00:00Z"
    assert content["expires"] == "2026-12-21T12:00:00Z"
    assert len(content["pose_table"]["ax"]) == 24
    assert len(content["result"]["poses"]["residual_g"][0]) == 24


def test_equal_calibrations_have_equal_ids_and_any_other_content_another() -> None:
    assert make().id == make().id
    assert len({make().id, make(seed=1).id, make(tool="x").id, make(serial=None).id, make(days=None).id}) == 5


def _paths(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    inner = [found for key, item in items for found in _paths(item, (*path, key))]
    return inner or [path]


def test_any_changed_value_is_tampering() -> None:
    text = make().to_json()
    data = json.loads(text)
    rng = np.random.default_rng(0)
    paths = [path for path in _paths(data) if path and path[0] not in ("id", "schema")]
    for index in rng.choice(len(paths), 60, replace=False):
        changed = json.loads(text)
        place = changed
        *way, last = paths[index]
        for key in way:
            place = place[key]
        old = place[last]
        place[last] = np.nextafter(old, 2.0 * old + 1.0) if isinstance(old, float) else "other"
        assert reason_of(lambda changed=changed: parse_record(json.dumps(changed))) is RecordReason.TAMPERED


def test_a_changed_id_is_tampering() -> None:
    data = json.loads(make().to_json())
    assert reason_of(lambda: parse_record(json.dumps(data | {"id": "0" * 64}))) is RecordReason.TAMPERED


def _signed(changes: Callable[[dict[str, Any]], None], record: CalibrationRecord | None = None) -> str:
    """A record changed by somebody who knows how to hash."""
    data = json.loads((record or make()).to_json())
    del data["id"]
    changes(data)
    return json.dumps({"id": content_id(data), **data})


def test_other_units_and_other_schemas_are_refused_by_name_even_with_a_right_hash() -> None:
    units = _signed(lambda d: d["units"].update(reading="m/s2"))
    assert reason_of(lambda: parse_record(units)) is RecordReason.UNIT_MISMATCH
    schema = _signed(lambda d: d.update(schema="highside.calibration/3"))
    assert reason_of(lambda: parse_record(schema)) is RecordReason.UNKNOWN_SCHEMA


def test_a_record_by_magnitude_of_an_earlier_version_is_read_and_applied() -> None:
    """What its fit says of poses held out had another name then."""
    record = make("joint", reference="magnitude")
    options = record.content["result"]["options"]

    def as_then(content: dict[str, Any]) -> None:
        then = content["result"]["options"]
        then["left_out_rms_g"] = then.pop("held_out_rms_g")

    earlier = parse_record(_signed(as_then, record))
    assert "held_out_rms_g" in options and earlier.id != record.id
    assert earlier.content["result"]["options"]["left_out_rms_g"] == options["held_out_rms_g"]
    assert largest_difference(earlier, recompute(earlier)) == 0.0
    correction, now = correction_from_record(earlier), correction_from_record(record)
    assert isinstance(correction, LinearCorrection) and isinstance(now, LinearCorrection)
    reading = np.array([[0.1], [0.7], [0.7]])
    assert np.array_equal(correction.correct_block(reading), now.correct_block(reading))


def test_variances_under_the_name_of_an_earlier_version_are_read_and_the_file_stays_as_it_is() -> None:
    record = make("joint")

    def as_then(content: dict[str, Any]) -> None:
        then = content["result"]["variance"]
        then["ring_inc_rad"] = then.pop("station_inc_rad")

    earlier = parse_record(_signed(as_then, record))
    assert earlier.result.variance == record.result.variance
    assert "ring_inc_rad" in earlier.content["result"]["variance"]
    assert largest_difference(earlier, recompute(earlier)) == 0.0


@pytest.mark.parametrize("part", ["result", "tool", "created", "environment", "pose_table", "guide", "request"])
def test_a_record_with_a_part_missing_is_malformed(part: str) -> None:
    text = _signed(lambda d: d.pop(part))
    assert reason_of(lambda: parse_record(text)) is RecordReason.MALFORMED


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "{}", '{"a": NaN}', "null", '{"id": "x"}', '{"id":1,"id":2}', "[" * 100000]
)
def test_what_is_no_record_is_wrong_input(text: str) -> None:
    with pytest.raises(InputError, match=r"file\.json"):
        parse_record(text, where="file.json")


def test_the_wrong_tool_serial_or_time_is_refused() -> None:
    record = make()
    verify(record, tool_id="tool-7", serial="42", now_s=NOW + 1.0)
    verify(record, tool_id="tool-7", serial=None, now_s=0.0)  # a clock of 1970 does not take the calibration away
    assert reason_of(lambda: verify(record, tool_id="tool-8", now_s=NOW)) is RecordReason.WRONG_TOOL
    assert reason_of(lambda: verify(record, tool_id="tool-7", serial="43", now_s=NOW)) is RecordReason.WRONG_TOOL
    late = NOW + 30 * 86400.0
    assert reason_of(lambda: verify(record, tool_id="tool-7", now_s=late)) is RecordReason.EXPIRED
    verify(make(days=None), tool_id="tool-7", now_s=NOW * 2.0)


def test_a_record_without_a_tool_or_expired_at_birth_is_not_made() -> None:
    with pytest.raises(InputError):
        make(tool=" ")
    with pytest.raises(InputError):
        make(days=-1.0)


def test_the_correction_of_a_record_is_of_its_kind_and_carries_its_id() -> None:
    single, zones, both = make(), make("balance"), make("balance", fallback="conventional")
    assert isinstance(correction_from_record(single), LinearCorrection)
    schedule, with_fallback = correction_from_record(zones), correction_from_record(both)
    assert isinstance(schedule, ScheduledCorrection)
    assert isinstance(with_fallback, ScheduledCorrection)
    assert schedule.fallback is None
    assert schedule.guide is not None
    assert with_fallback.fallback is not None
    for record, correction in ((single, correction_from_record(single)), (zones, schedule), (both, with_fallback)):
        assert correction.cal_id == record.id


def test_temperatures_trusted_come_from_the_table_or_the_stated_one() -> None:
    stated = temperature_trust(make())
    assert stated is not None
    assert (stated.min_c, stated.max_c) == (20.0, 30.0)
    measured = temperature_trust(make(temp_c=np.linspace(25.0, 125.0, 24).tolist()))
    assert measured is not None
    assert (measured.min_c, measured.max_c) == (25.0, 125.0)
    assert temperature_trust(make(environment=Environment())) is None


def test_times_are_written_and_read_in_utc() -> None:
    assert to_utc(NOW + 0.9) == "2026-11-21T12:00:00Z"
    with pytest.raises(ValueError):
        from_utc("2026-11-21 12:00")


# --- the store -----------------------------------------------------------------------------------------------


def test_activate_history_and_rollback(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path / "store")
    first, second, third = (make(seed=seed) for seed in (1, 2, 3))
    for k, record in enumerate((first, second, third)):
        store.activate(record, now_s=NOW + k)
    assert store.active("tool-7").id == third.id
    assert store.rollback("tool-7", now_s=NOW + 10).record_id == second.id
    assert store.rollback("tool-7", now_s=NOW + 11).record_id == first.id
    assert reason_of(lambda: store.rollback("tool-7", now_s=NOW + 12)) is RecordReason.NOTHING_BEFORE
    store.activate(third, now_s=NOW + 13)
    assert store.rollback("tool-7", now_s=NOW + 14).record_id == first.id
    assert [entry.action for entry in store.history()] == ["activate"] * 3 + ["rollback"] * 2 + ["activate", "rollback"]
    assert [entry.number for entry in store.history()] == list(range(1, 8))
    assert store.ids() == sorted(record.id for record in (first, second, third))
    assert load_active(store.directory, tool_id="tool-7", serial="42", now_s=NOW).cal_id == first.id


def test_activating_twice_does_not_hide_what_was_before(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path)
    first, second = make(seed=1), make(seed=2)
    for record in (first, second, second):
        store.activate(record, now_s=NOW)
    assert store.rollback("tool-7", now_s=NOW).record_id == first.id


def test_tools_in_one_store_do_not_disturb_each_other(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path)
    one, other = make(), make(tool="tool-8")
    store.activate(one, now_s=NOW)
    assert reason_of(lambda: load_active(tmp_path, tool_id="tool-8", now_s=NOW)) is RecordReason.WRONG_TOOL
    store.activate(other, now_s=NOW)
    assert store.active("tool-7").id == one.id
    assert store.active("tool-8").id == other.id
    assert reason_of(lambda: store.rollback("tool-8", now_s=NOW)) is RecordReason.NOTHING_BEFORE
    assert reason_of(lambda: store.activate(one, now_s=NOW, tool_id="tool-8")) is RecordReason.WRONG_TOOL


def test_an_empty_store_a_missing_one_and_an_unknown_id_are_named(tmp_path: Path) -> None:
    assert reason_of(lambda: load_active(tmp_path, tool_id="tool-7")) is RecordReason.NONE_ACTIVE
    assert reason_of(lambda: CalibrationStore(tmp_path).get("abcdef")) is RecordReason.NOT_FOUND
    with pytest.raises(InputError, match="no such calibration store"):
        load_active(tmp_path / "none", tool_id="tool-7")


def test_a_record_is_found_by_the_beginning_of_its_id(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path)
    record = make()
    assert store.add(record) is True
    assert store.add(record) is False
    assert store.get(record.id[:8]).id == record.id
    assert reason_of(lambda: store.get(record.id[:5])) is RecordReason.NOT_FOUND


def test_expired_and_damaged_records_are_refused_when_loaded(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path)
    record = make()
    store.activate(record, now_s=NOW)
    late = NOW + 31 * 86400.0
    assert reason_of(lambda: load_active(tmp_path, tool_id="tool-7", now_s=late)) is RecordReason.EXPIRED
    assert reason_of(lambda: store.activate(record, now_s=late)) is RecordReason.EXPIRED
    path = tmp_path / "records" / f"{record.id}.json"
    path.write_text(path.read_text().replace("operator", "another"))
    assert reason_of(lambda: load_active(tmp_path, tool_id="tool-7", now_s=NOW)) is RecordReason.TAMPERED
    assert reason_of(lambda: load_record_file(path, tool_id="tool-7", now_s=NOW)) is RecordReason.TAMPERED
    path.write_text(make(seed=9).to_json())
    assert reason_of(lambda: load_active(tmp_path, tool_id="tool-7", now_s=NOW)) is RecordReason.TAMPERED
    store.add(record)  # a good copy heals the store
    assert load_active(tmp_path, tool_id="tool-7", now_s=NOW).cal_id == record.id


def test_rolling_back_to_an_expired_record_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path)
    store.activate(make(days=1.0), now_s=NOW)
    present = make(seed=1)
    store.activate(present, now_s=NOW)
    assert reason_of(lambda: store.rollback("tool-7", now_s=NOW + 2 * 86400.0)) is RecordReason.EXPIRED
    assert store.active("tool-7").id == present.id


def test_nothing_in_the_store_is_ever_changed(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path)
    seen: dict[Path, bytes] = {}
    for seed in (1, 2, 1):
        store.activate(make(seed=seed), now_s=NOW)
        store.history()
        for path, content in seen.items():
            assert path.read_bytes() == content
        seen |= {path: path.read_bytes() for path in tmp_path.rglob("*.json")}
    store.rollback("tool-7", now_s=NOW)
    assert all(path.read_bytes() == content for path, content in seen.items())


def test_many_writers_at_once_lose_nothing(tmp_path: Path) -> None:
    records = [make(seed=seed) for seed in range(4)]
    failures: list[BaseException] = []

    def work(record: CalibrationRecord) -> None:
        try:
            for _ in range(5):
                CalibrationStore(tmp_path).activate(record, now_s=NOW)
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=work, args=(record,)) for record in records]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    entries = CalibrationStore(tmp_path).history()
    assert [entry.number for entry in entries] == list(range(1, 21))
    assert sorted(entry.record_id for entry in entries) == sorted(record.id for record in records for _ in range(5))


STEPS = ("open", "fsync", "replace", "rename", "mkdir", "close", "chmod", "fdopen")
"""What the store asks of the system; the process dies just before one of them."""


def _activate_and_die(directory: Path, record: CalibrationRecord, deadly: int) -> bool:
    """In a child process: activate, but be killed at the step with number `deadly`. Whether it was."""
    child = os.fork()
    if child == 0:
        steps = 0

        def counted(real: Callable[..., Any]) -> Callable[..., Any]:
            def call(*args: Any, **kwargs: Any) -> Any:
                nonlocal steps
                steps += 1
                if steps == deadly:
                    os.kill(os.getpid(), signal.SIGKILL)
                return real(*args, **kwargs)

            return call

        for name in STEPS:
            setattr(os, name, counted(getattr(os, name)))
        try:
            CalibrationStore(directory).activate(record, now_s=NOW)
        except BaseException:
            os._exit(1)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        assert os.WTERMSIG(status) == signal.SIGKILL
        return True
    assert os.WEXITSTATUS(status) == 0
    return False


def test_killed_between_any_two_steps_the_store_keeps_a_valid_calibration(tmp_path: Path) -> None:
    old, new = make(seed=1), make(seed=2)
    outcomes = []
    for deadly in range(1, 60):
        directory = tmp_path / f"store{deadly}"
        CalibrationStore(directory).activate(old, now_s=NOW)
        killed = _activate_and_die(directory, new, deadly)
        outcomes.append(load_active(directory, tool_id="tool-7", now_s=NOW).cal_id)
        # and the next writer is not held up by what the dead one left
        CalibrationStore(directory).activate(new, now_s=NOW)
        assert CalibrationStore(directory).active("tool-7").id == new.id
        if not killed:
            break
    else:
        pytest.fail("the writer never came to its end")
    assert len(outcomes) > 8
    assert outcomes[0] == old.id
    assert outcomes[-1] == new.id
    turn = outcomes.index(new.id)
    assert outcomes == [old.id] * turn + [new.id] * (len(outcomes) - turn)


def test_a_store_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        CalibrationStore(tmp_path / "file" / "store").add(make())


@pytest.mark.parametrize("content", ["", "{}", '{"number": 1, "tool": "tool-7"}', "not json"])
def test_a_damaged_activation_is_named_and_not_passed_over(tmp_path: Path, content: str) -> None:
    store = CalibrationStore(tmp_path)
    store.activate(make(), now_s=NOW)
    (tmp_path / "activations" / "00000002.json").write_text(content)
    assert reason_of(lambda: load_active(tmp_path, tool_id="tool-7", now_s=NOW)) is RecordReason.MALFORMED


@pytest.mark.parametrize("lost", [(1,), (2,), (1, 2)])
def test_an_activation_that_was_lost_changes_nothing_of_what_is_in_force(tmp_path: Path, lost: tuple[int, ...]) -> None:
    store = CalibrationStore(tmp_path)
    first, second = make(seed=1), make(seed=2)
    for record in (first, second):
        store.activate(record, now_s=NOW)
    store.rollback("tool-7", now_s=NOW)
    for number in lost:
        (tmp_path / "activations" / f"{number:08d}.json").unlink()
    assert store.active("tool-7").id == first.id
    assert store.was_taken_back("tool-7", second.id) is (2 not in lost)
    store.activate(second, now_s=NOW)
    assert store.rollback("tool-7", now_s=NOW).record_id == first.id
    store.take_out("tool-7", now_s=NOW)
    for path in sorted((tmp_path / "activations").iterdir())[:-1]:
        path.unlink()
    assert store.active_id("tool-7") is None


def test_a_file_that_is_not_there_or_not_text_is_wrong_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.json"):
        read_record(tmp_path / "none.json")
    (tmp_path / "binary.json").write_bytes(bytes(range(256)))
    with pytest.raises(InputError, match="not text"):
        read_record(tmp_path / "binary.json")
    assert [path.name for path in tmp_path.iterdir()] == ["binary.json"]


def test_a_record_of_nonsense_with_a_right_hash_is_refused_and_never_a_crash() -> None:
    """Values of other types and sizes anywhere in a record: refused by name, or still a usable record."""
    text = make("balance", fallback="conventional").to_json()
    rng = np.random.default_rng(4)
    paths = [path for path in _paths(json.loads(text)) if path and path[0] != "id"]
    wrong: list[Any] = [None, True, -1.0, 0, 1e308, "", "text", [], {}, [[]], {"a": 1}]
    refused = 0
    for trial in range(400):
        data = json.loads(text)
        del data["id"]
        path = paths[rng.integers(len(paths))]
        *way, last = path[: rng.integers(1, len(path) + 1)]
        place = data
        for key in way:
            place = place[key]
        place[last] = wrong[trial % len(wrong)]
        try:
            record = parse_record(json.dumps({"id": content_id(data), **data}))
            verify(record, tool_id="tool-7", serial="42", now_s=NOW)
            correction_from_record(record).correct((0.1, 0.2, 0.97), temp_c=25.0)
        except (RecordError, InputError):
            refused += 1
    assert refused > 200
