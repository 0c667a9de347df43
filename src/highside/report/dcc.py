"""A certificate as Digital Calibration Certificate: PTB's DCC XML 3.3.0, with quantities as D-SI 2.2.1.

The same figures as the printed certificate, for programs: expanded uncertainties over inclination, coefficients of each
zone with theirs, the statement of conformity if limits were agreed. What was not stated is said to be so where the
schema wants something, and left out elsewhere. The order of elements is the schema's (https://ptb.de/dcc/v3.3.0/dcc.xsd).
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, tostring

from highside.calibration.comparison import INCLINATIONS_DEG
from highside.calibration.zone import SHARED_NAMES, Zone
from highside.config.certificate import ReferenceInstrument
from highside.errors import InputError
from highside.report.certificate_budget import K, budget_at
from highside.report.certificate_conformity import RULE, as_found, as_left
from highside.report.certificate_evidence import method_name
from highside.report.certificate_inputs import NOT_STATED, Inputs
from highside.words import in_language

VERSION = "3.3.0"
LANGUAGE = "en"
COVERAGE = "0.95"
"""Probability of k = 2 for a normal distribution, as certificates round it."""
_ROOT = {
    "xmlns:dcc": "https://ptb.de/dcc",
    "xmlns:si": "https://ptb.de/si",
    "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
    "xsi:schemaLocation": f"https://ptb.de/dcc https://ptb.de/dcc/v{VERSION}/dcc.xsd",
    "schemaVersion": VERSION,
}
_UNITS = {"g": "\\one", "rad": "\\radian", "1": "\\one", "deg": "\\degree", "degC": "\\degreecelsius"}
"""D-SI's names; a zero offset in g is a ratio to gravity at the bench"""


@dataclass(frozen=True, slots=True)
class Printed:
    """The printed certificate that travels within."""

    name: str
    mime: str
    data: bytes


def dcc(inputs: Inputs, named: str, printed: Printed | None = None) -> bytes:
    """The XML document, in English, which it names as its language. `named`: number of the certificate. Raises
    InputError where no country is stated, without which there is no such certificate."""
    with in_language("en"):
        return _dcc(inputs, named, printed)


def _dcc(inputs: Inputs, named: str, printed: Printed | None) -> bytes:
    if inputs.fields.issue.country is None:
        remedy = 'give country = "NO" (ISO 3166-1, two capitals) in [issue] of the fields'
        raise InputError("a digital calibration certificate names the laboratory's country", remedy=remedy)
    root = Element("dcc:digitalCalibrationCertificate", _ROOT)
    _administrative(SubElement(root, "dcc:administrativeData"), inputs, named)
    _measured(SubElement(root, "dcc:measurementResults"), inputs)
    if printed is not None:
        document = SubElement(root, "dcc:document")
        _leaf(document, "fileName", printed.name)
        _leaf(document, "mimeType", printed.mime)
        _leaf(document, "dataBase64", base64.b64encode(printed.data).decode("ascii"))
    text: bytes = tostring(root, encoding="utf-8")
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + text + b"\n"


# --- who and what --------------------------------------------------------------------------------------------------


def _administrative(ring: Element, inputs: Inputs, named: str) -> None:
    record, issue = inputs.record, inputs.fields.issue
    software = record.content["software"]
    _software(SubElement(ring, "dcc:dccSoftware"), software)
    core = SubElement(ring, "dcc:coreData")
    _leaf(core, "countryCodeISO3166_1", str(issue.country))
    _leaf(core, "usedLangCodeISO639_1", LANGUAGE)
    _leaf(core, "mandatoryLangCodeISO639_1", LANGUAGE)
    _leaf(core, "uniqueIdentifier", named)
    identities = [("calibrationLaboratory", record.id, "SHA-256 of the calibration record")]
    if record.signature is not None:
        signed = f"ed25519 signature of the record by {record.signature.signer}, {record.signature.time}, key"
        identities.append(("calibrationLaboratory", record.signature.key, signed))
    _identifications(core, identities)
    day = str(record.content["created"])[:10]
    _leaf(core, "beginPerformanceDate", day)
    _leaf(core, "endPerformanceDate", day)
    _leaf(core, "performanceLocation", issue.performed_at)
    _leaf(core, "issueDate", inputs.issued_utc[:10])
    _items(SubElement(ring, "dcc:items"), inputs)
    laboratory = SubElement(ring, "dcc:calibrationLaboratory")
    contact = SubElement(laboratory, "dcc:contact")
    _contact(contact, issue.laboratory, issue.address, issue.country)
    responsible = SubElement(SubElement(ring, "dcc:respPersons"), "dcc:respPerson")
    _text(SubElement(responsible, "dcc:person"), "name", issue.signatory or NOT_STATED)
    if issue.role is not None:
        _leaf(responsible, "role", issue.role)
    _leaf(responsible, "mainSigner", "true")
    _contact(SubElement(ring, "dcc:customer"), issue.customer, None, None)
    _statements(ring, inputs)


