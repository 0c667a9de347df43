"""Who may command: whoever shows the token, once by its link or its form (a cookie then), or with each request.

The cookie is not the token but follows from it and from when it was given; it is HttpOnly and SameSite=Strict (and
Secure by https), so that a page of another origin can neither read it nor have it sent. Requests by programs carry
`Authorization: Bearer TOKEN` and no cookie counts there.
"""

from __future__ import annotations

import hashlib
import hmac
import time
from collections.abc import Callable

from pydantic import SecretStr

COOKIE = "highside_operator"
COOKIE_MAX_AGE_S = 7 * 86_400
"""The longest session, an oven's, takes days; a browser left behind forgets the token after a week."""


class Access:
    """Compares in constant time; holds the token."""

    def __init__(self, token: SecretStr, clock: Callable[[], float] = time.time) -> None:
        self._token = token.get_secret_value().encode()
        self._clock = clock

    @property
    def token(self) -> str:
        return self._token.decode()

    def cookie(self) -> str:
        """What is kept in the browser of who has shown the token: when that was, and that it was so."""
        given = str(int(self._clock()))
        return f"{given}.{self._sealed(given)}"

    def _sealed(self, given: str) -> str:
        return hmac.new(self._token, f"highside bench page {given}".encode(), hashlib.sha256).hexdigest()

    def by_token(self, shown: str | None) -> bool:
        return shown is not None and hmac.compare_digest(shown.strip().encode(), self._token)

    def by_cookie(self, shown: str | None) -> bool:
        given, _, seal = (shown or "").partition(".")
        if not hmac.compare_digest(seal.encode(), self._sealed(given).encode()):
            return False
        # a clock that was set back since shuts nobody out
        return self._clock() - int(given) <= COOKIE_MAX_AGE_S

    def by_header(self, authorization: str | None) -> bool:
        """`Authorization: Bearer TOKEN`."""
        kind, _, shown = (authorization or "").partition(" ")
        return kind.lower() == "bearer" and self.by_token(shown)
