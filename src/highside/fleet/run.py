"""A job on all recordings of a catalogue, distributed by dask.distributed: this machine's processors or any cluster.

Short recordings go in batches of about ten seconds, a long one is a task of its own. A process that dies costs its
batch only: its recordings are given out again one by one, and a recording that ends every process it is given to is an
error of its own. Each result is written where it was made, whole; what is there already is not computed again.
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from highside.errors import HighsideError, InputError
from highside.fleet.catalogue import INSTALL, Entry
from highside.fleet.jobs import Order, empty_row, row_of
from highside.fleet.parts import PartStore, key_of
from highside.fleet.policy import TASKS
from highside.reading import read_bytes, read_document
from highside.reading.files import allowed_bytes

__all__ = ["Finished", "Outcome", "run"]

MEGABYTE = 1_000_000


@dataclass(frozen=True)
class Outcome:
    """What became of one recording."""

    uri: str
    key: str | None
    """of its result; None where its content could not be had: it is tried again in the next run"""
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
    progress: Callable[[int, int, str], None] = lambda done, all_of_them, words: None,
) -> Finished:
    """Do the job on all entries. `workers`: processes of this machine; `scheduler`: a cluster's address instead.

    `progress` is given how many are done, of how many, and the address of the dashboard. Raises InputError for a model
    that is not in order, and where dask.distributed is missing or the cluster cannot be reached.
    """
    work = {entry.uri: _order_of(entry, order) for entry in entries}
    outcomes: dict[str, Outcome] = {}
    with _client(workers, scheduler) as client:
        from distributed import as_completed

        dashboard = str(client.dashboard_link or "")
        progress(0, len(work), dashboard)
        given = {}
        for batch in _batches(entries):
            pairs = [(entry.uri, work[entry.uri]) for entry in batch]
            given[_submit(client, pairs, store.folder)] = (pairs, 1)
        pending = as_completed(list(given))
        for future in pending:
            pairs, attempt = given.pop(future)
            if future.status == "finished":
                outcomes |= {one.uri: one for one in future.result()}
            else:
                for again in _again(pairs, attempt):
                    other = _submit(client, again, store.folder)
                    given[other] = (again, attempt + 1 if len(pairs) == 1 else 1)
                    pending.add(other)
                if len(pairs) == 1 and attempt >= TASKS.attempts:
                    outcomes[pairs[0][0]] = _deadly(pairs[0], store)
            future.release()
            progress(len(outcomes), len(work), dashboard)
    finished = Finished(tuple(outcomes[entry.uri] for entry in entries))
    store.write_catalogue(entries, finished.keys, order.job)
    return finished


def _order_of(entry: Entry, order: Order) -> Order:
    """What is asked of one recording. Raises InputError for a model of its own that cannot be read."""
    own = order
    if entry.model is not None:
        own = replace(order, model=read_document(Path(entry.model)).decode("utf-8", "replace"))
    own.model_of()
    if order.job == "solve":
        # a record is of a tool; all other results are of a recording
        own = replace(own, tool=entry.tool if entry.stated else "", serial=entry.more.get("serial", "").strip())
    return own


def _batches(entries: Sequence[Entry]) -> Iterator[list[Entry]]:
    batch: list[Entry] = []
    seconds = 0.0
    for entry in entries:
        size = entry.size if entry.size is not None else _size_of(entry.uri)
        cost = TASKS.per_recording_s + TASKS.per_megabyte_s * size / MEGABYTE
        if batch and seconds + cost > TASKS.seconds:
            yield batch
            batch, seconds = [], 0.0
        batch.append(entry)
        seconds += cost
    if batch:
        yield batch


def _size_of(uri: str) -> int:
    try:
        return Path(uri).stat().st_size
    except OSError:
        # a remote place: taken for a short one
        return 0


def _submit(client: Any, pairs: Sequence[Work], folder: Path) -> Any:
    # never cached by the scheduler: what is done is known by its part
    return client.submit(work_on, list(pairs), str(folder), pure=False, retries=0)


def _again(pairs: Sequence[Work], attempt: int) -> list[list[Work]]:
    """The tasks that a task whose process died is given out as again."""
    if len(pairs) > 1:
        return [[pair] for pair in pairs]
    return [list(pairs)] if attempt < TASKS.attempts else []


def _deadly(pair: Work, store: PartStore) -> Outcome:
    """The result of a recording that ended every process it was given to."""
    uri, order = pair
    said = f"ended {TASKS.attempts} processes that worked on it (out of memory?)"
    with _at_hand(uri) as path:
        key = _key(path, order)
    store.write(key, empty_row(order.job) | {"error": said})
    return Outcome(uri, key, "error", True, error=said)


def work_on(pairs: Sequence[Work], folder: str) -> list[Outcome]:
    """In a process of the cluster: the results of these recordings, each written as it is made."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    store = PartStore(Path(folder))
    return [_outcome(uri, order, store) for uri, order in pairs]


def _outcome(uri: str, order: Order, store: PartStore) -> Outcome:
    try:
        with _at_hand(uri) as path:
            key = _key(path, order)
            if store.has(key):
                return Outcome(uri, key, "", False)
            row = row_of(order, path)
    except HighsideError as error:
        return Outcome(uri, None, "error", False, error=str(error))
    if row.get("record") and row["verdict"] == "done":
        # before the result, which says that all of it is there
        store.write_record(row["record_id"], row["record"])
    store.write(key, row)
    return Outcome(uri, key, str(row["verdict"]), True, float(row["seconds"]), str(row["error"]))


def _key(path: Path, order: Order) -> str:
    return key_of(read_bytes(path), *order.key)


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


@contextmanager
def _client(workers: int | None, scheduler: str | None) -> Iterator[Any]:
    """A client of the cluster, which is ended with it where it was started here."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError("a fleet needs dask.distributed, which is not installed", remedy=INSTALL) from None
    # a batch whose process died is given out by us, alone; the scheduler need not try it on others first
    settings = {"distributed.scheduler.allowed-failures": 0, "distributed.worker.daemon": False}
    with dask.config.set(settings):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout="10s")
            except (OSError, ValueError) as error:
                raise InputError(f"cannot be reached: {error}", where=scheduler, field="--scheduler") from None
            with client:
                yield client
            return
        count = workers or os.cpu_count() or 1
        with (
            LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",
                host="127.0.0.1",
                silence_logs=50,
            ) as cluster,
            Client(cluster) as client,
            _kept_up(cluster, count),
        ):
            yield client


@contextmanager
def _kept_up(cluster: Any, count: int) -> Iterator[None]:
    """Ask for `count` processes again and again: dask begins no other in the place of one that dies while it starts, or
    is 15 s in starting anew (a busy machine), and a cluster that has lost all of them so would wait for ever."""
    ended = threading.Event()

    def ask() -> None:
        while not ended.wait(TASKS.ask_again_s):
            cluster.scale(count)

    thread = threading.Thread(target=ask, name="fleet workers", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
