"""Damaged files and messages given to every parser: each is accepted or refused by name, nothing else.

    python tests/faults/fuzz.py --inputs 1000000 [--parser NAME]... [--seconds S] [--seed N] [--keep DIR] [--counts DIR]

Prints a table `parser | inputs | accepted | refused by name | escaped` and exits with 1 if anything escaped: another
exception than the program's own errors, an error of more than one line, or an input that took longer than 10 s. A
parser that is not done after `--seconds` ends there; the table tells how far it came. Equal seeds give equal inputs.
With `--counts` the books are kept in a file of that folder, and the next run with the same seed goes on behind the last
input of this one: what takes hours can be spread over nights. The table then tells the sums, and what is interrupted
loses the last minute.
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
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

sys.path[:0] = [str(Path(__file__).resolve().parent)]

from parsers import Bench, Parser, all_parsers  # noqa: E402

from highside.errors import HighsideError  # noqa: E402

LONGEST_S = 10
"""for one input; what takes longer is an escape: a service would be ended by its watchdog"""
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

    before = signal.signal(signal.SIGALRM, ring)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def fuzz(parser: Parser, inputs: int, seed: int, seconds: float = 1e9, first: int = 0) -> Tally:
    """Give a parser up to `inputs` damaged inputs, from number `first` on."""
    tally = Tally()
    start = time.monotonic()
    with alarm(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for number in range(first, first + inputs):
            if number % 64 == 0 and time.monotonic() - start > seconds:
                break
            data = parser.make(random.Random(f"{seed} {parser.name} {number}"))
            tally.inputs += 1
            signal.alarm(LONGEST_S)
            _one(parser, data, tally)
            signal.alarm(0)
    tally.seconds = time.monotonic() - start
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


class Counts:
    """What became of all inputs so far, by parser, in a file of a folder; without a folder, nothing is kept."""

    def __init__(self, folder: Path | None, seed: int) -> None:
        self._path = None if folder is None else folder / f"fuzz-seed-{seed}.json"
        self._of: dict[str, dict[str, Any]] = {}
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            if self._path.exists():
                self._of = json.loads(self._path.read_text())

    def of(self, name: str) -> Tally:
        kept = dict(self._of.get(name, {}))
        return Tally(escaped=Counter(kept.pop("escaped", {})), **kept)

    def add(self, name: str, more: Tally) -> Tally:
        """The sum; on disk when this returns."""
        tally = self.of(name)
        for what in ("inputs", "accepted", "refused", "escaped", "seconds"):
            setattr(tally, what, getattr(tally, what) + getattr(more, what))
        assert tally.balanced()
        self._of[name] = {
            what: getattr(tally, what) for what in ("inputs", "accepted", "refused", "escaped", "seconds")
        }
        if self._path is not None:
            beside = self._path.with_suffix(".new")
            beside.write_text(json.dumps(self._of, indent=1))
            beside.replace(self._path)
        tally.examples = more.examples
        return tally


def at_most(parser: Parser, inputs: int, seed: int, seconds: float, counts: Counts) -> Tally:
    """Go on from what is kept until `inputs` are reached or `seconds` are over; kept once a minute."""
    end, tally = time.monotonic() + seconds, counts.of(parser.name)
    examples: dict[str, bytes] = {}
    while tally.inputs < inputs and (left := end - time.monotonic()) > 0:
        more = fuzz(parser, inputs - tally.inputs, seed, min(left, KEPT_S), tally.inputs)
        examples = more.examples | examples
        tally = counts.add(parser.name, more)
    tally.examples = examples
    return tally


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
    arguments.add_argument(
        "--counts", type=Path, help="folder where the books are kept: the next run goes on from there"
    )
    asked = arguments.parse_args()
    # an environment of a hundred variables is looked through for each field of each configuration
    for name in set(os.environ) - {"PATH", "HOME"}:
        del os.environ[name]
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    try:
        counts = Counts(asked.counts, asked.seed)
    except (OSError, ValueError) as error:
        arguments.error(f"--counts {asked.counts}: {error}; name another folder")
    bench = Bench()
    escaped = 0
    try:
        parsers = all_parsers(bench)
        unknown = set(asked.parser or ()) - {parser.name for parser in parsers}
        if unknown:
            arguments.error(f"no parser {unknown}; there are: {', '.join(parser.name for parser in parsers)}")
        print("| parser | inputs | accepted | refused by name | escaped | rate |\n|---|---|---|---|---|---|")
        for parser in parsers:
            if asked.parser and parser.name not in asked.parser:
                continue
            tally = at_most(parser, asked.inputs, asked.seed, asked.seconds, counts)
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
