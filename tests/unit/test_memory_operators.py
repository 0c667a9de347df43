"""Operators with memory worked through in pieces: the same as over the whole series."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from highside.arrays import AnyArray
from highside.physics.memory import Carry, carried, low_pass, play, unwrapped_angle

N = 5000
T_S = np.arange(N) * 0.02
RNG = np.random.default_rng(4)
SERIES = np.cumsum(RNG.standard_normal(N))
UNEVEN = np.sort(RNG.uniform(0, 100, N))

OPERATORS: dict[str, Callable[[AnyArray, AnyArray], AnyArray]] = {
    "lag": lambda t, x: low_pass(t, x, 3.0),
    "lag, uneven rows": lambda t, x: low_pass(UNEVEN[np.round(t / 0.02).astype(int)], x, 3.0),
    "lag, complex time constant": lambda t, x: low_pass(t, x, 3.0 + 1e-20j),
    "play": lambda t, x: play(x, 0.8),
    "play, slowly": lambda t, x: play(np.sin(t / 20), 0.1),
    "play that turns where pieces begin": lambda t, x: play(np.abs(np.round(t / 0.02) % 2000 - 1000) / 100, 0.8),
    "angle": lambda t, x: unwrapped_angle(np.mod(x, 2 * np.pi)),
    "two of them": lambda t, x: play(x, 0.8) + low_pass(t, x, 2.0) - play(x, 0.2),
}


@pytest.mark.parametrize("overlap", [0, 7])
@pytest.mark.parametrize("name", list(OPERATORS))
def test_pieces_go_on_where_the_ones_before_ended(name: str, overlap: int) -> None:
    operator, carry, made = OPERATORS[name], Carry(overlap), []
    for start in range(0, N, 1000):
        led = max(0, start - overlap)
        rows = np.concatenate([[0], np.arange(led, start + 1000)])
        with carried(carry):
            made.append(operator(T_S[rows], SERIES[rows])[1 + start - led :])
    whole = operator(T_S, SERIES)
    np.testing.assert_allclose(np.concatenate(made), whole, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(np.imag(np.concatenate(made)), np.imag(whole), rtol=1e-9, atol=1e-33)


def test_without_carrying_a_piece_begins_anew() -> None:
    later = play(SERIES[1000:], 0.8)
    assert later[0] == SERIES[1000]
    assert np.abs(later - play(SERIES, 0.8)[1000:]).max() > 0.1
