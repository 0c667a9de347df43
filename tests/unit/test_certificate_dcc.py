"""The digital calibration certificate has the elements of PTB's DCC 3.3.0 and D-SI 2.2.1 in their order, and the
figures of the record; the printed one bears its code, its logo and the words by which it is verified."""

from __future__ import annotations

import base64
import math
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import highside
from highside.calibration.method import SolveRequest
from highside.calibration.record import CalibrationRecord, Environment, build_record, solve_poses
from highside.calibration.signature import new_key
from highside.config.certificate import CertificateFields, load_certificate_fields
from highside.errors import InputError
from highside.physics.gravity import gravity_direction
from highside.report.certificate_budget import budget_at
from highside.words import in_language

DCC, SI = "{https://ptb.de/dcc}", "{https://ptb.de/si}"

TEXT = "content+"
RICH = "name? content*"
QUANTITY = "noQuantity|si:real|si:realListXMLList"
ORDER: dict[str, str] = {
    "digitalCalibrationCertificate": "administrativeData measurementResults comment? document?",
    "administrativeData": "dccSoftware coreData items calibrationLaboratory respPersons customer statements?",
    "dccSoftware": "software+",
    "usedSoftware": "software+",
    "software": "name release type? description?",
    "coreData": "countryCodeISO3166_1 usedLangCodeISO639_1+ mandatoryLangCodeISO639_1+ uniqueIdentifier"
    " identifications? receiptDate? beginPerformanceDate endPerformanceDate performanceLocation issueDate?"
    " reportAmendedSubstituted? previousReport?",
    "identifications": "identification+",
    "identification": "issuer value name?",
    "items": "name? equipmentClass* description? owner? manufacturer? identifications? item+",
    "item": "name equipmentClass* description? owner? installedSoftwares? manufacturer? model? identifications"
    " itemQuantities? subItems?",
    "calibrationLaboratory": "calibrationLaboratoryCode? contact cryptElectronicSeal?",
    "respPersons": "respPerson+",
    "respPerson": "person description? role? mainSigner? cryptElectronicSeal?",
    "contact": "name eMail? phone? fax? link? location descriptionData?",
    "customer": "name eMail? phone? fax? link? location descriptionData?",
    "person": "name eMail? phone? fax? link? location? descriptionData?",
    "manufacturer": "name eMail? phone? fax? link? location? descriptionData?",
    "statements": "statement+",
    "statement": "name? description? norm* reference* link* declaration? valid? date?",
    "measurementResults": "usedMethods? usedSoftware? measuringEquipments? influenceConditions? measurementResult+",
    "measurementResult": "name description? usedMethods? usedSoftware? measuringEquipments? influenceConditions?"
    " results measurementMetaData?",
    "usedMethods": "usedMethod+",
    "usedMethod": "name description? norm* reference* link*",
    "measuringEquipments": "name? equipmentClass* description? owner? identifications? measuringEquipment+",
    "measuringEquipment": "name equipmentClass* description? certificate? manufacturer? model? identifications?",
    "influenceConditions": "influenceCondition+",
    "influenceCondition": "name description? status? certificate? data",
    "results": "result+",
    "result": "name description? data",
    "list": "name? description? quantity+",
    "quantity": f"name? description? ({QUANTITY})",
    "document": "name? description? fileName mimeType dataBase64",
    "si:real": "si:label? si:quantityType? si:value si:unit si:measurementUncertaintyUnivariate?",
    "si:measurementUncertaintyUnivariate": "si:expandedMU",
    "si:expandedMU": "si:valueExpandedMU si:coverageFactor si:coverageProbability si:distribution?",
    "si:realListXMLList": "si:labelXMLList? si:valueXMLList si:unitXMLList",
    "name": TEXT, "noQuantity": RICH, "description": RICH, "declaration": RICH, "further": RICH,
}  # fmt: skip
"""What stands in an element, in which order, as the schema has it: ? at most once, * any number, + at least one"""
PATTERNS = {
    "countryCodeISO3166_1": "[A-Z]{2}", "countryCode": "[A-Z]{2}", "usedLangCodeISO639_1": "[a-z]{2}",
    "mandatoryLangCodeISO639_1": "[a-z]{2}", "beginPerformanceDate": r"\d{4}-\d\d-\d\d",
    "endPerformanceDate": r"\d{4}-\d\d-\d\d", "issueDate": r"\d{4}-\d\d-\d\d", "mainSigner": "true|false",
    "issuer": "manufacturer|calibrationLaboratory|customer|owner|other",
    "performanceLocation": "laboratory|customer|laboratoryBranch|customerBranch|other",
    "si:value": r"[-+]?\d[-+.e\d]*", "si:unit": r"(\\[a-z]+)+", "si:unitXMLList": r"(\\[a-z]+)+",
    "si:valueXMLList": r"[-+]?\d[-+.e\d]*( [-+]?\d[-+.e\d]*)*", "si:coverageProbability": r"0\.95",
}  # fmt: skip


