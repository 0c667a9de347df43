"""Bench or sensor, of a session whose misfit has no name in the library."""

import numpy as np
import pytest

from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from highside.report.bench_or_sensor import bench_or_sensor
from highside.units import STANDARD_GRAVITY_MPS2
from studies.open_world import world


def test_a_law_is_told_as_the_part_it_acts_in() -> None:
    """The page of a session ended in an internal error where the diagnosis had a law."""
    rng = np.random.default_rng(5)
    inc = np.radians(np.repeat(np.arange(10, 171, 20.0), 12))
    tf = np.radians(np.tile(np.arange(0, 360, 30.0), 9))
    lean = 2e-3 * np.tanh((np.arange(inc.size) / inc.size - 0.6) / 0.1)
    readings = world.euler_up(inc, tf, np.zeros(inc.size), lean) + rng.normal(0, 2e-5, (3, inc.size))
    columns = {name: row.tolist() for name, row in zip(("ax", "ay", "az"), readings, strict=True)}
    columns |= {"inc_ref_deg": np.degrees(inc).tolist(), "tf_ref_deg": np.degrees(tf).tolist()}
    found = bench_or_sensor(columns, None)
    assert found.diagnosis is not None
    laws = [claim for claim in found.diagnosis.claims if claim.effect.startswith("law:")]
    assert laws
    told = [str(one.text) for one in found.findings if one.where == "bench"]
    assert any(text.startswith("Unnamed: ") and "rms beyond" in text for text in told), told
    assert found.answer


FURTHER = pytest.mark.further
SIXTEEN_INC = (-60, -60, -45, -120, -45, -5, -5, -5, 5, 45, 45, 45, 90, 90, 150, 150)
SIXTEEN_TF = (45, 225, 90, 270, 315, 45, 180, 270, 315, 0, 90, 180, 135, 315, 0, 225)


@pytest.mark.parametrize(
    ("spread", "seed"),
    [
        (True, 9),
        pytest.param(True, 10, marks=FURTHER),
        pytest.param(True, 11, marks=FURTHER),
        pytest.param(False, 9, marks=FURTHER),
        (False, 10),
        pytest.param(False, 11, marks=FURTHER),
    ],
)
def test_errors_of_the_set_angles_in_sixteen_poses_are_no_law(spread: bool, seed: int) -> None:
    """Without a measured noise the errors of the angles were sought in units of rounding, and a lean that follows the
    time was told in their place: in two of three sessions of a simulated bench."""
    inc, tf = (np.array(angles, dtype=float) for angles in (SIXTEEN_INC, SIXTEEN_TF))
    rng = np.random.default_rng(seed)
    at = {"inc_ref_deg": inc + np.degrees(rng.normal(0, 6e-5, inc.size))}
    at["tf_ref_deg"] = tf + np.degrees(rng.normal(0, 1e-4, inc.size))
    bench = ForwardModel.of({"base_tilt": {"tilt_x": 3.3e-4, "tilt_y": -1.8e-4}})
    state = ChainState.from_columns(at | {"t_s": 60.0 * np.arange(inc.size)}, gravity_mps2=STANDARD_GRAVITY_MPS2)
    readings = bench.predict(state) + rng.normal(0, 1e-5, (3, inc.size))
    columns = {name: row.tolist() for name, row in zip(("ax", "ay", "az"), readings, strict=True)}
    columns |= {"inc_ref_deg": list(SIXTEEN_INC), "tf_ref_deg": list(SIXTEEN_TF), "n": [200.0] * inc.size}
    if spread:
        columns |= {name: [1.4e-4] * inc.size for name in ("std_ax", "std_ay", "std_az")}
    found = bench_or_sensor(columns, None).diagnosis
    assert found is not None
    told = {claim.effect for claim in found.claims}
    assert told <= {"base_tilt"}
