"""What the commands of `highside users` refuse leaves nothing behind."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from highside.cli.users import app
from highside.errors import InputError

USERS = """
[[user]]
name = "A. Operator"
role = "operate"
"""


@pytest.mark.parametrize("file", ["there", "not there"])
@pytest.mark.parametrize(
    "words",
    [
        ["remove", "nobody"],
        ["role", "nobody", "--role", "look"],
        ["password", "nobody", "--stdin"],
        ["add", "B. Operator", "--role", "king", "--stdin"],
        ["add", "B. Operator", "--role", "look", "--stdin"],
    ],
)
def test_a_refused_command_leaves_no_file_behind(tmp_path: Path, words: list[str], file: str) -> None:
    """The lock beside the file of users stayed, and in a folder without users as well. The password is too short."""
    path = tmp_path / "users.toml"
    if file == "there":
        path.write_text(USERS)
        path.chmod(0o600)
    before = {one: one.read_bytes() for one in tmp_path.iterdir()}
    done = CliRunner().invoke(app, [*words, "--file", str(path)], input="short\n")
    assert isinstance(done.exception, InputError), done
    assert {one: one.read_bytes() for one in tmp_path.iterdir()} == before
