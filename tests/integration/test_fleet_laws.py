"""A lot shares a law that no effect of the library is: too small for one tool, it is found in the lot."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import highside
from highside.diagnosis.core.pooled_laws import pooled_laws
from highside.fleet.catalogue import Entry
from highside.fleet.jobs import Order, row_of
from highside.fleet.parts import PartStore
from highside.fleet.summary import summarise
from highside.physics.state import ChainState

TOOLS = 10
AMPLITUDE_G = 1.5e-5
"""2.5 standard deviations of one tool"""
LAW = {
    "slug": "offset_x_tf",
    "place": "offset",
    "channels": ["x"],
    "coefficients": [[AMPLITUDE_G]],
    "axes": [{"covariate": "tf", "low": 0.0, "high": 360.0, "functions": [["cos", 3]]}],
}


def session(folder: Path, name: str, seed: int, *, law: bool) -> Path:
    model = {
        "motion": {
            "kind": "poses",
            "inclinations_deg": [3, 45, 88],
            "toolfaces_deg": list(range(0, 360, 30)),
            "hold_s": 2,
        },
        "effects": {"included": ["reading_noise"], "reading_noise": {"density_ug": 50}},
        "laws": [LAW] if law else [],
    }
    path = folder / f"{name}.csv"
    highside.simulate(model, seed=seed).recording.write(path)
    return path


def test_a_law_that_a_lot_shares_is_found_with_its_size(tmp_path: Path) -> None:
    store, order = PartStore(tmp_path / "results"), Order("diagnose", "[sensor]\nnoise_g = 5e-5\n")
    entries, keys, said = [], {}, []
    for lot in ("odd", "plain"):
        for i in range(TOOLS):
            path = session(tmp_path, f"{lot}{i}", 40 * (lot == "odd") + i, law=lot == "odd")
            row = row_of(order, path)
            said.append((row["verdict"], *row["claims"]))
            store.write({path.stem: row})
            entries.append(Entry(str(path), path.stem, lot))
            keys[str(path)] = path.stem
    store.write_catalogue(entries, keys, "diagnose")
    answer = summarise(store).to_dict()
    # single recordings do not show it: what one of them names is chance, and a name of the library
    assert sum(one == ("nothing_left_out",) for one in said) >= 2 * TOOLS - 4, said
    assert not any(claim.startswith("law:") for _, *claims in said for claim in claims), said
    (found,) = answer["common"]
    assert (found["lot"], found["effect"], found["parameter"]) == ("odd", "law:offset_x_tf[harmonic=3]", "cos")
    value = found["parameters"]["cos"]
    assert value["unit"] == "g"
    assert abs(value["value"] - AMPLITUDE_G) < 3.5 * value["std"]
    assert value["std"] < 0.3 * AMPLITUDE_G


def test_the_functions_of_a_pooled_law_do_not_depend_on_what_a_recording_visited() -> None:
    """Two sessions have the same columns where they were at the same place."""
    rng = np.random.default_rng(1)
    inc, tf, temp = rng.uniform(0.1, 3, 20), rng.uniform(0, 6, 20), rng.uniform(0, 60, 20)
    force = rng.standard_normal((3, 20))
    whole = pooled_laws(ChainState.build(inc, tf, temp_c=temp), force)
    some = pooled_laws(ChainState.build(inc[5:9], tf[5:9], temp_c=temp[5:9]), force[:, 5:9])
    assert [one.name for one in whole] == [one.name for one in some]
    for one, part in zip(whole, some, strict=True):
        np.testing.assert_allclose(part.columns, one.columns[:, :, 5:9], rtol=1e-12)
    square = next(one for one in whole if one.name == "law:scale_y_temp[power=2]")
    assert square.units == ("1/C^2",)
    np.testing.assert_allclose(square.columns[0, 1], (temp - 25.0) ** 2 * force[1], rtol=1e-12)
    assert not square.columns[0, [0, 2]].any()
