"""`highside keys`: the keys of a laboratory, signatures of records and files, and whether they hold."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli.options import as_options
from highside.cli.say import echo, echo_json
from highside.errors import InputError, Refused

if TYPE_CHECKING:
    from highside.calibration.signature import SigningKey, TrustedKeys

app = typer.Typer(
    name="keys",
    no_args_is_help=True,
    help="Sign calibration records and certificates (ed25519), and check signatures.",
)

KeyOption = Annotated[Path, typer.Option("--key", help="Private key; its name is in KEY.pub beside it.")]
TrustedOption = Annotated[Path, typer.Option("--trusted", help="File of trusted public keys, one a line.")]


@app.command()
def new(
    file: Annotated[Path, typer.Argument(help="Private key to write; the public one goes to FILE.pub.")],
    name: Annotated[str, typer.Option("--name", help="Who signs with it, as readers shall see it.")],
    passphrase: Annotated[bool, typer.Option("--passphrase", help="Lock it with a passphrase (prompted for).")] = False,
) -> None:
    """Make a key. The private one stays with the laboratory; the public line goes to whoever shall trust it."""
    from highside.calibration.signature import new_key
    from highside.recording.keys import write_key

    with as_options("name"):
        key = new_key(name)
    secret = typer.prompt("Passphrase", hide_input=True, confirmation_prompt=True).encode() if passphrase else None
    public = write_key(file, key, secret)
    echo(f"{file}: private key (readable by you alone), {public}: public key {key.fingerprint}")
    echo(key.public_line)


@app.command()
def show(file: Annotated[Path, typer.Argument(help="Public key, or a file of trusted keys.")]) -> None:
    """Print fingerprint and holder of each public key of a file."""
    from highside.recording.keys import read_trusted_keys

    for fingerprint, (name, _) in read_trusted_keys(file).keys.items():
        echo(f"{fingerprint}  {name}")


@app.command()
def sign(
    files: Annotated[list[Path], typer.Argument(help="Records (signed inside) or any files (signed in FILE.sig).")],
    key: KeyOption,
) -> None:
    """Sign records and files: you vouch for them."""
    private = signing_key(key)
    for file in files:
        _sign(file, private)


@app.command()
def verify(
    files: Annotated[list[Path], typer.Argument(help="Signed records, or files with FILE.sig beside them.")],
    trusted: TrustedOption,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Check signatures. Exit 1 unless every file is signed by a trusted key and unchanged."""
    from highside.recording.keys import read_trusted_keys

    keys = read_trusted_keys(trusted)
    rows = [_checked(file, keys) for file in files]
    if as_json:
        echo_json(json.dumps({"files": rows}))
    else:
        for row in rows:
            echo(f"{row['file']}: signed by {row['signer']} on {row['time']}" if row["valid"] else f"{row['refused']}")
    if not all(row["valid"] for row in rows):
        raise typer.Exit(1)


def signing_key(path: Path) -> SigningKey:
    """The private key of a file; somebody at the terminal is asked for its passphrase. Raises InputError."""
    import sys

    from highside.recording.keys import read_key

    def ask() -> str:
        return str(typer.prompt(f"Passphrase of {path}", hide_input=True, err=True))

    return read_key(path, ask=ask if sys.stdin.isatty() else None)


def signing_key_if_any(path: Path | None) -> SigningKey | None:
    """As `signing_key`, where a key was given."""
    return None if path is None else signing_key(path)


def _sign(file: Path, key: SigningKey) -> None:
    from highside.cli.kinds import SIGNATURE, refuse_another_kind
    from highside.recording.calibration_store import read_record
    from highside.recording.files import write_whole
    from highside.recording.keys import sign_file

    if _is_record(file):
        record = read_record(file).signed(key, now_s=time.time())
        write_whole(file, record.to_json().encode())
        echo(f"{file}: record {record.id[:12]} signed by {key.name} ({key.fingerprint})")
    else:
        refuse_another_kind(file.with_name(file.name + ".sig"), SIGNATURE, "FILE.sig")
        beside = sign_file(file, key, now_s=time.time())
        echo(f"{beside}: {file.name} signed by {key.name} ({key.fingerprint})")


def _checked(file: Path, keys: TrustedKeys) -> dict[str, Any]:
    from highside.recording.calibration_store import read_record
    from highside.recording.keys import check_file

    try:
        if _is_record(file):
            record = read_record(file)
            signer, signature = record.check_signature(keys), record.signature
        else:
            signer, signature = check_file(file, keys)
    except Refused as error:
        return {"file": str(file), "valid": False, "signer": None, "time": None, "refused": str(error)}
    assert signature is not None, "checked above"
    return {"file": str(file), "valid": True, "signer": signer, "time": signature.time, "refused": None}


def _is_record(file: Path) -> bool:
    """Whether a file says of itself that it is a calibration record; whether that is true, the reader finds."""
    from highside.calibration.record import SCHEMA
    from highside.reading import open_binary

    if file.is_dir():
        raise InputError("is a directory, not a file", where=str(file))
    family = SCHEMA.partition("/")[0].encode()
    if file.suffix != ".json" or not file.is_file():
        return False
    with open_binary(file) as stream:
        try:
            return family in stream.read(8_000_000)
        except OSError as error:
            raise InputError(f"cannot be read ({error.strerror or error})", where=str(file)) from error
