"""Ed25519 signatures (RFC 8032) of calibration records and of files: who vouches for a content, and whether it changed.

The id of a record is a hash of its content: it finds what was damaged by accident, but whoever can write the file can
compute a new one. A signature can only be made with the private key of a laboratory, and is checked against the public
keys that the reader trusts. What is signed is not the file but a short text that names the kind of thing, its SHA-256,
the key and the time, so that a signature of one kind never passes for one of another:

    highside.signature/1 LF kind LF sha256 LF key LF time LF

Keys are those of OpenSSH: a public key is one line (`ssh-ed25519 AAAA... Name`), and a key is named by the fingerprint
that `ssh-keygen -l` prints. A file of trusted keys holds such lines; the name behind the key is who signs with it.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from highside.errors import InputError

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

SCHEME = "highside.signature/1"
RECORD = "record"
"""kind of signature: of a calibration record, by its id"""
FILE = "file"
"""kind of signature: of any file, by the SHA-256 of its bytes"""

_TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", re.ASCII)
NAME_MAX = 200
"""Longest name of a signer, characters."""


class SignatureError(ValueError):
    """The signature is not one of this content by this key: one of them was changed."""


class KeyLockedError(InputError):
    """The private key is locked with a passphrase, and none was given."""


class UnknownKeyError(LookupError):
    """The signature is of a key that is not among those trusted."""


@dataclass(frozen=True, slots=True)
class Signature:
    """Who signed, when (UTC, `2026-11-21T02:40:00Z`), and the 64 bytes of the signature in base64.

    `signer` is a convenience for readers and is not proved by the signature; the trusted keys say who `key` is.
    """

    key: str
    signer: str
    time: str
    value: str

    def to_dict(self) -> dict[str, str]:
        return {
            "algorithm": "ed25519",
            "scheme": SCHEME,
            "key": self.key,
            "signer": self.signer,
            "time": self.time,
            "value": self.value,
        }

    @classmethod
    def from_dict(cls, data: object) -> Signature:
        """Read what `to_dict` wrote. Raises ValueError naming what is wrong."""
        if not isinstance(data, dict) or data.get("scheme") != SCHEME or data.get("algorithm") != "ed25519":
            raise ValueError(f"is no signature of the scheme {SCHEME} (ed25519)")
        texts = {name: data.get(name) for name in ("key", "signer", "time", "value")}
        for name, text in texts.items():
            if not isinstance(text, str) or len(text) > NAME_MAX or not text.isprintable():
                raise ValueError(f"{name} is not a text of one line")
        found = cls(**{name: str(text) for name, text in texts.items()})
        if not _TIME.fullmatch(found.time):
            raise ValueError("time is not of the form 2026-11-21T02:40:00Z")
        raw = found._bytes()
        # written in one way only: the last letter has bits that decode to nothing
        if len(raw) != 64 or base64.b64encode(raw).decode("ascii") != found.value:
            raise ValueError("value is not 64 bytes in base64")
        return found

    def _bytes(self) -> bytes:
        try:
            return base64.b64decode(self.value, validate=True)
        except (binascii.Error, ValueError) as error:
            raise ValueError("value is not base64") from error

    def check(self, kind: str, sha256: str, key: Ed25519PublicKey) -> None:
        """Raises SignatureError unless `key` made this signature for this content."""
        from cryptography.exceptions import InvalidSignature

        try:
            key.verify(self._bytes(), _message(kind, sha256, self.key, self.time))
        except InvalidSignature as error:
            raise SignatureError(f"the signature of {self.signer} is not of this content") from error


@dataclass(frozen=True, slots=True)
class SigningKey:
    """A laboratory's private key and the name it signs with."""

    private: Ed25519PrivateKey
    name: str

    @property
    def public_line(self) -> str:
        """The public key as one line for a file of trusted keys."""
        return public_line(self.private.public_key(), self.name)

    @property
    def fingerprint(self) -> str:
        return fingerprint(self.private.public_key())

    def sign(self, kind: str, sha256: str, time: str) -> Signature:
        """Sign a content named by its SHA-256 (64 hexadecimal digits); `time` in UTC, `2026-11-21T02:40:00Z`."""
        key = self.fingerprint
        value = self.private.sign(_message(kind, sha256, key, time))
        return Signature(key, self.name, time, base64.b64encode(value).decode("ascii"))


@dataclass(frozen=True, slots=True)
class TrustedKeys:
    """Public keys by fingerprint, each with the name of who holds it."""

    keys: Mapping[str, tuple[str, Ed25519PublicKey]]

    def check(self, signature: Signature, kind: str, sha256: str) -> str:
        """The trusted name of who signed this content. Raises UnknownKeyError or SignatureError."""
        found = self.keys.get(signature.key)
        if found is None:
            raise UnknownKeyError(
                f"signed with the key {signature.key} ({signature.signer}), which is not trusted here"
            )
        name, key = found
        signature.check(kind, sha256, key)
        return name


