"""Commands that come over MQTT: read, done once, and answered, whatever was sent.

A command is refused where it is retained (it would be done again at every connect) or no valid JSON of its model; one
that was done before (the same again, as a network may deliver it) is answered and not done again, and another one under
its id is refused: who counts on `ok` must not be told so of what was not done. Nothing raises: a fault of ours is
answered too.
"""

from __future__ import annotations

import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

from highside.errors import InputError
from highside.reading import parse_message, text_member
from highside.service.message_base import LONGEST_ID, CommandMessage, CommandReply
from highside.service.quiet_log import QuietLog

log = logging.getLogger("highside")

_REMEMBERED = 64
"""commands that are not done again"""
_LONGEST_COMMAND = 4096
_LONGEST_ERROR = 400
_AUDITED = 20
"""lines a minute that name commands done, of each kind"""


C = TypeVar("C", bound=CommandMessage)


class Commands(Generic[C]):
    """The commands to one part of the service.

    `do` returns why a command cannot be done, None: it was. `reply(payload, done)` publishes the answer, a
    `reply_model`; `after` is called when a command was obeyed or refused by `do`.
    """

    def __init__(
        self,
        name: str,
        model: type[C],
        reply_model: type[CommandReply],
        do: Callable[[C], str | None],
        reply: Callable[[bytes, bool], None],
        after: Callable[[], None],
    ) -> None:
        self._name, self._model, self._reply_model = name, model, reply_model
        self._do, self._reply, self._after = do, reply, after
        self._done: OrderedDict[str, C] = OrderedDict()
        self._quiet = QuietLog(log)
        self._audit = QuietLog(log, burst=_AUDITED)
        self.count = 0

    def on_command(self, payload: bytes, retained: bool) -> None:
        """A message on the topic. Never raises; every command is answered."""
        self.count += 1
        try:
            self._obey(payload, retained=retained)
        except Exception as error:
            # a fault of ours: who gave the command must know that it was not done
            self._quiet.say(logging.ERROR, type(error).__name__, "%s command failed: %r", self._name, error)
            self._answer("", f"could not be done: {type(error).__name__}; see the log of the service", logged=True)

    def _obey(self, payload: bytes, *, retained: bool) -> None:
        if retained:
            self._answer("", "is retained: it would be done again at every connect; publish it without that flag")
            return
        try:
            command = parse_message(self._model, payload, max_bytes=_LONGEST_COMMAND)
        except InputError as error:
            self._answer(text_member(payload, "id", LONGEST_ID), str(error))
            return
        of, word = command.id, command.command
        if (before := self._done.get(of)) is not None:
            other = f"the id was that of another command ({before.command}): give each command an id of its own"
            self._answer(of, None if before == command else other)
            return
        try:
            problem = self._do(command)
        except Exception as error:
            self._quiet.say(logging.ERROR, type(error).__name__, "%s: %s failed: %r", self._name, word, error)
            self._answer(of, f"{word} failed ({type(error).__name__}): see the service's log")
            return
        if problem is None:
            self._done[of] = command
            if len(self._done) > _REMEMBERED:
                self._done.popitem(last=False)
            self._audit.say(logging.INFO, word, "%s: %s done (%s)", self._name, word, of)
        self._answer(of, problem)
        self._after()

    def _answer(self, of: str, problem: str | None, *, logged: bool = False) -> None:
        if problem is not None:
            problem = _bounded(problem, _LONGEST_ERROR)
            if not logged:
                self._quiet.say(logging.WARNING, "refused", "%s command refused: %s", self._name, problem)
        reply = self._reply_model(
            id=_bounded(of, LONGEST_ID), t=round(time.time(), 6), ok=problem is None, error=problem
        )
        self._reply(reply.model_dump_json().encode(), problem is None)


def _bounded(text: str, longest: int) -> str:
    """What can be said in JSON, whatever it holds: no lone surrogates, and no more than `longest` characters."""
    return text[:longest].encode("utf-8", "backslashreplace").decode()[:longest]
