"""Blocks of samples: online and batch are the same to the last bit, and the transition is the closed form."""

from __future__ import annotations

import numpy as np
import pytest

from highside.attitude.quaternion import conjugate, from_rotation_vector, multiply, to_rotation_vector
from highside.gyro.blocks import MAX_GAP_S, Batch, Block, Gatherer

Samples = tuple[np.ndarray, np.ndarray, np.ndarray]


def _jittered(seconds: float = 12.0) -> Samples:
    """Rows at 100 Hz with jitter, some lost, one gap, in lively motion."""
    rng = np.random.default_rng(1)
    t = np.arange(int(seconds * 100)) / 100 + rng.uniform(-0.004, 0.004, int(seconds * 100))
    keep = rng.random(t.size) > 0.05
    keep[500:580] = False
    t = t[keep]
    return t, rng.standard_normal((3, t.size)), rng.standard_normal((3, t.size)) + np.array([[0.0], [0.5], [0.8]])


def _online(samples: Samples) -> list[Block]:
    t, w, a = samples
    gatherer = Gatherer()
    blocks = []
    for i in range(t.size):
        done = gatherer.add(float(t[i]), tuple(w[:, i].tolist()), tuple(a[:, i].tolist()))
        if done is not None:
            blocks.append(done)
    last = gatherer.finish()
    assert last is not None
    return [*blocks, last]


def test_online_and_batch_blocks_are_equal_bit_for_bit() -> None:
    samples = _jittered()
    batch = Batch.of(*samples).blocks()
    online = _online(samples)
    assert len(batch) == len(online)
    for ours, theirs in zip(batch, online, strict=True):
        assert np.array_equal(ours.vector, theirs.vector)
    assert sum(block.n for block in batch) == samples[0].size


def test_a_gap_is_reported_and_not_integrated() -> None:
    t, w, a = _jittered()
    blocks = Batch.of(t, w, a).blocks()
    gap = sum(block.gap_s for block in blocks)
    assert 0.7 < gap < 0.9
    assert gap > MAX_GAP_S
    assert sum(block.seconds for block in blocks) == pytest.approx(t[-1] - t[0] - gap)


@pytest.mark.parametrize("rate_dps", [0.0, 10.0, 60.0, 300.0])
def test_a_constant_rate_gives_the_rodrigues_transition(rate_dps: float) -> None:
    w = np.radians(rate_dps) * np.array([0.1, 0.9, -0.42])
    n = 401
    t = np.arange(n) / 400
    block = Batch.of(t, np.repeat(w[:, None], n, axis=1), np.tile([[0.0], [0.0], [1.0]], n), 2.0).blocks()[0]
    dt = t[-1]
    phi = np.linalg.norm(w) * dt
    A = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]]) * dt
    c2, c3 = ((1 - np.cos(phi)) / phi**2, (phi - np.sin(phi)) / phi**3) if phi else (0.5, 1 / 6)
    closed = dt * (np.eye(3) - c2 * A + c3 * A @ A)
    # the trapezoid within a sample costs (w T)^2 / 12
    tolerance = dt * (1e-12 + (np.radians(rate_dps) / 400) ** 2)
    assert np.abs(block.J - closed).max() < tolerance
    assert np.abs(block.S - closed[:, 1] * w[1]).max() <= tolerance * abs(w[1])
    assert (
        np.abs(to_rotation_vector(block.q) - np.angle(np.exp(1j * phi)) * (w / np.linalg.norm(w) if phi else w)).max()
        < 1e-12
    )


def test_the_jacobian_predicts_what_a_bias_does() -> None:
    t, w, a = _jittered(1.0)
    bias = np.array([2e-4, -1e-4, 3e-4])
    scale = 3e-4
    plain = Batch.of(t, w, a, 5.0).blocks()[0]
    other = w - bias[:, None]
    other[1] -= scale * w[1]
    disturbed = Batch.of(t, other, a, 5.0).blocks()[0]
    seen = to_rotation_vector(multiply(conjugate(plain.q), disturbed.q))
    predicted = -(plain.J @ bias + plain.S * scale)
    assert np.abs(seen - predicted).max() < 2e-3 * np.abs(predicted).max()


def test_gravity_is_not_smeared_when_the_tool_turns() -> None:
    n = 100
    w = np.repeat(np.array([[0.0], [1.0], [0.0]]), n, axis=1)
    t = np.arange(n) / 100
    up0 = np.array([0.0, 0.6, 0.8])
    from highside.attitude.quaternion import direction_cosines

    a = np.array([direction_cosines(from_rotation_vector(np.array([0.0, s, 0.0]))) @ up0 for s in t]).T
    block = Batch.of(t, w, a, 2.0).blocks()[0]
    assert np.abs(block.accel - a[:, -1]).max() < 1e-12
    assert block.accel_std < 1e-7
