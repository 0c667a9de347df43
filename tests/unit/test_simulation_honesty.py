"""Beside another program's prediction: no "nothing" over a large misfit, and no name for a size that changes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import chdtrc, fdtrc

from highside.diagnosis.core.regression import log10_p
from highside.diagnosis.core.stability import Change
from highside.diagnosis.rows.gram import Gram, HeldOutRows
from highside.diagnosis.rows.policy import GRAMS
from highside.diagnosis.simulation.band import humps
from highside.diagnosis.simulation.design import SimulationDesign
from highside.diagnosis.simulation.independence import NoNoise, hidden_motions, no_noise
from highside.diagnosis.simulation.turning import angular_acceleration, noise_of_rate
from highside.report.diagnosis_words import verdict_words
from studies import simulation_honesty as study

FURTHER = pytest.mark.further

SEED = 41


def reported(case: str, strength: float, course: str = "constant") -> study.DiagnosisResult:
    motion = study.Motion(SEED)
    added = study.COURSES[course]() * study.made(case, motion, strength)
    return study.reported(motion, added, "white", SEED, laws=False)


def test_noise_that_is_known_for_certain_is_judged_by_chi_squared() -> None:
    gain, dof = np.array([3.0, 25.0, 0.0]), np.array([1, 3, 0])
    known = log10_p(gain, dof, np.inf)
    assert known[:2] == pytest.approx(-np.log10(chdtrc(dof[:2], gain[:2])), rel=1e-6)
    assert known[2] == pytest.approx(0.0, abs=1e-9)
    mixed = log10_p(gain, dof, np.array([np.inf, 40.0, 40.0]))
    assert mixed[:2] == pytest.approx([known[0], -np.log10(fdtrc(3, 40.0, 25.0 / 3))], rel=1e-6)


@pytest.mark.parametrize(("added", "stable"), [(4.0, True), (22.0, False), (60.0, False)])
def test_a_change_of_a_size_is_judged_by_its_own_chance(added: float, stable: bool) -> None:
    """It was no number, and no change was ever believed; between the two thresholds one is."""
    change = Change(150.0, added, (1.3, 1.3, 0.7), 10)
    assert np.isfinite(change.log_p)
    assert change.stability.stable is stable
    assert not change.chosen.stable


@pytest.mark.parametrize("strength", [3e3, 1e6])
def test_a_line_of_fixed_frequency_is_a_tone_and_no_noise(strength: float) -> None:
    """The filter that learns the noise took it for colour: nothing was left out, at any strength."""
    found = reported("tone", strength)
    assert [claim.effect for claim in found.claims] == ["tone"]
    frequency = found.claims[0].parameters["f"]
    assert frequency.value == pytest.approx(1.7, abs=max(5 * frequency.std, 1e-4))


@pytest.mark.parametrize("strength", [1e4, 1e6])
def test_motion_that_the_prediction_lacks_is_not_nothing(strength: float) -> None:
    found = reported("missing motion", strength)
    assert found.verdict != "nothing_left_out"
    assert any("something moves that the prediction does not have" in hint for hint in found.remainder.hints)


@pytest.mark.parametrize("noise", study.NOISES)
def test_no_noise_of_a_sensor_stands_out_of_its_own_spectrum(noise: str) -> None:
    motion = study.Motion(SEED)
    drawn = study.noise_of(noise, np.random.default_rng(3), motion.at(study.T_S))
    assert humps(drawn, 1 / study.RATE_HZ, None, study.NAMES, study.NAMES) == ()


def test_a_lever_arm_whose_size_changes_has_not_that_name() -> None:
    constant = reported("lever_arm", 1e4)
    assert [(claim.effect, claim.stable) for claim in constant.claims] == [("lever_arm", True)]
    # it was found 12 to 16 % too long: differences of neighbouring rows are smaller than the acceleration
    per_unit = study.CASES["lever_arm"][0](motion := study.Motion(SEED), motion.at(study.T_S))
    for name, arm_m in (("r_x", 1e-2), ("r_y", -4e-3), ("r_z", 6e-3)):
        size, scaled = constant.claims[0].parameters[name], study.of_strength(per_unit, 1e4)
        true = arm_m * float(np.linalg.norm(scaled) / np.linalg.norm(per_unit))
        assert abs(size.value - true) < 3 * size.std
    changing = reported("lever_arm", 1e4, "step")
    assert "lever_arm" not in {claim.effect for claim in changing.claims}
    assert "lever_arm" in changing.remainder.changing


def test_a_small_claim_that_a_product_does_as_well_withdraws_no_large_one() -> None:
    """Beside a lever arm of strength 1e2 to 1e6 the noise of this seed looks like a square, or like a product."""
    motion = study.Motion(822)
    thrown = motion.thrown(np.random.default_rng(822).standard_normal(3))
    added = study.of_strength(np.concatenate([thrown, np.zeros_like(thrown)]), 1e4)
    found = study.reported(motion, added, "white", 822, laws=False)
    assert [claim.effect for claim in found.claims] == ["lever_arm"]


def test_an_angular_acceleration_is_that_of_the_motion_and_not_of_the_noise() -> None:
    """Beside a car's measured yaw rate an exact derivative was noise: neither arm nor centripetal term was found."""
    rng, step_s, raw_hz = np.random.default_rng(4), 0.05, 100.0
    raw_s, grid_s = np.arange(0.0, 60.0, 1 / raw_hz), np.arange(0.0, 60.0, step_s)
    turns = [(hz, rng.uniform(0, 6)) for hz in (0.3, 0.7, 4.0)]

    def rate(t_s: study.Array, derived: int) -> study.Array:
        waves = [(2 * np.pi * f) ** derived * np.sin(2 * np.pi * f * t_s + p + derived * np.pi / 2) for f, p in turns]
        return np.asarray(waves[0] + waves[1] + 0.02 * waves[2])

    quiet = angular_acceleration(rate(grid_s, 0), step_s, noise_of_rate(raw_s, rate(raw_s, 0), 8.0))
    inner = slice(20, -20)
    assert np.std((quiet - rate(grid_s, 1))[inner]) < 0.01 * np.std(rate(grid_s, 1))
    noise = 0.1 * rng.standard_normal(raw_s.size)
    density = noise_of_rate(raw_s, rate(raw_s, 0) + noise, 8.0)
    assert density == pytest.approx(2 * 0.1**2 / raw_hz, rel=0.3)
    loud = rate(grid_s, 0) + noise[:: round(step_s * raw_hz)] * np.sqrt(2 * 8.0 / raw_hz)
    off = angular_acceleration(loud, step_s, density) - rate(grid_s, 1)
    assert np.std(off[inner]) < 0.5 * np.std((angular_acceleration(loud, step_s, 0.0) - rate(grid_s, 1))[inner])


