"""The intervals stated for blended corrections hold the truth as often as they say, neither less nor more."""

from __future__ import annotations

import numpy as np
import pytest

from studies import schedule_coverage as study

SENSORS = 100


BLENDS = [place in (0.9, 1.0, 1.6, 2.0, 2.5, 4.0, 7.0, 10.0, 25.0, 37.0) for place in study.PLACES_DEG]

VERTICAL = np.array(study.PLACES_DEG) <= 1.0


@pytest.mark.parametrize("name", ["balance+conventional", "balance+conventional, level bench", "balance+joint"])
def test_stated_intervals_of_blends_hold_the_truth_in_95_percent(name: str) -> None:
    """Pooled over the blends, the share of 100 sensors scatters by 0.4 % from seeds to seeds (tilts are stratified).

    The bounds lie four standard deviations and more away: other draws fail by chance in fewer than one of 1,000 runs.
    The bound `sum w Cov(x)` would give 97.8 % on a level bench.
    """
    found = study.coverage(name, SENSORS)
    share = found.share
    assert found.zones == 10.0
    inside = np.mean(share[:, BLENDS], axis=1)
    assert np.all(inside > 0.93)
    assert np.all(inside < 0.97)
    # a single place scatters by 1 to 1.5 %
    assert share.min() > 0.89
    assert 0.93 < np.mean(share[:, VERTICAL]) < 0.97
