"""The watch where the noise of a sensor changes and its calibration does not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import highside
import studies.watch_means
from highside.arrays import Array
from highside.report.watch_page import page_of
from highside.watch import POLICY, STATED, Still, Watch
from highside.watch.axis_noise import AxisNoise, scatters
from highside.watch.bank import Update
from highside.watch.hold import Hold, noise_evidence, rests_of
from highside.watch.noise_level import NoiseLevel, robust_scale
from highside.watch.parameters import prior
from highside.watch.words import noise_words
from studies.survey_analysis import calibration
from studies.watch_noise import FROM, RESTS, Series, rows_of, streamed

AT_S = 900.0 * FROM + 30.0
"""the middle of the first rest after the change"""


def series(*, factors: tuple[float, float, float], step_g: float = 0.0, colour: str = "white") -> Series:
    return Series(colour, np.array(factors), np.array([step_g, 0.0, 0.0]))


def a_watch() -> Watch:
    return Watch(prior(np.eye(12) * 1e-10, 1e-6, 20.0, STATED, POLICY))


@pytest.mark.parametrize("colour", ["white", "1/f"])
def test_an_axis_that_becomes_noisy_is_named_and_nothing_departs(colour: str) -> None:
    rows = rows_of(3, series(factors=(1.0, 4.0, 1.0), colour=colour))
    made = highside.watch_recording(rows, calibration())
    for found in (made.found, streamed(rows)):
        assert found.verdict == "holds"
        (change,) = found.noise_changes
        assert change.axis == "y"
        assert change.factor == pytest.approx(4.0, rel=0.15)
        assert change.since_s == pytest.approx(AT_S, abs=5.0)
        # and its rests are used as before
        assert found.counts.stills >= RESTS - 1
        assert any("y has become" in line and "no departure" in line for line in found.advice)
    assert made.to_dict()["noise_changes"][0]["axis"] == "y"
    assert noise_words(made.found.noise_changes[0]) in page_of(made.found, "rows")


def test_noise_of_all_axes_is_said_to_be_the_tool_that_shakes_or_its_supply() -> None:
    found = highside.watch_recording(rows_of(4, series(factors=(5.0, 5.0, 5.0))), calibration()).found
    assert found.verdict == "holds"
    assert [one.axis for one in found.noise_changes] == ["x", "y", "z"]
    assert any("all axes" in line and "pumps" in line for line in found.advice)


def test_a_step_is_found_in_rests_that_have_become_noisy_at_the_same_time() -> None:
    """By the noise of the calm rests the noisy ones were none, and nothing of them was seen."""
    found = highside.watch_recording(rows_of(5, series(factors=(1.0, 1.0, 5.0), step_g=2e-3)), calibration()).found
    assert found.verdict == "departs"
    assert "b_x" in found.claims[0].equivalence_class
    assert [one.axis for one in found.noise_changes] == ["z"]


def test_a_tool_that_is_moved_slowly_is_not_taken_for_one_that_rests_noisily() -> None:
    """A turn of 0.2 deg/s about y, without gyros, between calm rests: on its own scale it is smooth."""
    rows = rows_of(6, series(factors=(1.0, 1.0, 1.0)))
    moving = (rows["t_s"] % 900.0 >= 64.0) & (rows["t_s"] > 5 * 900.0)
    t = np.arange(0.0, 60.0, 0.1)
    angle = np.radians(0.2) * t
    extra: dict[str, list[Array]] = {name: [] for name in ("t_s", "ax_g", "ay_g", "az_g")}
    rng = np.random.default_rng(1)
    for k in range(5, RESTS):
        for name, values in zip(extra, (900.0 * k + 70.0 + t, np.sin(angle), 0.0 * t, np.cos(angle)), strict=True):
            extra[name].append(values + (name != "t_s") * 3e-4 * rng.standard_normal(t.size))
    order = np.argsort(np.concatenate([rows["t_s"][~moving], *extra["t_s"]]))
    whole = {name: np.concatenate([rows[name][~moving], *extra[name]])[order] for name in extra}
    found = highside.watch_recording(whole | {"temp_c": np.full(order.size, 25.0)}, calibration()).found
    assert found.counts.stills == RESTS
    assert (found.verdict, found.noise_changes) == ("holds", ())


def test_noise_that_falls_again_is_no_change_any_more_and_a_few_rests_are_none() -> None:
    axes, rng = AxisNoise(POLICY), np.random.default_rng(8)
    said = []
    for k in range(40):
        noisy = np.array([1.0, 6.0, 1.0]) if 12 <= k < 24 else 1.0
        axes.take(600.0 * k, np.array([3e-4 * np.ones(3), 1e-4 * np.ones(3)]) * noisy * rng.uniform(0.9, 1.1, (2, 3)))
        said.append([one.axis for one in axes.changes()])
    assert not any(said[: 11 + POLICY.noise_confirm])
    assert all(one == ["y"] for one in said[11 + POLICY.noise_confirm : 23 + POLICY.noise_confirm])
    assert not any(said[23 + POLICY.noise_confirm :])


def test_an_axis_coarser_than_its_noise_is_said_nothing_of() -> None:
    """Its readings stay the same, or move by a whole step."""
    axes = AxisNoise(POLICY)
    for k in range(30):
        step = (k % 4 == 0) * 2e-4
        axes.take(600.0 * k, np.array([[step, 3e-4, 3e-4], [step, 1e-4, 1e-4]]))
    assert axes.changes() == ()
    assert axes.times(np.array([[0.0, 3e-4, 3e-4], [np.nan, 1e-4, 1e-4]])) == pytest.approx(np.ones(3))


def surveyed(seed: int, *, times: float = 1.0, step_g: float = 0.0, count: int = 65) -> Watch:
    """Rests whose rows scatter as ever, whatever happens to their means from the 40th on."""
    watch, rng = a_watch(), np.random.default_rng(seed)
    calm = np.array([3e-4 * np.ones(3), 1e-4 * np.ones(3)])
    for k in range(count):
        f = rng.standard_normal(3)
        noise = np.hypot(1e-5, STATED.still_floor_g) * (times if k >= 40 else 1.0)
        f = f / np.linalg.norm(f) * (1.0 + noise * rng.standard_normal())
        watch.still(Still(1800.0 * k, f + np.array([step_g, 0.0, 0.0]) * (k >= 40), 1e-5, 20.0, None, calm))
    return watch


def test_noise_from_rest_to_rest_that_no_rest_shows_in_itself_is_noise_and_a_step_a_step() -> None:
    """Some one jump of the noise in fifteen looks like a departure for as long as is waited."""
    noisy = [surveyed(700 + seed, times=6.0).result() for seed in range(8)]
    assert sum(one.verdict == "departs" for one in noisy) <= 2
    assert all(one.noise_grown or one.verdict == "departs" for one in noisy)
    for seed in range(6):
        (claim,) = surveyed(700 + seed, step_g=3e-4).result().claims
        assert "b_x" in claim.equivalence_class


def test_what_waits_is_kept_with_what_its_rows_say() -> None:
    noisy = np.array([9e-4 * np.ones(3), 1e-4 * np.ones(3)])
    watch, again = surveyed(701, count=40), a_watch()
    for k in range(2):
        watch.still(Still(1800.0 * (40 + k), np.array([1.001, 0.0, 0.0]), 1e-5, 20.0, None, noisy))
    assert watch.result().undecided == 2
    again.recall(watch.memory())
    for key, kept in watch.memory().arrays.items():
        assert again.memory().arrays[key] == pytest.approx(kept), key
    (_, times), _ = rests_of(watch.memory().arrays["held"])
    assert times == pytest.approx(np.full(3, 3.0), rel=1e-6)


def test_a_few_numbers_do_not_make_noise_that_is_as_stated_larger_than_chance_does() -> None:
    """Else the threshold is above its own value in half of all wells, and what departs is said late."""
    level = NoiseLevel(POLICY)
    for share in (np.arange(POLICY.scale_from) + 0.5) / POLICY.scale_from:
        innovation = 1.1 * norm.ppf(share)
        level.take(Update(np.eye(1), np.eye(1), np.eye(1), np.array([innovation])), np.eye(1), 1.0)
    assert level.expected_ratio() == pytest.approx(1.1, rel=0.02)
    assert level.surely_expected_ratio() == pytest.approx(1.0, rel=0.02)


def test_the_scale_of_normal_numbers_is_their_standard_deviation_and_bears_some_that_are_none() -> None:
    rng = np.random.default_rng(4)
    found = [robust_scale((2.0 * rng.standard_normal(60)) ** 2) for _ in range(400)]
    assert np.mean(found) == pytest.approx(2.0, rel=0.02)
    assert np.std(found) / 2.0 == pytest.approx(np.sqrt(0.5 / 60 / 0.75), rel=0.15)
    some = np.concatenate([rng.standard_normal(54), np.full(6, 100.0)])
    assert robust_scale(some**2) < 1.5
    assert robust_scale(np.zeros(8)) == 0.0


def test_scatter_is_that_of_neighbours_whatever_drifts() -> None:
    rng = np.random.default_rng(9)
    t = np.arange(0.0, 120.0, 0.05)
    c = 1e-3 * rng.standard_normal((3, t.size)) + 1e-4 * t
    found = scatters(t, c)
    assert found[0] == pytest.approx(np.full(3, 1e-3), rel=0.05)
    # forty readings in two seconds, and the drift of 0.2 mg in them
    assert found[1] == pytest.approx(np.full(3, np.hypot(1e-3 / np.sqrt(40), 2e-4 / np.sqrt(2))), rel=0.3)


def rests(watch: Watch, seed: int, *, times: float, step_g: float = 0.0, at: int = 40, count: int = 80) -> None:
    """Of means alone, without rows."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        f = rng.standard_normal(3)
        noise = np.hypot(1e-5, STATED.still_floor_g) * (times if k >= at else 1.0)
        f = f / np.linalg.norm(f) * (1.0 + noise * rng.standard_normal())
        watch.still(Still(600.0 * k, f + np.array([step_g, 0.0, 0.0]) * (k >= at), 1e-5, 20.0))