def test_what_one_stretch_alone_shows_is_not_extrapolated_from_the_others() -> None:
    """Rounding of what is left of it was divided by itself: squares of that overflowed."""
    rng = np.random.default_rng(4)
    keys = [(fold, -1, True) for fold in range(GRAMS.folds)]
    rows = rng.standard_normal((GRAMS.folds, 3, 50))
    rows[1:, 1] *= 1e-7
    rows[0, 1] *= 1e3
    parts = {key: own @ own.T for key, own in zip(keys, rows, strict=True)}
    gram = Gram(parts, np.zeros((3, 1)), np.ones(1), dict.fromkeys(keys, 50.0), np.zeros(1))
    design = SimpleNamespace(where=np.array([[0], [1]]), base=np.array([0]))
    held = HeldOutRows(design, [gram])  # type: ignore[arg-type]
    before, after = (held.energies(np.array(own, dtype=np.intp), held.folds) for own in ([], [1]))
    assert after == pytest.approx(before, rel=0.2)


def none_of(noise: str, seed: int) -> study.DiagnosisResult:
    motion = study.Motion(seed)
    return study.reported(motion, np.zeros((6, study.T_S.size)), noise, seed, laws=False)


@pytest.mark.parametrize(("noise", "seed"), [("AR 0.7", 101), ("coloured", 101), ("AR 0.97", 103)])
def test_what_a_filter_leaves_of_slow_colour_is_a_memory_and_no_effect(noise: str, seed: int) -> None:
    """Beside random walks alone these were `temperature_scale`, and twice a walk."""
    found = none_of(noise, seed)
    assert found.verdict == "nothing_left_out", study.short(found)
    assert max(found.noise["memory_evidence"]) > 12.0


@pytest.mark.parametrize(
    ("noise", "seed"), [("walk", 6004), ("walk", 6009), ("walk", 20014), ("walk", 20021), ("coloured", 6012)]
)
def test_what_a_random_walk_or_chance_explains_as_well_is_no_alarm(noise: str, seed: int) -> None:
    """Offsets and products were found beside random walks, which were taken to begin with the recording and had to be
    beaten by names alone; and candidates and scan had an alarm of one in a hundred each."""
    found = none_of(noise, seed)
    assert found.verdict in {"nothing_left_out", "wander", "not_testable"}, study.short(found)


def test_an_offset_that_exceeds_a_random_walk_is_found_beside_it() -> None:
    motion = study.Motion(20014)
    found = study.reported(motion, study.made("bias", motion, 1e4), "walk", 20014, laws=False)
    assert any("bias" in (claim.effect, *claim.equivalence_class) for claim in found.claims), study.short(found)


