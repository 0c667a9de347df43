"""An offset that oscillates in time is told with its period, and what sets in with another quantity is in its class."""

import numpy as np
import pytest

from highside.api.diagnosis import Diagnosis, diagnose
from highside.config.model import Model
from highside.physics.gravity import gravity_direction
from highside.physics.law import Law
from highside.report.diagnosis_claims import law_words

FURTHER = pytest.mark.further
ROW_G = 5e-5
MODEL = Model.model_validate({"sensor": {"free": ["bias", "scale", "misalignment"]}})
ROWS, STEP_S = 24, 1.0
"""of a pose"""


def grid(seed: int, shuffled: bool = False) -> dict[str, np.ndarray]:
    """Twelve toolfaces at each of five inclinations, one after the other, the moves of uneven length."""
    rng = np.random.default_rng(seed)
    inc, tf = np.repeat([15.0, 40.0, 75.0, 110.0, 150.0], 12), np.tile(np.arange(12) * 30.0, 5)
    order = rng.permutation(inc.size) if shuffled else np.arange(inc.size)
    began = np.cumsum(rng.uniform(34.0, 52.0, inc.size))
    t_s = (began[:, None] + STEP_S * np.arange(ROWS)).reshape(-1)
    pose = np.repeat(np.arange(inc.size), ROWS)
    temp = 24.0 + 8.0 * (1.0 - np.exp(-t_s / 900.0))
    return {
        "t_s": t_s,
        "temp_c": temp,
        "inc_ref_deg": inc[order][pose],
        "tf_ref_deg": tf[order][pose],
        "pose": pose * 1.0,
    }


def diagnosed(columns: dict[str, np.ndarray], added: np.ndarray, tf_rad: np.ndarray | float = 0.0) -> Diagnosis:
    """Readings (3, N) that differ by an addition, and the toolface by an error."""
    rng = np.random.default_rng(8)
    inc, tf = np.radians(columns["inc_ref_deg"]), np.radians(columns["tf_ref_deg"]) + tf_rad
    read = 1.001 * np.asarray(gravity_direction(inc, tf), dtype=float) + rng.normal(0, 2e-3, (3, 1)) + added
    read = read + rng.normal(0, ROW_G, read.shape)
    return diagnose({**columns, **{f"a{axis}_g": read[k] for k, axis in enumerate("xyz")}}, MODEL)


@pytest.mark.parametrize(
    ("period_s", "size_g"),
    [
        (192.3, 6e-5),
        pytest.param(192.3, 2e-3, marks=FURTHER),
        pytest.param(192.3, 5e-2, marks=FURTHER),
        pytest.param(76.3, 2e-4, marks=FURTHER),
        (76.3, 2e-2),
    ],
)
def test_a_tone_is_told_with_its_period_whatever_its_size(period_s: float, size_g: float) -> None:
    """Between poses that follow one another at a regular pace it looked like surfaces of toolface and temperature."""
    columns = grid(1)
    tone = size_g * np.sin(2 * np.pi * columns["t_s"] / period_s + np.array([[0.0], [1.0], [2.0]]))
    made = diagnosed(columns, tone)
    assert [(claim.place, claim.depends_on) for claim in made.claims] == [("offset", ("time",))]
    (axis,) = Law.from_dict(made.claims[0].law or {}).axes
    assert [function.kind for function in axis.functions] == ["sine", "cosine_of"]
    assert axis.functions[0].numbers[0] == pytest.approx(period_s, rel=0.01)
    assert "pump" in " ".join(made.claims[0].readings)
    assert "oscillates with a period of" in law_words(made.claims[0])


def test_what_sets_in_with_an_inclination_may_be_of_the_inclination() -> None:
    columns = grid(2)
    dent = np.exp(-(((columns["tf_ref_deg"] - 120.0) / 40.0) ** 2)) * (columns["inc_ref_deg"] > 60.0)
    made = diagnosed(columns, np.zeros((3, 1)), 1e-3 * dent)
    (claim,) = made.claims
    assert claim.place == "toolface"
    follows = [
        set(claim.depends_on),
        *(set(name.partition("_tf_")[2].split("_x_")) for name in claim.equivalence_class),
    ]
    assert {"tf", "inc"} in follows


@FURTHER
def test_in_an_order_at_random_it_is_the_inclination_alone() -> None:
    columns = grid(2, shuffled=True)
    dent = np.exp(-(((columns["tf_ref_deg"] - 120.0) / 40.0) ** 2)) * (columns["inc_ref_deg"] > 60.0)
    made = diagnosed(columns, np.zeros((3, 1)), 1e-3 * dent)
    assert all("time" not in claim.depends_on for claim in made.claims)
