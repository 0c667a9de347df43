"""The journal's lines: one JSON object an event, chained by hashes; written and read the same way for ever.

    {"n":0,"e":"session","d":{...plan, tool, bench...},"t":1795200000.1,"h":"9f86d081884c7d65"}
    {"n":1,"e":"taken","d":{...},"t":...,"h":"..."}

`n` counts the lines, `e` names the event, `d` holds it, `t` is the wall clock in UTC epoch seconds, `h` the first 16
digits of the SHA-256 of the line before it (its `h`) and of this line without `h`. Numbers are written with the digits
that read back exactly. A line that the end of the process or of the power tore off at the end of the file is dropped,
and what it said is lost: at most the pose in progress. Damage anywhere else is refused by the number of its line.

Pure: text in, entries out. Writing and flushing to the disk is the driver's work.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from highside.bench.session import entries
from highside.bench.session.entries import Entry, HoldReadings
from highside.bench.session.ledger import Ledger
from highside.bench.session.plans import SessionPlan
from highside.bench.session.reasons import Rejection
from highside.calibration.record import CalibrationRecord, Environment, parse_record
from highside.errors import HighsideError, InputError
from highside.reading import MALFORMED, instant, parse_json

SCHEMA = "highside.journal/1"
_SHA256 = re.compile(r"[0-9a-f]{64}")

_KINDS: dict[str, type] = {
    "began": entries.Began,
    "taken": entries.TakenPose,
    "refused": entries.RefusedHold,
    "skipped": entries.Skipped,
    "reopened": entries.Reopened,
    "undone": entries.Undone,
    "stage_ready": entries.StageReady,
    "plan_closed": entries.PlanClosed,
    "paused": entries.Paused,
    "resumed": entries.Resumed,
    "noted": entries.Noted,
    "photographed": entries.Photographed,
    "ended": entries.Ended,
    "put_in_force": entries.PutInForce,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}


class StorageError(Exception):
    """A line could not be kept; the text says why."""


@dataclass(frozen=True, slots=True)
class Header:
    """The first line: what the session is, and all that a record will need to know."""

    session: str
    tool_id: str
    serial: str | None
    plan: SessionPlan
    environment: Environment
    expires_days: float | None
    software: str
    t_wall_s: float
    judged: CalibrationRecord | None = field(default=None, compare=False)
    """the calibration that a verification or roll test judges, whole: the journal tells its verdict alone"""

    def to_dict(self) -> dict[str, Any]:
        return {
            "schema": SCHEMA,
            "session": self.session,
            "tool_id": self.tool_id,
            "serial": self.serial,
            "plan": self.plan.to_dict(),
            "environment": self.environment.to_dict(),
            "expires_days": self.expires_days,
            "software": self.software,
            "judged": None if self.judged is None else parse_json(self.judged.to_json()),
        }


@dataclass(frozen=True, slots=True)
class Journal:
    """A journal read back."""

    header: Header
    entries: tuple[Entry, ...]
    times_s: tuple[float, ...]
    """wall clock of each entry"""
    good_bytes: int
    """length of what could be read; what lies behind it is a torn line, to be cut off before going on"""
    encoder: Encoder
    """goes on where the journal ends"""

    def ledger(self) -> Ledger:
        """The session as it stood: every entry applied in order."""
        out = Ledger(self.header.plan)
        for entry in self.entries:
            out.apply(entry)
        return out


class Encoder:
    """Numbers and chains the lines."""

    def __init__(self) -> None:
        self._count = 0
        self._chain = ""

    def header(self, header: Header) -> bytes:
        return self._line("session", header.to_dict(), header.t_wall_s)

    def entry(self, entry: Entry, t_wall_s: float) -> bytes:
        return self._line(_NAMES[type(entry)], asdict(entry), t_wall_s)

    def mark(self) -> tuple[int, str]:
        """Where the journal stands, for `back_to`."""
        return self._count, self._chain

    def back_to(self, mark: tuple[int, str]) -> None:
        """The lines made since `mark` were not kept."""
        self._count, self._chain = mark

    def _line(self, kind: str, data: Mapping[str, Any], t_wall_s: float) -> bytes:
        content = {"n": self._count, "e": kind, "d": data, "t": t_wall_s}
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        chain = _chain(self._chain, text)
        self._accept(chain)
        return f'{text[:-1]},"h":"{chain}"}}\n'.encode("ascii")

    def _accept(self, chain: str) -> None:
        self._count += 1
        self._chain = chain

    def check(self, line: str) -> dict[str, Any]:
        """Take a line read back. Raises ValueError for one that is not the next of this journal."""
        text, mark, tail = line.rpartition(',"h":"')
        if not mark or len(tail) != 18 or not tail.endswith('"}'):
            raise ValueError("has no hash at its end")
        text += "}"
        chain = _chain(self._chain, text)
        if tail[:16] != chain:
            raise ValueError("does not follow from the line before it, or was changed")
        content = parse_json(text)
        if not isinstance(content, dict) or content.get("n") != self._count:
            raise ValueError("is out of order")
        self._accept(chain)
        return content


def _chain(before: str, text: str) -> str:
    return hashlib.sha256((before + text).encode("ascii", "replace")).hexdigest()[:16]


def read_journal(data: bytes, *, where: str | None = None) -> Journal:
    """Read a journal. Raises InputError for what is none, or is damaged elsewhere than at its torn end."""
    encoder = Encoder()
    header: Header | None = None
    ledger: Ledger | None = None
    found: list[Entry] = []
    times: list[float] = []
    position = 0
    lines = data.split(b"\n")
    for number, raw in enumerate(lines[:-1]):
        try:
            content = encoder.check(raw.decode("ascii"))
            if header is None or ledger is None:
                header = _header(content)
                ledger = Ledger(header.plan)
            else:
                entry, t_wall_s = _entry(content), instant(content["t"])
                # whether it makes sense is found where its line can be named
                ledger.apply(entry)
                found.append(entry)
                times.append(t_wall_s)
        except (*MALFORMED, HighsideError) as error:
            if number == len(lines) - 2 and header is not None:
                break  # a torn sector may hold its line's end but not its middle
            what = " ".join(str(error).split())[:200]
            raise InputError(
                f"line {number + 1} {what}", where=where, remedy="a journal is never edited; use the original file"
            ) from None
        position += len(raw) + 1
    if header is None:
        raise InputError("holds no session", where=where, remedy="begin a new session (without --resume)")
    return Journal(header, tuple(found), tuple(times), position, encoder)


def _header(content: Mapping[str, Any]) -> Header:
    data = content["d"]
    if content["e"] != "session" or data["schema"] != SCHEMA:
        raise ValueError(f"is not the beginning of a journal of schema {SCHEMA!r}")
    plan, judged = SessionPlan.from_dict(data["plan"]), data.get("judged")
    record = None if judged is None else parse_record(json.dumps(judged))
    if (plan.criterion is None) != (record is None) or (
        plan.criterion and record and plan.criterion.record != record.id
    ):
        raise ValueError("does not hold the calibration that its plan judges")
    return Header(
        session=str(data["session"]),
        tool_id=str(data["tool_id"]),
        serial=data["serial"],
        plan=plan,
        environment=Environment(**data["environment"]),
        expires_days=data["expires_days"],
        software=str(data["software"]),
        t_wall_s=instant(content["t"]),
        judged=record,
    )


def _entry(content: Mapping[str, Any]) -> Entry:
    data = dict(content["d"])
    if data.get("readings") is not None:
        data["readings"] = _readings(data["readings"])
    if "reason" in data:
        data["reason"] = Rejection(data["reason"])
    if "sha256" in data and _SHA256.fullmatch(data["sha256"]) is None:
        raise ValueError("has no SHA-256 of its photograph")
    entry: Entry = _KINDS[content["e"]](**data)
    return entry


def _readings(data: Mapping[str, Any]) -> HoldReadings:
    x, y, z = (tuple(map(float, row)) for row in data["a"])
    if not len(x) == len(y) == len(z) > 0:
        raise ValueError("has readings of unequal length")
    ex, ey, ez = map(float, data["std_error_g"])
    return HoldReadings((x, y, z), data["t_start_s"], data["t_stop_s"], data["temp_c"], (ex, ey, ez))


def encode_all(header: Header, items: Iterable[tuple[Entry, float]]) -> bytes:
    """A whole journal from its entries and their times."""
    encoder = Encoder()
    return encoder.header(header) + b"".join(encoder.entry(entry, t) for entry, t in items)
