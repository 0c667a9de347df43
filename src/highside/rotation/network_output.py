"""What the network of the paper's fourth method gives for its inputs, and its derivatives by the weights.

With Q = tanh(W1 P + b1) and v = W2:  O = v Q + b2,  dO/dW1 = (1 - Q^2) v P,  dO/db1 = (1 - Q^2) v,  dO/dW2 = Q,
dO/db2 = 1. `network` trains the weights; a curve keeps them.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.rotation.bases import combined


def forward(weights: Array, inputs: Array, hidden: int, hidden_bias: bool = True) -> Array:
    """Outputs (N,) on the standardised scale for inputs (d, N)."""
    w1, b1, w2, b2 = split_weights(weights, inputs.shape[0], hidden, hidden_bias)
    return combined(w2, hidden_layer(w1, inputs, b1)) + b2


def jacobian_rows(weights: Array, inputs: Array, hidden: int, hidden_bias: bool = True) -> Array:
    """(P, N): derivative of the outputs by each weight."""
    w1, b1, w2, _ = split_weights(weights, inputs.shape[0], hidden, hidden_bias)
    return jacobian_of(inputs, hidden_layer(w1, inputs, b1), w2, hidden_bias)


def hidden_layer(w1: Array, inputs: Array, b1: Array) -> Array:
    """Q = tanh(W1 P + b1), (hidden, N)."""
    total = np.einsum("hd,dn->hn", w1, inputs)
    total += b1[:, None]
    return np.asarray(np.tanh(total, out=total))


def split_weights(weights: Array, d: int, hidden: int, hidden_bias: bool) -> tuple[Array, Array, Array, float]:
    """W1 (hidden, d), b1 and W2 (hidden,) and b2 from all weights (P,)."""
    w1 = weights[: hidden * d].reshape(hidden, d)
    rest = weights[hidden * d :]
    b1 = rest[:hidden] if hidden_bias else np.zeros(hidden)
    return w1, b1, rest[-hidden - 1 : -1], float(rest[-1])


def jacobian_of(inputs: Array, q: Array, w2: Array, hidden_bias: bool) -> Array:
    """(P, N): derivative of the outputs by each weight, from the hidden layer\'s own outputs q (hidden, N)."""
    d, hidden, n = inputs.shape[0], w2.size, inputs.shape[1]
    slopes = (1.0 - q * q) * w2[:, None]
    rows = np.empty((hidden * (d + 1 + int(hidden_bias)) + 1, n))
    np.multiply(slopes[:, None, :], inputs[None, :, :], out=rows[: hidden * d].reshape(hidden, d, n))
    if hidden_bias:
        rows[hidden * d : hidden * (d + 1)] = slopes
    rows[-hidden - 1 : -1] = q
    rows[-1] = 1.0
    return rows
