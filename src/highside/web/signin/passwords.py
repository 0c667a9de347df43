"""Passwords: hashed by argon2id (RFC 9106) with the library's own parameters, compared in constant time."""

from __future__ import annotations

import secrets
import unicodedata
from functools import cache
from typing import TYPE_CHECKING

from highside.errors import InputError

if TYPE_CHECKING:
    from argon2 import PasswordHasher

LENGTH_MIN = 10
"""Characters. NIST SP 800-63B asks for eight at least where attempts are limited, and for no rules beyond length."""
LENGTH_MAX = 200


def hashed(password: str) -> str:
    """The text that is kept. Raises InputError for a password that is too short or too long."""
    text = _plain(password)
    if not LENGTH_MIN <= len(text) <= LENGTH_MAX:
        what = f"has {len(text)} characters: {LENGTH_MIN} to {LENGTH_MAX} are allowed"
        raise InputError(what, field="password", remedy="take several words")
    return _hasher().hash(text)


def matches(kept: str | None, password: str) -> bool:
    """Whether the password is the one that was kept. Without one the same work is done, and the answer is no."""
    from argon2.exceptions import InvalidHashError, VerificationError

    text = _plain(password[: LENGTH_MAX + 1])
    try:
        _hasher().verify(_nobody() if kept is None else kept, text)
    except (VerificationError, InvalidHashError):
        return False
    return kept is not None


def need_argon2() -> None:
    """Raises InputError where the library is not installed."""
    try:
        import argon2  # noqa: F401
    except ImportError:
        raise InputError("passwords need argon2-cffi", remedy="pip install 'highside[web]'") from None


def _plain(password: str) -> str:
    """The same letters from any keyboard are the same password."""
    return unicodedata.normalize("NFKC", password)


@cache
def _hasher() -> PasswordHasher:
    need_argon2()
    from argon2 import PasswordHasher

    return PasswordHasher()


@cache
def _nobody() -> str:
    """What is compared with where there is no such user: a password nobody has."""
    return _hasher().hash(secrets.token_urlsafe(32))