def parse_trusted_keys(text: str, *, where: str | None = None) -> TrustedKeys:
    """Public keys, one a line, `#` begins a comment line. Raises InputError naming the line, or
    where there is none at all."""
    serialization, ed25519 = _cryptography()
    keys: dict[str, tuple[str, Ed25519PublicKey]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.strip()
        if not words or words.startswith("#"):
            continue
        kind, _, rest = words.partition(" ")
        name = rest.partition(" ")[2].strip()
        remedy = "a line is `ssh-ed25519 AAAA... Name`, as `highside keys show` prints it"
        try:
            key = serialization.load_ssh_public_key(words.encode("utf-8"))
        except Exception as error:
            # the library raises its own classes beside ValueError for damaged keys
            raise InputError("is no public key", where=where, field=f"line {number}", remedy=remedy) from error
        if not isinstance(key, ed25519.Ed25519PublicKey):
            raise InputError(f"is a key of the kind {kind}, not ed25519", where=where, field=f"line {number}")
        if not name or len(name) > NAME_MAX or not name.isprintable():
            raise InputError("does not say whose key it is", where=where, field=f"line {number}", remedy=remedy)
        keys[fingerprint(key)] = (name, key)
    if not keys:
        raise InputError("holds no key", where=where, remedy="add the lines that `highside keys show` prints")
    return TrustedKeys(MappingProxyType(keys))


def new_key(name: str) -> SigningKey:
    """A new private key. Raises InputError for a name that cannot stand in a line."""
    _, ed25519 = _cryptography()
    return SigningKey(ed25519.Ed25519PrivateKey.generate(), checked_name(name))


def checked_name(name: str) -> str:
    """The name of a signer, stripped. Raises InputError."""
    name = " ".join(name.split())
    if not name or len(name) > NAME_MAX or not name.isprintable():
        raise InputError(f"is not a name of 1 to {NAME_MAX} characters", field="name")
    return name


def private_pem(key: SigningKey, passphrase: bytes | None = None) -> bytes:
    """The private key as PKCS 8 PEM, encrypted where there is a passphrase."""
    serialization, _ = _cryptography()
    lock = serialization.BestAvailableEncryption(passphrase) if passphrase else serialization.NoEncryption()
    return key.private.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, lock)


def parse_private_key(
    data: bytes, name: str, *, passphrase: bytes | None = None, where: str | None = None
) -> SigningKey:
    """A private key as PKCS 8 PEM or as OpenSSH writes it. Raises KeyLockedError, InputError."""
    serialization, ed25519 = _cryptography()
    load = serialization.load_ssh_private_key if b"OPENSSH" in data[:64] else serialization.load_pem_private_key
    try:
        key = load(data, passphrase)
    except TypeError as error:
        # raised for a passphrase that is missing, and for one that is not wanted
        if passphrase:
            raise InputError("has no passphrase", where=where) from error
        raise KeyLockedError("is locked with a passphrase", where=where) from error
    except Exception as error:
        wrong = " or the passphrase is wrong" if passphrase else ""
        raise InputError(
            f"is no private key{wrong}", where=where, remedy="give the file that `highside keys new` made"
        ) from error
    if not isinstance(key, ed25519.Ed25519PrivateKey):
        raise InputError("is not an ed25519 key", where=where, remedy="make one with `highside keys new`")
    return SigningKey(key, name)


def public_line(key: Ed25519PublicKey, name: str) -> str:
    """`ssh-ed25519 AAAA... Name`"""
    serialization, _ = _cryptography()
    line = key.public_bytes(serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH)
    return f"{line.decode('ascii')} {name}"


def fingerprint(key: Ed25519PublicKey) -> str:
    """`SHA256:...`, as `ssh-keygen -l` prints it."""
    blob = base64.b64decode(public_line(key, "x").split()[1])
    return "SHA256:" + base64.b64encode(hashlib.sha256(blob).digest()).decode("ascii").rstrip("=")


def _message(kind: str, sha256: str, key: str, time: str) -> bytes:
    return "\n".join((SCHEME, kind, sha256, key, time, "")).encode("ascii")


def _cryptography() -> tuple[Any, Any]:
    try:
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric import ed25519
    except ImportError as error:
        raise InputError(
            "signatures need cryptography, which is not installed", remedy="pip install 'highside[sign]'"
        ) from error
    return serialization, ed25519
