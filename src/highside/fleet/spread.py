"""One recording that is read run by run, on the processes of a cluster: each answers for many runs of rows at a time.

What a pass computes of a run of rows is a function of arrays that lie in files. They are in a folder that all processes
see, and so is the function: a task is a place there and two numbers, its result a sum. A process that dies costs its
task only, which another takes; nothing that counts is in its memory.
"""

from __future__ import annotations

import io
import pickle
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache, reduce
from itertools import count as numbers
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from highside.diagnosis.core.chunks import spread_over
from highside.errors import InputError
from highside.fleet.cluster import cluster_client
from highside.fleet.policy import SPREAD, TASKS
from highside.scratch_arrays import scratch_shared
from highside.version import __version__

__all__ = ["on_cluster"]

S = TypeVar("S")
T = TypeVar("T")


@contextmanager
def on_cluster(address: str, *, runs: int | None = None, scratch: Path | None = None) -> Iterator[None]:
    """Diagnoses meanwhile give the passes over a long recording out to the cluster at this address.

    `runs` of rows are worked on in one task (None: as the policy says). `scratch`: a folder that all machines see, for
    the files of the recording; None: where temporary files are. Raises InputError where the cluster cannot be reached,
    has no processes, where these do not see the folder or have another version of highside.
    """
    with cluster_client(None, address, option="--cluster") as client, scratch_shared(scratch) as folder:
        _require_alike(client, folder, address)
        with spread_over(Cluster(client, folder, SPREAD.runs if runs is None else runs)):
            yield


def _require_alike(client: Any, folder: Path, address: str) -> None:
    """That there are processes, that all see the folder and have this version."""
    try:
        client.wait_for_workers(1, timeout=SPREAD.waits_s)
    except TimeoutError:
        raise InputError(
            "has no processes", where=address, field="--cluster", remedy="start dask workers there"
        ) from None
    token = folder / "seen"
    token.write_text(__version__)
    found = client.run(_seen, str(token))
    for process, said in found.items():
        if said is None:
            raise InputError(
                f"the process {process} does not see {folder}",
                where=address,
                field="--cluster",
                remedy="name a folder that all machines of the cluster see by TMPDIR",
            )
        if said != __version__:
            raise InputError(f"the process {process} has highside {said}, this is {__version__}", where=address)


def _seen(token: str) -> str | None:
    """In a process of the cluster: its version, if it reads there what was written here."""
    try:
        return __version__ if Path(token).read_text() else None
    except OSError:
        return None


class Cluster:
    """Runs of rows, given out to the processes of a client; as `diagnosis.core.chunks.Elsewhere`."""

    def __init__(self, client: Any, folder: Path, runs: int) -> None:
        self._client, self._folder, self._runs, self._numbers = client, folder, runs, numbers()

    def takes(self, count: int) -> bool:
        """Whether there is more than one task in it."""
        return count > self._runs

    def results(
        self, work: Callable[[S], T], items: Sequence[S], both: Callable[[T, T], T] | None = None
    ) -> Iterator[T]:
        """The results of items in their order, those of a task made one by `both`."""
        place = self._folder / f"work{next(self._numbers)}"
        place.write_bytes(packed((work, list(items), both)))
        try:
            yield from self._results(str(place), len(items))
        finally:
            place.unlink(missing_ok=True)

    def _results(self, place: str, count: int) -> Iterator[Any]:
        left = iter([(start, min(start + self._runs, count)) for start in range(0, count, self._runs)])
        ahead: deque[tuple[tuple[int, int], Any]] = deque()
        wanted = 2 * max(1, sum(self._client.nthreads().values()))
        while True:
            while len(ahead) < wanted and (part := next(left, None)) is not None:
                ahead.append((part, self._submit(place, part)))
            if not ahead:
                return
            part, future = ahead.popleft()
            yield from self._result(place, part, future)

    def _submit(self, place: str, part: tuple[int, int]) -> Any:
        return self._client.submit(work_on_runs, place, *part, pure=False)

    def _result(self, place: str, part: tuple[int, int], future: Any) -> list[Any]:
        """Of a task; one whose process died is given out again."""
        from distributed import KilledWorker

        for _ in range(TASKS.attempts - 1):
            try:
                return cast(list[Any], future.result())
            except KilledWorker:
                future = self._submit(place, part)
        try:
            return cast(list[Any], future.result())
        except KilledWorker:
            raise InputError(
                f"runs {part[0]} to {part[1]} of rows ended {TASKS.attempts} processes of the cluster",
                remedy="give its processes more memory",
            ) from None


def work_on_runs(place: str, start: int, stop: int) -> list[Any]:
    """In a process of the cluster: the results of these runs of rows, as one where they add up."""
    work, items, both = _loaded(place)
    made = map(work, items[start:stop])
    return list(made) if both is None else [reduce(both, made)]


@lru_cache(maxsize=1)
def _loaded(place: str) -> tuple[Callable[[Any], Any], list[Any], Callable[[Any, Any], Any] | None]:
    """What is worked on; kept for the next task of the same pass."""
    work, items, both = pickle.loads(Path(place).read_bytes())
    return work, items, both


def packed(what: object) -> bytes:
    """Anything, functions within functions too, to be read by `pickle`."""
    import cloudpickle

    class Packer(cloudpickle.Pickler):  # type: ignore[misc]
        def reducer_override(self, obj: Any) -> Any:
            # one number in the place of a long column stays one number
            if type(obj) is np.ndarray and obj.size > 1 and not any(obj.strides):
                return np.broadcast_to, (obj[(slice(0, 1),) * obj.ndim].copy(), obj.shape)
            return super().reducer_override(obj)

    into = io.BytesIO()
    Packer(into, protocol=5).dump(what)
    return into.getvalue()
