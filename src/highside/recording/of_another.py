"""What the reader of our tables says of a file of another program: which command reads it."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager

from highside.errors import InputError

_NEEDED = frozenset({"t_s", "ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps"})
"""columns that other programs call otherwise"""
_SAYS = (
    "the header",
    "has ",
    "is not text",
    "is UTF-16",
    "holds a NUL",
    "is a text",
    "a carriage return",
    "holds no mes",
)
"""beginnings of what is said of a file that is no table of ours"""


def import_hint(source: str | None, absent: Collection[str]) -> str:
    """Behind the names of what a file has, where what it lacks is called otherwise in files of other programs."""
    meant = source is not None and bool(_NEEDED & set(absent))
    return f"; if it is of another program: highside import {source} -o REC.csv.gz" if meant else ""


@contextmanager
def of_another(path: str, *, tables_alone: bool) -> Iterator[None]:
    """Around the reading of a file: an error that a file of another program gives names the command that reads it.

    `tables_alone`: what is read has no time, so that no recording is meant.
    """
    try:
        yield
    except InputError as error:
        if tables_alone or not (error.where or "").startswith(path) or not error.what.startswith(_SAYS):
            raise
        hint = f"if it is of another program: highside import {path} -o REC.csv.gz"
        remedy = f"{error.remedy}; {hint}" if error.remedy else hint
        raise InputError(error.what, where=error.where, field=error.field, remedy=remedy) from None
