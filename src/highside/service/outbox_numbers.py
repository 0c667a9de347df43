"""The numbers of an outbox: reserved on the disk before the sender gets a message that carries one."""

from __future__ import annotations

import logging
import sqlite3

from highside.service.outbox_file import MessageFile
from highside.service.outbox_memory import OutboxMemory
from highside.service.sequence import BLOCK, SAFETY, SequenceFile

log = logging.getLogger("highside.service.outbox")


class NumberedOutbox(OutboxMemory):
    """What is here belongs to the outbox's thread."""

    _file: MessageFile
    _numbers: SequenceFile
    _sequence_read = False
    """whether the file of numbers is open"""
    _opened_before = False
    """whether the file of messages was open in this run, so that all numbers of earlier ones are known"""

    def _begin_numbers(self) -> None:
        """Where the numbering goes on. An older version kept it in the file of messages."""
        saved = self._numbers.open()
        if self._opened_before:
            # the file was deleted or replaced: whatever it says, in this run the numbers are known
            with self._lock:
                self._reserved = {}
            self._sequence_read = True
            return
        first_free = dict(saved.first_free)
        if not first_free or not saved.sound:
            if not self._file.is_open:
                self._file.open()
            for topic, last in self._file.last_numbers().items():
                first_free[topic] = max(first_free.get(topic, 0), last + 1)
        if not saved.sound:
            log.error("outbox: the file of sequence numbers is damaged; %d numbers are omitted", SAFETY)
            first_free = {topic: number + SAFETY for topic, number in first_free.items()}
        with self._lock:
            for topic, number in first_free.items():
                self._seq[topic] = max(self._seq.get(topic, -1), number - 1)
            self._reserved = dict(first_free)
            if not saved.orderly:
                self._resumed_at = first_free
        self._sequence_read = True

    def _reserve(self) -> Exception | None:
        """Numbers for the next messages; returns why the disk did not take it."""
        try:
            if not self._sequence_read:
                self._begin_numbers()
            with self._lock:
                wanted = {
                    topic: self._seq[topic] + 1 + BLOCK
                    for topic in self._topics
                    if self._reserved.get(topic, 0) - (self._seq[topic] + 1) < BLOCK // 2
                }
                first_free = {topic: max(seq + 1, self._reserved.get(topic, 0)) for topic, seq in self._seq.items()}
            if wanted:
                self._numbers.write(first_free | wanted)
                with self._lock:
                    self._reserved = first_free | wanted
            self._reserving = True
        except (OSError, sqlite3.Error) as error:
            self._reserving = False
            return error
        return None
