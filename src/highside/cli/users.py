"""`highside users`: who may sign in at the pages, and what each may do."""

from __future__ import annotations

import getpass
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.say import echo
from highside.errors import InputError

if TYPE_CHECKING:
    from highside.config.users import Role, User

app = typer.Typer(name="users", no_args_is_help=True, help="Who may sign in at the pages of serve and bench.")

NameArgument = Annotated[str, typer.Argument(help="Name of the person, as the journal of acts says it.")]
FileOption = Annotated[Path, typer.Option("--file", help="File of users: [web] users.")]
RoleOption = Annotated[str, typer.Option("--role", help="look, operate or 'put in force'; each includes those before.")]
StdinOption = Annotated[bool, typer.Option("--stdin", help="Read the password from standard input, one line.")]

USERS = Path("users.toml")


@app.command()
def add(
    name: NameArgument,
    role: RoleOption,
    file: FileOption = USERS,
    stdin: StdinOption = False,
    no_password: Annotated[
        bool, typer.Option("--no-password", help="Signs in through the proxy of [web.proxy] alone.")
    ] = False,
) -> None:
    """Add a user; the password is prompted for."""
    from highside.config.users import User, changing_users, plain_name

    found = _role(role)
    try:
        given = plain_name(name)
    except ValueError as error:
        raise InputError(str(error), field="NAME") from None
    _refuse_known(file, given)
    password = None if no_password else _password(stdin)
    with changing_users(file) as users:
        users.append(User(name=given, role=found, password=password))
    echo(f"{file}: {given} may {found}")


@app.command(name="list")
def list_users(file: FileOption = USERS) -> None:
    """Print names and roles."""
    from highside.config.users import read_users

    for user in read_users(file).user:
        echo(f"{user.name}: {user.role}{'' if user.password else ' (by the proxy alone)'}")


@app.command()
def remove(name: NameArgument, file: FileOption = USERS) -> None:
    """Remove a user, who is signed out at once."""
    from highside.config.users import changing_users

    _require_known(name, file)
    with changing_users(file) as users:
        user = _known(users, name, file)
        users.remove(user)
    echo(f"{file}: {user.name} was removed")


@app.command()
def password(name: NameArgument, file: FileOption = USERS, stdin: StdinOption = False) -> None:
    """Give a user another password; who is signed in under that name is signed out."""
    from highside.config.users import changing_users

    _require_known(name, file)
    made = _password(stdin)
    with changing_users(file) as users:
        user = _known(users, name, file)
        users[users.index(user)] = user.model_copy(update={"password": made})
    echo(f"{file}: {user.name} has another password")


@app.command()
def role(name: NameArgument, role: RoleOption, file: FileOption = USERS) -> None:
    """Give a user another role; who is signed in under that name is signed out."""
    from highside.config.users import changing_users

    found = _role(role)
    _require_known(name, file)
    with changing_users(file) as users:
        user = _known(users, name, file)
        users[users.index(user)] = user.model_copy(update={"role": found})
    echo(f"{file}: {user.name} may {found}")


@app.command()
def acts(
    file: Annotated[
        Path | None, typer.Option("--file", help="Journal of acts: [web] acts; without it the one of this user.")
    ] = None,
) -> None:
    """Check that the journal of acts is as it was written, through all its numbered files."""
    from highside.config.places import acts as place
    from highside.errors import Refused
    from highside.web.signin.acts import Acts

    journal = Acts(file or place())
    if not journal.path.exists():
        raise InputError("there is no such journal", where=str(journal.path), field="--file")
    found = journal.chain()
    if found.trouble:
        raise Refused(f"the journal of acts was changed: {found.trouble} ({found.lines} acts before it are whole)")
    echo(f"{journal.path}: {found.lines} acts in {found.files} file{'' if found.files == 1 else 's'}, as written")


def _role(given: str) -> Role:
    from highside.config.users import Role

    try:
        return Role(given.strip().lower().replace("-", " "))
    except ValueError:
        known = ", ".join(repr(str(role)) for role in Role)
        raise InputError(f"{given!r} is no role", field="--role", remedy=f"one of {known}") from None


def _known(users: list[User], name: str, file: Path) -> User:
    from highside.config.users import UsersFile

    user = UsersFile(user=tuple(users)).find(name)
    if user is None:
        names = ", ".join(known.name for known in users) or "nobody"
        raise InputError(f"{name!r} is no user", where=str(file), remedy=f"there are: {names}")
    return user


def _require_known(name: str, file: Path) -> None:
    """Before the file is locked: what is refused leaves nothing behind, not even the lock's file."""
    from highside.config.users import read_users

    _known(list(read_users(file).user), name, file)


def _refuse_known(file: Path, name: str) -> None:
    from highside.config.users import read_users

    if file.exists() and read_users(file).find(name) is not None:
        raise InputError(f"{name!r} is there already", where=str(file), remedy="highside users password, or remove")


def _password(stdin: bool) -> str:
    from highside.web.signin.passwords import LENGTH_MAX, hashed, need_argon2

    need_argon2()
    if stdin:
        return hashed(sys.stdin.readline(4 * LENGTH_MAX).rstrip("\r\n"))
    with warnings.catch_warnings():
        # that no terminal is there is seen by the prompt
        warnings.simplefilter("ignore", getpass.GetPassWarning)
        return hashed(str(typer.prompt("Password", hide_input=True, confirmation_prompt=True)))
