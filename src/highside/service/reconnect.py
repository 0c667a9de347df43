"""When to connect to the broker again, and whether somebody else uses our client id.

A broker ends the older of two connections with one client id. Two daemons of one tool (a desk test beside the rig, a
disk image used twice) then throw each other off for ever, each connection a success that lives for a fraction of a
second, and `status` flips with every one. Two things tell:

- connections that end within `SHORT_S`, several in a row: something sheds us, whatever it is;
- a foreign name in the retained topic `instance`: each run of a daemon has a random one and says it there with its
  birth (`online 5f0c2a91`), and who reads another name there than its own last word has a twin for certain. At the
  first connection of a run it means nothing: it is the run before.

The pause between connections doubles up to `reconnect_max_s`, and a short connection counts as a failed one. Beyond
that somebody has to give way, or both are useless: who has never been connected for long in this run does so at the
first sign of a twin (it is the newcomer), who has been, after `TOLERATED` short connections in a row. Nothing is lost
by it: messages wait in the outbox.
"""

from __future__ import annotations

import random
import secrets
import time
from collections.abc import Callable

from highside.printable import printable

SHORT_S = 5.0
"""Seconds: a connection that ended sooner was no success. A takeover by a twin comes after the twin's own pause (0.1 s
at first); an honest link that is lost every few seconds is as little use."""
SHORT_IN_A_ROW = 5
"""So many short connections in a row raise the alarm, and lengthen the pause beyond `reconnect_max_s`."""
TOLERATED = 3
"""So many in a row are answered at once by who was connected for long before, although a twin was noticed."""
SHED_PAUSE_S = 2.0
"""Seconds, doubling up to `SHED_PAUSE_MAX_S`: the pause after many short connections of which nobody knows why. Not
longer, because it may be a bad line, on which each second of connection counts."""
SHED_PAUSE_MAX_S = 10.0
TWIN_PAUSE_S = 20.0
"""Seconds, doubling up to `TWIN_PAUSE_MAX_S`: the pause of who gives way. Each attempt costs the other one
interruption, so they are to be rare; and they must not end, because the other may have gone."""
TWIN_PAUSE_MAX_S = 300.0
STANDS_S = 600.0
"""Seconds for which the alarm stands after the last sign: twice the longest pause, so that it does not come and go."""


def instance_word(word: bytes, instance: str) -> bytes:
    """The payload of the topic `instance`."""
    return word + b" " + instance.encode()


def read_instance(payload: bytes) -> tuple[str, str]:
    """The word and the name of a run in the topic `instance`; empty where there is none."""
    word, _, instance = payload[:100].decode("utf-8", errors="replace").partition(" ")
    return word, instance


class Reconnect:
    """Fed with what happens to the connections of one client id; says how long to wait."""

    def __init__(
        self,
        client_id: str,
        instance: str,
        *,
        min_s: float,
        max_s: float,
        rng: random.Random,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._client_id, self._instance = client_id, instance
        self._min_s, self._max_s, self._rng, self._clock = min_s, max_s, rng, clock
        self._wait_s = min_s
        self._began: float | None = None
        self._connects = 0
        self._settled = False
        """a connection of this run has lasted"""
        self._given_way = 0
        self._other_instance = ""
        """the twin's instance, on this connection or the last"""
        self._short = 0
        self._report = ""
        self._reported_at = 0.0
        self.short_connections = 0

    def connected(self) -> None:
        """The broker has let us in."""
        self._began = self._clock()
        self._connects += 1
        self._other_instance = ""

    def heard_instance(self, payload: bytes, *, retained: bool) -> None:
        """What came on our own topic `instance`."""
        word, instance = read_instance(payload)
        if instance == self._instance or not instance:
            return
        if not retained:
            # we are connected and so is it: another client id, one tool. One that leaves says `offline`
            if word == "online":
                self._conflict(
                    f"another service (instance {printable(instance)[:32]}) speaks as this tool at the broker"
                )
        elif self._connects > 1:
            self._other_instance = printable(instance)[:32]
            if self._short:
                self._report_twin()

    def pause_s(self) -> float:
        """The connection has ended, or was not made: how long to wait before the next."""
        began, self._began = self._began, None
        if began is None:
            return self._doubled()
        if self._clock() - began >= SHORT_S:
            self._settled, self._short, self._given_way = True, 0, 0
            self._wait_s = self._min_s
            return self._doubled()
        self._short += 1
        self.short_connections += 1
        if self._other_instance:
            self._report_twin()
            if not self._settled or self._short >= TOLERATED:
                self._given_way += 1
                return self._jittered(min(TWIN_PAUSE_S * 2.0 ** (self._given_way - 1), TWIN_PAUSE_MAX_S))
        if self._short >= SHORT_IN_A_ROW:
            if not self._other_instance:
                self._conflict(
                    f"{self._short} connections in a row ended within {SHORT_S:g} s: another client uses"
                    f" {self._client_id}, or the broker sheds us"
                )
            over = min(self._short - SHORT_IN_A_ROW, 10)
            return self._jittered(max(self._max_s, min(SHED_PAUSE_S * 2.0**over, SHED_PAUSE_MAX_S)))
        return self._doubled()

    @property
    def taken(self) -> str | None:
        """Why `client_id_taken` stands; None: it does not."""
        return self._report if self._report and self._clock() - self._reported_at < STANDS_S else None

    def _doubled(self) -> float:
        wait_s, self._wait_s = self._wait_s, min(2.0 * self._wait_s, self._max_s)
        return self._jittered(wait_s)

    def _jittered(self, wait_s: float) -> float:
        return wait_s * self._rng.uniform(0.5, 1.0)

    def _report_twin(self) -> None:
        who = f"another client uses {self._client_id} (instance {self._other_instance})"
        self._conflict(f"{who}: stop one of the two, or give it its own tool.id")

    def _conflict(self, text: str) -> None:
        self._report, self._reported_at = text, self._clock()


def new_instance() -> str:
    """A name for one run of a daemon, to tell it from any other."""
    return secrets.token_hex(4)