@pytest.mark.parametrize("seed", range(6))
def test_noise_that_jumps_from_one_rest_to_the_next_is_noise_and_a_step_a_step(seed: int) -> None:
    """Means alone, of which the first that is far off may be either: those after it tell."""
    noisy, stepped = a_watch(), a_watch()
    rests(noisy, 800 + seed, times=6.0)
    said = noisy.result()
    assert said.verdict != "departs"
    assert said.noise_grown
    assert said.noise_ratio == pytest.approx(6.0, rel=0.4)
    rests(stepped, 800 + seed, times=1.0, step_g=1e-3)
    (claim,) = stepped.result().claims
    assert "b_x" in claim.equivalence_class
    # within four rests of the first
    assert 24_000.0 <= claim.alarm_s <= 24_000.0 + 4 * 600.0


def test_while_noise_and_a_departure_are_not_told_apart_that_is_said_and_outlives_a_restart() -> None:
    watch, again, whole = a_watch(), a_watch(), a_watch()
    rests(watch, 801, times=1.0, step_g=1e-3, count=41)
    said = watch.result()
    assert said.verdict == "learning"
    assert said.undecided == 1
    assert "noise that has grown, or a departure" in said.advice[0]
    again.recall(watch.memory())
    assert again.result().undecided == 1
    rests(whole, 801, times=1.0, step_g=1e-3, count=46)
    rng = np.random.default_rng(801)
    for k in range(46):
        f = rng.standard_normal(3)
        f = f / np.linalg.norm(f) * (1.0 + np.hypot(1e-5, STATED.still_floor_g) * rng.standard_normal())
        if k > 40:
            again.still(Still(600.0 * k, f + np.array([1e-3, 0.0, 0.0]), 1e-5, 20.0))
    assert again.alarm_s == whole.alarm_s is not None
    assert again.result().claims[0].parameters == whole.result().claims[0].parameters


