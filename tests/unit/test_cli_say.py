"""What the commands print is harmless on a terminal, and they print in no other way."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import highside.cli
from highside.cli.main import app
from highside.cli.say import echo, echo_json

COMMANDS = Path(highside.cli.__file__).parent


def said_bare(source: str) -> list[int]:
    """Lines that print by themselves."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        what = ast.unparse(node.func)
        if what in ("print", "typer.echo", "typer.secho", "click.echo") or what.startswith(
            ("sys.stdout.w", "sys.stderr.w")
        ):
            found.append(node.lineno)
    return found


def test_no_command_prints_past_the_one_function_for_it() -> None:
    modules = [path for path in COMMANDS.glob("*.py") if path.name != "say.py"]
    assert len(modules) > 30
    assert {path.name: lines for path in modules if (lines := said_bare(path.read_text()))} == {}


@pytest.mark.parametrize("line", ["print(1)", "typer.echo('a')", "sys.stdout.write('a')", "sys.stderr.writelines([])"])
def test_that_rule_sees_what_it_forbids(line: str) -> None:
    assert said_bare(f"import typer\n{line}\n") == [2]


def test_lines_stay_lines_and_nothing_in_them_is_obeyed(capsys: pytest.CaptureFixture[str]) -> None:
    echo("a\tµ °\n\x1b[2Jb \u202eevil\r\u009b31m \ud800")
    assert capsys.readouterr().out == "a\tµ °\n\\x1b[2Jb \\u202eevil\\r\\x9b31m \\ud800\n"
    echo("to the other", err=True, nl=False)
    assert capsys.readouterr().err == "to the other"


@given(st.dictionaries(st.text(), st.text()))
def test_a_document_has_the_same_values(value: dict[str, str]) -> None:
    import contextlib
    import io

    for plain in (json.dumps(value), json.dumps(value, ensure_ascii=False)):
        with contextlib.redirect_stdout(io.StringIO()) as out:
            echo_json(plain)
        assert json.loads(out.getvalue()) == value
        assert all(c.isprintable() or c in "\n\t" for c in out.getvalue())


def test_an_author_out_of_a_file_does_not_command_the_terminal(tmp_path: Path) -> None:
    config = tmp_path / "t.toml"
    config.write_text(
        '[tool]\nid = "t-1"\n[link]\nkind = "simulated"\n[codec]\nname = "tool"\n[service]\nstate_dir = "s"\n'
    )
    author = "Eve\x1b]0;owned\x07\u202e"
    assert (
        CliRunner().invoke(app, ["toolface", "set", "12", "--config", str(config), "--author", author]).exit_code == 0
    )
    shown = CliRunner().invoke(app, ["toolface", "show", "--config", str(config)]).output
    assert "by Eve\\x1b]0;owned\\x07\\u202e" in shown
    report = json.loads(CliRunner().invoke(app, ["toolface", "show", "--config", str(config), "--json"]).output)
    assert report[0]["author"] == author
