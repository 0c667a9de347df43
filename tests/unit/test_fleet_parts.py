"""Results of a fleet in files: several in one, found again, and made without what costs a process its start."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from highside.errors import InputError
from highside.fleet.catalogue import Entry
from highside.fleet.flushed import TOGETHER
from highside.fleet.given_out import pieces
from highside.fleet.jobs import Order, empty_row
from highside.fleet.parts import PartStore
from highside.fleet.policy import TASKS
from highside.fleet.run import work_on
from highside.fleet.summary import summarise

TIMES = {"seconds": 0.25, "cpu_s": 0.125}


def row(name: str, **own: object) -> dict[str, object]:
    return empty_row("diagnose") | TIMES | {"verdict": name, **own}


def test_results_of_a_batch_are_one_part_and_are_read_as_they_were_written(tmp_path: Path) -> None:
    store = PartStore(tmp_path)
    written = {
        "b": row("named", claims=["lever_arm", "naïve"], rows=7, temp_c=21.5, score=[1 / 3, -2e-300], entry_of=[0, 3]),
        "a": row("error", error="", temp_c=None, freedom=4.0),
    }
    store.write(written)
    assert len(list((tmp_path / "parts").iterdir())) == 1
    assert store.read() == {key: {"key": key, **values} for key, values in written.items()}
    other = PartStore(tmp_path)
    assert not other.has("a")
    other.look()
    assert other.has("a") and other.has("b") and not other.has("c")


def test_what_another_process_wrote_is_seen_and_what_was_removed_is_not(tmp_path: Path) -> None:
    store, other = PartStore(tmp_path), PartStore(tmp_path)
    store.write({"a": row("named"), "b": row("named")})
    other.look()
    store.write({"c": row("unknown")})
    other.look()
    assert other.has("a") and other.has("c")
    assert (tmp_path / "parts" / "c.parquet").exists()
    for part in (tmp_path / "parts").glob("batch-*"):
        part.unlink()
    other.look()
    assert not other.has("a") and other.has("c")


@pytest.mark.parametrize("keys", ["a", "ab"])
def test_a_damaged_part_is_one_line(keys: str, tmp_path: Path) -> None:
    store = PartStore(tmp_path)
    store.write({key: row("named") for key in keys})
    store.write_catalogue([Entry("a.csv", "a")], {"a.csv": "a"}, "diagnose")
    (part,) = (tmp_path / "parts").iterdir()
    whole = part.read_bytes()
    for length in (len(whole) - 9, 2, 0):
        part.write_bytes(whole[:length])
        with pytest.raises(InputError, match="is damaged") as error:
            PartStore(tmp_path).look()
        assert part.name in str(error.value)
        with pytest.raises(InputError, match="is damaged"):
            summarise(PartStore(tmp_path))
    # damaged in the middle, it is seen when it is read
    part.write_bytes(whole[:40] + bytes(400) + whole[440:])
    with pytest.raises(InputError, match=r"cannot be read|is damaged") as error:
        summarise(PartStore(tmp_path))
    assert "\n" not in str(error.value)


def test_a_damaged_catalogue_is_one_line(tmp_path: Path) -> None:
    store = PartStore(tmp_path)
    store.write({"a": row("named")})
    store.catalogue.write_text("garbage")
    with pytest.raises(InputError, match=r"catalogue.parquet.*is damaged"):
        summarise(store)


def test_recordings_with_the_same_content_are_worked_on_once(tmp_path: Path) -> None:
    for name in ("one.csv", "two.csv", "three.csv"):
        (tmp_path / name).write_text("t_s,ax_g\n0,1\n" if name != "three.csv" else "t_s,ay_g\n0,1\n")
    order = Order("solve")
    pairs = [(str(tmp_path / name), order) for name in ("one.csv", "two.csv", "three.csv", "absent.csv")]
    found = work_on(pairs, str(tmp_path / "out"))
    assert [one.computed for one in found] == [True, False, True, False]
    assert found[0].key == found[1].key and found[3].key is None
    assert [path.name.startswith("batch-") for path in (tmp_path / "out" / "parts").iterdir()] == [True]
    assert not any(one.computed for one in work_on(pairs, str(tmp_path / "out")))


def test_a_process_of_a_fleet_imports_no_more_than_its_job(tmp_path: Path) -> None:
    program = """
