"""What was hidden beside what was told: a case in which the true set of laws is the less likely one."""

from studies.open_world import judging
from studies.open_world.true_sets import compared

SEED = "6724e6662d58492268508a628bcbff6915126d29"


def test_a_law_in_few_poses_is_less_likely_than_noise() -> None:
    """A product beside a scale factor that follows the temperature, in 17 poses."""
    row, one = compared(SEED, "law/168")
    assert one is not None
    assert not judging.judged(row)["in_class"]
    assert one.lacking == 0
    # both laws leave 1.2 times the floor and one of them 2.8 times, and that is not worth 6 nats
    assert 15.0 < one.true < one.found < 40.0
