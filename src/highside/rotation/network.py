"""The paper's fourth method: O = W2 tanh(W1 P + b1) + b2 with eight hidden units, trained by Levenberg-Marquardt.

(tansig is tanh.) Equation (7) is printed with b1 outside of tansig; such a network is an odd function plus a constant
and cannot fit (`hidden_bias=False` shows it). The input P is t / pi - 1 as in the paper or (sin t, cos t), which has no
seam; targets are standardised; the first weights are those of Nguyen and Widrow (1990), drawn from a seed.

Jacobian of an output with Q = tanh(W1 P + b1) and v = W2:  dO/dW1 = (1 - Q^2) v P,  dO/db1 = (1 - Q^2) v,
dO/dW2 = Q,  dO/db2 = 1.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.rotation.bases import combined, gram, projected
from highside.rotation.curve import CurveForm, CurveMethod, ErrorCurve, NetworkInput
from highside.rotation.network_output import hidden_layer, jacobian_of, split_weights
from highside.rotation.samples import Samples

HIDDEN = 8
FIRST_DAMPING = 1e-3
SMALLEST_DECREASE = 1e-10
"""relative decrease of the sum of squares at which training ends"""
MOST_ROWS = 20_000
"""longer recordings are thinned for training, which would otherwise take minutes for no gain"""


def network(
    samples: Samples,
    *,
    network_input: NetworkInput = NetworkInput.SCALED,
    seed: int = 0,
    iterations: int = 200,
    hidden: int = HIDDEN,
    hidden_bias: bool = True,
) -> ErrorCurve:
    """Train on the samples. Raises Refused where less than half of the turn is covered."""
    samples.require_coverage()
    stride = -(-samples.n // MOST_ROWS)
    theta, error = samples.theta_rad[::stride], samples.error[::stride]
    inputs = network_input.rows(theta)
    centre, scale = float(error.mean()), float(error.std()) or 1.0
    targets = (error - centre) / scale
    weights = _first_weights(inputs.shape[0], hidden, hidden_bias, np.random.default_rng(seed))
    weights, normal, cost, used = _train(weights, inputs, targets, hidden, hidden_bias, iterations)
    freedom = max(1, theta.size - weights.size)
    noise = scale * float(np.sqrt(cost / freedom))
    # units that do the same leave directions in which nothing changes: no information, no variance claimed
    covariance = np.asarray((cost / freedom) * np.linalg.pinv(normal, rcond=1e-12, hermitian=True), dtype=float)
    remarks = [samples.coverage.warning] if samples.coverage.warning else []
    if stride > 1:
        remarks.append(f"trained on every {stride}th row of {samples.n}")
    if used == iterations:
        remarks.append(f"training stopped at {iterations} iterations; another seed gives another curve")
    if samples.n < 5 * weights.size:
        remarks.append(f"{samples.n} rows for {weights.size} parameters: the network follows the noise")
    return ErrorCurve(
        CurveMethod.NETWORK,
        CurveForm.NETWORK,
        hidden,
        weights,
        covariance,
        noise,
        samples.coverage,
        network_input=network_input,
        hidden_bias=hidden_bias,
        target_centre=centre,
        target_scale=scale,
        remarks=tuple(remarks),
    )


def _first_weights(d: int, hidden: int, hidden_bias: bool, rng: np.random.Generator) -> Array:
    """Nguyen and Widrow: the units' slopes share the range [-1, 1] of the inputs out between them."""
    reach = 0.7 * hidden ** (1.0 / d)
    w1 = rng.uniform(-1.0, 1.0, (hidden, d))
    w1 *= reach / np.linalg.norm(w1, axis=1, keepdims=True)
    b1 = reach * np.linspace(-1.0, 1.0, hidden) * np.sign(w1[:, 0])
    w2 = rng.uniform(-0.5, 0.5, hidden)
    return np.concatenate([w1.ravel(), b1 if hidden_bias else [], w2, [0.0]])


def _train(
    weights: Array, inputs: Array, targets: Array, hidden: int, hidden_bias: bool, iterations: int
) -> tuple[Array, Array, float, int]:
    """Levenberg-Marquardt: weights, normal matrix at them, sum of squares, iterations used."""
    d = inputs.shape[0]
    damping = FIRST_DAMPING

    def at(w: Array) -> tuple[Array, Array, float]:
        w1, b1, w2, b2 = split_weights(w, d, hidden, hidden_bias)
        q = hidden_layer(w1, inputs, b1)
        residual = targets - (combined(w2, q) + b2)
        return q, residual, float(residual @ residual)

    q, residual, cost = at(weights)
    rows = jacobian_of(inputs, q, split_weights(weights, d, hidden, hidden_bias)[2], hidden_bias)
    normal = gram(rows)
    used = 0
    while used < iterations:
        used += 1
        gradient = projected(rows, residual)
        accepted = False
        while damping <= 1e10:
            step = np.linalg.solve(normal + damping * np.eye(weights.size), gradient)
            tried_q, tried_residual, tried = at(weights + step)
            if tried < cost:
                accepted = True
                break
            damping *= 10.0
        if not accepted:
            break
        decrease = (cost - tried) / cost
        weights, q, residual, cost = weights + step, tried_q, tried_residual, tried
        rows = jacobian_of(inputs, q, split_weights(weights, d, hidden, hidden_bias)[2], hidden_bias)
        normal = gram(rows)
        damping = max(damping / 10.0, 1e-15)
        if decrease < SMALLEST_DECREASE:
            break
    return weights, normal, cost, used
