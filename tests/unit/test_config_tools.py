"""A configuration of several tools: what holds for all, what is each one's own, and what two may not share."""

from __future__ import annotations

from pathlib import Path

import pytest

from highside.config.tools import load_tool, load_tools, tool_ids
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
