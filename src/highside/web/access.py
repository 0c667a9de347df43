"""Who may command: whoever shows the token, once by its link or its form (a cookie then), or with each request.

The cookie is not the token but follows from it; it is HttpOnly and SameSite=Strict, so that a page of another origin
can neither read it nor have it sent. Requests by programs carry `Authorization: Bearer TOKEN` and no cookie counts
there.
"""

from __future__ import annotations

import hashlib
import hmac

from pydantic import SecretStr

COOKIE = "highside_operator"


class Access:
    """Compares in constant time; holds the token."""

    def __init__(self, token: SecretStr) -> None:
        self._token = token.get_secret_value().encode()
        self._cookie = hmac.new(self._token, b"highside bench page", hashlib.sha256).hexdigest()

    @property
    def token(self) -> str:
        return self._token.decode()

    @property
    def cookie(self) -> str:
        """What is kept in the browser of who has shown the token."""
        return self._cookie

    def by_token(self, shown: str | None) -> bool:
        return shown is not None and hmac.compare_digest(shown.strip().encode(), self._token)

    def by_cookie(self, shown: str | None) -> bool:
        return shown is not None and hmac.compare_digest(shown.encode(), self._cookie.encode())

    def by_header(self, authorization: str | None) -> bool:
        """`Authorization: Bearer TOKEN`."""
        kind, _, shown = (authorization or "").partition(" ")
        return kind.lower() == "bearer" and self.by_token(shown)
