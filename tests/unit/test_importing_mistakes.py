"""Files whose names lie, or say nothing: the values are right, or the file is refused. Never a wrong unit or axis."""

from __future__ import annotations

from itertools import permutations, product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_importing import ACCEL, session

import highside
from highside.errors import InputError

RATES = ["gx_dps", "gy_dps", "gz_dps"]
_ACCEL_UNITS = {"": None, "g": 1.0, "m/s2": 9.80665, "mg": 1000.0}
_RATE_UNITS = {"": None, "deg/s": 1.0, "rad/s": np.pi / 180}
_TIME_UNITS = {"": None, "s": 1.0, "ms": 1e3, "us": 1e6}
_ANGLE_UNITS = {"": None, "deg": 1.0, "rad": np.pi / 180}


def spoilt(rng: np.random.Generator) -> tuple[pd.DataFrame, pd.DataFrame]:
    """(what is true, the same as a file may give it): scales, names of units and axes each at random."""
    rate_hz = float(rng.choice([20.0, 50.0, 100.0]))
    own = session(160, rate_hz, int(rng.integers(1000)))

    def named(units: dict[str, float | None], others: list[float]) -> tuple[str, float]:
        name = str(rng.choice(list(units)))
        own_scale = units[name]
        scales = [value for value in units.values() if value is not None] + others
        honest = own_scale is not None and rng.random() < 0.5
        return (f" ({name})" if name else ""), float(own_scale if honest and own_scale else rng.choice(scales))

    accel, accel_scale = named(_ACCEL_UNITS, [16384.0, 1024.0, 256.0, 57.3])
    rate, rate_scale = named(_RATE_UNITS, [16.4, 131.0, 1000.0])
    time, time_scale = named(_TIME_UNITS, [])
    angle, angle_scale = named(_ANGLE_UNITS, [])
    order, signs = (0, 1, 2), (1, 1, 1)
    if rng.random() < 0.3:
        order = list(permutations(range(3)))[int(rng.integers(6))]
        signs = list(product((1, -1), repeat=3))[int(rng.integers(8))]
    file = {f"Time{time}": own.t_s * time_scale}
    with_reference = rng.random() < 0.6 or order != (0, 1, 2) or signs != (1, 1, 1)
    for k, axis in enumerate("xyz"):
        file[f"acc {axis}{accel}"] = signs[k] * own[ACCEL[order[k]]] * accel_scale
    for k, axis in enumerate("xyz"):
        file[f"gyro {axis}{rate}"] = signs[k] * own[RATES[order[k]]] * rate_scale
    if with_reference:
        file[f"ref inclination{angle}"] = own.inc_ref_deg * angle_scale
        file[f"ref toolface{angle}"] = own.tf_ref_deg * angle_scale
    if accel_scale > 200 and accel_scale != 1000.0:
        file = {name: (np.rint(v) if name.startswith("acc") else v) for name, v in file.items()}
    return own, pd.DataFrame(file)


def agrees(found: highside.Recording, own: pd.DataFrame) -> list[str]:
    """The columns that are wrong."""
    wrong = []
    for name in ("t_s", *ACCEL, *RATES, "inc_ref_deg", "tf_ref_deg"):
        if found.has(name):
            coarse = 5e-3 if name in ACCEL else 1e-6 * (1 + float(np.abs(own[name]).max()))
            if not np.allclose(found[name], own[name], rtol=0, atol=coarse):
                wrong.append(name)
    return wrong


@pytest.mark.slow
def test_no_wrong_unit_and_no_wrong_axis_is_ever_taken(tmp_path: Path) -> None:
    rng = np.random.default_rng(20261122)
    taken = accepted = 0
    for number in range(200):
        own, file = spoilt(rng)
        path = tmp_path / "x.csv"
        file.to_csv(path, index=False)
        for accept in (False, True):
            try:
                found = highside.import_recording(path, accept=accept)
            except InputError:
                continue
            wrong = agrees(found, own)
            assert not wrong, (number, accept, wrong, list(file.columns), file.iloc[5].to_dict())
            taken, accepted = taken + (not accept), accepted + accept
    print(f"200 files: {taken} taken, {accepted} taken with accept")
    # they are not all refused
    assert taken >= 1
    assert accepted >= 20
