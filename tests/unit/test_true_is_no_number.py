"""True and false are refused wherever a file of settings has a number: pydantic alone takes them for 1 and 0."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, get_args, get_origin, get_type_hints

import pytest
from pydantic import BaseModel, ValidationError

import highside.config.bench
import highside.config.certificate
import highside.config.model
import highside.config.serve
import highside.config.users  # noqa: F401
from highside.codec.registry import codecs
from highside.config.settings import validate
from highside.errors import InputError
from highside.physics.motion import Leg
from highside.reading.config_table import ConfigTable

NOT_FROM_A_FILE = {"rotor_faults"}
"""given as an object by the program that makes a simulated device"""


def below(table: type[BaseModel]) -> Iterator[type[BaseModel]]:
    for one in table.__subclasses__():
        yield one
        yield from below(one)


def places_refused(table: type[BaseModel], given: object) -> set[object]:
    try:
        table.model_validate(given)
    except ValidationError as error:
        return {place for detail in error.errors() for place in detail["loc"][:1]}
    return set()


def numbers_in(annotation: object) -> set[object]:
    if get_origin(annotation) is Literal:
        return {type(value) for value in get_args(annotation)}
    return set().union(*map(numbers_in, get_args(annotation))) if get_args(annotation) else {annotation}


def test_no_table_of_any_file_takes_true_for_a_number() -> None:
    codecs()
    tables = dict.fromkeys(below(ConfigTable))
    looked_at = 0
    for table in tables:
        for name, field in table.model_fields.items():
            kinds = numbers_in(field.annotation)
            if not kinds & {int, float} or bool in kinds or name in NOT_FROM_A_FILE:
                continue
            for given in (True, [True, True], {"a": False}):
                assert name in places_refused(table, {name: given}), f"{table.__name__}.{name} takes {given}"
            looked_at += 1
    assert looked_at > 300


def test_the_legs_of_a_motion_take_none_either() -> None:
    from highside.config.model_motion import LegsMotion

    for name in get_type_hints(Leg, include_extras=False).keys() - {"__pydantic_config__"}:
        with pytest.raises(ValidationError, match=name):
            LegsMotion.model_validate({"kind": "legs", "legs": [{"duration_s": 1.0, name: True}]})


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (
            {"pipeline": {"output_rate_hz": True}},
            "f: pipeline.output_rate_hz: input should be a valid number (given true)",
        ),
        ({"mqtt": {"qos": True}}, "f: mqtt.qos: input should be 0 or 1 (given true)"),
        (
            {"link": {"kind": "serial", "port": "/dev/x", "baud": False}},
            "f: link.baud: input should be a valid integer",
        ),
    ],
)
def test_the_field_is_named(table: dict[str, object], said: str) -> None:
    tables = {"tool": {"id": "t1"}, "link": {"kind": "serial", "port": "/dev/x"}, "codec": {"name": "tool"}}
    with pytest.raises(InputError) as caught:
        validate(tables | table, where="f", environment=False)
    assert str(caught.value).startswith(said)


def test_what_is_true_or_false_stays_so() -> None:
    tables = {"tool": {"id": "t1"}, "link": {"kind": "serial", "port": "/dev/x"}, "codec": {"name": "tool"}}
    off = validate(tables | {"recorder": {"enabled": False}}, where="f", environment=False)
    assert off.recorder.enabled is False
