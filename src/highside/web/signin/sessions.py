"""Who is signed in: sessions in the memory of this process, each known to its browser by a random cookie.

Kept is the SHA-256 of the cookie: nobody who reads the memory of a crash has a session. A session ends by sign-out,
after `AGE_MAX_S`, after `IDLE_MAX_S` without a request, or when the user was removed or has another role or password;
all of them end with the process.
"""

from __future__ import annotations

import hashlib
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from highside.config.users import User

COOKIE = "highside_session"
AGE_MAX_S = 12 * 3600.0
"""A shift on a rig has twelve hours."""
IDLE_MAX_S = 4 * 3600.0
"""Without a request; an open live page keeps its own session."""
SESSIONS_MAX = 500
"""At once; beyond, the one not used for longest ends."""
PER_USER = 10
"""Browsers of one user."""


@dataclass(slots=True)
class _Session:
    user: User
    begun_s: float
    used_s: float


class Sessions:
    """The table of them."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._sessions: OrderedDict[str, _Session] = OrderedDict()

    def __len__(self) -> int:
        return len(self._sessions)

    def begin(self, user: User) -> str:
        """A new session of a user who has proved who they are; the cookie."""
        cookie = secrets.token_urlsafe(32)
        now = self._clock()
        own = [key for key, session in self._sessions.items() if session.user.name == user.name]
        for key in own[: max(0, len(own) - PER_USER + 1)]:
            del self._sessions[key]
        self._sessions[_key(cookie)] = _Session(user, now, now)
        while len(self._sessions) > SESSIONS_MAX:
            self._sessions.popitem(last=False)
        return cookie

    def user(self, cookie: str | None, *, touch: bool = True) -> User | None:
        """Whose session this is; None where there is none or it has ended. `touch`: it counts as used."""
        key = _key(cookie or "")
        session = self._sessions.get(key)
        if session is None:
            return None
        now = self._clock()
        if now - session.begun_s > AGE_MAX_S or now - session.used_s > IDLE_MAX_S:
            del self._sessions[key]
            return None
        if touch:
            session.used_s = now
            self._sessions.move_to_end(key)
        return session.user

    def end(self, cookie: str | None) -> None:
        """Signed out."""
        self._sessions.pop(_key(cookie or ""), None)


def _key(cookie: str) -> str:
    return hashlib.sha256(cookie.encode("utf-8", "replace")).hexdigest()
