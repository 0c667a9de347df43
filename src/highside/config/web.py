"""The table `[web]`: where the bench page is served, and who may command."""

from __future__ import annotations

import ipaddress
import secrets
from pathlib import Path

from pydantic import Field, SecretStr

from highside.config.settings import Table
from highside.errors import InputError

TOKEN_MIN = 16


class WebTable(Table):
    """The bench page. Without a token anybody who reaches it may look; commands need the token."""

    host: str = Field(default="127.0.0.1", min_length=1, description="Address to listen on; 0.0.0.0: all.")
    port: int = Field(default=8765, ge=0, le=65_535, description="0: any that is free.")
    token_file: Path | None = Field(
        default=None, description="File with the token for commands; absent: a new one each time, printed at the start."
    )
    hosts: tuple[str, ...] = Field(
        default=(),
        description="Names under which the page may be asked for; absent: the loopback's, or any if not bound to it.",
    )
    certificate: Path | None = Field(
        default=None, description="What the page's certificate says beyond the record; see config/certificate.toml."
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

    def allowed_hosts(self) -> list[str]:
        """Host names that are answered: a page elsewhere that makes a browser ask for us under its own name is not."""
        if self.hosts:
            return list(self.hosts)
        return ["127.0.0.1", "localhost", "[::1]", self.host] if self.is_loopback else ["*"]

    def read_token(self) -> SecretStr:
        """The token. Raises InputError for a file that cannot be read or is too short to be one."""
        if self.token_file is None:
            return SecretStr(secrets.token_urlsafe(18))
        try:
            text = self.token_file.read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "is not UTF-8 text"
            raise InputError(f"cannot be read ({reason})", where=str(self.token_file), field="web.token_file") from None
        if len(text) < TOKEN_MIN:
            raise InputError(
                f"has {len(text)} characters", where=str(self.token_file), field="web.token_file",
                remedy=f"a token has at least {TOKEN_MIN}",
            )  # fmt: skip
        return SecretStr(text)
