"""The time that is known: from the last synchronised moment on, by the boot clock."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from highside.service.clock import Moment
from highside.service.clock_watch import ClockWatch
from highside.service.known_time import BELIEVED_AFTER_S, FILE, KEPT_EVERY_S, KnownTime, Present

T0, DAY = 1_790_000_000.0, 86_400.0


def moment(elapsed_s: float, *, off_s: float = 0.0, synced: bool = True, boot: str = "a") -> Moment:
    return Moment(T0 + elapsed_s + off_s, synced, boot, 500.0 + elapsed_s)


def test_without_any_synchronised_moment_nothing_is_known(tmp_path: Path) -> None:
    known = KnownTime(tmp_path)
    for off_s in (0.0, -900 * DAY, 900 * DAY):
        now = moment(0.0, off_s=off_s, synced=False)
        known.look(now)
        present = known.present(now)
        assert (present.known, present.wall_s, present.surely_s) == (False, now.wall_s, float("-inf"))
    assert not known.to_be_kept


@pytest.mark.parametrize("off_s", [-900 * DAY, -DAY, DAY, 900 * DAY])
@pytest.mark.parametrize("synced", [True, False])
def test_a_clock_that_is_set_changes_nothing_within_a_boot_and_through_a_restart(
    tmp_path: Path, off_s: float, synced: bool
) -> None:
    known = KnownTime(tmp_path)
    known.look(moment(0.0))
    assert known.to_be_kept
    known.keep()
    later = moment(3 * DAY, off_s=off_s, synced=synced)
    for one in (known, KnownTime(tmp_path)):
        one.look(later)
        present = one.present(later)
        assert present.known
        assert present.wall_s == present.surely_s == T0 + 3 * DAY


def test_a_reference_that_contradicts_is_believed_after_an_hour(tmp_path: Path) -> None:
    known = KnownTime(tmp_path)
    known.look(moment(0.0))
    for elapsed_s in range(0, int(BELIEVED_AFTER_S), 600):
        known.look(moment(elapsed_s, off_s=DAY))
        assert known.present(moment(elapsed_s, off_s=DAY)).wall_s == T0 + elapsed_s
    last = moment(BELIEVED_AFTER_S + 1.0, off_s=DAY)
    known.look(last)
    assert known.present(last).wall_s == last.wall_s


def test_one_that_agrees_again_meanwhile_begins_the_hour_anew(tmp_path: Path) -> None:
    known = KnownTime(tmp_path)
    known.look(moment(0.0))
    known.look(moment(1.0, off_s=DAY))
    known.look(moment(3000.0))
    last = moment(BELIEVED_AFTER_S + 10.0, off_s=DAY)
    known.look(last)
    assert known.present(last).wall_s == T0 + BELIEVED_AFTER_S + 10.0


def test_after_another_boot_the_last_moment_is_only_the_earliest_that_it_can_be(tmp_path: Path) -> None:
    known = KnownTime(tmp_path)
    known.look(moment(0.0))
    known.keep()
    for off_s in (-900 * DAY, 900 * DAY):
        again = KnownTime(tmp_path)
        now = moment(DAY, off_s=off_s, synced=False, boot="b")
        again.look(now)
        present = again.present(now)
        assert (present.known, present.surely_s, present.wall_s) == (False, T0, max(now.wall_s, T0))
    # a reference that says a time before it is not believed at once, one that says a time after it is
    again = KnownTime(tmp_path)
    now = moment(DAY, off_s=-900 * DAY, boot="b")
    again.look(now)
    assert not again.present(now).known
    now = moment(DAY, boot="b")
    again.look(now)
    assert again.present(now) == Present(now.wall_s, known=True, surely_s=now.wall_s)


@pytest.mark.parametrize("content", ["", "{", "[" * 100_000, '{"wall_s": 1e400}', '{"wall_s": NaN}', "[]"])
def test_a_damaged_file_tells_nothing_and_is_replaced(tmp_path: Path, content: str) -> None:
    (tmp_path / FILE).write_text(content)
    known = KnownTime(tmp_path)
    assert not known.present(moment(0.0, synced=False)).known
    known.look(moment(0.0))
    known.keep()
    assert KnownTime(tmp_path).present(moment(1.0, synced=False)).wall_s == T0 + 1.0


def test_it_is_written_once_an_hour(tmp_path: Path) -> None:
    known = KnownTime(tmp_path)
    writes = 0
    for elapsed_s in range(0, int(DAY), 10):
        known.look(moment(elapsed_s))
        if known.to_be_kept:
            known.keep()
            writes += 1
    assert writes == DAY / KEPT_EVERY_S


def test_a_place_that_cannot_be_written_ends_nothing(tmp_path: Path) -> None:
    known = KnownTime(tmp_path / "no" / "such")
    known.look(moment(0.0))
    known.keep()
    assert known.present(moment(1.0)).known


def test_a_clock_that_was_set_while_the_start_waited_was_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    watch, real = ClockWatch(tmp_path), time.time
    monkeypatch.setattr(time, "time", lambda: real() - DAY)
    step_s = watch.steps.look()
    assert step_s is not None and abs(step_s + DAY) < 1.0
    assert watch.steps.alarm
