"""The lock of a state directory that is deleted or replaced while a service holds it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from highside.errors import InputError
from highside.service.places import StateLock


def held(directory: Path) -> StateLock:
    lock = StateLock(directory)
    lock.take()
    return lock


@pytest.mark.parametrize("deleted", ["directory", "lock", "replaced by a directory"])
def test_what_was_deleted_is_taken_again_before_another_service_can(
    tmp_path: Path, deleted: str, caplog: pytest.LogCaptureFixture
) -> None:
    state = tmp_path / "state"
    first = held(state)
    with pytest.raises(InputError, match="another highside uses this state directory"):
        held(state)
    if deleted == "directory":
        shutil.rmtree(state)
    else:
        (state / "lock").unlink()
        if deleted != "lock":
            (state / "lock").mkdir()
    first.look()
    with pytest.raises(InputError, match="another highside uses this state directory"):
        held(state)
    first.look()
    assert [record.getMessage() for record in caplog.records] == [
        f"the lock of the state directory {state} was gone; it was made anew and taken again"
    ]
    assert not first.taken
    first.release()
    first.look()
    assert not first.held
    held(state).release()


def test_another_service_that_was_faster_is_told_and_the_lock_taken_once_it_ends(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = tmp_path / "state"
    first = held(state)
    shutil.rmtree(state)
    second = held(state)
    first.look()
    assert not first.taken, "somebody may only have looked whether a service runs"
    for _ in range(5):
        first.look()
    assert first.taken
    assert first.held
    assert len(caplog.records) == 1
    assert "stop one of them" in caplog.text
    second.look()
    assert not second.taken
    second.release()
    first.look()
    assert not first.taken
    with pytest.raises(InputError, match="another highside"):
        held(state)
    first.release()


def test_a_directory_that_cannot_be_made_again_keeps_the_lock_that_was_had(tmp_path: Path) -> None:
    state = tmp_path / "state"
    first = held(state)
    shutil.rmtree(state)
    state.write_text("a file in its place")
    first.look()
    assert first.held
    state.unlink()
    first.look()
    with pytest.raises(InputError, match="another highside"):
        held(state)
    first.release()
