"""A configuration of several tools: what holds for all, what is each one's own, and what two may not share."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from click.testing import Result
from jsonschema import Draft202012Validator, FormatChecker
from typer.testing import CliRunner

from highside.cli.main import app
from highside.config.settings import load
from highside.config.tools import chosen_tools, load_tool, load_tools, one_tool, tool_ids
from highside.config.tools_schema import config_schema
from highside.errors import InputError

COMMON = '[codec]\nname = "tool"\n[link]\nkind = "serial"\nport = "/dev/x"\nbaud = 9600\n[service]\nstate_dir = "s"\n'
TWO = '[[tools]]\nid = "a"\nlink = { port = "/dev/a" }\n[[tools]]\nid = "b"\nlink = { kind = "simulated" }\n'


def written(folder: Path, text: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(text)
    return path


def test_an_entry_is_merged_with_what_holds_for_all(tmp_path: Path) -> None:
    path = written(tmp_path, COMMON + TWO)
    a, b = load_tools(path, ["pipeline.output_rate_hz=5"])
    assert (a.tool.id, b.tool.id) == tool_ids(path) == ("a", "b")
    assert a.link.place == "/dev/a"
    assert getattr(a.link, "baud", None) == 9600
    assert b.link.kind == "simulated"  # another kind: nothing of the common table is left in it
    assert (a.service.state_dir, b.service.state_dir) == (tmp_path / "s/a", tmp_path / "s/b")
    assert a.pipeline.output_rate_hz == b.pipeline.output_rate_hz == 5
    assert load_tool(path, None, "b").tool.id == "b"


def test_systemds_folder_is_divided_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/highside")
    path = written(tmp_path, COMMON.replace('state_dir = "s"\n', "") + TWO)
    assert load_tool(path, None, "a").service.state_dir == Path("/var/lib/highside/a")


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ("tools = 3\n", "begin each with [[tools]]"),
        ("[[tools]]\n", "id: is missing"),
        ('[[tools]]\nid = "a"\n[[tools]]\nid = "a"\n', "'a' is given twice"),
        ('[[tools]]\nid = "a"\n[[tools]]\nid = "b"\n', "/dev/x is that of a and b"),
        ('[[tools]]\nid = "a"\npipeline = { output_rate = 3 }\n', "tool a: pipeline.output_rate"),
        ('[[tools]]\nid = "a/b"\n', "tool a/b: tool.id"),
    ],
)
def test_what_is_wrong_is_named_with_its_tool(tmp_path: Path, tables: str, said: str) -> None:
    text = tables + COMMON if tables.startswith("tools") else COMMON + tables
    with pytest.raises(InputError) as refused:
        load_tools(written(tmp_path, text))
    assert said in str(refused.value)


def test_an_id_cannot_be_given_to_all(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="goes with one tool alone"):
        load_tools(written(tmp_path, COMMON + TWO), ["tool.id=z"])


def test_of_several_tools_a_command_takes_the_one_that_is_named(tmp_path: Path) -> None:
    path = written(tmp_path, COMMON + TWO)
    assert [one.tool.id for one in chosen_tools(path, None, None)] == ["a", "b"]
    assert [one.tool.id for one in chosen_tools(path, None, "b")] == ["b"]
    assert one_tool(path, None, "b").tool.id == "b"
    with pytest.raises(InputError, match=r"--tool: holds 2 tools; say which: a, b"):
        one_tool(path, None, None)
    with pytest.raises(InputError, match=r"--tool: 'c' is not in .*; one of a, b"):
        chosen_tools(path, None, "c")
    single = tmp_path / "one.toml"
    single.write_text('[tool]\nid = "a"\n' + COMMON)
    assert one_tool(single, None, None) == one_tool(single, None, "a") == load(single)
    with pytest.raises(InputError, match=r"--tool: 'b' is not in .*; one of a"):
        one_tool(single, None, "b")


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        (COMMON, True),
        (COMMON + TWO, True),
        # what one place leaves to the other
        (COMMON.replace('kind = "serial"\n', "") + TWO.replace("link = {", 'link = { kind = "serial",', 1), True),
        (COMMON.replace('name = "tool"', 'nam = "tool"') + TWO, False),
        (COMMON + '[[tools]]\nlink = { port = "/dev/a" }\n', False),
        (COMMON + '[[tools]]\nid = "a b"\n', False),
        (COMMON + '[[tools]]\nid = "a"\nlink = { prot = "/dev/a" }\n', False),
        (COMMON.replace("[link]", "[lin]"), False),
        ('[codec]\nname = "tool"\n', False),
    ],
)
def test_the_schema_tells_files_of_one_tool_and_of_several_from_wrong_ones(text: str, holds: bool) -> None:
    schema = config_schema()
    # its patterns are those of ECMA-262, of which Python's own do not know all
    Draft202012Validator.check_schema(schema, format_checker=FormatChecker(()))
    assert Draft202012Validator(schema).is_valid(tomllib.loads(text)) is holds


def commanded(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_toolface_and_doctor_know_the_tools_of_a_file(tmp_path: Path) -> None:
    path = written(tmp_path, COMMON + TWO)
    refused = commanded("toolface", "set", "12.5", "--config", path, "--author", "A. Driller")
    assert isinstance(refused.exception, InputError)
    assert "say which: a, b" in str(refused.exception)
    assert commanded("toolface", "set", "12.5", "--config", path, "--author", "A", "--tool", "b").exit_code == 0
    shown = json.loads(commanded("toolface", "show", "--config", path, "--json").stdout)
    assert [one["offset_deg"] for one in shown["b"]] == [12.5]
    assert shown["a"] == []
    assert json.loads(commanded("toolface", "show", "--config", path, "--tool", "b", "--json").stdout) == shown["b"]
    assert (
        "tool a:\nnever set: the offset is 0 deg\ntool b:\n" in commanded("toolface", "show", "--config", path).stdout
    )
    done = commanded("doctor", "--config", path, "--json", "--set", "mqtt.port=1")
    answer = json.loads(done.stdout)
    assert (done.exit_code, answer["ok"], [*answer["tools"]]) == (1, False, ["a", "b"])
    assert any("/dev/a" in finding["found"] for finding in answer["tools"]["a"])
    assert not any("/dev/a" in finding["found"] for finding in answer["tools"]["b"])
    of_one = json.loads(commanded("doctor", "--config", path, "--json", "--set", "mqtt.port=1", "--tool", "b").stdout)
    assert [one["check"] for one in of_one["findings"]] == [one["check"] for one in answer["tools"]["b"]]


def test_a_table_by_its_name_of_before_is_understood(tmp_path: Path) -> None:
    path = tmp_path / "highside.toml"
    path.write_text(
        '[tool]\nid = "a"\n[link]\nkind = "simulated"\n[codec]\nname = "tool"\n[rebalance]\nmax_offset_g = 0.002\n'
    )
    found = load(path, ["rebalance.apply=true"])
    assert found.rolling_bias.apply and found.rolling_bias.max_offset_g == 0.002