def departing(rows: study.Array) -> NoNoise | None:
    white = rows / rows.std(axis=1, keepdims=True)
    return no_noise(rows, white, 0.08, None, [f"c{k}" for k in range(len(rows))])


def test_chance_of_a_rising_spectrum_and_of_a_shared_departure_is_as_stated() -> None:
    rng = np.random.default_rng(6)
    drawn = rng.standard_normal((150, 4, 600))
    # falling spectra too: they are farther from rising
    walking = 0.1 * np.cumsum(drawn[:50], axis=2) + rng.standard_normal((50, 4, 600))
    assert sum(departing(rows) is not None for rows in [*drawn, *walking]) <= 2


@pytest.mark.parametrize("size", [0.5, 5.0, 500.0])
def test_a_departure_in_a_band_or_on_two_channels_is_no_noise(size: float) -> None:
    rng = np.random.default_rng(8)
    rows, t = rng.standard_normal((4, 600)), 0.08 * np.arange(600)
    band = rows.copy()
    band[2] += size * sum(
        np.sin(2 * np.pi * f * t + p) for f, p in zip((1.3, 1.5, 1.61, 1.83), rng.uniform(0, 6, 4), strict=True)
    )
    found = departing(band)
    assert found is not None
    assert found.channels == (2,)
    assert "c2 departs more from" in found.words
    both = rows.copy()
    both[[0, 3]] += 2 * size * rng.standard_normal(600)
    found = departing(both)
    assert found is not None
    assert found.channels == (0, 3)


def in_octave(rng: np.random.Generator, size: float, channels: int) -> study.Array:
    """Motion of an rms size in an octave from 0.83 to 1.7 Hz, (channels, 600) rows of 0.08 s."""
    waves = np.zeros((channels, 301), dtype=complex)
    waves[:, 40:80] = rng.standard_normal((channels, 40)) + 1j * rng.standard_normal((channels, 40))
    moved = np.fft.irfft(waves, n=600, axis=1)
    return np.asarray(moved * size / np.sqrt(np.mean(moved**2)))


def test_what_moves_several_channels_is_told_where_on_each_it_is_too_little() -> None:
    rng = np.random.default_rng(12)
    told = 0
    for _ in range(30):
        rows = rng.standard_normal((6, 600))
        rows[:3] += in_octave(rng, 0.37, 3)
        told += no_noise(rows, rows, 0.08, None, study.NAMES) is not None
    # by each channel alone, and all six together, it was a third
    assert told >= 20


def test_the_size_of_motion_that_would_not_show_holds() -> None:
    rng = np.random.default_rng(13)
    names = study.NAMES
    told = 0
    for _ in range(30):
        rows = rng.standard_normal((6, 600))
        accelerations, rates = hidden_motions(rows, 0.08, None, names)
        assert (accelerations.channels, rates.channels) == (names[:3], names[3:])
        size = next(rms for low, high, rms in accelerations.octaves if low < 1.2 < high)
        assert 0.2 < size < 0.6
        rows[:3] += in_octave(rng, size, 3)
        told += no_noise(rows, rows, 0.08, None, names) is not None
    assert told >= 24


@pytest.mark.parametrize("strength", [1e2, 3e2])
def test_motion_that_is_too_small_to_be_told_lies_within_the_size_that_is_stated(strength: float) -> None:
    """It was "nothing was left out", without a word of how much could be there."""
    motion = study.Motion(SEED)
    added = study.made("missing motion", motion, strength)
    found = study.reported(motion, added, "white", SEED, laws=False)
    if found.verdict != "nothing_left_out":
        return
    (accelerations, _) = found.noise["hidden_motion"]
    assert accelerations["channels"] == ["ax_g", "ay_g", "az_g"]
    size = next(one["rms"] for one in accelerations["octaves"] if one["from_hz"] < 1.2 < one["to_hz"])
    # of the motion, some 1.6 octaves, the better part lies in this one
    assert size > 0.8 * np.sqrt(np.mean(added[:3] ** 2))
    words = verdict_words(found)
    assert words.startswith("No effect was found.")
    assert "rms, by the octave, of ax_g, ay_g, az_g" in words


@pytest.mark.parametrize("seed", [33000, 33002])
def test_motion_that_no_noise_makes_is_located_whatever_the_colour_of_the_noise(seed: int) -> None:
    """It was not testable: "an error of the noise's colour", which the test does not rest on."""
    motion = study.Motion(seed)
    found = study.reported(motion, study.made("missing motion", motion, 5e2), "white", seed, laws=False)
    assert found.verdict == "unknown"
    assert set(found.location[0].channels) == {"ax_g", "ay_g", "az_g"}
    assert any("0.83 to 1.6 Hz" in hint for hint in found.remainder.hints)