def _items(items: Element, inputs: Inputs) -> None:
    record, item = inputs.record, inputs.fields.item
    one = SubElement(items, "dcc:item")
    _text(one, "name", item.description)
    if item.condition is not None:
        _text(one, "description", f"Condition on receipt: {item.condition}")
    if item.maker is not None:
        _text(SubElement(one, "dcc:manufacturer"), "name", item.maker)
    if item.model is not None:
        _leaf(one, "model", item.model)
    identities = [("customer", record.tool_id, "tool")]
    if record.serial is not None:
        identities.append(("manufacturer", record.serial, "serial number"))
    _identifications(one, identities)


def _statements(ring: Element, inputs: Inputs) -> None:
    statements = SubElement(ring, "dcc:statements")
    texts = [("Scope", "This certificate relates only to the item described in it.")]
    if inputs.fields.decision is not None:
        agreed = inputs.fields.decision
        limits = (
            f"Limits of error: inclination {agreed.limit_inc_deg:g} deg, toolface {agreed.limit_tf_deg:g} deg. {RULE}"
        )
        found = (("As found", as_found(inputs)), ("As left", as_left(inputs)))
        texts += [(title, f"{one.what}. {one.found.text} {limits}") for title, one in found if one is not None]
    if inputs.fields.next is not None:
        agreed_next = inputs.fields.next
        text = f"{agreed_next.next_calibration.isoformat()}, as agreed with {agreed_next.agreed_with}"
        texts.append(("Next calibration", text))
    texts += [("Remark", text) for text in inputs.fields.remarks]
    for name, text in texts:
        one_statement = SubElement(statements, "dcc:statement")
        _text(one_statement, "name", name)
        _text(one_statement, "declaration", text)


# --- results -------------------------------------------------------------------------------------------------------


def _measured(ring: Element, inputs: Inputs) -> None:
    record = inputs.record
    result = SubElement(ring, "dcc:measurementResult")
    _text(result, "name", "Calibration of a directional sensor")
    methods = SubElement(result, "dcc:usedMethods")
    used = SubElement(methods, "dcc:usedMethod")
    _text(used, "name", method_name(record))
    evaluated = SubElement(methods, "dcc:usedMethod")
    _text(evaluated, "name", "Evaluation of the uncertainty")
    _leaf(evaluated, "norm", "JCGM 100:2008")
    _software(SubElement(result, "dcc:usedSoftware"), record.content["software"])
    _equipment(result, inputs)
    _conditions(result, inputs)
    results = SubElement(result, "dcc:results")
    _uncertainties(results, inputs)
    for zone in record.result.zones:
        _coefficients(results, zone)


def _equipment(result: Element, inputs: Inputs) -> None:
    fields = inputs.fields
    named: list[ReferenceInstrument] = [one for one in (fields.bench, fields.thermometer) if one is not None]
    if not named:
        return
    listed = SubElement(result, "dcc:measuringEquipments")
    for one in named:
        entry = SubElement(listed, "dcc:measuringEquipment")
        _text(entry, "name", one.description)
        words = [
            f"calibration certificate {one.certificate}" if one.certificate else "",
            f"issued by {one.issued_by}" if one.issued_by else "",
            f"valid until {one.valid_until.isoformat()}" if one.valid_until else "",
        ]
        if any(words):
            _text(entry, "description", ", ".join(word for word in words if word))


def _conditions(result: Element, inputs: Inputs) -> None:
    room = inputs.fields.environment
    spans = (
        ("Temperature of the room", room.temp_c, "\\degreecelsius"),
        ("Relative humidity", room.humidity_percent, "\\percent"),
        ("Air pressure", room.pressure_hpa, "\\hecto\\pascal"),
    )
    known = [(name, span, unit) for name, span, unit in spans if span is not None]
    if not known:
        return
    listed = SubElement(result, "dcc:influenceConditions")
    for name, span, unit in known:
        one = SubElement(listed, "dcc:influenceCondition")
        _text(one, "name", name)
        _text(one, "description", "lowest and highest value")
        _list_quantity(SubElement(one, "dcc:data"), name, span, unit)


