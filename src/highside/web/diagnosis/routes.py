"""Answers requests for a diagnosis.

    GET  /diagnosis                    the form, or the viewer's job and how it stands
    POST /diagnosis/sign-in            the token, by a form
    POST /diagnosis/file               a recording (and a model), to be looked at
    POST /diagnosis/look               the same file with other words of its columns
    POST /diagnosis/run                diagnose what was looked at
    POST /diagnosis/forget             cancel, and take the files away
    GET  /diagnosis/state              how it stands (JSON), for the script of the page
    GET  /diagnosis/report, /diagnosis/diagnosis.json

All but the token's form are for who has shown it, and a form must come from a page of ours. Each browser has a job of
its own, by a cookie that means nothing else; nobody else sees it.
"""

from __future__ import annotations

import asyncio
import re
import secrets
from collections.abc import Awaitable, Callable
from pathlib import Path

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse
from starlette.datastructures import FormData, UploadFile

from highside.config.serve import DiagnosisTable
from highside.errors import HighsideError, Refused
from highside.reading import read_document
from highside.web.diagnosis.jobs import Job, Jobs, Words
from highside.web.diagnosis.views import MAP_MAX, DiagnosisViews
from highside.web.front import of_our_origin
from highside.web.host import PageHost, notice
from highside.web.navigation import Link
from highside.web.plain import FORM_HEADERS, HEADERS
from highside.web.words import _, said
from highside.words import language
from highside.words.errors import error_told

VIEWER = "highside_viewer"
"""The cookie by which a browser finds its job again."""
_VIEWER = re.compile(r"[A-Za-z0-9_-]{22,64}")
UPLOAD_WITHIN_S = 300.0
"""For a whole upload; 64 MB take that at 0.2 MB/s."""
MODEL_MAX = 200_000
"""Bytes of a model; the shipped ones have 2,000."""
FORM_MAX = 24_000
"""Bytes of a form beside its files: of `MAP_MAX` letters each has four at most."""
MAPPINGS_MAX = 40
_UPLOAD = "/diagnosis/file"
_REPORT_POLICY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:;"
    " font-src data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""Of a report, which has scripts of ours and words of the file: it is not of our origin and reaches nobody."""

_SCRIPT = Path(__file__).with_name("diagnosis.js").read_text(encoding="utf-8")

Handler = Callable[[Request, str], Awaitable[Response]]


