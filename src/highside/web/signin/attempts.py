"""How often somebody may try to sign in: counted by address, by name, and by both; pure, with a clock.

Who guesses from one address is held up soon, who guesses one name from many addresses later; whoever shares neither
signs in as ever, so that nobody is locked out by a stranger who knows a name.
"""

from __future__ import annotations

import ipaddress
import time
from collections import OrderedDict, deque
from collections.abc import Callable

WITHIN_S = 900.0
"""A failed attempt is forgotten after that."""
PER_PAIR = 5
"""Failed attempts of one name from one address: a person mistypes twice or thrice."""
PER_ADDRESS = 20
"""Failed attempts from one address: some people behind one router."""
PER_NAME = 200
"""Failed attempts of one name from everywhere: 20,000 a day, against 10 characters."""
KEPT_MAX = 20_000
"""Names and addresses kept; beyond, those that failed first are forgotten. Some 300 bytes each."""


class Attempts:
    """Counts failures. `wait_s` before an attempt, `failed` or `succeeded` after it."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._failed: OrderedDict[tuple[str, ...], deque[float]] = OrderedDict()

    def wait_s(self, name: str, address: str) -> float:
        """Seconds until another attempt is looked at; 0: now."""
        now = self._clock()
        return max(0.0, *(self._wait(key, limit, now) for key, limit in _keys(name, address)))

    def failed(self, name: str, address: str) -> None:
        """One more failure."""
        now = self._clock()
        for key, limit in _keys(name, address):
            times = self._failed.setdefault(key, deque(maxlen=limit))
            times.append(now)
            self._failed.move_to_end(key)
        while len(self._failed) > KEPT_MAX:
            self._failed.popitem(last=False)

    def succeeded(self, name: str, address: str) -> None:
        """The person is there: what was mistyped before is forgotten, but not what others tried."""
        (pair, _), *_rest = _keys(name, address)
        self._failed.pop(pair, None)

    def _wait(self, key: tuple[str, ...], limit: int, now: float) -> float:
        times = self._failed.get(key)
        if times is None or len(times) < limit:
            return 0.0
        return max(0.0, times[0] + WITHIN_S - now)


def _keys(name: str, address: str) -> tuple[tuple[tuple[str, ...], int], ...]:
    who, place = name.casefold()[:64], network(address)
    return ((("pair", who, place), PER_PAIR), (("address", place), PER_ADDRESS), (("name", who), PER_NAME))


def network(address: str) -> str:
    """What one person can take addresses from: an IPv4 address, the /64 of an IPv6 address."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address[:64]
    if isinstance(found, ipaddress.IPv6Address):
        mapped = found.ipv4_mapped
        return str(mapped) if mapped is not None else str(ipaddress.ip_network((found, 64), strict=False))
    return str(found)