def _uncertainties(results: Element, inputs: Inputs) -> None:
    found = [(inc, budget) for inc in INCLINATIONS_DEG if (budget := budget_at(inputs.record, inputs.fields, inc))]
    if not found:
        return
    result = SubElement(results, "dcc:result")
    _text(result, "name", "Expanded uncertainty of an indication over inclination")
    _text(
        result,
        "description",
        "At rest, with the corrections of the record; k = 2, the largest over toolface.",
    )
    listed = SubElement(SubElement(result, "dcc:data"), "dcc:list")
    columns = (
        ("Inclination", [inc for inc, _ in found]),
        ("Expanded uncertainty of inclination", [budget.expanded[0] for _, budget in found]),
        ("Expanded uncertainty of toolface", [budget.expanded[1] for _, budget in found]),
    )
    for name, values in columns:
        _list_quantity(listed, name, values, _UNITS["deg"])


def _coefficients(results: Element, zone: Zone) -> None:
    parameters = zone.parameters
    result = SubElement(results, "dcc:result")
    _text(result, "name", f"Coefficients: {zone.name}")
    held = [math.degrees(value) for value in (zone.inc_min_rad, zone.inc_max_rad)]
    _text(
        result,
        "description",
        f"m = A g + b: readings m of gravity g, both in units of gravity at the bench; inclination {held[0]:.2f} to"
        f" {held[1]:.2f} deg.",
    )
    data = SubElement(result, "dcc:data")
    for name, value in zip(parameters.names, parameters.values, strict=True):
        if name in SHARED_NAMES:
            continue
        unit = _UNITS.get(parameters.unit(name))
        quantity = SubElement(data, "dcc:quantity")
        _text(quantity, "name", name)
        if unit is None:
            text = f"{float(value):.12g} {parameters.unit(name)}, expanded uncertainty {K * parameters.std(name):.3g}"
            _text(quantity, "noQuantity", text)
            continue
        _real(quantity, float(value), unit, K * parameters.std(name))


# --- elements ------------------------------------------------------------------------------------------------------


def _real(quantity: Element, value: float, unit: str, expanded: float) -> None:
    real = SubElement(quantity, "si:real")
    SubElement(real, "si:value").text = f"{value:.12g}"
    SubElement(real, "si:unit").text = unit
    if expanded > 0.0 and math.isfinite(expanded):
        stated = SubElement(SubElement(real, "si:measurementUncertaintyUnivariate"), "si:expandedMU")
        SubElement(stated, "si:valueExpandedMU").text = f"{expanded:.4g}"
        SubElement(stated, "si:coverageFactor").text = f"{K:g}"
        SubElement(stated, "si:coverageProbability").text = COVERAGE
        SubElement(stated, "si:distribution").text = "normal"


def _list_quantity(parent: Element, name: str, values: Iterable[float], unit: str) -> None:
    quantity = SubElement(parent, "dcc:quantity")
    _text(quantity, "name", name)
    listed = SubElement(quantity, "si:realListXMLList")
    SubElement(listed, "si:valueXMLList").text = " ".join(f"{value:.6g}" for value in values)
    SubElement(listed, "si:unitXMLList").text = unit


def _software(parent: Element, software: dict[str, str]) -> None:
    one = SubElement(parent, "dcc:software")
    _text(one, "name", software["name"])
    _leaf(one, "release", software["version"])


def _contact(contact: Element, name: str | None, address: str | None, country: str | None) -> None:
    """A contact needs a place: what was stated of it, or that nothing was."""
    _text(contact, "name", name or NOT_STATED)
    location = SubElement(contact, "dcc:location")
    if country is not None:
        _leaf(location, "countryCode", country)
    if address is not None or country is None:
        _text(location, "further", address or NOT_STATED)


def _identifications(parent: Element, rows: Sequence[tuple[str, str, str]]) -> None:
    listed = SubElement(parent, "dcc:identifications")
    for issuer, value, name in rows:
        one = SubElement(listed, "dcc:identification")
        _leaf(one, "issuer", issuer)
        _leaf(one, "value", value)
        _text(one, "name", name)


def _text(parent: Element, name: str, text: str) -> None:
    """Words with their language."""
    SubElement(SubElement(parent, f"dcc:{name}"), "dcc:content", {"lang": LANGUAGE}).text = _plain(text)


def _leaf(parent: Element, name: str, text: str) -> None:
    SubElement(parent, f"dcc:{name}").text = _plain(text)


def _plain(text: str) -> str:
    """Without what XML 1.0 cannot hold, and without the blanks around it that the schema refuses."""
    return " ".join("".join(c if c.isprintable() or c.isspace() else "\ufffd" for c in text).split()) or NOT_STATED
