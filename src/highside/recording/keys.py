"""Files of keys and of detached signatures: private keys that only their owner can read, trusted keys, `FILE.sig`.

A record carries its signature inside; any other file (a certificate, a report, a recording) has it beside, as JSON in
`FILE.sig`, over the SHA-256 of the file's bytes.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Callable
from pathlib import Path

from highside.calibration.record import to_utc
from highside.calibration.signature import (
    FILE,
    KeyLockedError,
    Signature,
    SigningKey,
    TrustedKeys,
    UnknownKeyError,
    parse_private_key,
    parse_trusted_keys,
    private_pem,
)
from highside.errors import InputError, Refused
from highside.reading import MALFORMED, parse_json, read_bytes
from highside.reading.files import OPEN_FLAGS
from highside.recording.files import write_whole

PASSPHRASE = "HIGHSIDE_KEY_PASSPHRASE"
"""Environment variable with the passphrase of a locked key, where nobody can be asked."""
KEY_MAX = 100_000
"""Bytes of a key file; a private key has about 120."""


def write_key(path: Path, key: SigningKey, passphrase: bytes | None = None) -> Path:
    """Write the private key (readable by its owner alone) and beside it `PATH.pub`. Never over a file that is there.

    Returns the path of the public key. Raises InputError.
    """
    public = path.with_name(path.name + ".pub")
    for there in (path, public):
        if there.exists():
            raise InputError("is there already, and a key is never overwritten", where=str(there))
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | OPEN_FLAGS, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(private_pem(key, passphrase))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", where=str(path)) from error
    try:
        write_whole(public, (key.public_line + "\n").encode())
    except InputError:
        path.unlink()
        raise
    return public


def read_key(path: Path, *, ask: Callable[[], str] | None = None) -> SigningKey:
    """The private key of a file; the name is that of `PATH.pub` beside it. Raises InputError.

    A key that others can read is refused. `ask`: asks somebody for the passphrase of a locked key where the environment
    has none.
    """
    data = _small(path)
    # elsewhere (Windows) the bits say nothing of who can read it
    if hasattr(os, "getuid") and path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise InputError(
            "can be read by others: no signature of it proves anything", where=str(path), remedy="chmod 600"
        )
    public = path.with_name(path.name + ".pub")
    (name, line_key), *_ = read_trusted_keys(public).keys.values()
    try:
        key = parse_private_key(data, name, where=str(path))
    except KeyLockedError:
        passphrase = os.environ.get(PASSPHRASE) or (ask() if ask is not None else None)
        if not passphrase:
            raise InputError(
                "is locked with a passphrase", where=str(path), remedy=f"give it in {PASSPHRASE}"
            ) from None
        key = parse_private_key(data, name, passphrase=passphrase.encode(), where=str(path))
    if key.private.public_key() != line_key:
        raise InputError(f"is not the public key of {path.name}", where=str(public))
    return key


def read_trusted_keys(path: Path) -> TrustedKeys:
    """The public keys of a file. Raises InputError."""
    try:
        text = _small(path).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError("is no file of public keys (not text)", where=str(path)) from None
    return parse_trusted_keys(text, where=str(path))


def sign_file(path: Path, key: SigningKey, *, now_s: float) -> Path:
    """Sign a file; returns the path of its signature, `PATH.sig`. Raises InputError."""
    beside = path.with_name(path.name + ".sig")
    signature = key.sign(FILE, _sha256(path), to_utc(now_s))
    write_whole(beside, (json.dumps(signature.to_dict(), indent=1) + "\n").encode())
    return beside


def check_file(path: Path, trusted: TrustedKeys) -> tuple[str, Signature]:
    """Who signed a file, by the keys trusted, and the signature in `PATH.sig`. Raises InputError, Refused."""
    beside = path.with_name(path.name + ".sig")
    sha256 = _sha256(path)
    if not beside.exists():
        raise Refused(f"{path}: there is no signature {beside.name} beside it")
    try:
        signature = Signature.from_dict(parse_json(_small(beside)))
        return trusted.check(signature, FILE, sha256), signature
    except (*MALFORMED, InputError, UnknownKeyError) as error:
        raise Refused(f"{path}: {error}") from error


def _sha256(path: Path) -> str:
    """Of the bytes as they are on the disk, gzipped or not."""
    digest = hashlib.sha256()
    try:
        # a pipe would be waited for, a device has no end, and neither is there to be checked afterwards
        if path.exists() and not path.is_file():
            what = "a directory" if path.is_dir() else "a pipe, a socket or a device"
            raise InputError(f"is {what}, not a file", where=str(path), remedy="sign a file that stays")
        with path.open("rb") as file:
            while part := file.read(1 << 20):
                digest.update(part)
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path)) from error
    return digest.hexdigest()


def _small(path: Path) -> bytes:
    return read_bytes(path, max_bytes=KEY_MAX)
