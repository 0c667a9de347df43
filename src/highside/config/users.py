"""The file of users: who may sign in at the pages, and what each may do; `highside users` writes it.

    [[user]]
    name = "K. Hansen"
    role = "operate"
    password = "$argon2id$v=19$..."

A password is kept as argon2's own text (RFC 9106), never as itself. A user without one signs in through a proxy alone
(`[web.proxy]`). The file is for the page's user alone: whoever may write it may do everything.
"""

from __future__ import annotations

import contextlib
import json
import os
import unicodedata
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from highside.config.mistakes import input_error
from highside.errors import InputError
from highside.reading import parse_toml, read_named
from highside.reading.config_table import ConfigTable
from highside.reading.files import OPEN_FLAGS
from highside.recording.files import write_whole
from highside.recording.locks import lock

USERS_MAX = 1_000
NAME_MAX = 64
FILE_MAX = 400_000
"""Bytes of the file: a thousand users of some 250."""
_HEAD = "# Who may sign in; written by `highside users`. For the user of the page alone.\n"


class Role(StrEnum):
    """What somebody may do; each includes those before it."""

    LOOK = "look"
    OPERATE = "operate"
    FORCE = "put in force"

    @property
    def rank(self) -> int:
        return list(Role).index(self)

    def includes(self, other: Role) -> bool:
        """Whether who has this role may do what the other allows."""
        return self.rank >= other.rank


def plain_name(name: str) -> str:
    """A name as it is compared: composed (NFC), without blanks around. Raises ValueError for one that is none."""
    text = unicodedata.normalize("NFC", name).strip()
    if not text or len(text) > NAME_MAX:
        raise ValueError(f"a name has 1 to {NAME_MAX} characters")
    if not text.isprintable():
        raise ValueError("a name is one line of printable characters")
    return text


class User(ConfigTable):
    """One of them."""

    name: Annotated[str, AfterValidator(plain_name)] = Field(description="As the journal of acts names the person.")
    role: Role = Field(description="What the person may do; each role includes those before it.")
    password: str | None = Field(
        default=None, pattern=r"^\$argon2id\$[!-~]{20,400}$", description="argon2's text; absent: only by the proxy."
    )


class UsersFile(ConfigTable):
    """The whole file."""

    user: tuple[User, ...] = Field(default=(), max_length=USERS_MAX)

    @model_validator(mode="after")
    def _once(self) -> Self:
        names = [user.name.casefold() for user in self.user]
        twice = next((user.name for user in self.user if names.count(user.name.casefold()) > 1), None)
        if twice is not None:
            raise ValueError(f"{twice!r} is there twice")
        return self

    def find(self, name: str) -> User | None:
        """The user of a name, whatever the case of its letters."""
        try:
            wanted = plain_name(name).casefold()
        except ValueError:
            return None
        return next((user for user in self.user if user.name.casefold() == wanted), None)

    def to_toml(self) -> str:
        """The file's text."""
        blocks = []
        for user in self.user:
            lines = ["[[user]]", f"name = {_quoted(user.name)}", f"role = {_quoted(user.role)}"]
            lines += [] if user.password is None else [f"password = {_quoted(user.password)}"]
            blocks.append("\n".join(lines) + "\n")
        return "\n".join([_HEAD, *blocks])


def read_users(path: Path) -> UsersFile:
    """Raises InputError for a file that cannot be read, is no such file, or can be read or written by others."""
    data = read_named(path, "web.users", max_bytes=FILE_MAX)
    if hasattr(os, "getuid") and path.stat().st_mode & 0o077:
        raise InputError("may be read by others", where=str(path), field="web.users", remedy=f"chmod 600 {path}")
    tables = parse_toml(data, where=str(path))
    try:
        return UsersFile.model_validate(tables)
    except ValidationError as error:
        raise input_error(error, str(path), {}, UsersFile) from None


@contextlib.contextmanager
def changing_users(path: Path) -> Iterator[list[User]]:
    """The users, to be changed in place; written at the end, while nobody else changes them. Raises InputError."""
    beside = path.with_name(f".{path.name}.lock")
    try:
        descriptor = os.open(beside, os.O_RDWR | os.O_CREAT | OPEN_FLAGS, 0o600)
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", where=str(path)) from None
    try:
        lock(descriptor, wait=True)
        users = list(read_users(path).user) if path.exists() else []
        yield users
        try:
            made = UsersFile(user=tuple(users))
        except ValidationError as error:
            raise input_error(error, str(path), {}, UsersFile) from None
        _write_private(path, made.to_toml().encode())
    finally:
        os.close(descriptor)


def _write_private(path: Path, data: bytes) -> None:
    """Whole, and for its owner alone from the first moment on."""
    earlier = os.umask(0o077)
    try:
        write_whole(path, data)
    finally:
        os.umask(earlier)


def _quoted(text: str) -> str:
    """A TOML string: names are printable, so that JSON's own escapes are TOML's."""
    return json.dumps(str(text), ensure_ascii=False)
