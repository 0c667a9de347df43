"""Certificates of the store's records: the fields are asked on a page, the document is made and sent. For who may
operate: a certificate names a customer.

    GET   /calibrations/ID/certificate     the form, filled in with what `[web] certificate` says
    POST  /calibrations/ID/certificate     the certificate: printed sheets (PDF or HTML), or the digital one (DCC)

Logo and what is not asked here (references, use, environment) come from that file. Nothing is kept but the act's line
in the journal.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse
from pydantic import ValidationError

from highside.bench.photographs import Found
from highside.calibration.record import CalibrationRecord, to_utc
from highside.config.certificate import CertificateFields
from highside.config.mistakes import input_error
from highside.config.users import Role
from highside.errors import HighsideError, InputError
from highside.recording.calibration_store import CalibrationStore
from highside.report.certificate import certificate, number_of
from highside.report.certificate_inputs import Inputs
from highside.report.dcc import dcc
from highside.web.plain import FORM_HEADERS, HEADERS, form_of
from highside.web.records.shelf import SessionShelf
from highside.web.records.views import Views
from highside.web.signin.acts import Acts, Person
from highside.web.viewer import viewer
from highside.web.words import _, said_later
from highside.words.errors import error_told

BODY_MAX = 30_000
"""Bytes of the form: 20 fields of 200 letters, each of which may be nine bytes."""

ASKED: tuple[tuple[str, str, str], ...] = (
    ("issue", "number", said_later("Number of the certificate (empty: made from the record)")),
    ("issue", "laboratory", said_later("Laboratory")),
    ("issue", "address", said_later("Its address")),
    ("issue", "country", said_later("Its country, two capitals (for the digital certificate)")),
    ("issue", "customer", said_later("Customer")),
    ("issue", "place", said_later("Place of the calibration")),
    ("issue", "signatory", said_later("Who authorises it")),
    ("issue", "role", said_later("Their role")),
    ("item", "maker", said_later("Maker of the tool")),
    ("item", "model", said_later("Model")),
    ("item", "condition", said_later("Condition on receipt")),
    ("decision", "limit_inc_deg", said_later("Limit of error of inclination, ° (empty: no statement of conformity)")),
    ("decision", "limit_tf_deg", said_later("Limit of error of toolface, °")),
    ("decision", "agreed_with", said_later("Who agreed to the limits")),
    ("next", "next_calibration", said_later("Next calibration (year-month-day), only if the customer agreed")),
    ("next", "agreed_with", said_later("Who of the customer agreed to it")),
)
"""Table and field of the file, and the words for it."""
LANGUAGE = "issue.language"
"""The field of the choice between languages."""
ANNEX = "photographs"
"""The field of the box for the annex."""
FORMS = {"pdf": "application/pdf", "html": "text/html; charset=utf-8", "dcc": "application/xml"}


class CertificatePages:
    """Adds the routes; `answer` makes an answer in a thread, in its turn."""

    def __init__(
        self,
        store: CalibrationStore,
        sessions: SessionShelf | None,
        views: Views,
        acts: Acts,
        fields: CertificateFields,
        answer: Callable[[Callable[[], Response]], Awaitable[Response]],
    ) -> None:
        self._store, self._sessions = store, sessions
        self._views, self._acts, self._fields, self._answer = views, acts, fields, answer

    def serve(self, app: FastAPI) -> None:
        """Add the routes, before that of a record."""

        @app.get("/calibrations/{name}/certificate")
        async def form(name: str) -> Response:
            if self._person() is None:
                return self._not_for_you()
            return await self._answer(lambda: self._form(name, shown(self._fields)))

        @app.post("/calibrations/{name}/certificate")
        async def made(name: str, request: Request) -> Response:
            person = self._person()
            if person is None:
                return self._not_for_you()
            given = {field: values[0] for field, values in form_of(await request.body()).items()}
            return await self._answer(lambda: self._made(person, name, given))

    def _person(self) -> Person | None:
        person = viewer().person
        return person if person is not None and person.may(Role.OPERATE) else None

    def _not_for_you(self) -> Response:
        page = self._views.trouble(_("That is not for you."), _("A certificate is for who may operate."))
        return HTMLResponse(page, 403, HEADERS)

    def _form(self, name: str, values: Mapping[str, str], trouble: str | None = None) -> Response:
        record = self._store.get(name)
        rows = [(f"{table}.{field}", words, values.get(f"{table}.{field}", "")) for table, field, words in ASKED]
        more = {"language": values.get(LANGUAGE) or viewer().language, "photographs": len(self._photographs(record))}
        page = self._views.certificate(record, rows, trouble, annex=trouble is None or ANNEX in values, **more)
        return HTMLResponse(page, 200 if trouble is None else 409, FORM_HEADERS)

    def _photographs(self, record: CalibrationRecord) -> tuple[Found, ...]:
        return () if self._sessions is None else self._sessions.photographs_of(record)

    def _made(self, person: Person, name: str, given: Mapping[str, str]) -> Response:
        record = self._store.get(name)
        kind = given.get("form", "")
        try:
            if kind not in FORMS:
                raise InputError(_("choose PDF, HTML or the digital certificate"))
            taken = self._photographs(record) if ANNEX in given else ()
            inputs = Inputs(record, with_answers(self._fields, given), to_utc(time.time()), photographs=taken)
            number = number_of(inputs)
            if kind == "dcc":
                data = dcc(inputs, number)
            elif kind == "pdf":
                data, _sheets = certificate(inputs).pdf()
            else:
                data = certificate(inputs).html().encode()
            self._acts.write(person, "make a certificate", record=record.id, number=number, form=kind)
        except HighsideError as error:
            return self._form(name, given, error_told(error, "refusals"))
        ending = "xml" if kind == "dcc" else kind
        shown_as = "attachment" if kind == "dcc" else "inline"
        disposition = {"Content-Disposition": f'{shown_as}; filename="certificate-{record.id[:12]}.{ending}"'}
        return Response(data, media_type=FORMS[kind], headers={"Cache-Control": "no-store", **disposition})


def shown(fields: CertificateFields) -> dict[str, str]:
    """What the file says of the fields that are asked."""
    known = fields.model_dump(mode="json", exclude_none=True)
    asked = [(table, field) for table, field, _words in ASKED] + [("issue", "language")]
    return {f"{table}.{field}": str(known[table][field]) for table, field in asked if field in known.get(table, {})}


def with_answers(fields: CertificateFields, given: Mapping[str, str]) -> CertificateFields:
    """The fields with what was answered on the page; an empty answer takes what the file says away. Raises
    InputError."""
    tables: dict[str, Any] = fields.model_dump(exclude_none=True)
    for table, field, _words in ASKED:
        answer = given.get(f"{table}.{field}", "").strip()
        found = tables.setdefault(table, {})
        found.pop(field, None)
        if answer:
            found[field] = answer.replace(",", ".") if field.startswith("limit_") else answer
    if given.get(LANGUAGE):
        tables["issue"]["language"] = given[LANGUAGE]
    tables = {name: table for name, table in tables.items() if table != {}}
    try:
        return CertificateFields.model_validate(tables)
    except ValidationError as error:
        raise input_error(error, "form", {}, CertificateFields) from None
