"""A law that acts on the gyros alone is judged by what it leaves of theirs."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from highside.diagnosis.law_outcomes import explains_nothing

ROWS, CELLS = 4000, 500
FLOOR = np.array([7e-5, 7e-5, 7e-5, 1e-4, 1e-4, 1e-4])


def judged(acts: int, explained: float) -> bool:
    """Of a misfit of fifteen floors on one channel, in rows that scatter by 3.5, a law there takes this share."""
    rng = np.random.default_rng(1)
    noise = 3.5 * FLOOR[:, None] * rng.standard_normal((6, ROWS))
    swing = np.zeros((6, ROWS))
    swing[acts] = 15 * FLOOR[acts] * np.sqrt(2) * np.sin(np.arange(ROWS) / 9)
    effect = np.zeros((6, CELLS))
    effect[acts] = 1e-3
    floor = np.repeat(FLOOR[:, None], CELLS, axis=1)
    found = SimpleNamespace(noise=SimpleNamespace(factor=np.ones(6)))
    outcome = SimpleNamespace(found=found, laws=(SimpleNamespace(effect=effect),))
    left = np.sqrt(1 - explained)
    return explains_nothing(floor, outcome, noise + swing, noise + left * swing)  # type: ignore[arg-type]


@pytest.mark.parametrize("channel", [1, 5])
def test_what_explains_its_channel_is_an_answer(channel: int) -> None:
    """On a gyro it was none: the accelerometers, of which nothing was left out, were as before."""
    assert not judged(channel, 0.999)


@pytest.mark.parametrize("channel", [1, 5])
def test_what_leaves_its_channel_as_it_was_is_none(channel: int) -> None:
    assert judged(channel, 1e-3)
