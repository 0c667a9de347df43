"""The calibration methods judged against the truth, 200 simulated instruments on each kind of bench.

The table of all rivals is written by `studies/calibration_montecarlo.py`; this gate runs the same code. Seeds are
fixed, so that a failure is a change of the code. Over fresh seeds a correct estimator would fail in fewer than 1 run of
100: the ratio to the Cramer-Rao total scatters by 2 % on the affine benches (bar: 10 %) and by 4 % in the non-linear
study (bar: 15 %), where half of the error is that of the calibration.
"""

from __future__ import annotations

import numpy as np
import pytest

from highside.calibration.result import CalibrationResult
from studies import calibration_montecarlo as bench


@pytest.mark.parametrize("kind", ["independent", "common"])
def test_the_joint_estimator_reaches_the_cramer_rao_limit_on_both_kinds_of_bench(kind: str) -> None:
    study = bench.run(bench.KINDS[kind], 200, rivals=False)
    assert np.all(study.ratio_inc <= 1.1), study.ratio_inc
    assert np.all(study.ratio_tf <= 1.1), study.ratio_tf
    assert study.rms_tf[0] / study.limit_tf[0] <= 1.05
    for coverage in (study.coverage_inc, study.coverage_tf):
        assert np.all((coverage >= 0.93) & (coverage <= 0.97)), coverage
    assert all(0.93 <= share <= 0.97 for share in study.coverage_vertical)
    assert study.admitted == {"none": 200}, "a term was found that is not there"
    assert not study.remarks, "a good session was criticised"


@pytest.mark.parametrize("kind", ["nonlinear", "nonlinear-common"])
def test_the_full_model_finds_nonlinear_terms_and_pays_little_for_them(kind: str) -> None:
    study = bench.run(bench.KINDS[kind], 200, rivals=False)
    assert np.all(study.ratio_inc <= 1.15), study.ratio_inc
    assert np.all(study.ratio_tf <= 1.15), study.ratio_tf
    assert study.admitted.get("quadratic cubic cross", 0) >= 190
    assert 0.925 <= study.coverage_inc.mean() <= 0.97
    assert 0.925 <= study.coverage_tf.mean() <= 0.97


def test_it_beats_every_other_method_on_the_same_instruments() -> None:
    methods = bench.run(bench.KINDS["independent"], 30).methods
    joint, limit = methods.pop("joint with tilt"), methods.pop("limit: perfect calibration")
    assert len(methods) >= 5
    for name, figures in methods.items():
        assert all(joint[k] < figures[k] for k in range(3)), name
    assert joint[0] < 1.15 * limit[0]
    # and the order of the rest is that of the specification
    assert methods["conventional, 3 positions"][0] > methods["balance, a matrix a zone (without 90 deg)"][0]
    assert methods["plain 12-parameter least squares, the same poses"][0] > 3 * joint[0]


def test_without_the_tilt_pose_weights_make_toolface_worse_than_plain_least_squares() -> None:
    """Why the tilt is part of the model: the figure that the specification warns of."""
    from highside.calibration.joint import joint
    from highside.calibration.linear_errors import BenchAccuracy

    def level_bench(poses: object) -> CalibrationResult:
        return joint(poses, bench=BenchAccuracy(tilt_rad=1e-9), nonlinear="none", estimate_variances=False)  # type: ignore[arg-type]

    without = bench.run(bench.KINDS["independent"], 30, rivals=False, solve=level_bench)
    with_tilt = bench.run(bench.KINDS["independent"], 30)
    middle = int(np.argmin(np.abs(bench.ASCENDING - np.deg2rad(45.0))))
    plain = with_tilt.methods["plain 12-parameter least squares, the same poses"][2]
    assert np.rad2deg(without.rms_tf[middle]) > plain > 3 * np.rad2deg(with_tilt.rms_tf[middle])


def test_closures_of_good_sessions_follow_their_theory() -> None:
    p = np.concatenate([bench.run(bench.KINDS[kind], 40, rivals=False).closure_p for kind in ("independent", "common")])
    assert p.size == 2 * 40 * 11
    # uniform: the share below 0.05 is binomial, 880 closures, five standard deviations; uniform errors have light tails
    assert np.mean(p < 0.05) < 0.05 + 5 * np.sqrt(0.05 * 0.95 / p.size)
    assert np.mean(p < 1e-3) < 6 / p.size
    assert 0.4 < np.mean(p) < 0.62
