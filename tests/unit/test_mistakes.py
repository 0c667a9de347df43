"""Every mistake of a file of settings is told at once, names that are not known first."""

from __future__ import annotations

import pytest

from highside.config.settings import validate
from highside.errors import InputError
from highside.words.errors import error_told


def test_a_name_misspelt_is_not_hidden_by_the_name_that_is_missing_for_it() -> None:
    tables = {
        "tool": {"id": "t1"},
        "link": {"kind": "serial", "prot": "/dev/ttyUSB0", "baud": "fast"},
        "codec": {"name": "tool"},
        "mqqt": {},
    }
    with pytest.raises(InputError) as caught:
        validate(tables, where="my.toml", environment=False)
    said = str(caught.value)
    assert said.startswith("my.toml: link.prot: is not a known field; did you mean 'port'? | also mqqt: is not a known")
    assert "did you mean 'mqtt'?" in said
    assert "also link.port: is missing; add it" in said
    assert "also link.baud: input should be a valid integer" in said
    assert said.count("| also") == 3


def test_many_mistakes_are_counted_and_what_is_allowed_is_reported_once() -> None:
    with pytest.raises(InputError) as caught:
        validate({f"zz{i}": 1 for i in range(20)}, where="my.toml", environment=False)
    said = str(caught.value)
    assert said.count("allowed: ") == 1
    assert said.count("| also") == 7
    assert "more" in said.rpartition("|")[2]


def test_what_has_no_remedy_is_followed_by_the_next_mistake() -> None:
    with pytest.raises(InputError) as caught:
        validate({"mqtt": [], "pipeline": 1}, where="my.toml", environment=False)
    assert "must be a table | also " in str(caught.value)
    assert "; |" not in str(caught.value)
    assert error_told(caught.value) == str(caught.value)