import sys
from pathlib import Path
import highside.fleet.run
import highside.api.calibration
assert not {"scipy", "highside.config.model", "highside.rotation"} & set(sys.modules)
assert "highside.diagnosis.engine" not in sys.modules
from highside.fleet.flushed import TOGETHER
from highside.fleet.jobs import empty_row
from highside.fleet.parts import PartStore
store = PartStore(Path(sys.argv[1]))
a_row = empty_row("solve") | {"seconds": 1.0, "cpu_s": None}
store.write({"a": a_row, "b": a_row})
store.look()
print("pandas" in sys.modules)
"""
    pytest.importorskip("pandas")
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (0, "False\n"), done.stderr


@pytest.mark.parametrize(
    ("job", "processes", "seconds"), [("solve", 2, 1.25), ("diagnose", 2, 10), ("diagnose", 500, 5)]
)
def test_work_is_given_out_in_pieces_that_keep_all_processes_and_the_scheduler_free(
    job: str, processes: int, seconds: float
) -> None:
    """1,000 short recordings: a quarter of a process's share, at most 10 s, and no more tasks than a scheduler can."""
    entries = [Entry(f"{i}.csv", str(i), size=0) for i in range(1000)]
    cost = TASKS.seconds_of(job, 0)
    batches = list(pieces(entries, [cost] * 1000, TASKS.batch_seconds(1000 * cost, processes)))
    assert [entry for batch in batches for entry in batch] == entries
    sizes = [len(batch) * cost for batch in batches]
    assert max(sizes) <= seconds + 1e-9 and min(sizes[:-1]) > seconds - 2 * cost
    assert len(batches) >= min(processes, 1000 * cost / seconds)


def test_the_records_of_a_batch_are_whole_files_beside_its_part(tmp_path: Path) -> None:
    store = PartStore(tmp_path)
    solved = empty_row("solve") | TIMES | {"record": "{}"}
    rows = {k: solved | {"verdict": "done", "record_id": k * 64} for k in "abc"}
    store.write(rows | {"d": solved | {"verdict": "refused", "record_id": "d" * 64}})
    assert {path.name for path in (tmp_path / "records").iterdir()} == {f"{k * 64}.json" for k in "abc"}
    assert all(path.read_bytes() == b"{}" for path in (tmp_path / "records").iterdir())
    # where the records cannot be written there is no result either, which would say that all of it is there
    other = PartStore(tmp_path / "other")
    (tmp_path / "other" / "records").write_text("no folder")
    with pytest.raises(InputError, match=r"records.*cannot be (made|written)"):
        other.write(rows)
    assert not list((tmp_path / "other" / "parts").iterdir())


def test_a_part_has_its_name_when_its_records_are_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loss of power leaves no part whose records are missing or half there: each is flushed before it has its name,
    and their folder before the part has its own."""
    store = PartStore(tmp_path)
    happened: list[tuple[str, str]] = []
    flush, rename = os.fsync, os.replace

    def flushed(descriptor: int) -> None:
        happened.append(("flushed", str(Path(f"/proc/self/fd/{descriptor}").readlink())))
        flush(descriptor)

    def renamed(old: str | Path, new: str | Path) -> None:
        assert ("flushed", str(old)) in happened
        happened.append(("renamed", str(new)))
        rename(old, new)

    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(os, "replace", renamed)
    solved = empty_row("solve") | TIMES | {"record": "{}", "verdict": "done"}
    count = 2 * TOGETHER + 3
    store.write({f"{k}": solved | {"record_id": f"{k:064d}"} for k in range(count)})
    names = [name for what, name in happened if what == "renamed"]
    assert len(names) == count + 1 and Path(names[-1]).parent.name == "parts"
    of_folder = happened.index(("flushed", str(tmp_path / "records")), happened.index(("renamed", names[-2])))
    assert of_folder < happened.index(("renamed", names[-1]))
    assert len({path.name for path in (tmp_path / "records").iterdir()}) == count


def test_records_that_find_no_room_leave_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = PartStore(tmp_path)
    solved = empty_row("solve") | TIMES | {"record": "{}", "verdict": "done"}
    write, written = os.write, []

    def full(descriptor: int, data: bytes) -> int:
        written.append(descriptor)
        if len(written) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(InputError, match=r"records: cannot be written: No space left"):
        store.write({k: solved | {"record_id": k * 64} for k in "abcd"})
    assert not list((tmp_path / "records").iterdir()) and not list((tmp_path / "parts").iterdir())
    assert not store.has("a")
