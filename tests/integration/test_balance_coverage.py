"""What one published table predicts of the others holds as often as it says: the study, short."""

from __future__ import annotations

import pytest

from studies import balance_coverage as study

FURTHER = pytest.mark.further
LEAST = 0.85


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", [500_002, pytest.param(500_013, marks=FURTHER)])
def test_cells_of_a_known_instrument_are_within_their_intervals(seed: int) -> None:
    """Instruments of the study, each by itself. Cells of one instrument miss together: even three drawn from those of
    the study fall below this bound by chance in 13 % of cases; with intervals half as wide, in 94 %."""
    predictions, _, _ = study.one(seed)
    assert predictions.overall.of == 92
    assert predictions.overall.covered >= LEAST * 92
    # nor are they so wide that they say nothing
    assert sum(z <= 0.5 for column in study.departures(predictions).values() for z in column) < 0.9 * 92
