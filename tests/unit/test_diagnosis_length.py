"""What a longer recording shows: no less than a shorter one of the same tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.rows import noise
from highside.diagnosis.rows.inner_products import _of_all_rows
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from studies import rotation_cases as cases

SHORT, LONG = 2_500, 12_000
LEARNED = 800
"""rows that the noise is learned from here, so that these recordings are long"""


def turning(rows: int) -> RotationSession:
    """A lever arm that the model lacks, in so many rows of one rotation."""
    state = cases.design(3, seconds=rows / 50)
    rng = np.random.default_rng(4)
    drawn = cases.noise_of("white", state, rng).draw(rng)
    return RotationSession(ForwardModel.of({"lever_arm": {"r_x": 8e-6}}).predict(state) + drawn, state)


def test_what_is_found_is_not_lost_in_a_longer_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    few = replace(noise.ROW_NOISE, max_rows=LEARNED)
    monkeypatch.setattr(noise, "ROW_NOISE", few)
    method = ProcedureParts.without("laws")
    answers = [diagnose_rotation(turning(n), ForwardModel.of({}), cases.FREE, method=method)[0] for n in (SHORT, LONG)]
    assert [[claim.effect for claim in answer.claims] for answer in answers] == [["lever_arm"]] * 2
    limits = [answer.noise["threshold_log10_p"] for answer in answers]
    # chance does not grow with the recording; by the share of its rows that the noise is learned from it would by 0.8
    assert limits[1] == pytest.approx(limits[0], abs=0.1)
    assert answers[1].claims[0].p_familywise < answers[0].claims[0].p_familywise


def test_chance_is_as_large_in_all_rows_as_functions_are_there() -> None:
    rng = np.random.default_rng(0)
    rows, blocks = 40_000, 50
    at = np.arange(rows)
    early, late = np.exp(-at / 200), (at > rows - 500).astype(float)
    functions = np.stack([np.ones(rows), np.sin(at / 7), early, late])
    seen = slice(0, 4_000)
    own = functions[:, seen].reshape(4, blocks, -1)
    left = rng.standard_normal((blocks, own.shape[2]))
    products = np.einsum("kbn,bn->bk", own, left)
    inner = functions[:, seen] @ functions[:, seen].T
    made = _of_all_rows(products, functions @ functions.T, inner, 0.1)
    spread = np.linalg.norm(made, axis=0) / np.linalg.norm(functions, axis=1)
    # each flip of signs gives a unit of noise along every function: where it is seen, in few blocks, and not at all
    assert spread == pytest.approx(1.0, abs=0.35)
    assert np.linalg.norm(products, axis=0)[2] * np.sqrt(10) > 2.5 * np.linalg.norm(early)


def test_chance_is_the_same_whichever_axes_rounding_chooses() -> None:
    """Functions that are hardly seen and alike: between them no axis is better than another."""
    rng = np.random.default_rng(1)
    turned, _ = np.linalg.qr(rng.standard_normal((8, 8)))
    whole = turned @ np.diag([9.0, *[4.0] * 7]) @ turned.T
    seen = 0.1 * np.outer(turned[:, 0], turned[:, 0])
    products = rng.standard_normal((50, 8)) @ seen
    once = _of_all_rows(products, whole, seen, 0.1)
    noise = rng.standard_normal((2, 8, 8)) * 1e-14
    again = _of_all_rows(products, whole + noise[0] + noise[0].T, seen + noise[1] + noise[1].T, 0.1)
    np.testing.assert_allclose(again, once, atol=1e-9)
