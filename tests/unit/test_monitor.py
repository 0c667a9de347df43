"""The monitor gives every frame one name and its counters always balance."""

from __future__ import annotations

import random

from hypothesis import example, given
from hypothesis import strategies as st

from highside.codec.frame import Frame
from highside.service.monitor import Monitor

MODULUS = 65536
PERIOD = 0.01


def monitor(modulus: int | None = MODULUS, **changes: float) -> Monitor:
    return Monitor(seq_modulus=modulus, range_g=changes.get("range_g", 20.0), stuck_frames=50)


def frame(index: int, *, seq: int | None = None, t_s: float | None = None, a: tuple[float, float, float] | None = None):
    noise = random.Random(index)
    ax, ay, az = a or (noise.gauss(0.1, 1e-4), noise.gauss(0.2, 1e-4), noise.gauss(0.97, 1e-4))
    return Frame((index if seq is None else seq) % MODULUS, index * PERIOD if t_s is None else t_s, 0.0, ax, ay, az)


def test_a_clean_stream_is_all_good():
    watch = monitor()
    assert all(watch.check(frame(i)) for i in range(1000))
    assert watch.counts.good == 1000
    assert watch.counts.gap == watch.counts.duplicate == watch.counts.late == watch.counts.resets == 0


def test_gaps_are_counted_exactly_through_the_wrap_of_the_counter():
    watch = monitor()
    kept = [i for i in range(65000, 67000) if i % 7]
    for i in kept:
        watch.check(frame(i))
    missing = 2000 - len(kept)
    assert watch.counts.gap == missing - sum(1 for i in (65000, 66999) if not i % 7)
    assert watch.counts.expected == watch.counts.good + watch.counts.gap


def test_an_outage_longer_than_a_turn_of_the_counter_is_counted_from_device_time():
    watch = monitor()
    for i in range(10):
        watch.check(frame(i))
    later = 10 + 3 * MODULUS + 500
    watch.check(frame(later))
    assert watch.counts.gap == later - 10


def test_duplicates_and_late_frames_are_not_used():
    watch = monitor()
    order = [0, 1, 2, 2, 3, 5, 4, 6]
    used = [i for i in order if watch.check(frame(i))]
    assert used == [0, 1, 2, 3, 5, 6]
    assert (watch.counts.duplicate, watch.counts.late, watch.counts.gap) == (1, 1, 1)


def test_a_device_that_begins_again_is_a_reset_not_a_gap():
    watch = monitor()
    for i in range(5000, 5100):
        watch.check(frame(i))
    for i in range(100):
        assert watch.check(frame(i))
    assert watch.counts.resets == 1
    assert watch.counts.gap == 0


def test_without_a_counter_gaps_come_from_device_time():
    watch = Monitor(seq_modulus=None, range_g=20, stuck_frames=50)
    for i in range(1000):
        if 300 <= i < 310 or i == 500:
            continue
        jitter = random.Random(i).uniform(-0.1, 0.1) * PERIOD
        watch.check(Frame(None, i * PERIOD + jitter, 0.0, 0.1, 0.2, 0.97 + i * 1e-6))
    assert watch.counts.gap == 11


def test_readings_out_of_range_or_absent_are_counted_and_not_used():
    watch = monitor()
    assert not watch.check(frame(0, a=(0.0, 25.0, 0.0)))
    assert not watch.check(frame(1, a=(float("nan"), 0.0, 1.0)))
    assert not watch.check(frame(2, a=(float("inf"), 0.0, 1.0)))
    assert watch.check(frame(3))
    assert (watch.counts.out_of_range, watch.counts.not_finite) == (2, 1)


def test_one_stuck_axis_is_named_once_and_released():
    watch = monitor()
    for i in range(200):
        ok = frame(i)
        watch.check(ok._replace(ay=0.25))
    assert watch.stuck_axes == ("ay",)
    assert watch.counts.stuck == {"ax": 0, "ay": 1, "az": 0}
    for i in range(200, 210):
        watch.check(frame(i))
    assert watch.stuck_axes == ()


def test_a_device_that_repeats_all_axes_is_frozen_until_it_moves_again():
    watch = monitor()
    for i in range(500):
        watch.check(frame(i, a=(0.1, 0.2, 0.97)))
    assert watch.stuck_axes == ()
    assert watch.frozen
    assert watch.counts.frozen == 1
    watch.check(frame(500))
    assert not watch.frozen
    for i in range(501, 520):
        watch.check(frame(i, a=(0.1, 0.2, 0.97)))
    assert not watch.frozen


@given(
    st.lists(
        st.tuples(st.integers(0, MODULUS - 1), st.floats(0, 1e6), st.floats(allow_nan=True, allow_infinity=True)),
        max_size=60,
    ),
    st.booleans(),
)
@example([(0, 0.0, 0.0), (0, 5e-324, 0.0), (0, 1.0, 0.0)], False)  # a step that no clock makes
def test_the_counters_balance_whatever_arrives(rows, with_counter):
    watch = monitor(MODULUS if with_counter else None)
    for seq, t_s, value in rows:
        watch.check(Frame(seq if with_counter else None, t_s, 0.0, value, 0.0, 1.0))
        assert watch.counts.balanced()
        assert watch.counts.gap >= 0