def test_a_step_in_means_alone_is_said_within_two_hours_of_surveys() -> None:
    """0.3 mg, a survey each half hour: what it leaves is noise as expected, which noise of no size does.
    The evidence that the best hypothesis had by chance before is no reason to wait longer."""
    said = [studies.watch_means.run(1000 * seed, 1800.0, (), 3e-4) for seed in range(90_000, 90_010)]
    assert all(one.named for one in said)
    assert sum(one.after is not None and one.after <= 4 for one in said) >= 8


@pytest.mark.parametrize(
    ("squares", "explained", "over", "found"),
    [
        (80.0, 76.0, True, "departure"),  # what the departure leaves is noise as expected
        (83.0, 53.4, True, "noise"),  # above the threshold, but noise of the best size explains it better
        (70.0, 40.0, False, "noise"),  # the same below the threshold: an alarm would follow with the next odd mean
        (44.0, 36.0, False, "neither"),  # the likelier of the two is below the threshold yet
        (12.0, 3.0, False, "neither"),
    ],
)
def test_at_the_end_of_the_wait_the_likelier_is_taken(squares: float, explained: float, over: bool, found: str) -> None:
    hold = Hold(a_watch().memory(), 1.0)
    for _ in range(POLICY.jump_wait):
        hold.add(Still(0.0, np.array([0.0, 0.0, 1.0]), 1e-5), np.sqrt([squares / POLICY.jump_wait]))
    assert hold.judged(explained, POLICY, over=over) == found


def test_one_mean_far_off_is_waited_with_whatever_explains_it() -> None:
    hold = Hold(a_watch().memory(), 1.0)
    for k in range(POLICY.jump_fewest):
        hold.add(Still(0.0, np.array([0.0, 0.0, 1.0]), 1e-5), np.array([30.0 * (k == 0)]))
        found = hold.judged(900.0, POLICY, over=True)
        assert found == ("departure" if k == POLICY.jump_fewest - 1 else "undecided")


@pytest.mark.parametrize("damage", ["held", "noise_rests", "noise_changed", "jump"])
def test_a_memory_of_noise_that_is_none_is_refused(damage: str) -> None:
    watch = a_watch()
    rests(watch, 801, times=1.0, step_g=1e-3, count=41)
    memory = watch.memory()
    wrong: dict[str, Any] = {**memory.arrays, damage: np.full((2, 3), -1.0)}
    with pytest.raises(ValueError, match=r"shape|none"):
        a_watch().recall(replace(memory, arrays=wrong))


def test_noise_as_it_was_expected_is_no_evidence() -> None:
    assert noise_evidence(3.0, 4) == 0.0
    assert noise_evidence(36.0, 1) == pytest.approx(35.0 - np.log(36.0))