def test_a_delay_that_changes_is_located_where_it_is_small() -> None:
    """At this strength it was nothing."""
    found = reported("delay by time", 3e2)
    assert found.verdict != "nothing_left_out"
    assert any("t_s x the change of the prediction" in place.covariate for place in found.location)


@pytest.mark.parametrize("seed", [pytest.param(1, marks=FURTHER), pytest.param(2, marks=FURTHER), 3])
def test_no_misfit_above_the_noise_is_nothing(seed: int) -> None:
    """Random smooth functions of time, of a rate or of a load, on a channel or two, over six decades of strength."""
    rng = np.random.default_rng(seed)
    motion = study.Motion(SEED)
    clean = motion.at(study.T_S)
    along = [study.T_S, clean[rng.integers(3, 6)], clean[rng.integers(3)]][seed % 3]
    u = 2 * np.pi * (along - along.min()) / np.ptp(along)
    course = sum(rng.standard_normal() * np.sin(k * u / 2 + rng.uniform(0, 6)) / k for k in range(1, 6))
    added = np.zeros_like(clean)
    added[rng.permutation(6)[:2]] = course
    added = added * study.SIGMA
    for strength in (1e3, 1e5, 1e7, 1e9):
        found = study.reported(motion, study.of_strength(added, strength), "white", SEED, laws=False)
        assert found.verdict != "nothing_left_out", (strength, study.short(found))


@pytest.mark.parametrize("strength", [3e3, 1e6])
def test_a_step_of_an_offset_is_named_with_its_instant(strength: float) -> None:
    """It was a random walk below a strength of 1e5."""
    found = reported("step", strength)
    assert [claim.effect for claim in found.claims] == ["bias_step"], study.short(found)
    instant = found.claims[0].parameters["t0"]
    assert instant.value == pytest.approx(0.55 * study.LENGTH_S, abs=5 * instant.std)


@pytest.mark.parametrize("seed", [701, 702])
def test_the_instant_of_a_small_step_is_not_moved_by_all_that_explains_a_part_of_it(seed: int) -> None:
    """All columns together do most of what a step does: beside all of them it was found 10 s too early."""
    motion = study.Motion(seed)
    clean = motion.at(study.T_S)
    noise = study.SIGMA * np.random.default_rng(seed + 10_000).standard_normal(clean.shape)
    rows = clean + study.made("gyro step", motion, 3e2) + noise
    recorded = {"t_s": study.T_S, **dict(zip(study.NAMES, rows, strict=True)), "temp_c": study.TEMP_C}
    predicted = {"t_s": study.T_S, **dict(zip(study.NAMES, clean, strict=True))}
    design = SimulationDesign(study.simulation_session(recorded, predicted), (), {})
    (step,) = (one for one in design.candidates if one.id == "gyro_bias_step")
    assert min(abs(v.shape["t0"] - 0.4 * study.LENGTH_S) for v in step.variants) < 1.5
    # rows beside which the noise is learned hold one step of each kind at most
    assert all(n - own.size <= 1 for n, own in zip(design.sizes, design.before_noise, strict=True))


def test_a_step_of_a_gyro_is_named_though_it_leaves_a_little_correlated_noise() -> None:
    motion = study.Motion(41)
    found = study.reported(motion, study.made("gyro step", motion, 3e3), "white", 41, laws=False)
    assert [claim.effect for claim in found.claims] == ["gyro_bias_step"], study.short(found)


@pytest.mark.parametrize(("case", "word"), [("value of g", "value of g"), ("unit of rates", "unit of rates")])
def test_one_factor_of_all_channels_is_a_constant_of_the_simulation(case: str, word: str) -> None:
    found = reported(case, 1e4)
    assert any(word in hint for hint in found.remainder.hints), found.remainder.hints
    # of one channel it is a scale factor of the sensor
    assert not any("times the prediction" in hint for hint in reported("scale", 1e4).remainder.hints)


def test_the_edge_of_a_low_pass_is_no_line() -> None:
    assert none_of("heavy", 5012).verdict == "nothing_left_out"


def test_a_lag_of_one_kind_of_channels_has_the_columns_of_its_own_time_constant() -> None:
    """Those of the first that is tried were taken: nothing was left to fit, an internal error."""
    motion = study.Motion(721)
    found = study.reported(motion, study.made("unit of rates", motion, 1e2), "white", 721, laws=False)
    assert found.verdict != "nothing_left_out"
