"""The page of a diagnosis in each of its stages, as HTML: pure, from a job. Everything is escaped by the templates."""

from __future__ import annotations

from collections.abc import Sequence

from highside.shown.card import templates
from highside.web.diagnosis.jobs import LIVE, SUFFIXES, Job
from highside.web.navigation import Link

WORDS = {
    "looking": "Looking at the file.",
    "looked": "Is this what the file holds?",
    "waiting": "Waiting: another diagnosis is in progress.",
    "running": "The diagnosis is in progress.",
    "done": "The diagnosis is done.",
    "failed": "It could not be done.",
}
OPEN = "The file leaves something open."
COLUMNS_SHOWN = 60


class DiagnosisViews:
    """The pages, each with the navigation."""

    def __init__(self, links: Sequence[Link], upload_mb: int) -> None:
        self._links = tuple(links)
        self._upload_mb = upload_mb

    def begin(self, trouble: str | None = None) -> str:
        """The form for a file."""
        return self._page("begin", trouble=trouble, upload_mb=self._upload_mb, accept=",".join(SUFFIXES))

    def sign_in(self) -> str:
        """For who has not shown the token."""
        return self._page("sign_in")

    def words(self, job: Job, before: int) -> str:
        """What it is and how it stands, in a sentence or two."""
        size = f"{job.size / 1e6:.1f} MB" if job.size >= 100_000 else f"{job.size:,} bytes"
        what = f"{job.name}, {size}, {'with' if job.has_model else 'without'} a model."
        if job.stage in ("looking", "waiting") and before:
            return f"{what} {before} before it."
        if job.stage in LIVE:
            return f"{what} {job.age_s:.0f} s so far."
        return f"{what} It took {job.age_s:.0f} s." if job.stage == "done" else what

    def job(self, job: Job, before: int, *, report: bool) -> str:
        """One job; `before`: how many are before it, `report`: whether there is one to read."""
        doubts = job.looked.get("doubts", [])
        is_open = any(doubt["open"] for doubt in doubts)
        return self._page(
            "job",
            job=job,
            heading=OPEN if is_open and job.stage == "looked" else WORDS[job.stage],
            live=job.stage in LIVE,
            words=self.words(job, before),
            columns=job.looked.get("columns", [])[:COLUMNS_SHOWN],
            beside=[name for key in ("kept", "omitted") for name in job.looked.get(key, [])][:COLUMNS_SHOWN],
            findings=job.looked.get("findings", []),
            doubts=doubts,
            is_open=is_open,
            report=report,
            mapping="\n".join(job.words.mapping),
        )

    def _page(self, template: str, **values: object) -> str:
        found = templates("highside.web").get_template(f"diagnosis/{template}.html")
        return found.render(links=self._links, here="/diagnosis", **values)
