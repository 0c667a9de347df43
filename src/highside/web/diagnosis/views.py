"""The page of a diagnosis in each of its stages, as HTML: pure, from a job. Everything is escaped by the templates."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from highside.web.diagnosis.jobs import LIVE, SUFFIXES, Job, Words
from highside.web.navigation import Link
from highside.web.plain import render
from highside.web.words import _, said_later
from highside.words.marked import in_words

WORDS = {
    "looking": said_later("Looking at the file."),
    "looked": said_later("Is this what the file holds?"),
    "waiting": said_later("Waiting: another diagnosis is in progress."),
    "running": said_later("The diagnosis is in progress."),
    "done": said_later("The diagnosis is done."),
    "failed": said_later("It could not be done."),
}
OPEN = said_later("The file leaves something open.")
COLUMNS_SHOWN = 60
MAP_MAX = 4_000
"""Letters of what is said of columns"""


def found_in_words(text: str) -> Markup:
    """What an import says of a file, in the reader's language: remarks one after the other."""
    return Markup("; ").join(in_words(part, of="importing") for part in text.split("; "))


class DiagnosisViews:
    """The pages, each with the navigation."""

    def __init__(self, links: Sequence[Link], upload_mb: int) -> None:
        self._links = tuple(links)
        self._upload_mb = upload_mb

    def begin(self, trouble: str | None = None) -> str:
        """The form for a file."""
        return self._page(
            "begin", trouble=trouble, upload_mb=self._upload_mb, accept=",".join(SUFFIXES), map_max=MAP_MAX
        )

    def sign_in(self) -> str:
        """For who has not shown the token."""
        return self._page("sign_in")

    def words(self, job: Job, before: int) -> str:
        """What it is and how it stands, in a sentence or two."""
        size = f"{job.size / 1e6:.1f} MB" if job.size >= 100_000 else _("%(count)s bytes") % {"count": f"{job.size:,}"}
        model = _("with a model") if job.has_model else _("without a model")
        what = f"{job.name}, {size}, {model}."
        seconds = {"seconds": f"{job.age_s:.0f}"}
        if job.stage in ("looking", "waiting") and before:
            return f"{what} " + _("%(count)s before it.") % {"count": before}
        if job.stage in LIVE:
            return f"{what} " + _("%(seconds)s s so far.") % seconds
        return f"{what} " + _("It took %(seconds)s s.") % seconds if job.stage == "done" else what

    def job(self, job: Job, before: int, *, report: bool, written: Words, trouble: str = "") -> str:
        """One job; `before`: how many are before it, `report`: whether there is one to read; `written`: what is said
        of its columns, `trouble`: why that is not taken."""
        doubts = job.looked.get("doubts", [])
        is_open = any(doubt["open"] for doubt in doubts)
        heading = OPEN if is_open and job.stage == "looked" else WORDS[job.stage]
        return self._page(
            "job",
            job=job,
            heading=_(heading),
            live=job.stage in LIVE,
            words=self.words(job, before),
            columns=job.looked.get("columns", [])[:COLUMNS_SHOWN],
            found=found_in_words,
            beside=[name for key in ("kept", "omitted") for name in job.looked.get(key, [])][:COLUMNS_SHOWN],
            findings=job.looked.get("findings", []),
            doubts=doubts,
            is_open=is_open,
            report=report,
            written=written,
            mapping="\n".join(written.mapping),
            trouble=trouble,
            map_max=MAP_MAX,
        )

    def _page(self, template: str, **values: object) -> str:
        return render(f"diagnosis/{template}.html", self._links, "/diagnosis", **values)