class DiagnosisPages:
    """The pages of a diagnosis on a host. `serve` adds them; `close` ends what is in progress."""

    def __init__(self, settings: DiagnosisTable, links: tuple[Link, ...]) -> None:
        self._settings = settings
        self._views = DiagnosisViews(links, settings.upload_mb)
        self._jobs = Jobs(settings.minutes)
        self._host: PageHost | None = None

    def serve(self, host: PageHost) -> None:
        """Add the routes to a host's application."""
        self._host = host
        app: FastAPI = host.app
        app.get("/diagnosis")(self._guarded(self._show))
        app.get("/diagnosis/state")(self._guarded(self._state))
        app.get("/diagnosis/report")(self._guarded(self._report))
        app.get("/diagnosis/diagnosis.json")(self._guarded(self._answer))
        app.get("/diagnosis.js")(_script)
        app.post(_UPLOAD)(self._guarded(self._file))
        app.post("/diagnosis/look")(self._guarded(self._look))
        app.post("/diagnosis/run")(self._guarded(self._run))
        app.post("/diagnosis/forget")(self._guarded(self._forget))
        app.post("/diagnosis/sign-in")(self._sign_in)

    async def close(self) -> None:
        await self._jobs.close()

    def allowed(self, request: Request) -> tuple[int, float] | None:
        """How much of a body is read: an upload from who has shown the token alone."""
        path = request.url.path
        if path == _UPLOAD and self._may(request):
            return self._settings.upload_mb * 1_000_000 + MODEL_MAX + FORM_MAX, UPLOAD_WITHIN_S
        return None

    def _may(self, request: Request) -> bool:
        return self._host is not None and self._host.may_command(request)

    def _guarded(self, handler: Handler) -> Callable[[Request], Awaitable[Response]]:
        async def answered(request: Request) -> Response:
            if not self._may(request):
                return HTMLResponse(self._views.sign_in(), 401, FORM_HEADERS)
            if request.method != "GET" and not of_our_origin(request.scope):
                return notice(_("Refused"), _("This form does not come from a page of this server."), 403)
            viewer = request.cookies.get(VIEWER, "")
            known = _VIEWER.fullmatch(viewer) is not None
            viewer = viewer if known else secrets.token_urlsafe(24)
            try:
                answer = await handler(request, viewer)
            except HighsideError as error:
                answer = HTMLResponse(self._views.begin(error_told(error, "refusals")), 409, FORM_HEADERS)
            if not known:
                assert self._host is not None
                secure = self._host.settings.tls is not None
                answer.set_cookie(VIEWER, viewer, httponly=True, samesite="strict", secure=secure)
            return answer

        return answered

    async def _sign_in(self, request: Request) -> Response:
        assert self._host is not None
        if not of_our_origin(request.scope):
            return notice(_("Refused"), _("This form does not come from a page of this server."), 403)
        form = await request.form(max_files=0, max_fields=4)
        answer = self._host.let_in(_text(form, "token", 200))
        if answer.status_code == 303:
            answer.headers["location"] = "/diagnosis"
        return answer

    async def _show(self, request: Request, viewer: str) -> Response:
        job = self._jobs.of(viewer)
        if job is None:
            return HTMLResponse(self._views.begin(), headers=FORM_HEADERS)
        return await self._shown(job)

    async def _shown(self, job: Job, status: int = 200, trouble: str = "", written: Words | None = None) -> Response:
        """`written`: what was said of the columns and is not taken."""
        report = await asyncio.to_thread(job.report.is_file)
        before = self._jobs.waiting_before(job)
        page = self._views.job(job, before, report=report, trouble=trouble, written=written or job.words)
        return HTMLResponse(page, status, FORM_HEADERS)

    async def _state(self, request: Request, viewer: str) -> Response:
        job = self._jobs.of(viewer)
        if job is None:
            return JSONResponse({"stage": "none", "words": ""}, headers=HEADERS)
        words = self._views.words(job, self._jobs.waiting_before(job))
        return JSONResponse({"stage": job.stage, "words": words}, headers=HEADERS)

    async def _file(self, request: Request, viewer: str) -> Response:
        form = await request.form(max_files=2, max_fields=10)
        recording, model = form.get("recording"), form.get("model")
        if not isinstance(recording, UploadFile) or not recording.filename or not recording.size:
            raise Refused(_("no recording was sent, or an empty one: choose a file"))
        if recording.size > self._settings.upload_mb * 1_000_000:
            raise Refused(_("the recording is larger than %(most)s MB") % {"most": self._settings.upload_mb})
        text = await model.read(MODEL_MAX + 1) if isinstance(model, UploadFile) else b""
        if len(text) > MODEL_MAX:
            raise Refused(_("the model is larger than %(most)s KB: it is no model") % {"most": MODEL_MAX // 1000})
        await self._jobs.begin(viewer, recording.filename, await recording.read(), text, _words(form))
        return _back()

    async def _look(self, request: Request, viewer: str) -> Response:
        form = await request.form(max_files=0, max_fields=10)
        job = self._jobs.of(viewer)
        if job is None:
            return _back()
        try:
            self._jobs.look_again(job, _words(form))
        except HighsideError as error:
            return await self._shown(job, 409, error_told(error, "refusals"), _written(form))
        return _back()

    async def _run(self, request: Request, viewer: str) -> Response:
        job = self._jobs.of(viewer)
        if job is not None:
            self._jobs.run(job, language())
        return _back()

    async def _forget(self, request: Request, viewer: str) -> Response:
        await self._jobs.forget(viewer)
        return _back()

    async def _report(self, request: Request, viewer: str) -> Response:
        policy = {"Content-Security-Policy": _REPORT_POLICY}
        return await self._document(viewer, lambda job: job.report, "text/html", policy)

    async def _answer(self, request: Request, viewer: str) -> Response:
        shown = {**HEADERS, "Content-Disposition": 'attachment; filename="diagnosis.json"'}
        return await self._document(viewer, lambda job: job.answer, "application/json", shown)

    async def _document(self, viewer: str, of: Callable[[Job], Path], kind: str, headers: dict[str, str]) -> Response:
        job = self._jobs.of(viewer)
        if job is None or job.stage != "done":
            return _back()
        content = await asyncio.to_thread(read_document, of(job))
        return Response(content, media_type=f"{kind}; charset=utf-8", headers={**headers, "Cache-Control": "no-store"})


def _words(form: FormData) -> Words:
    """Raises Refused for more than anybody writes."""
    lines = [line.strip() for line in _text(form, "map", MAP_MAX).splitlines() if line.strip()]
    if len(lines) > MAPPINGS_MAX:
        raise Refused(said("%(count)s columns are named: at most %(most)s", count=len(lines), most=MAPPINGS_MAX))
    units, axes, rate = _text(form, "units", 100), _text(form, "axes", 20), _text(form, "rate", 20)
    return Words(tuple(lines), units, axes, rate, form.get("poses") == "yes")


def _written(form: FormData) -> Words:
    """The same as it was written, within what a page shows again."""
    units, axes, rate = (str(form.get(name, ""))[:200] for name in ("units", "axes", "rate"))
    return Words((str(form.get("map", ""))[:MAP_MAX],), units, axes, rate, form.get("poses") == "yes")


def _text(form: FormData, name: str, longest: int) -> str:
    """One line, or lines, without what no field needs. Raises Refused for one that is too long."""
    value = form.get(name, "")
    if not isinstance(value, str) or len(value) > longest:
        raise Refused(said("%(name)s has more than %(most)s characters", name=name, most=longest))
    return "".join(letter for letter in value if letter.isprintable() or letter == "\n").strip()


async def _script() -> Response:
    return Response(_SCRIPT, media_type="text/javascript", headers={"Cache-Control": "max-age=3600"})


def _back() -> Response:
    return RedirectResponse("/diagnosis", 303, headers=HEADERS)
