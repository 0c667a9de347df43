"""Which two calibrations a page offers to compare: of one tool, from the one in force, to one that has not expired."""

from __future__ import annotations

from highside.web.records.shelf import RecordLine, to_compare


def line(name: str, tool: str = "a", *, expires_s: float | None = None, refused: str | None = None) -> RecordLine:
    return RecordLine(name, tool, expires_s=expires_s, refused=refused)


def test_they_are_of_one_tool() -> None:
    lines = [line("new", "b"), line("2", "a"), line("other", "c"), line("1", "a")]
    assert to_compare(lines, {"b": "new"}, 0.0) == ("1", "2")


def test_from_the_one_in_force_to_the_newest_that_lasts() -> None:
    lines = [line("expired", expires_s=5.0), line("force"), line("old"), line("older")]
    assert to_compare(lines, {"a": "force"}, 10.0) == ("force", "old")
    assert to_compare(lines, {"a": "force"}, 1.0) == ("force", "expired")
    assert to_compare(lines, {"a": "expired"}, 10.0) == ("expired", "force")
    assert to_compare([line("force"), line("x", expires_s=1.0)], {"a": "force"}, 10.0) == ("force", "x")


def test_a_damaged_record_is_not_offered() -> None:
    lines = [line("bad", refused="damaged"), line("2", ""), line("worse", refused="damaged"), line("1", "")]
    assert to_compare(lines, {}, 0.0) == ("1", "2")
    assert to_compare(lines[:3], {}, 0.0) == ("", "")
    assert to_compare([], {}, 0.0) == ("", "")
    assert to_compare([line("2", "a"), line("1", "b")], {}, 0.0) == ("1", "2"), "of two tools where there is no other"
