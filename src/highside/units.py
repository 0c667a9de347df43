"""Constants of units, in one place."""

STANDARD_GRAVITY_MPS2 = 9.80665
"""m/s^2 in 1 g, by definition (3rd General Conference on Weights and Measures, 1901)."""
