"""Monte Carlo by the engine of `highside fleet`: cases of a study on all processors, their answers kept as parts.

A case is a call of a function of a study, by its name and plain arguments (a seed among them); its answer is plain too,
and comes back as JSON gives it, to the last digit. It is a row of a file of `DIR/parts`, as the results of a fleet are
(`highside.fleet.parts`). Its key is the SHA-256 of the function, the arguments and all code that may answer (`CODE`):
an interrupted study goes on where it stopped, and after a change of the code begins anew. The figures are those of a
loop: answers come in the order of the cases, whichever process made them.

    python -m studies.NAME ... --workers 0 --parts DIR      (0: all processors; without --workers a loop, as ever)
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import highside
from highside.fleet.cluster import cluster_client
from highside.fleet.given_out import Lost, answers, pieces
from highside.fleet.parts import PartStore, key_of
from highside.fleet.policy import TASKS

TOP = Path(__file__).parent.parent
CODE = (Path(highside.__file__).parent, TOP / "studies", TOP / "tests" / "session")
"""folders of what a study may call: a bench session is rehearsed by what tests it"""

Case = tuple[Any, ...]
"""arguments of one call: numbers, texts, lists of them"""
Over = Callable[[Callable[..., Any], Sequence[Case]], list[Any]]
"""what has cases answered by a function, in their order"""


class NoAnswerError(Exception):
    """Cases that have no answer: without them a study would be another."""


def in_a_loop(one: Callable[..., Any], cases: Sequence[Case]) -> list[Any]:
    """Here, one after the other."""
    return [_plain(one(*case)) for case in cases]


@dataclass(frozen=True)
class OnProcesses:
    """By `workers` processes of this machine (None: as many as processors); answers are kept in `parts`."""

    workers: int | None = None
    parts: Path | None = None
    """None: nowhere after the study"""
    seconds: float = 1.0
    """that a case takes, about: so many go in one piece that it takes ten"""

    def __call__(self, one: Callable[..., Any], cases: Sequence[Case]) -> list[Any]:
        """Raises `NoAnswerError` where a case has none when all others have theirs."""
        name = f"{module_of(one)}:{one.__qualname__}"
        with ExitStack() as open_until_read:
            folder = self.parts or Path(open_until_read.enter_context(tempfile.TemporaryDirectory()))
            keys = [key_case(name, case) for case in cases]
            store = PartStore(folder)
            store.look()
            missing = {key: case for key, case in zip(keys, cases, strict=True) if not store.has(key)}
            faults = self._given_out(name, missing, folder) if missing else []
            if faults:
                raise NoAnswerError(f"{len(faults)} of {len(cases)} cases have no answer; the first: {faults[0]}")
            found = store.read(["answer"])
            return [json.loads(found[key]["answer"]) for key in keys]

    def _given_out(self, name: str, missing: dict[str, Case], folder: Path) -> list[str]:
        """What went wrong, case by case."""
        processes = self.workers or os.cpu_count() or 1
        costs = [self.seconds] * len(missing)
        given = pieces(list(missing.items()), costs, TASKS.batch_seconds(sum(costs), processes))
        faults: list[str] = []
        # each process runs the module of a program by itself
        asked_here = importlib.import_module("__main__").__spec__
        modules = [module for module in [name.split(":")[0]] if asked_here is None or asked_here.name != module]
        with cluster_client(processes, None, modules) as client:

            def submit(piece: list[tuple[str, Case]]) -> Any:
                return client.submit(work_on, name, piece, str(folder), pure=False, retries=0)

            for made in answers(client, given, submit):
                faults += [f"{made.thing[1]}: {made.said}"] if isinstance(made, Lost) else made
        return faults


def module_of(one: Callable[..., Any]) -> str:
    """Where a function is found by a process that did not begin as this one: `python -m studies.NAME` has two names."""
    asked_here = importlib.import_module("__main__").__spec__
    return asked_here.name if one.__module__ == "__main__" and asked_here is not None else one.__module__


def work_on(name: str, piece: Sequence[tuple[str, Case]], folder: str) -> list[str]:
    """In a process: the answers of these cases, those of about ten seconds in one part; what went wrong."""
    module, _, function = name.partition(":")
    one = getattr(importlib.import_module(module), function)
    store = PartStore(Path(folder))
    store.look()
    faults: list[str] = []
    made: dict[str, dict[str, Any]] = {}
    begun = time.monotonic()
    try:
        for key, case in piece:
            if store.has(key):
                continue
            try:
                made[key] = row_of(name, one, case)
            except Exception as error:
                faults.append(f"{case}: {type(error).__name__}: {error}")
            if time.monotonic() - begun > TASKS.seconds:
                store.write(made)
                made, begun = {}, time.monotonic()
    finally:
        store.write(made)
    return faults


def row_of(name: str, one: Callable[..., Any], case: Case) -> dict[str, Any]:
    """The answer of a case, and what it cost."""
    begun, used = time.perf_counter(), time.process_time()
    answer = json.dumps(_plain(one(*case)))
    cost = {"seconds": time.perf_counter() - begun, "cpu_s": time.process_time() - used}
    return {"job": name, "verdict": "done", "arguments": json.dumps(case), "answer": answer, **cost}


def key_case(name: str, case: Case) -> str:
    """The name of an answer."""
    return key_of(code_digest(), name, json.dumps(case))


@cache
def code_digest() -> bytes:
    """SHA-256 of all code that may answer."""
    digest = hashlib.sha256()
    for path in sorted(path for folder in CODE for path in folder.rglob("*.py")):
        digest.update(f"{path.relative_to(path.parents[1])}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.digest()


def _plain(answer: Any) -> Any:
    """As JSON gives it back: arrays and tuples are lists."""
    return json.loads(json.dumps(answer, default=_of_numpy))


def _of_numpy(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no plain answer")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Where the cases are answered."""
    parser.add_argument("--workers", type=int, help="processes; 0: as many as processors; not given: a loop")
    parser.add_argument("--parts", type=Path, help="folder in which answers are kept, and found again")


def chosen(options: argparse.Namespace, seconds: float = 1.0) -> Over:
    """What these options ask for; a case takes about so many seconds."""
    if options.workers is None and options.parts is None:
        return in_a_loop
    return OnProcesses(options.workers or None, options.parts, seconds)
