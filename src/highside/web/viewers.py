"""Who looks at the page: known from when the page is given out, forgotten when its socket never comes or stays away.

Each viewer costs the memory of his page and a share of the processor that acquisition needs, so that there are places
for so many and no more; those with the token have places of their own, which no crowd of onlookers takes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

OPERATORS_MAX = 20
"""Pages of those who have shown the token, beside the places of onlookers: a table, a phone or two, and reloads."""
SOCKETS_EACH = 3
"""Sockets of one page at a time: its own, and one or two that were cut and are not yet known to be dead."""


class Viewers:
    """Pages given out, by the id of each, and whether it may command."""

    def __init__(self, onlookers_max: int) -> None:
        self.onlookers_max = onlookers_max
        self._pages: dict[str, bool] = {}
        self._building = {True: 0, False: 0}
        self._sockets: dict[str, int] = {}

    def full(self, *, commands: bool) -> bool:
        """Whether there is no place left."""
        taken = sum(1 for may in self._pages.values() if may is commands) + self._building[commands]
        return taken >= (OPERATORS_MAX if commands else self.onlookers_max)

    @contextlib.contextmanager
    def building(self, *, commands: bool) -> Iterator[None]:
        """While a page is made its place is taken: of a hundred that ask at once none is made for nothing."""
        self._building[commands] += 1
        try:
            yield
        finally:
            self._building[commands] -= 1

    def add(self, page: str, *, commands: bool) -> None:
        self._pages[page] = commands

    def remove(self, page: str) -> None:
        self._pages.pop(page, None)

    def __contains__(self, page: object) -> bool:
        return page in self._pages

    def __len__(self) -> int:
        return len(self._pages)

    def may_command(self, page: str) -> bool:
        return self._pages.get(page, False)

    def socket_opened(self, page: str) -> bool:
        """Count one in; False where the page is not known or has enough."""
        if page not in self._pages or self._sockets.get(page, 0) >= SOCKETS_EACH:
            return False
        self._sockets[page] = self._sockets.get(page, 0) + 1
        return True

    def socket_closed(self, page: str) -> None:
        left = self._sockets.get(page, 0) - 1
        if left > 0:
            self._sockets[page] = left
        else:
            self._sockets.pop(page, None)
