"""What can be read at the end of a session: the report, and the certificate once it was accepted.

Both are made from the journal on the disk, in a thread, and kept until the journal grows. The solver's work competes
with acquisition for the processor, so that they are made only when nothing is being measured.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

from highside.bench.photographs import photographs
from highside.bench.session.driver import SessionDriver
from highside.bench.session.journal import Journal, read_journal
from highside.bench.session.snapshot import SessionState
from highside.calibration.record import to_utc
from highside.config.certificate import CertificateFields
from highside.errors import Refused
from highside.reading import read_bytes
from highside.words import language, said

READABLE = frozenset({SessionState.REVIEW, SessionState.ACCEPTED, SessionState.REJECTED, SessionState.ABORTED})


class Documents:
    """Made on demand, one at a time."""

    def __init__(self, driver: SessionDriver, fields: CertificateFields | None = None) -> None:
        self._driver = driver
        self._fields = fields or CertificateFields()
        self._one = asyncio.Lock()
        self._kept: dict[tuple[str, str], tuple[int, str]] = {}

    async def report(self) -> str:
        """The page of the session. Raises Refused while it is measured, or where no journal is kept."""
        return await self._made("report", _report)

    async def certificate(self) -> str:
        """The certificate of the session's record. Raises Refused where there is none."""
        return await self._made("certificate", self._certificate)

    async def _made(self, name: str, make: Callable[[Journal, Path], str]) -> str:
        if self._driver.snapshot().state not in READABLE:
            raise Refused(said("the session is not finished: report and certificate follow when all poses are taken"))
        path = self._driver.journal_path
        if path is None:
            raise Refused(said("this session keeps no journal, and there is nothing to make it from"))
        async with self._one:
            size = await asyncio.to_thread(lambda: Path(path).stat().st_size)
            key = (name, language())
            known = self._kept.get(key)
            if known is None or known[0] != size:
                self._kept[key] = known = (size, await asyncio.to_thread(lambda: make(_read(path), Path(path))))
            return known[1]

    def _certificate(self, journal: Journal, path: Path) -> str:
        from highside.bench.session.outcome import replay
        from highside.report.certificate import certificate
        from highside.report.certificate_inputs import Inputs

        record = replay(journal)[2]
        if record is None:
            raise Refused(said("no calibration was accepted in this session: there is nothing to certify"))
        taken = tuple(photographs(journal, path))
        return certificate(Inputs(record, self._fields, to_utc(time.time()), photographs=taken)).html()


def _read(path: str) -> Journal:
    return read_journal(read_bytes(Path(path)), where=path)


def _report(journal: Journal, path: Path) -> str:
    from highside.report.session_page import session_page

    return session_page(journal, photographs(journal, path))
