"""Diagnoses that were asked for in a browser, each in a folder of its own, the work in a child process.

Looking at a file and diagnosing it are `highside import` and `highside diagnose`, started anew each time: what a file
breaks breaks the child. One child runs at a time; a viewer has one job, and a new one ends the one before. Nothing that
a browser sends becomes a path: files have fixed names here, and what it says of them is an argument after `=`.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from highside.errors import HighsideError, Refused
from highside.printable import one_line
from highside.reading import parse_json, read_bytes
from highside.words import _, said, told
from highside.words.errors import error_told

JOBS_MAX = 8
"""Viewers whose jobs are kept; the oldest that has ended makes room."""
KEPT_S = 3600.0
"""A job that has ended is kept for so long."""
LOOK_S = 180.0
"""For looking at a file: 2,000,000 rows of CSV take some 10 s."""
SAID_MAX = 200_000
"""Bytes of what a child says that are read."""
LINES_SHOWN = 200
SUFFIXES = (
    ".csv.gz", ".csv", ".txt", ".parquet", ".mcap", ".xlsx", ".mat", ".h5", ".hdf5", ".ulg", ".bag", ".db3", ".bin",
)  # fmt: skip
"""Of what a browser calls its file the ending alone is used, and only one of these."""

Stage = Literal["looking", "looked", "waiting", "running", "done", "failed"]
LIVE: frozenset[Stage] = frozenset({"looking", "waiting", "running"})
"""Stages in which a child works, or waits for its turn."""


@dataclass(frozen=True, slots=True)
class Words:
    """What the viewer says of the columns, as the options of `highside import`."""

    mapping: tuple[str, ...] = ()
    units: str = ""
    axes: str = ""
    rate: str = ""
    poses: bool = False

    def arguments(self) -> list[str]:
        out = [f"--map={one}" for one in self.mapping]
        out += [f"--{name}={value}" for name, value in self._texts() if value]
        return out + (["--poses"] if self.poses else [])

    def _texts(self) -> tuple[tuple[str, str], ...]:
        return (("units", self.units), ("axes", self.axes), ("rate", self.rate))


@dataclass(slots=True)
class Job:
    """One viewer's file and what became of it. Times are monotonic, s."""

    folder: Path
    recording: Path
    name: str
    """what the browser calls the file: only shown"""
    size: int
    has_model: bool
    words: Words
    language: str = "en"
    """of its report"""
    stage: Stage = "looking"
    looked: dict[str, Any] = field(default_factory=dict)
    said: tuple[str, ...] = ()
    """lines of the diagnosis, or why it failed"""
    begun: float = field(default_factory=time.monotonic)
    ended: float | None = None
    task: asyncio.Task[None] | None = None

    @property
    def age_s(self) -> float:
        return (time.monotonic() if self.ended is None else self.ended) - self.begun

    @property
    def report(self) -> Path:
        return self.folder / "out" / "report.html"

    @property
    def answer(self) -> Path:
        return self.folder / "out" / "diagnosis.json"


