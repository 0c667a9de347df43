"""The laws of `diagnosis.laws` beside those of scipy.stats, which a short diagnosis does not wait for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2, linregress, t

from highside.diagnosis.core.probability import chi2_beyond, straight_line, student_beyond, student_quantile
from tests.few_poses import model_of_few_poses

FREEDOMS = [1.5, 2.0, 3.0, 4.0, 8.0, 30.0, 211.0, 1e4]


@pytest.mark.parametrize("freedom", FREEDOMS)
def test_students_law(freedom: float) -> None:
    values = np.array([-3.0, 0.0, 0.5, 2.0, 8.0, 40.0, 1e3])
    assert student_beyond(values, freedom) == pytest.approx(t.sf(values, freedom), rel=1e-12, abs=0)
    assert float(student_beyond(6.0, freedom)) == pytest.approx(t.sf(6.0, freedom), rel=1e-12, abs=0)
    for chance in (0.75, 0.975, 0.99):
        assert student_quantile(chance, freedom) == pytest.approx(t.ppf(chance, freedom), rel=1e-12)


def test_student_without_end_is_the_normal_law() -> None:
    assert student_quantile(0.975, np.inf) == pytest.approx(t.ppf(0.975, np.inf), rel=1e-12)


@pytest.mark.parametrize("freedom", [1, 2, 5, 60])
def test_chi_squared(freedom: int) -> None:
    for value in (0.0, 0.3, 4.0, 50.0, 600.0):
        assert chi2_beyond(value, freedom) == pytest.approx(chi2.sf(value, freedom), rel=1e-12, abs=0)


@pytest.mark.parametrize("slope", [0.0, 0.02, -3.0])
def test_a_straight_line(slope: float) -> None:
    at = np.linspace(5.0, 900.0, 20)
    level = slope * at + np.random.default_rng(7).standard_normal(20)
    found, p = straight_line(at, level)
    expected = linregress(at, level)
    assert found == pytest.approx(expected.slope, rel=1e-12)
    # where a correlation is one to the last digits, the chance is known to some digits only
    assert p == pytest.approx(expected.pvalue, rel=1e-12 if expected.pvalue > 1e-9 else 1e-6, abs=0)


def test_a_short_diagnosis_does_not_wait_for_scipy_stats(tmp_path: Path, project_root: Path) -> None:
    highside, model = Path(sys.executable).with_name("highside"), project_root / "config"
    made = [
        highside,
        "simulate",
        model_of_few_poses(tmp_path / "model.toml"),
        "-o",
        tmp_path / "s.csv",
        "--poses",
        tmp_path / "poses.csv",
    ]
    subprocess.run(made, capture_output=True, timeout=120, check=True)
    program = (
        "import sys; from highside.cli.main import app; app(sys.argv[1:], standalone_mode=False);"
        " print('stats:', sorted({'scipy.stats', 'scipy.signal'} & set(sys.modules)))"
    )
    asked = ["diagnose", tmp_path / "poses.csv", "--model", model / "model-known.toml", "--out", tmp_path / "out"]
    done = subprocess.run([sys.executable, "-c", program, *asked], capture_output=True, text=True, timeout=120)
    assert done.stdout.splitlines()[-1] == "stats: []", done.stderr
    assert (tmp_path / "out" / "diagnosis.json").is_file()


def test_a_level_line_is_no_slope() -> None:
    assert straight_line(np.arange(20.0), np.full(20, 0.01)) == (0.0, 1.0)
    assert straight_line(np.arange(20.0), 2.0 * np.arange(20.0)) == pytest.approx((2.0, 0.0), abs=1e-12)
