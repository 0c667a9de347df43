"""Damaged files and messages given to every parser: each is accepted or refused by name, nothing else.

    python tests/faults/fuzz.py --inputs 1000000 [--parser NAME]... [--seconds S] [--seed N] [--keep DIR] [--books FILE]
    python tests/faults/fuzz.py --report [--books FILE]

Prints a table `parser | inputs | accepted | refused by name | escaped` and exits with 1 if anything escaped: another
exception than the program's own errors, an error of more than one line, or an input that took longer than 10 s of the
processor. A parser that is not done after `--seconds` ends there; the table tells how far it came. Equal seeds give
equal inputs.

With `--books` what became of the inputs is kept in a file (`tests/faults/fuzzed.json` is tracked), and the next run
with the same seed goes on behind the last input of this one: what takes hours can be spread over nights. An
interruption loses the last minute. The books say for each parser which inputs of which seed were given to which state
of its code (the hash of its modules, without comments and docstrings); `--inputs` counts those that the present code
took, `--report` prints them beside all others.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import signal
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType

sys.path[:0] = [str(Path(__file__).resolve().parent)]

from parsers import Bench, Parser, all_parsers  # noqa: E402

from highside.errors import HighsideError  # noqa: E402

LONGEST_S = 10
"""of the processor for one input; what takes longer is an escape: a service would be ended by its watchdog"""
STUCK_S = 300
"""for one input, waiting included: a parser that waits for ever; a busy machine may take 10 s from an idle process"""
BOOKS = Path(__file__).with_name("fuzzed.json")
KEPT_S = 60.0
"""Seconds after which the books are written again"""
MEMORY_BYTES = 6 << 30
"""address space of the whole run: an input that wants more gets MemoryError"""


@dataclass(slots=True)
class Tally:
    """What became of the inputs of a parser; the books balance: inputs = accepted + refused + escaped."""

    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    escaped: Counter[str] = field(default_factory=Counter)
    examples: dict[str, bytes] = field(default_factory=dict)
    seconds: float = 0.0

    def balanced(self) -> bool:
        return self.inputs == self.accepted + self.refused + self.escaped.total()


class TooLongError(BaseException):
    """No part of the program may catch it."""


@contextmanager
def alarm() -> Iterator[None]:
    """Ends an input that takes too long."""

    def ring(_signal: int, _frame: FrameType | None) -> None:
        raise TooLongError

    before = {number: signal.signal(number, ring) for number in (signal.SIGALRM, signal.SIGPROF)}
    try:
        yield
    finally:
        _set_alarms(0, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


def _set_alarms(computing_s: float, waiting_s: int) -> None:
    signal.setitimer(signal.ITIMER_PROF, computing_s)
    signal.alarm(waiting_s)


def fuzz(parser: Parser, inputs: int, seed: int, seconds: float = 1e9, first: int = 0) -> Tally:
    """Give a parser up to `inputs` damaged inputs, from number `first` on."""
    tally = Tally()
    start, computed = time.monotonic(), time.process_time()
    with alarm(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number in range(first, first + inputs):
            if number % 64 == 0 and time.monotonic() - start > seconds:
                break
            data = parser.make(random.Random(f"{seed} {parser.name} {number}"))
            tally.inputs += 1
            _set_alarms(LONGEST_S, STUCK_S)
            _one(parser, data, tally)
            _set_alarms(0, 0)
    tally.seconds = time.process_time() - computed
    return tally


def _one(parser: Parser, data: bytes, tally: Tally) -> None:
    try:
        accepted = parser.parse(data)
    except HighsideError as error:
        line = str(error)
        if not line or not line.isprintable():
            _escape(tally, f"an error of {len(line)} characters that is no line", data)
        else:
            tally.refused += 1
    except TooLongError:
        _escape(tally, f"more than {LONGEST_S} s", data)
    except Exception as error:
        import traceback

        last = traceback.extract_tb(error.__traceback__)[-1]
        _escape(tally, f"{type(error).__name__} ({Path(last.filename).name}:{last.lineno}): {str(error)[:80]}", data)
    else:
        if accepted:
            tally.accepted += 1
        else:
            tally.refused += 1


def _escape(tally: Tally, what: str, data: bytes) -> None:
    tally.escaped[what] += 1
    tally.examples.setdefault(what, data)


@dataclass(slots=True)
class Entry:
    """What one state of a parser's code made of a stretch of inputs."""

    code: str
    """first digits of the SHA-256 of the parser's modules"""
    seed: int
    first: int
    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    escaped: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    """of the processor"""
    date: str = ""

    def add(self, more: Tally) -> None:
        assert more.balanced()
        self.inputs += more.inputs
        self.accepted += more.accepted
        self.refused += more.refused
        self.escaped = dict(Counter(self.escaped) + more.escaped)
        self.seconds = round(self.seconds + more.seconds, 1)
        self.date = time.strftime("%Y-%m-%d")