def called(element: ElementTree.Element) -> str:
    return element.tag.replace(DCC, "").replace(SI, "si:")


def mistakes(element: ElementTree.Element) -> list[str]:
    """What the schema would refuse, by the tables above."""
    name, children = called(element), [called(child) for child in element]
    found = [line for child in element for line in mistakes(child)]
    if name == "data":
        bad = [child for child in children if child not in ("quantity", "list", "text")]
        return found + ([f"data holds {bad}"] if bad or not children else [])
    if name == "location":
        bad = [child for child in children if child not in ("countryCode", "further")]
        return found + ([f"location holds {bad}"] if bad or not children else [])
    if children:
        if name not in ORDER:
            return [*found, f"{name} is not known"]
        pattern = re.sub(r"([A-Za-z:_0-9]+)", r"(?:\1 )", ORDER[name]).replace(") (", ")(").replace(" ", "")
        pattern = re.sub(r"\(\?:([^)]*)\)", r"(?:\1,)", pattern)
        if not re.fullmatch(pattern, "".join(f"{child}," for child in children)):
            found.append(f"{name} holds {children}")
    else:
        wanted = PATTERNS.get(name, r"\S+(\s+\S+)*")
        if not re.fullmatch(wanted, element.text or ""):
            found.append(f"{name} is {element.text!r}")
    return found


def record(seed: int = 1) -> CalibrationRecord:
    rng = np.random.default_rng(seed)
    inc, tf = np.repeat((10.0, 45.0, 80.0), 8), np.tile(np.arange(0.0, 360.0, 45.0), 3)
    matrix = np.eye(3) + 2e-3 * rng.standard_normal((3, 3))
    read = matrix @ gravity_direction(np.deg2rad(inc), np.deg2rad(tf)) + 1e-5 * rng.standard_normal((3, inc.size))
    table = {"inc_ref_deg": inc.tolist(), "tf_ref_deg": tf.tolist(), "n": [100.0] * inc.size}
    table |= {name: row.tolist() for name, row in zip(("ax", "ay", "az"), read, strict=True)}
    request = SolveRequest("joint")
    result = solve_poses(table, request).result
    return build_record(
        tool_id="tool <7> & \x07", serial="42", request=request, result=result, pose_columns=table,
        raw_sha256="0" * 64, raw_name="poses.csv", environment=Environment("bench 1", "A. Operator", 25.0),
        now_s=1.79e9, expires_s=None,
    )  # fmt: skip


FULL = load_certificate_fields(Path(__file__).parents[2] / "config" / "certificate.toml")
LEAST = CertificateFields.model_validate({"issue": {"country": "DE"}})


@pytest.mark.parametrize("fields", [FULL, LEAST], ids=["all fields", "none but the country"])
@pytest.mark.parametrize("signed", [True, False])
def test_it_has_the_elements_of_the_schema_in_their_order(fields: CertificateFields, signed: bool) -> None:
    made = record().signed(new_key("A. Laboratory"), now_s=1.79e9) if signed else record()
    root = ElementTree.fromstring(highside.certify(made, fields).dcc())
    assert root.get("schemaVersion") == "3.3.0" and mistakes(root) == []
    values = [element.text for element in root.iter(f"{DCC}value")]
    assert made.id in values and (made.signature is None or made.signature.key in values)


def test_the_table_of_the_schema_refuses_what_is_out_of_order() -> None:
    root = ElementTree.fromstring(highside.certify(record(), FULL).dcc())
    core = root.find(f"{DCC}administrativeData/{DCC}coreData")
    assert core is not None
    core[:] = [core[1], core[0], *core[2:]]
    real = next(root.iter(f"{SI}real"))
    real.remove(real[0])
    assert len(mistakes(root)) == 2


