"""What a published table allows of its instrument: the truth is among it, and it knows what it does not know."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.table.chain import Procedure
from highside.diagnosis.table.explained import Explained, explain, prepare
from highside.diagnosis.table.policy import EXPLAINING
from highside.diagnosis.table.posterior import Posterior, instruments
from highside.papers.balance_session import INCLINATIONS_DEG, PaperPlan, cells_of, run_session
from highside.physics.forward import ForwardModel

FURTHER = pytest.mark.further

NOISE_G = 40e-6
MODEL = ForwardModel.of(
    {
        "bias": {"b_x": 3e-4, "b_y": -2e-4, "b_z": 5e-4},
        "scale": {"s_x": 2e-3, "s_y": -1e-3, "s_z": 1e-3},
        "base_tilt": {"tilt_x": 4e-4, "tilt_y": -3e-4},
        "pose_error": {
            "inc_station": EXPLAINING.step_rad,
            "tf_station": EXPLAINING.step_rad,
            "inc_pose": 0.0,
            "tf_pose": 0.0,
        },
    }
)


@pytest.fixture(scope="module")
def explained() -> Explained:
    session = run_session(PaperPlan.of_the_paper(), MODEL, NOISE_G, np.random.default_rng(3))
    table_given = cells_of(session.errors_deg())[0]
    free = ("bias", "scale", "misalignment")
    problem = prepare(
        np.array(INCLINATIONS_DEG), table_given, Procedure("conventional3"), ForwardModel.of({}), free, None, 1
    )
    return explain(problem, lambda share, words: None)


@pytest.fixture(scope="module")
def posterior(explained: Explained) -> Posterior:
    return instruments(explained, 120, 1)


@FURTHER
def test_probabilities_of_the_explanations_sum_to_one_and_all_hold_what_is_there(posterior: Posterior) -> None:
    assert abs(sum(e.probability for e in posterior.explanations) - 1.0) < 1e-9
    assert sum(e.probability for e in posterior.explanations if "base_tilt" in e.effects) > 0.9
    # effects too small to show are not excluded
    assert len(posterior.explanations) > 3


def test_sizes_and_noise_lie_about_the_true_ones(posterior: Posterior) -> None:
    tilts = [d.model.parameters()["base_tilt"] for d in posterior.draws if "base_tilt" in d.model.ids]
    for name, true in (("tilt_x", 4e-4), ("tilt_y", -3e-4)):
        low, high = np.quantile([t[name] for t in tilts], [0.001, 0.999])
        assert low - 5e-6 < true < high + 5e-6
    noise = np.array([d.noise_g for d in posterior.draws])
    assert 0.4 * NOISE_G < np.median(noise) < 2.5 * NOISE_G
    assert noise.std() > 0.02 * NOISE_G


def test_the_same_seed_gives_the_same_instruments(explained: Explained, posterior: Posterior) -> None:
    again = instruments(explained, 120, 1)
    assert [d.noise_g for d in again.draws] == [d.noise_g for d in posterior.draws]
    assert again.draws[7].model.parameters() == posterior.draws[7].model.parameters()


def test_draws_do_not_repeat_one_another(posterior: Posterior) -> None:
    assert len({d.noise_g for d in posterior.draws}) > 0.6 * len(posterior.draws)
    assert 5 < posterior.effective <= 2000
