"""A law of one order of toolface is told as that order, and beside it the order that a grid cannot tell from it."""

import numpy as np
import pytest

from highside.api.diagnosis import diagnose
from highside.config.model import Model

FURTHER = pytest.mark.further
SIGMA = 2e-4
MODEL = Model.model_validate({"sensor": {"noise_g": SIGMA}})


def poses(seed: int, order: int, size_g: float, toolfaces: int) -> dict[str, np.ndarray]:
    """Six inclinations at equally spaced toolfaces; an offset of x of one order of toolface."""
    rng = np.random.default_rng(seed)
    inc = np.tile(np.arange(6) * 30.0, toolfaces)
    tf = np.repeat(np.arange(toolfaces) * 360.0 / toolfaces, 6)
    s, c = np.sin(np.radians(inc)), np.cos(np.radians(inc))
    read = np.vstack([s * np.cos(np.radians(tf)), s * np.sin(np.radians(tf)), c])
    read = (np.eye(3) + rng.normal(0, 2e-3, (3, 3))) @ read + rng.normal(0, 3e-3, (3, 1))
    read[0] += size_g * np.sin(order * np.radians(tf) + 1.0)
    read += rng.normal(0, SIGMA, read.shape)
    temp = 20 + 40 * ((np.arange(inc.size) * 5) % inc.size) / inc.size
    return {
        "inc_ref_deg": inc,
        "tf_ref_deg": tf,
        "temp_c": temp,
        **dict(zip(("ax", "ay", "az"), read, strict=True)),
    }


@pytest.mark.parametrize("size_g", [pytest.param(1e-3, marks=FURTHER), pytest.param(1e-2, marks=FURTHER), 1e-1])
@pytest.mark.parametrize(
    ("order", "toolfaces", "alike"),
    [
        (5, 12, 7),
        pytest.param(5, 18, None, marks=FURTHER),
        pytest.param(7, 18, 11, marks=FURTHER),
        pytest.param(3, 18, None, marks=FURTHER),
        (8, 24, None),
    ],
)
def test_one_whole_order_is_told_as_it_is(order: int, toolfaces: int, alike: int | None, size_g: float) -> None:
    made = diagnose(poses(order, order, size_g, toolfaces), MODEL)
    (claim,) = made.claims
    assert (claim.place, claim.channels, claim.depends_on) == ("offset", ("ax",), ("tf",))
    assert claim.formula is not None
    size = f"{size_g * np.sin(1.0):.2g}"[:3]
    told = claim.formula.split(" or ")
    assert any(f" cos({order} tf)" in text and text.startswith(size) for text in told), (claim.formula, size)
    if alike is None:
        assert len(told) == 1
    else:
        assert any(f" cos({alike} tf)" in text for text in told)
