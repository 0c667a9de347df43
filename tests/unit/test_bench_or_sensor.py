"""Bench or sensor, of a session whose misfit has no name in the library."""

import numpy as np

from highside.report.bench_or_sensor import bench_or_sensor
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