class Jobs:
    """The jobs of all viewers. `close` ends them and takes their files away."""

    def __init__(self, minutes: float) -> None:
        self._within_s = 60.0 * minutes
        self._folder = Path(tempfile.mkdtemp(prefix="highside-diagnosis-"))
        self._jobs: dict[str, Job] = {}
        self._turn = asyncio.Semaphore(1)
        self._ended: set[asyncio.Task[None]] = set()

    def of(self, viewer: str) -> Job | None:
        """The viewer's job, if it is kept."""
        self._forget_old()
        return self._jobs.get(viewer)

    def waiting_before(self, job: Job) -> int:
        """Jobs that were asked for before this one and have not ended."""
        return sum(1 for other in self._jobs.values() if other.stage in LIVE and other.begun < job.begun)

    async def begin(self, viewer: str, name: str, recording: bytes, model: bytes, words: Words) -> Job:
        """Take a file and look at it. Raises Refused where all places are taken by work in progress."""
        await self.forget(viewer)
        self._forget_old()
        if len(self._jobs) >= JOBS_MAX:
            ended = [key for key, job in self._jobs.items() if job.stage not in LIVE]
            if not ended:
                raise Refused(
                    said("others' diagnoses are in progress, and there is no place for another: come back later")
                )
            await self.forget(min(ended, key=lambda key: self._jobs[key].begun))
        folder = Path(tempfile.mkdtemp(dir=self._folder))
        suffix = next((one for one in SUFFIXES if name.lower().endswith(one)), ".csv")
        shown, has_model = one_line(name)[:120], bool(model.strip())
        job = Job(folder, folder / f"recording{suffix}", shown, len(recording), has_model, words)
        self._jobs[viewer] = job
        await asyncio.to_thread(_keep, job, recording, model)
        if self._jobs.get(viewer) is not job:
            raise Refused(said("another file was sent meanwhile from this browser"))
        self._start(job, self._look(job))
        return job

    def look_again(self, job: Job, words: Words) -> None:
        """Look at the same file with other words."""
        if job.stage in ("looked", "failed", "done"):
            job.words, job.stage = words, "looking"
            self._start(job, self._look(job))

    def run(self, job: Job, language: str = "en") -> None:
        """Diagnose what was looked at and confirmed; the report is in that language."""
        if job.stage == "looked" and not any(doubt["open"] for doubt in job.looked["doubts"]):
            job.stage, job.language = "waiting", language
            self._start(job, self._diagnose(job))

    async def forget(self, viewer: str) -> None:
        """End the viewer's job, whatever it does, and take its files away."""
        job = self._jobs.pop(viewer, None)
        if job is None:
            return
        if job.task is not None:
            job.task.cancel()
            await asyncio.gather(job.task, return_exceptions=True)
        await asyncio.to_thread(shutil.rmtree, job.folder, True)

    async def close(self) -> None:
        for viewer in list(self._jobs):
            await self.forget(viewer)
        await asyncio.to_thread(shutil.rmtree, self._folder, True)

    # --- the work ------------------------------------------------------------------------------------------------

    def _start(self, job: Job, work: Any) -> None:
        job.begun, job.ended, job.said = time.monotonic(), None, ()
        job.task = asyncio.create_task(self._to_its_end(job, work))

    async def _to_its_end(self, job: Job, work: Any) -> None:
        try:
            await work
        except HighsideError as error:
            job.stage, job.said = "failed", (self._told(job, error_told(error, "refusals")),)
        except OSError as error:
            why = error.strerror or type(error).__name__
            job.stage, job.said = "failed", (_("cannot be done here: %(why)s", why=why),)
        finally:
            job.ended = time.monotonic()

    async def _look(self, job: Job) -> None:
        arguments = ["import", str(job.recording), "--inspect", "--json", *job.words.arguments()]
        async with self._turn:
            status, out, err = await self._child(job, arguments, LOOK_S)
        if status != 0:
            why = said("the file could not be looked at (status %(status)s)", status=status)
            raise Refused(_in_words(_last(err)) or why)
        looked = parse_json(out, kind="answer", remedy="try again")
        job.looked = looked if isinstance(looked, dict) else {}
        job.stage = "looked"

    async def _diagnose(self, job: Job) -> None:
        async with self._turn:
            job.stage, job.begun = "running", time.monotonic()
            rows = job.recording
            if not job.looked["own"] or job.words.arguments():
                rows = job.folder / "taken.csv.gz"
                taken = ["import", str(job.recording), "--yes", f"--output={rows}", *job.words.arguments()]
                status, _, err = await self._child(job, taken, LOOK_S)
                if status != 0:
                    why = said("the file could not be taken (status %(status)s)", status=status)
                    raise Refused(_in_words(_last(err)) or why)
            model, out = job.folder / "model.toml", job.answer.parent
            asked = ["diagnose", str(rows), f"--model={model}", f"--out={out}", f"--language={job.language}"]
            asked.append(f"--called={job.name}")
            status, heard, err = await self._child(job, asked, self._within_s)
        # 1: the data are bad, which is an answer with a report
        if status not in (0, 1):
            raise Refused(_in_words(_last(err)) or said("the diagnosis ended with status %(status)s", status=status))
        lines = [self._told(job, line) for line in heard.splitlines() if line.strip()]
        job.stage, job.said = "done", tuple(lines[:LINES_SHOWN])

    async def _child(self, job: Job, arguments: Sequence[str], within_s: float) -> tuple[int, str, str]:
        """Run a command of ours; its status and what it said. Raises Refused where its time is over."""
        program = [sys.executable, "-c", "from highside.cli.main import main; main()", *arguments]
        out, err = job.folder / "said.out", job.folder / "said.err"
        with out.open("wb") as to_out, err.open("wb") as to_err:
            process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "highside.web.diagnosis.limited", str(within_s), *program,
                stdin=asyncio.subprocess.DEVNULL, stdout=to_out, stderr=to_err, cwd=job.folder, env=_environment(job),
                start_new_session=True,
            )  # fmt: skip
        try:
            async with asyncio.timeout(within_s):
                status = await process.wait()
        except TimeoutError:
            raise Refused(
                said("it took longer than %(minutes)s min and was ended", minutes=f"{within_s / 60:.0f}")
            ) from None
        finally:
            await _end(process)
        # a signal: the system, or a limit of ours, has ended it
        if status < 0:
            name = signal.Signals(-status).name
            raise Refused(said("it was ended by the system (%(signal)s): too much memory or time", signal=name))
        texts = [await asyncio.to_thread(_text, path) for path in (out, err)]
        return status, texts[0], texts[1]

    def _told(self, job: Job, text: str) -> str:
        """Without the place on this machine's disk."""
        return text.replace(str(job.recording), job.name).replace(f"{job.folder}{os.sep}", "")

    def _forget_old(self) -> None:
        now = time.monotonic()
        for viewer, job in list(self._jobs.items()):
            if job.stage not in LIVE and job.ended is not None and now - job.ended > KEPT_S:
                task = asyncio.get_running_loop().create_task(self.forget(viewer))
                self._ended.add(task)
                task.add_done_callback(self._ended.discard)


def _keep(job: Job, recording: bytes, model: bytes) -> None:
    job.recording.write_bytes(recording)
    (job.folder / "model.toml").write_bytes(model)


def _environment(job: Job) -> dict[str, str]:
    """What the child knows of ours: nothing that loads code or names files, but where programs are."""
    kept = {name: os.environ[name] for name in ("PATH", "LANG", "LC_ALL", "SYSTEMROOT") if name in os.environ}
    place = str(job.folder)
    return kept | {"HOME": place, "TMPDIR": place, "XDG_DATA_HOME": place, "XDG_CONFIG_HOME": place, "COLUMNS": "120"}


async def _end(process: asyncio.subprocess.Process) -> None:
    """Kill the child and what it started, and wait for it."""
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            if hasattr(os, "killpg"):
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
        await process.wait()


def _text(path: Path) -> str:
    with contextlib.suppress(HighsideError):
        return read_bytes(path, max_bytes=SAID_MAX).decode(errors="replace")
    return ""


def _in_words(text: str) -> str:
    """What a file was refused for, and what to do, in the language of who sent it."""
    return "; ".join(told(part, "refusals") for part in text.split("; "))


def _last(text: str) -> str:
    """The last line of what a command says: the one that names what is wrong."""
    lines = [line for line in text.splitlines() if line.strip()]
    return one_line(lines[-1].removeprefix("highside: "))[:600] if lines else ""
