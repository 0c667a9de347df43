"""The table `[web]`: where the bench page is served, and who may command."""

from __future__ import annotations

import ipaddress
import secrets
import ssl
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, SecretStr, field_validator, model_validator

from highside.config.places import acts
from highside.config.users import read_users
from highside.errors import InputError
from highside.reading import CERTIFICATES_MAX, SECRET_MAX, read_named
from highside.reading.config_table import ConfigTable, HostName

TOKEN_MIN = 16


Host = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.:%\[\]-]{1,253}$")]


class WebTls(ConfigTable):
    """The table `[web.tls]`: the page by https."""

    certificate: Path = Field(description="Certificate (PEM), with those between it and the root below it.")
    key: Path = Field(description="Its private key (PEM), not encrypted.")

    def context(self) -> ssl.SSLContext:
        """Raises InputError where a file cannot be read, the two do not belong together, or the time is over."""
        try:
            from cryptography import x509
            from cryptography.hazmat.primitives.serialization import load_pem_private_key
        except ImportError:
            remedy = "pip install 'highside[web]'"
            raise InputError("[web.tls] needs the library cryptography", field="web.tls", remedy=remedy) from None

        _only_for(self.key, 0o007, "web.tls.key", "640")
        shown, secret = _bytes(self.certificate, "web.tls.certificate"), _bytes(self.key, "web.tls.key")
        try:
            leaf = x509.load_pem_x509_certificates(shown)[0]
        except (ValueError, IndexError):
            raise _tls_error(
                "certificate", self.certificate, "holds no certificate", "a PEM file is expected"
            ) from None
        try:
            key = load_pem_private_key(secret, password=None)
        except TypeError:
            raise _tls_error("key", self.key, "is encrypted", "decrypt it, and let only its owner read it") from None
        except ValueError:
            raise _tls_error("key", self.key, "holds no private key", "a PEM file is expected") from None
        if leaf.public_key() != key.public_key():
            raise _tls_error(
                "key", self.key, f"does not belong to {self.certificate}", "name the certificate's own key"
            )
        now = datetime.now(UTC)
        if now > leaf.not_valid_after_utc:
            until = f"{leaf.not_valid_after_utc:%Y-%m-%d}"
            raise _tls_error("certificate", self.certificate, f"has expired on {until}", "renew it")
        if now < leaf.not_valid_before_utc:
            begins = f"{leaf.not_valid_before_utc:%Y-%m-%d}"
            raise _tls_error("certificate", self.certificate, f"is not valid before {begins}", "is the clock right?")
        made = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        made.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            made.load_cert_chain(self.certificate, self.key)
        except ssl.SSLError as error:
            text = f"cannot be used with its key ({error.reason or error})"
            raise _tls_error("certificate", self.certificate, text, "make the pair anew") from None
        return made


class WebProxy(ConfigTable):
    """The table `[web.proxy]`: a proxy that has signed people in (OpenID Connect) and names them in a header. Only what
    comes from its address is believed."""

    address: str = Field(description="Address that the proxy connects from.")
    header: str = Field(
        default="X-Auth-Request-User",
        pattern=r"^[A-Za-z][A-Za-z0-9-]{1,63}$",
        description="Header with the name of the user; the proxy must set it anew in every request.",
    )
    origin: str = Field(
        pattern=r"^https?://[a-z0-9.-]{1,253}(:[0-9]{1,5})?$", description="Where browsers reach the proxy."
    )

    @field_validator("address")
    @classmethod
    def _an_address(cls, given: str) -> str:
        return str(ipaddress.ip_address(given))


