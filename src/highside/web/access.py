"""Who may command. With users: who has signed in, by the role. Without: whoever shows the token, once by its link or
its form (a cookie then), or with each request.

The cookie is not the token but follows from it and from when it was given; it is HttpOnly and SameSite=Strict (and
Secure by https), so that a page of another origin can neither read it nor have it sent. Requests by programs carry
`Authorization: Bearer TOKEN` and no cookie counts there; that goes on with users, where a token is configured.
"""

from __future__ import annotations

import hashlib
import hmac
import time
from collections.abc import Callable

from pydantic import SecretStr

from highside.config.users import Role
from highside.web.signin.acts import Person
from highside.web.signin.people import People, Scope, cookie_of, header_of, peer_of

COOKIE = "highside_operator"
COOKIE_MAX_AGE_S = 7 * 86_400
"""The longest session, an oven's, takes days; a browser left behind forgets the token after a week."""


class Access:
    """Compares in constant time; holds the token. `people`: who signs in, where the token's link opens nothing."""

    def __init__(self, token: SecretStr, clock: Callable[[], float] = time.time, people: People | None = None) -> None:
        self._token = token.get_secret_value().encode()
        self._clock = clock
        self.people = people

    def who(self, scope: Scope) -> Person | None:
        """Whom a request or socket comes from; None for nobody that is known."""
        named = None if self.people is None else self.people.who(scope)
        if named is not None:
            return named
        shown = self.by_header(header_of(scope, "authorization"))
        if not shown and self.people is None:
            shown = self.by_cookie(cookie_of(scope, COOKIE))
        return Person("", Role.FORCE, "token", peer_of(scope)) if shown else None

    def knows(self, scope: Scope) -> bool:
        """Whether somebody who is known sends a request; a session is not renewed by this question."""
        if self.by_header(header_of(scope, "authorization")):
            return True
        if self.people is None:
            return self.by_cookie(cookie_of(scope, COOKIE))
        return self.people.who(scope, touch=False) is not None

    def opens(self, scope: Scope, *, commands: bool) -> bool:
        """Whether a socket for a page is for whom it comes from; `commands`: the page may command."""
        if self.people is None:
            return not commands or self.by_cookie(cookie_of(scope, COOKIE))
        person = self.people.who(scope)
        return person is not None and (not commands or person.may(Role.OPERATE))

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
