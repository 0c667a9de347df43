"""The toolface offset's log: who, when, and what survives a power cut."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from highside.errors import InputError
from highside.service.rig.toolface import ToolfaceLog


def test_every_setting_is_kept_and_the_last_is_in_force(tmp_path: Path) -> None:
    log = ToolfaceLog(tmp_path / "state")
    assert log.current() is None
    log.set(37.5, "A. Driller", 1e9, "scribe at the pin")
    log.set(-12.25, "B. Engineer", 1e9 + 60)
    first, second = log.history()
    assert (first.offset_deg, first.author, first.note, first.previous_deg) == (
        37.5, "A. Driller", "scribe at the pin", 0.0,
    )  # fmt: skip
    assert (second.offset_deg, second.previous_deg) == (347.75, 37.5)
    assert log.current() == second


def test_half_a_line_is_forgotten_and_the_next_setting_is_whole(tmp_path: Path) -> None:
    log = ToolfaceLog(tmp_path)
    log.set(10.0, "a", 1.0)
    whole = log.path.read_bytes()
    for cut in range(1, len(whole)):
        log.path.write_bytes(whole + whole[:cut])
        kept = log.current()
        assert kept is not None
        assert kept.offset_deg == 10.0
        log.set(20.0, "b", 2.0)
        assert [s.offset_deg for s in log.history()][-1] == 20.0
        for line in log.path.read_text().splitlines():
            json.loads(line)


def test_a_spoilt_file_is_named_with_its_line(tmp_path: Path) -> None:
    log = ToolfaceLog(tmp_path)
    log.set(10.0, "a", 1.0)
    log.path.write_bytes(b'{"offset_deg": 4000}\n' + log.path.read_bytes())
    with pytest.raises(InputError, match=r"toolface.jsonl: line 1: is no toolface setting"):
        log.history()


@pytest.mark.parametrize(
    ("offset", "author", "field"), [(float("nan"), "a", "offset"), (361.0, "a", "offset"), (1.0, " ", "author")]
)
def test_what_cannot_be_is_refused_and_nothing_is_written(
    tmp_path: Path, offset: float, author: str, field: str
) -> None:
    log = ToolfaceLog(tmp_path)
    with pytest.raises(InputError, match=field):
        log.set(offset, author, 1.0)
    assert not log.path.exists()


@pytest.mark.parametrize("t", ["1e18", "1e300", "-1e12"])
def test_a_time_that_no_calendar_has_is_named_with_its_line(tmp_path: Path, t: str) -> None:
    log = ToolfaceLog(tmp_path)
    log.set(10.0, "a", 1.0)
    log.path.write_text(log.path.read_text().replace('"t": 1.0', f'"t": {t}') + log.path.read_text())
    with pytest.raises(InputError, match="line 1: is no toolface setting"):
        log.history()


def test_a_change_is_noticed_once(tmp_path: Path) -> None:
    log = ToolfaceLog(tmp_path)
    # the first look is one: what was there before the start, or was set aside, is to be read
    assert log.changed()
    assert not log.changed()
    log.set(1.0, "a", 1.0)
    assert log.changed()
    assert not log.changed()
