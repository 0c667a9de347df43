"""The journal of acts: chained through files of bounded size; what is changed, taken out or put in between is found."""

from __future__ import annotations

import json
import multiprocessing
from pathlib import Path

import pytest

from highside.cli.commands import run
from highside.config.users import Role
from highside.web.signin.acts import Acts, Person
from highside.web.signin.chain import ChainedLines

WHO = Person("F. Force", Role.FORCE, "password", "127.0.0.1")


def made(folder: Path, count: int = 40, file_max: int = 1_000) -> ChainedLines:
    lines = ChainedLines(folder / "acts.jsonl", file_max)
    for k in range(count):
        lines.append({"act": f"act {k} äöü", "who": "F. Force"})
    return lines


def test_no_file_is_longer_than_allowed_and_none_is_lost(tmp_path: Path) -> None:
    lines = made(tmp_path)
    files = lines.files()
    assert [path.name for path in files[:2]] == ["acts-000001.jsonl", "acts-000002.jsonl"]
    assert files[-1].name == "acts.jsonl" and len(files) > 2
    assert all(path.stat().st_size <= 1_000 for path in files)
    kept = [json.loads(line)["act"] for path in files for line in path.read_text().splitlines()]
    assert kept == [f"act {k} äöü" for k in range(40)]
    assert (lines.check().lines, lines.check().files, lines.check().trouble) == (40, len(files), "")


@pytest.mark.parametrize(
    ("place", "said"),
    [("changed", "acts-000002.jsonl line 3"), ("taken out", "acts-000002.jsonl line 3"), ("put in", "line 3"),
     ("without a hash", "line 3"), ("a file lost", "acts-000002.jsonl is missing"), ("newest lost", "")],
)  # fmt: skip
def test_what_was_tampered_with_is_found(tmp_path: Path, place: str, said: str) -> None:
    lines = made(tmp_path)
    path = lines.files()[1]
    kept = path.read_text().splitlines(keepends=True)
    if place == "changed":
        kept[2] = kept[2].replace("F. Force", "O. Other")
    elif place == "taken out":
        del kept[2]
    elif place == "put in":
        kept.insert(2, kept[1])
    elif place == "without a hash":
        kept.insert(2, json.dumps({"act": "none of ours"}) + "\n")
    path.write_text("".join(kept))
    if place == "a file lost":
        path.unlink()
    if place == "newest lost":
        lines.path.unlink()
        # the chain goes on from the last full file
        lines.append({"act": "after"})
    found = lines.check()
    assert (found.trouble == "") == (said == "") and said in found.trouble


def test_a_torn_line_and_lines_of_before_do_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "acts.jsonl"
    path.write_text('{"act": "of an earlier version"}\n')
    acts = Acts(path)
    acts.write(WHO, "sign in")
    with path.open("a") as file:
        file.write('{"act": "torn off by the p')
    acts.write(WHO, "sign out")
    assert acts.chain().trouble == "" and acts.chain().lines == 2
    assert [row["act"] for row in acts.last()] == ["sign out", "sign in", "of an earlier version"]
    assert all("h" not in row for row in acts.last())


def test_the_newest_are_shown_across_files(tmp_path: Path) -> None:
    lines = made(tmp_path)
    shown = Acts(lines.path).last(30)
    assert [row["act"] for row in shown] == [f"act {k} äöü" for k in range(39, 9, -1)]


def _write(path: Path, name: str) -> None:
    lines = ChainedLines(path, 3_000)
    for k in range(50):
        lines.append({"act": f"{name} {k}"})


def test_two_processes_write_one_chain(tmp_path: Path) -> None:
    path = tmp_path / "acts.jsonl"
    context = multiprocessing.get_context("fork")
    both = [context.Process(target=_write, args=(path, name)) for name in ("serve", "bench")]
    for one in both:
        one.start()
    for one in both:
        one.join(30)
    found = ChainedLines(path).check()
    assert (found.lines, found.trouble) == (100, "")


def test_the_command_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = made(tmp_path, 3)
    asked = ["users", "acts", "--file", str(lines.path)]
    assert run(asked) == 0 and "3 acts in 1 file, as written" in capsys.readouterr().out
    lines.path.write_text(lines.path.read_text().replace("act 1", "act 7"))
    assert run(asked) == 1
    assert "acts.jsonl line 2 does not follow" in capsys.readouterr().err