class Books:
    """What became of all inputs so far, by parser, in a file; without one, nothing is kept."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._of: dict[str, list[Entry]] = {}
        if path is not None and path.exists():
            kept = json.loads(path.read_text())
            self._of = {name: [Entry(**entry) for entry in entries] for name, entries in kept.items()}

    def of(self, parser: Parser) -> Tally:
        """All that the present code of a parser took."""
        return _sum(entry for entry in self._of.get(parser.name, ()) if entry.code == parser.code)

    def before(self, parser: Parser) -> Tally:
        """What earlier code of it took."""
        return _sum(entry for entry in self._of.get(parser.name, ()) if entry.code != parser.code)

    def next(self, parser: Parser, seed: int) -> int:
        """The first input of a seed that the present code has not had."""
        had = [e for e in self._of.get(parser.name, ()) if (e.code, e.seed) == (parser.code, seed)]
        return max((entry.first + entry.inputs for entry in had), default=0)

    def add(self, parser: Parser, seed: int, first: int, more: Tally) -> None:
        """On disk when this returns."""
        entries = self._of.setdefault(parser.name, [])
        for entry in entries:
            if (entry.code, entry.seed, entry.first + entry.inputs) == (parser.code, seed, first):
                break
        else:
            entries.append(entry := Entry(parser.code, seed, first))
        entry.add(more)
        if self._path is not None:
            beside = self._path.with_suffix(".new")
            rows = {name: [asdict(entry) for entry in of] for name, of in self._of.items()}
            beside.write_text(json.dumps(rows, indent=1) + "\n")
            beside.replace(self._path)


def _sum(entries: Iterable[Entry]) -> Tally:
    total = Tally()
    for entry in entries:
        for what in ("inputs", "accepted", "refused", "seconds"):
            setattr(total, what, getattr(total, what) + getattr(entry, what))
        total.escaped.update(entry.escaped)
    return total


def at_most(parser: Parser, inputs: int, seed: int, seconds: float, books: Books) -> Tally:
    """Go on from what is kept until the present code has had `inputs`, or `seconds` are over; kept once a minute."""
    end, examples = time.monotonic() + seconds, dict[str, bytes]()
    while (had := books.of(parser).inputs) < inputs and (left := end - time.monotonic()) > 0:
        first = books.next(parser, seed)
        more = fuzz(parser, inputs - had, seed, min(left, KEPT_S), first)
        examples = more.examples | examples
        books.add(parser, seed, first, more)
    tally = books.of(parser)
    tally.examples = examples
    return tally


HEAD = "| parser | inputs | accepted | refused by name | escaped | a second of processor |\n|---|---|---|---|---|---|"


def reported(parsers: Sequence[Parser], books: Books) -> str:
    """The books as a table."""
    lines = ["| parser | inputs, its present code | accepted | refused by name | escaped | inputs, code before |",
             "|---|---|---|---|---|---|"]  # fmt: skip
    for parser in parsers:
        now, before = books.of(parser), books.before(parser)
        lines.append(
            f"| {parser.name} | {now.inputs:,} | {now.accepted:,} | {now.refused:,} | {now.escaped.total():,} |"
            f" {before.inputs:,} |"
        )
    return "\n".join(lines)


def row(name: str, tally: Tally) -> str:
    return (
        f"| {name} | {tally.inputs:,} | {tally.accepted:,} | {tally.refused:,} | {tally.escaped.total():,} |"
        f" {tally.inputs / max(tally.seconds, 1e-9):,.0f}/s |"
    )


def main() -> int:
    arguments = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    arguments.add_argument("--inputs", type=int, default=10_000, help="for each parser")
    arguments.add_argument("--parser", action="append", help="only this one; may be given several times")
    arguments.add_argument("--seconds", type=float, default=1e9, help="at most, for each parser")
    arguments.add_argument("--seed", type=int, default=1)
    arguments.add_argument("--keep", type=Path, help="folder for one input of each kind of escape")
    arguments.add_argument("--books", type=Path, help="file where the books are kept: the next run goes on from there")
    arguments.add_argument("--report", action="store_true", help="give no inputs, print what the books hold")
    asked = arguments.parse_args()
    # an environment of a hundred variables is looked through for each field of each configuration
    for name in set(os.environ) - {"PATH", "HOME"}:
        del os.environ[name]
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    try:
        books = Books(asked.books or (BOOKS if asked.report else None))
    except (OSError, ValueError, TypeError) as error:
        arguments.error(f"--books {asked.books}: {error}; name another file")
    bench = Bench()
    escaped = 0
    try:
        parsers = all_parsers(bench)
        unknown = set(asked.parser or ()) - {parser.name for parser in parsers}
        if unknown:
            arguments.error(f"no parser {unknown}; there are: {', '.join(parser.name for parser in parsers)}")
        if asked.report:
            print(reported(parsers, books))
            return 0
        print(HEAD)
        for parser in parsers:
            if asked.parser and parser.name not in asked.parser:
                continue
            tally = at_most(parser, asked.inputs, asked.seed, asked.seconds, books)
            print(row(parser.name, tally), flush=True)
            escaped += tally.escaped.total()
            for number, (what, count) in enumerate(tally.escaped.most_common(12)):
                print(f"  {count} x {what}", file=sys.stderr, flush=True)
                if asked.keep is not None and what in tally.examples:
                    asked.keep.mkdir(parents=True, exist_ok=True)
                    place = asked.keep / f"{parser.name.replace('/', '-')}-{number}"
                    place.write_bytes(tally.examples[what])
    finally:
        bench.close()
    return 1 if escaped else 0


if __name__ == "__main__":
    sys.exit(main())