def test_its_figures_are_those_of_the_record() -> None:
    made = record()
    root = ElementTree.fromstring(highside.certify(made, FULL).dcc())
    parameters = made.result.zones[0].parameters
    read = {}
    for quantity in root.iter(f"{DCC}quantity"):
        real, name = quantity.find(f"{SI}real"), quantity.findtext(f"{DCC}name/{DCC}content")
        if real is not None and name is not None:
            band = real.findtext(f"{SI}measurementUncertaintyUnivariate/{SI}expandedMU/{SI}valueExpandedMU")
            read[name] = (float(real.findtext(f"{SI}value") or "nan"), float(band or "nan"))
    for name in ("b_x", "b_y", "b_z"):
        k = parameters.names.index(name)
        assert math.isclose(read[name][0], parameters.values[k], rel_tol=1e-10)
        assert math.isclose(read[name][1], 2.0 * parameters.std(name), rel_tol=1e-3)
    columns = [
        [float(word) for word in (listed.findtext(f"{SI}valueXMLList") or "").split()]
        for listed in root.iter(f"{SI}realListXMLList")
    ][-3:]
    for inc, u_inc, u_tf in zip(*columns, strict=True):
        budget = budget_at(made, FULL, inc)
        assert budget is not None
        assert np.allclose((u_inc, u_tf), budget.expanded, rtol=1e-5)
    assert len(columns[0]) > 3


def test_a_country_is_needed_and_the_printed_one_travels_within(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="names the laboratory's country; give country"):
        highside.certify(record()).dcc()
    printed = tmp_path / "cert.html"
    made = highside.certify(record(), LEAST)
    made.save(printed)
    root = ElementTree.fromstring(made.dcc(printed))
    assert mistakes(root) == []
    assert base64.b64decode(root.findtext(f"{DCC}document/{DCC}dataBase64") or "") == printed.read_bytes()


PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)


def test_the_printed_one_bears_code_logo_and_how_it_is_verified(tmp_path: Path) -> None:
    (tmp_path / "logo.png").write_bytes(PIXEL)
    (tmp_path / "logo.svg").write_text("<svg onload='x'/>")
    file = tmp_path / "fields.toml"
    file.write_text('[issue]\nlogo = "logo.png"\n')
    html = highside.certify(record(), file).sheets().html()
    assert f"data:image/png;base64,{base64.b64encode(PIXEL).decode()}" in html
    assert html.count('class="letterhead"') == 1 and "keys verify RECORD.json" in html
    code = html.partition('<span class="code">')[2].partition("</span>")[0]
    assert code.startswith("<svg") and "tool" not in code
    file.write_text('[issue]\nlogo = "logo.svg"\n')
    with pytest.raises(InputError, match=r"issue\.logo: is neither PNG nor JPEG"):
        highside.certify(record(), file).sheets()


def test_the_code_says_record_and_key_or_the_laboratory_s_address() -> None:
    from highside.report.certificate_inputs import Inputs
    from highside.report.certificate_marks import verification

    made = record().signed(new_key("A. Laboratory"), now_s=1.79e9)
    assert made.signature is not None
    said = verification(Inputs(made, LEAST, ""), "N-1").split("\n")
    assert said[0] == "Calibration certificate N-1" and f"record SHA-256 {made.id}" in said
    assert said[1] == "tool tool <7> & \\x07"
    assert said[-1] == f"signed ed25519 {made.signature.key}"
    with in_language("de"):
        assert verification(Inputs(made, LEAST, ""), "N-1").split("\n")[2] == f"Datensatz SHA-256 {made.id}"
    where = CertificateFields.model_validate({"issue": {"verify_url": "https://lab.example/c/"}})
    assert verification(Inputs(made, where, ""), "N-1") == f"https://lab.example/c/{made.id}"


def test_the_verdicts_are_said_in_the_language_of_the_terminal() -> None:
    made = highside.certify(record(), FULL)
    with in_language("de"):
        found, *_ = made.verdicts
    assert found.startswith("Ausgangszustand: ") and "within the limits" not in found, found
