"""What is told beside laws and the names that joined them."""

from highside.diagnosis.core.result import Remainder
from highside.diagnosis.law_answers import beside_laws


def test_no_hint_says_of_a_claimed_name_that_it_is_not_the_cause() -> None:
    before = Remainder(
        hints=("sag is no constant", "backlash is no constant", "poses disagree"),
        resembles=("sag", "cubic", "no effect of that name"),
        changing=("sag", "backlash"),
    )
    told = beside_laws(before, {"sag", "quadratic"})
    assert (told.hints, told.resembles, told.changing) == (("backlash is no constant",), ("cubic",), ("backlash",))
