"""A job on all recordings of a catalogue, distributed by dask.distributed: this machine's processors or any cluster.

Short recordings go in batches of about ten seconds, a long one is a task of its own. A process that dies costs its
batch only: its recordings are given out again one by one, and a recording that ends every process it is given to is an
error of its own. Results are written where they were made, those of a batch as one part, whole; what is there already
is not computed again.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from highside.errors import HighsideError, InputError
from highside.fleet.catalogue import Entry
from highside.fleet.cluster import cluster_client
from highside.fleet.given_out import Lost, answers, pieces
from highside.fleet.jobs import Order, empty_row, modules_of, row_of
from highside.fleet.parts import PartStore, content_digest, key_of
from highside.fleet.policy import TASKS
from highside.reading import read_document
from highside.reading.files import allowed_bytes

__all__ = ["Finished", "Outcome", "run"]


@dataclass(frozen=True)
class Outcome:
    """What became of one recording."""

    uri: str
    key: str | None
    """of its result; None where its content could not be had, or changed: it is tried again in the next run"""
    verdict: str
    computed: bool
    """else its result was there already"""
    seconds: float = 0.0
    error: str = ""


@dataclass(frozen=True)
class Finished:
    """A run to its end."""

    outcomes: tuple[Outcome, ...]

    @property
    def keys(self) -> dict[str, str]:
        """Key of each recording that has a result."""
        return {one.uri: one.key for one in self.outcomes if one.key is not None}


Work = tuple[str, Order]
"""a recording and what is asked of it"""


def run(
    entries: Sequence[Entry],
    order: Order,
    store: PartStore,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    dashboard: bool | None = None,
    progress: Callable[[int, int, str], None] = lambda done, all_of_them, words: None,
) -> Finished:
    """Do the job on all entries. `workers`: processes of this machine; `scheduler`: a cluster's address instead.

    `dashboard`: whether dask's is begun; None: where the work takes more than a minute. `progress` is given how many
    are done, of how many, and the address of the dashboard. Raises InputError for a model
    that is not in order, and where dask.distributed is missing or the cluster cannot be reached.
    """
    work = {entry.uri: _order_of(entry, order) for entry in entries}
    # a damaged part is said before anything is begun
    store.look()
    outcomes: dict[str, Outcome] = {}
    sizes = {entry.uri: _size_of(entry) for entry in entries}
    costs = [TASKS.seconds_of(order.job, size) for size in sizes.values()]
    processes = workers or os.cpu_count() or 1
    watched = sum(costs) > TASKS.watched_s * processes if dashboard is None else dashboard
    with cluster_client(processes, scheduler, modules_of(order.job), dashboard=watched) as client:
        page = str(client.dashboard_link or "") if watched or scheduler is not None else ""
        progress(0, len(work), page)
        if scheduler is not None:
            processes = max(1, sum(client.nthreads().values()))
        given = pieces(list(work.items()), costs, TASKS.batch_seconds(sum(costs), processes))
        for made in answers(client, given, lambda pairs: _submit(client, pairs, store.folder)):
            found = [_deadly(made, store)] if isinstance(made, Lost) else made
            outcomes |= {one.uri: one for one in found}
            progress(len(outcomes), len(work), page)
    finished = Finished(_with_errors_of_before([outcomes[entry.uri] for entry in entries], store))
    store.write_catalogue(entries, finished.keys, order.job)
    return finished


def _with_errors_of_before(outcomes: Sequence[Outcome], store: PartStore) -> tuple[Outcome, ...]:
    """What was there already may be the error of an earlier run, which stands as long as the recording does."""
    if all(one.computed or one.key is None for one in outcomes):
        return tuple(outcomes)
    errors = {key: str(row["error"] or "") for key, row in store.read(["error"]).items()}
    return tuple(
        one if one.computed or one.key is None else replace(one, error=_of_named(one.uri, errors.get(one.key, "")))
        for one in outcomes
    )


def _order_of(entry: Entry, order: Order) -> Order:
    """What is asked of one recording. Raises InputError for a model of its own that cannot be read."""
    own = order
    if entry.model is not None:
        own = replace(order, model=read_document(Path(entry.model)).decode("utf-8", "replace"))
    if own.model:
        own.model_of()
    if order.job == "solve":
        # a record is of a tool; all other results are of a recording
        own = replace(own, tool=entry.tool if entry.stated else "", serial=entry.more.get("serial", "").strip())
    return own


def _size_of(entry: Entry) -> int:
    if entry.size is not None:
        return entry.size
    try:
        return Path(entry.uri).stat().st_size
    except OSError:
        # a remote place: taken for a short one
        return 0


def _submit(client: Any, pairs: Sequence[Work], folder: Path) -> Any:
    # never cached by the scheduler: what is done is known by its part
    return client.submit(work_on, list(pairs), str(folder), pure=False, retries=0)


def _deadly(lost: Lost[Work], store: PartStore) -> Outcome:
    """The result of a recording that ended every process it was given to, or that none could begin with."""
    uri, order = lost.thing
    try:
        with _at_hand(uri) as path:
            key = _key(path, order)
    except HighsideError as gone:
        return Outcome(uri, None, "error", False, error=_of_named(uri, str(gone)))
    store.write({key: empty_row(order.job) | {"error": lost.said, "seconds": None, "cpu_s": None}})
    return Outcome(uri, key, "error", True, error=lost.said)


def work_on(pairs: Sequence[Work], folder: str) -> list[Outcome]:
    """In a process of the cluster: the results of these recordings, those of about ten seconds in one part."""
    store = _store_of(folder)
    store.look()
    outcomes: list[Outcome] = []
    made: dict[str, dict[str, Any]] = {}
    begun = time.monotonic()
    try:
        for uri, order in pairs:
            outcomes.append(_outcome(uri, order, store, made))
            if time.monotonic() - begun > TASKS.seconds:
                store.write(made)
                made, begun = {}, time.monotonic()
    finally:
        store.write(made)
    return outcomes


@lru_cache(maxsize=4)
def _store_of(folder: str) -> PartStore:
    """The results of a folder, and what this process knows of them already."""
    return PartStore(Path(folder))


def _outcome(uri: str, order: Order, store: PartStore, made: dict[str, dict[str, Any]]) -> Outcome:
    """What became of a recording; its row, if it was computed, is put into `made`."""
    try:
        with _at_hand(uri) as path:
            before = _state_of(path)
            key = _key(path, order)
            if store.has(key) or key in made:
                return Outcome(uri, key, "", False)
            row = row_of(order, path)
            if _state_of(path) != before:
                # its result, or its error, would be that of the content of before, for good
                raise InputError("changed while it was read", where=uri, remedy="run it again when it is written")
    except HighsideError as error:
        return Outcome(uri, None, "error", False, error=_of_named(uri, str(error)))
    made[key] = row
    return Outcome(uri, key, str(row["verdict"]), True, float(row["seconds"]), _of_named(uri, str(row["error"])))


def _of_named(uri: str, error: str) -> str:
    """An error as it is told of a recording that is named beside it."""
    return error.removeprefix(f"{uri}: ").removeprefix(f"{uri.rsplit('/', 1)[-1]}: ")


def _state_of(path: Path) -> tuple[int, ...] | None:
    """By which it is seen that a file is another; None for one that is not there."""
    try:
        state = path.stat()
    except OSError:
        return None
    return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns


def _key(path: Path, order: Order) -> str:
    return key_of(content_digest(path), *order.key)


@contextmanager
def _at_hand(uri: str) -> Iterator[Path]:
    """The recording as a file of this machine. Raises InputError where it cannot be had."""
    if "://" not in uri:
        yield Path(uri)
        return
    import fsspec

    with tempfile.TemporaryDirectory(prefix="highside-fleet-") as folder:
        name = uri.rsplit("/", 1)[-1]
        try:
            fs, path = fsspec.core.url_to_fs(uri)
            if (size := fs.size(path)) is not None and size > allowed_bytes():
                raise InputError(f"is longer than {allowed_bytes()} bytes", where=uri, remedy="see --max-bytes")
            fs.get_file(path, f"{folder}/{name}")
        except (OSError, ImportError, ValueError) as error:
            raise InputError(
                f"cannot be fetched: {error}", where=uri, remedy="see that the place can be read"
            ) from None
        yield Path(folder) / name
