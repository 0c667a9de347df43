"""What was hidden beside what was told: a case in which the true set of laws is the less likely one."""

import numpy as np

from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.problem import PlaceField
from highside.physics.law import Axis
from highside.physics.law_functions import Function
from studies.open_world import judging
from studies.open_world.laws import Law
from studies.open_world.shapes import Shape
from studies.open_world.true_sets import compared, is_of, of_channels

SEED = "6724e6662d58492268508a628bcbff6915126d29"


def test_a_law_in_few_poses_is_less_likely_than_noise() -> None:
    """A product beside a scale factor that follows the temperature, in 17 poses."""
    row, one = compared(SEED, "law/168")
    assert one is not None
    assert not judging.judged(row)["in_class"]
    assert one.lacking == 0
    # side by side, where they are, one of the two is not worth what a law must be
    assert one.shown is not None and one.shown < 2
    # both laws leave 1.2 times the floor and one of them 2.8 times, and that is not worth 6 nats
    assert 15.0 < one.true < one.found < 40.0


def test_a_true_law_is_looked_for_on_its_own_channels() -> None:
    load = np.array([[0.1], [0.2], [0.9]])

    def group(place: str, *channels: str) -> LawGroup:
        axis = Axis("temp", 0.0, 1.0, (Function("straight"),))
        units = tuple(PlaceField(place, channel, load) for channel in channels)
        return LawGroup(units, (axis,), np.zeros(1), np.ones((len(units), 1, 1)))

    def law(place: str, weights: tuple[float, ...], element: tuple[int, int] = (0, 0)) -> Law:
        return Law(place, ("temp",), Shape("power", {}), ((0.0, 1.0),), weights=weights, element=element)

    assert of_channels(group("offset", "y"), law("offset", (0.0, 1.0, 0.0)))
    assert not of_channels(group("offset", "x"), law("offset", (0.0, 1.0, 0.0)))
    assert of_channels(group("offset", "x", "y", "z"), law("offset", (0.3, -1.0, 0.2)))
    assert not of_channels(group("offset", "x"), law("offset", (0.3, -1.0, 0.2)))
    assert of_channels(group("matrix", "yx"), law("matrix", (1.0, 0.0, 0.0), (1, 0)))
    assert not of_channels(group("matrix", "xy"), law("matrix", (1.0, 0.0, 0.0), (1, 0)))
    assert of_channels(group("level", "y"), law("level", (0.0, 1.0, 0.0)))
    assert not of_channels(group("level", "x", "y"), law("level", (0.0, 1.0, 0.0)))
    assert of_channels(group("toolface", "tf"), law("toolface", (1.0, 0.0, 0.0)))
    # a lean about the axis of the inclination is tried as an error of that, one about the other axis is not
    assert is_of(group("inclination", "inc"), law("level", (1.0, 0.0, 0.0)))
    assert not is_of(group("inclination", "inc"), law("level", (0.0, 1.0, 0.0)))
