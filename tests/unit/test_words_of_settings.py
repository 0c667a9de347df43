"""What `highside check` finds in a configuration, and in the files that it names, in the reader's language: what is
raised there is known to the catalogue, which a language in brackets shows."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from highside.words import catalogue, in_language, told
from tests.brackets import outside, written

SOURCES = Path(catalogue.__file__).parents[1]
SAYING = (
    "config/settings.py", "config/tools.py", "config/bench.py", "config/web.py", "config/mqtt.py", "config/rig.py",
    "config/recorder.py", "config/links.py", "service/broker_client.py", "bench/setup.py", "codec/axes.py",
    "codec/can_dbc.py", "codec/tool_can.py",
)  # fmt: skip
RAISED = re.compile(r"InputError|ValueError|Refused|_tls_error")
COMMANDS = re.compile(r"chmod 7 7|pip install .*")
"""Remedies that are typed as they stand"""
ELSEWHERE = re.compile(
    # of `run` and `calibrate bench` alone; of `highside run --tool`; of what a simulated tool sends
    r"the rotor angle is not finite|is not in the file any more|7 is not in 7|one of 7|holds 7 tools|say which: 7"
    r"|7 = 7|allowed: 7|7"
)


def raised_by(path: Path) -> set[str]:
    """What is wrong, and what to do, of each error that a module raises."""
    found: list[ast.expr] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and RAISED.fullmatch(ast.unparse(node.func)):
            found += node.args[2:] if ast.unparse(node.func) == "_tls_error" else node.args[:1]
            found += [one.value for one in node.keywords if one.arg == "remedy"]
    return {text for node in found if (text := written(node)) and " " in text}


@pytest.mark.usefixtures("brackets")
def test_what_a_check_finds_is_known() -> None:
    said = {text for name in SAYING for text in raised_by(SOURCES / name)}
    said = {text for text in said if not COMMANDS.fullmatch(text) and not ELSEWHERE.fullmatch(text)}
    assert len(said) > 50
    with in_language("de"):
        unknown = {text for text in said if re.search(r"[^\W\d_]{3,}", outside(told(text, "settings")))}
    assert unknown == set(), "list them in words.sentences_of_settings, make words, then translate"
