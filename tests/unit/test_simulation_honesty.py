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
from studies import simulation_honesty as study

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
    change = Change(150.0, added, (1.3, 0.7), 10)
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
    changing = reported("lever_arm", 1e4, "step")
    assert "lever_arm" not in {claim.effect for claim in changing.claims}
    assert "lever_arm" in changing.remainder.changing


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
