"""The errors a user may see: each says what is wrong, where, and what to do, in one line.

`InputError` ends a command with exit status 2 (wrong usage or input), `Refused` with 1 (the input was read, the
answer is bad news that scripts must see). Anything else that reaches the command line is a defect of highside.
"""

from __future__ import annotations

from highside.printable import one_line


class HighsideError(Exception):
    """Base of all errors made for a user's eyes; `str(error)` is one line that a terminal prints as it is: names and
    texts from outside may be in it."""

    exit_status = 2

    def __str__(self) -> str:
        return one_line(super().__str__())


class InputError(HighsideError):
    """Wrong usage or unreadable input.

    `where` names the file (and line or table), `field` what in it, `remedy` what to do.
    """

    exit_status = 2

    def __init__(
        self, what: str, *, where: str | None = None, field: str | None = None, remedy: str | None = None
    ) -> None:
        self.what, self.where, self.field, self.remedy = what, where, field, remedy
        parts = [part for part in (where, field, what) if part]
        line = ": ".join(parts)
        super().__init__(f"{line}; {remedy}" if remedy else line)


class Refused(HighsideError):  # noqa: N818 - an answer, not a failure
    """The input was read and understood, and the answer is no (a pose set, a record, a survey)."""

    exit_status = 1
