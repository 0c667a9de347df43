"""A wide step of time is rows that were lost, a row that was written late, or a step of the clock; each is said so."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.importing.core.stepping import wide_steps
from highside.importing.core.timing import RowFindings, rows_of

STEPS = st.sampled_from([1_000_000, 10_000_000, 20_000_000, 3_333_333])
"""ns"""


def found_in(ns: np.ndarray, counter: np.ndarray | None = None) -> RowFindings:
    return rows_of(ns, np.zeros(ns.size - 1, dtype=bool), lambda row: f"row {row}", counter=counter)


def jittered(rows: np.ndarray, step: int, share: float, seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, share * step, rows.size)
    return np.rint(rows * step + noise).astype(np.int64)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    step=STEPS, jitter=st.floats(0, 0.06), seed=st.integers(0, 10**6),
    lost=st.lists(st.tuples(st.integers(15, 280), st.integers(1, 18)), min_size=1, max_size=4),
)  # fmt: skip
def test_rows_that_were_lost_are_counted_and_placed(
    step: int, jitter: float, seed: int, lost: list[tuple[int, int]]
) -> None:
    kept = np.arange(400)
    for begin, count in lost:
        kept = kept[(kept < begin) | (kept >= begin + count)]
    widest = int(np.diff(kept).max())
    if widest > 18 or not np.all(np.diff(np.flatnonzero(np.diff(kept) > 1)) > 4):
        return
    found = wide_steps(jittered(kept, step, jitter, seed))
    assert int(found.lost.sum()) == 400 - kept.size
    assert not found.clock_ns.any() and not found.late.any()
    np.testing.assert_array_equal(found.after, np.flatnonzero(np.diff(kept) > 1) + 1)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    step=STEPS, jitter=st.floats(0, 0.06), seed=st.integers(0, 10**6),
    late=st.dictionaries(st.integers(2, 38), st.floats(0.65, 0.9), min_size=1, max_size=5),
)  # fmt: skip
def test_rows_that_were_written_late_are_not_lost(step: int, jitter: float, seed: int, late: dict[int, float]) -> None:
    ns = jittered(np.arange(400), step, jitter, seed)
    for place, share in late.items():
        ns[10 * place] += round(share * step)
    said = found_in(np.sort(ns)).lines
    assert len(said) == 1 and said[0].startswith(f"{len(late)} rows written late, none lost")


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    step=STEPS, jitter=st.floats(0, 0.02), seed=st.integers(0, 10**6), row=st.integers(20, 380),
    whole=st.integers(0, 17), part=st.floats(0.25, 0.75),
)  # fmt: skip
def test_a_clock_that_is_set_forward_by_no_whole_rows_has_lost_none(
    step: int, jitter: float, seed: int, row: int, whole: int, part: float
) -> None:
    moved = whole + part if whole else 0.6 + part / 5
    ns = jittered(np.arange(400), step, jitter, seed)
    ns[row:] += round(moved * step)
    found = wide_steps(ns)
    assert found.after.tolist() == [row] and found.lost.tolist() == [0]
    assert found.clock_ns[0] == pytest.approx(moved * step, abs=0.1 * step)
    (said,) = found_in(ns).lines
    assert said.startswith("1 steps of the clock by +") and said.endswith(f"none called lost, before: row {row}")


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    step=STEPS, jitter=st.floats(0, 0.06), seed=st.integers(0, 10**6), row=st.integers(20, 380),
    lost=st.integers(0, 6), moved=st.integers(1, 10),
)  # fmt: skip
def test_a_counter_of_the_device_tells_a_whole_step_of_the_clock_from_lost_rows(
    step: int, jitter: float, seed: int, row: int, lost: int, moved: int
) -> None:
    rows = np.concatenate((np.arange(row), np.arange(row + lost, 400 + lost)))
    ns = jittered(rows, step, jitter, seed)
    ns[row:] += moved * step
    found = wide_steps(ns, rows.astype(float))
    assert found.lost.tolist() == [lost]
    assert found.clock_ns[0] == pytest.approx(moved * step, abs=0.3 * step)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    step=STEPS, jitter=st.floats(0, 0.05), seed=st.integers(0, 10**6), row=st.integers(20, 380),
    moved=st.floats(1.8, 300),
)  # fmt: skip
def test_a_clock_that_is_set_back_begins_another_part_and_no_rows_are_mixed(
    step: int, jitter: float, seed: int, row: int, moved: float
) -> None:
    ns = jittered(np.arange(400), step, jitter, seed)
    ns[row:] -= round(moved * step)
    found = found_in(ns)
    assert [begin for begin, _ in found.parts] == [0, row]


@settings(max_examples=150, deadline=None, derandomize=True)
@given(
    step=STEPS, jitter=st.floats(0, 0.05), seed=st.integers(0, 10**6), row=st.integers(20, 350),
    block=st.integers(1, 20), behind=st.integers(1, 20),
)  # fmt: skip
def test_rows_out_of_order_are_put_where_their_time_belongs(
    step: int, jitter: float, seed: int, row: int, block: int, behind: int
) -> None:
    ns = jittered(np.arange(400), step, jitter, seed)
    order = np.concatenate(
        (np.arange(row), np.arange(row + block, row + block + behind), np.arange(row, row + block),
         np.arange(row + block + behind, 400))
    )  # fmt: skip
    found = found_in(ns[order])
    assert len(found.parts) == 1
    np.testing.assert_array_equal(ns[order][found.keep], ns)
    assert not any("lost" in line for line in found.lines)