class WebTable(ConfigTable):
    """A page. Without users anybody who reaches it may look, and commands need the token; with users everybody has to
    sign in, and there is no token."""

    host: HostName = Field(default="127.0.0.1", min_length=1, description="Address to listen on; 0.0.0.0: all.")
    port: int = Field(default=8765, ge=0, le=65_535, description="0: any that is free.")
    token_file: Path | None = Field(
        default=None, description="File with the token for commands; absent: a new one each time, printed at the start."
    )
    allowed_hosts: tuple[Host, ...] = Field(
        default=(),
        description="Names and addresses under which the page may be requested, beside this machine's own.",
    )
    tls: WebTls | None = None
    users: Path | None = Field(
        default=None, description="File of users (`highside users`); absent: nobody signs in, commands need the token."
    )
    acts: Path | None = Field(
        default=None, description="Journal of what was done, with `users`; absent: in the user's state directory."
    )
    proxy: WebProxy | None = None
    viewers: int = Field(default=50, ge=1, le=500, description="Who may look on at once, beside those with the token.")
    certificate: Path | None = Field(
        default=None, description="What certificates say beyond the record; see config/certificate.toml."
    )
    home_port: int | None = Field(
        default=None,
        ge=1,
        le=65_535,
        description="Port of the page that begins sessions, to which this one leads back.",
    )
    rate_hz: float = Field(default=5.0, gt=0, le=20, description="Pictures a second for each viewer, at most.")

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches the page."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def warning(self) -> str | None:
        """What whoever starts the page should know of how it is served."""
        if self.is_loopback or self.tls is not None:
            return None
        return (
            f"[web] host = {self.host!r} without [web.tls]: the token and all commands travel in clear, and who can"
            " listen on that network can command; give a certificate and its key, or bind to 127.0.0.1 and tunnel"
        )

    @property
    def acts_file(self) -> Path:
        """Where acts are written."""
        return acts() if self.acts is None else self.acts

    @property
    def is_https(self) -> bool:
        """Whether browsers come by https alone."""
        return self.tls is not None or (self.proxy is not None and self.proxy.origin.startswith("https://"))

    @model_validator(mode="after")
    def _users_for_the_proxy(self) -> Self:
        if self.proxy is not None and self.users is None:
            raise ValueError("[web.proxy] needs users: the file says what each person may do")
        return self

    def check(self) -> None:
        """Everything that can be judged before the page is served. Raises InputError."""
        self.read_token()
        self.tls_context()
        if self.users is not None:
            read_users(self.users)

    def tls_context(self) -> ssl.SSLContext | None:
        """For the server. Raises InputError for files that cannot be used."""
        return None if self.tls is None else self.tls.context()

    def read_token(self) -> SecretStr:
        """The token. Raises InputError for a file that cannot be read or is too short to be one."""
        if self.token_file is None:
            return SecretStr(secrets.token_urlsafe(18))
        _only_for(self.token_file, 0o077, "web.token_file", "600")
        try:
            text = read_named(self.token_file, "web.token_file", max_bytes=SECRET_MAX).decode().strip()
        except UnicodeDecodeError:
            raise InputError("is not UTF-8 text", where=str(self.token_file), field="web.token_file") from None
        if len(text) < TOKEN_MIN:
            raise InputError(
                f"has {len(text)} characters",
                where=str(self.token_file),
                field="web.token_file",
                remedy=f"a token has at least {TOKEN_MIN}",
            )
        return SecretStr(text)


def _bytes(path: Path, field: str) -> bytes:
    return read_named(path, field, max_bytes=CERTIFICATES_MAX)


def _only_for(path: Path, forbidden: int, field: str, mode: str) -> None:
    """Raises InputError where a secret's file may be read by others than it should."""
    try:
        found = path.stat().st_mode
    except OSError:
        return  # said when it is read
    if found & forbidden:
        raise InputError(
            f"may be read by others (mode {found & 0o777:o})",
            where=str(path),
            field=field,
            remedy=f"chmod {mode} {path}",
        )


def _tls_error(name: str, path: Path, what: str, remedy: str) -> InputError:
    return InputError(what, where=str(path), field=f"web.tls.{name}", remedy=remedy)
