"""Arrays too long for the memory: what numpy gives for the whole, run by run; and an error where it needs the whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from highside import long_arrays, scratch_arrays
from highside.errors import InputError
from highside.long_arrays import LongArray, by_runs, concatenated, counted, numbered_rows
from highside.scratch_arrays import ScratchColumns, evaluated, filed, stored

N = 150_001
"""more than two runs of rows"""
VALUES = np.random.default_rng(1).standard_normal((3, N))


@pytest.fixture(scope="module")
def long() -> LongArray:
    return filed(VALUES)


@pytest.mark.parametrize(
    "key",
    [
        (slice(None), slice(5, 9)),
        (slice(None), slice(65_530, 65_550)),
        (slice(None), slice(N - 3, N)),
        (slice(None), slice(7, 7)),
        (slice(None), slice(0, N, 50_000)),
        (1, slice(65_530, 131_080)),
        (slice(0, 2), slice(10, 12)),
        (slice(None), np.array([0, 5, 140_000, 140_001, -1])),
        (..., slice(3, 8)),
        (2, 17),
        (slice(None), -1),
    ],
)
def test_rows_are_those_of_the_whole(long: LongArray, key: object) -> None:
    np.testing.assert_array_equal(long[key], VALUES[key])  # type: ignore[index]


def test_a_channel_and_some_channels_are_long_still(long: LongArray) -> None:
    for key in (1, slice(0, 2), slice(None)):
        assert isinstance(long[key], LongArray)
        np.testing.assert_array_equal(long[key][..., 100_000:100_004], VALUES[key][..., 100_000:100_004])
    assert len(list(long)) == 3


def test_a_mask_picks_rows(long: LongArray) -> None:
    mask = np.zeros(N, dtype=bool)
    mask[[3, 70_000, N - 1]] = True
    np.testing.assert_array_equal(long[0][mask], VALUES[0][mask])


def test_functions_of_elements_are_evaluated_when_rows_are_read(long: LongArray) -> None:
    made = np.round(np.degrees(np.abs(long[0] - 2 * long[1])) % 7.0, 3)
    whole = np.round(np.degrees(np.abs(VALUES[0] - 2 * VALUES[1])) % 7.0, 3)
    assert isinstance(made, LongArray)
    np.testing.assert_array_equal(made[65_000:66_000], whole[65_000:66_000])
    np.testing.assert_array_equal(np.where(long[0] < 0, -1.0, 1.0)[:9], np.where(VALUES[0] < 0, -1.0, 1.0)[:9])
    np.testing.assert_array_equal((VALUES[0] * long[0])[9:12], VALUES[0, 9:12] ** 2)
    size = VALUES.std(axis=1, keepdims=True)
    np.testing.assert_array_equal((long / size)[:, 9:12], VALUES[:, 9:12] / size)


@pytest.mark.parametrize("name", ["sum", "mean", "std", "min", "max", "ptp"])
@pytest.mark.parametrize("axis", [None, 1, -1])
def test_sums_and_extremes_are_those_of_the_whole(long: LongArray, name: str, axis: int | None) -> None:
    own, whole = getattr(np, name)(long, axis=axis), getattr(np, name)(VALUES, axis=axis)
    np.testing.assert_allclose(own, whole, rtol=1e-12, atol=1e-9 if name == "sum" else 1e-14)
    if axis is not None and name != "ptp":
        assert getattr(long, name)(axis=axis, keepdims=True).shape == (3, 1)


@given(
    st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=40),
    st.integers(1, 3),
)
def test_the_median_is_exact(values: list[float], times: int) -> None:
    column = np.array(values * times)
    assert filed(column).median() == np.median(column)


@pytest.mark.parametrize("far", [1e-12, 1.0, 1e12])
def test_the_median_of_many_is_exact_where_one_is_far_off(far: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long_arrays, "_FEW", 100)
    column = 0.02 + 1e-9 * np.random.default_rng(2).standard_normal(N)
    column[77_777] = far
    assert np.median(filed(column)) == np.median(column)  # type: ignore[call-overload]


@pytest.mark.parametrize(
    "whole",
    [
        lambda a: np.asarray(a),
        lambda a: np.cumsum(a),
        lambda a: np.sort(a),
        lambda a: np.add.reduce(a),
        lambda a: list(a[0]),
        lambda a: np.stack([a, a]),
    ],
)
def test_what_needs_all_rows_at_once_is_an_error(long: LongArray, whole: object) -> None:
    with pytest.raises(TypeError, match="needs all rows of an array that is too long for the memory"):
        whole(long)  # type: ignore[operator]


def test_runs_of_any_length_are_one_array(long: LongArray) -> None:
    pieces = np.split(VALUES, [10, 10, 70_000, 70_001], axis=1)
    np.testing.assert_array_equal(stored(long, VALUES.shape, pieces)[:, 5:75_000], VALUES[:, 5:75_000])
    np.testing.assert_array_equal(stored(VALUES, VALUES.shape, pieces), VALUES)


def test_an_array_is_long_where_what_it_is_made_like_is(long: LongArray) -> None:
    assert isinstance(by_runs(VALUES, (4,), lambda part: np.arange(part.start, part.stop)), np.ndarray)
    np.testing.assert_array_equal(numbered_rows(long)[N - 2 :], [N - 2, N - 1])  # type: ignore[arg-type]
    both = concatenated([long[0][None], VALUES[1:2]])
    np.testing.assert_array_equal(both[:, 5:7], VALUES[:2, 5:7])
    np.testing.assert_array_equal(evaluated(long * 2.0)[:, 5:7], 2 * VALUES[:, 5:7])  # type: ignore[arg-type]


def test_values_are_counted_over_runs() -> None:
    rows = np.random.default_rng(3).integers(0, 9, 1000).astype(float)
    values, counts = counted(np.split(rows, [100, 350]))
    np.testing.assert_array_equal((values, counts), np.unique(rows, return_counts=True))


def test_columns_written_together_are_read_alone() -> None:
    into = ScratchColumns(["a", "b"])
    for rows in np.split(VALUES[:2], [0, 100, 70_000], axis=1):
        into.add({"b": rows[1], "a": rows[0]})
    columns = into.columns()
    np.testing.assert_array_equal(columns["b"][99:101], VALUES[1, 99:101])
    assert columns["a"].n == N


@pytest.mark.parametrize("offsets", [True, False])
def test_a_file_is_read_where_the_system_has_no_reads_at_an_offset(
    offsets: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not offsets:
        monkeypatch.delattr(scratch_arrays.os, "pread")
    column = filed(VALUES[0])
    for part in (slice(0, 4096), slice(N - 7, N), slice(100, 100)):
        np.testing.assert_array_equal(column[part], VALUES[0, part])


def test_no_room_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scratch_arrays.tempfile, "tempdir", "/absent")
    with pytest.raises(InputError, match=r"/absent: has no room for columns that do not fit.*TMPDIR"):
        filed(VALUES)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full (Linux)")
def test_a_full_disk_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    full = Path("/dev/full")
    monkeypatch.setattr(scratch_arrays.tempfile, "TemporaryFile", lambda **_: full.open("r+b", buffering=0))
    with pytest.raises(InputError, match=r"has no room for columns .*No space left.*TMPDIR"):
        filed(VALUES)


def test_a_file_that_cannot_be_read_back_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    column = filed(VALUES[0])
    monkeypatch.setattr(scratch_arrays.os, "pread", lambda *_: b"")
    with pytest.raises(InputError, match=r"a scratch file cannot be read back .0 of 80 bytes.*TMPDIR"):
        column[0:10]
