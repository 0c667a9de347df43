"""The reference of the documentation follows the code: nothing that exists is missing from it."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from pydantic import BaseModel

import highside
from highside.calibration.record import RecordError, RecordReason
from highside.calibration.remark import CalibrationRefused, Reason
from highside.cli.options import as_options
from highside.config.settings import Settings, validate
from highside.errors import AREAS, InputError, Refused
from highside.link.base import LinkError, LinkReason
from highside.reading.files import size
from highside.report.error_codes import CALIBRATION, LINK, RECORD, catalogue
from highside.service.messages import PAYLOADS, schemas


@pytest.fixture(scope="module")
def pages(project_root_of_module: Path) -> Iterator[ModuleType]:
    folder = str(project_root_of_module / "docs" / "site")
    sys.path.insert(0, folder)
    try:
        import pages as found  # type: ignore[import-not-found]

        yield found
    finally:
        sys.path.remove(folder)
        sys.modules.pop("pages", None)


@pytest.fixture(scope="module")
def project_root_of_module() -> Path:
    return Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def texts(pages: ModuleType) -> dict[str, str]:
    made = pages.pages()
    assert isinstance(made, dict)
    return made


def test_every_command_with_each_of_its_options_is_there(pages: ModuleType, texts: dict[str, str]) -> None:
    import typer

    from highside.cli.main import app

    leaves = dict(pages.leaves(typer.main.get_command(app)))
    assert len(leaves) > 40
    sections = dict(re.findall(r"^## `highside ([^`]+)`\n(.*?)(?=^## |\Z)", texts["commands.md"], re.M | re.S))
    assert sections.keys() == leaves.keys()
    for name, command in leaves.items():
        for parameter in command.params:
            if parameter.param_type_name == "option" and not parameter.hidden and parameter.name != "help":
                assert f"`{parameter.opts[0]}`" in sections[name], (name, parameter.opts)


def fields(model: type[BaseModel], pages: ModuleType) -> Iterator[tuple[str, Any]]:
    for name, info in model.model_fields.items():
        parts = pages.models_in(info.annotation)
        if not parts:
            yield name, info
        for part in parts:
            yield from fields(part, pages)


def test_every_field_of_the_service_is_there_with_its_default_and_what_it_says(
    pages: ModuleType, texts: dict[str, str]
) -> None:
    page = texts["configuration.md"]
    listed = list(fields(Settings, pages))
    assert len(listed) > 120
    for name, info in listed:
        line = f"| `{name}` | {pages.cell(pages.kind_of(info))} | {pages.cell(pages.default_of(info))} |"
        assert f"{line} {pages.cell(info.description or '')} |" in page
    assert "| `port` | whole number, ≥ 1, ≤ 65535 | `1883` |" in page


def references(node: object) -> Iterator[str]:
    if isinstance(node, dict):
        for key, value in node.items():
            if key == "$ref":
                yield value
            else:
                yield from references(value)
    elif isinstance(node, list):
        for value in node:
            yield from references(value)


def test_the_asyncapi_document_names_every_topic_and_every_reference_leads_somewhere(pages: ModuleType) -> None:
    """Its structure; the document was held against the JSON Schema of AsyncAPI 3.0.0 when it was made."""
    document = pages.document()
    assert document["asyncapi"] == "3.0.0" and {"title", "version"} <= document["info"].keys()
    addresses = {channel["address"].removeprefix("{prefix}/{tool}/") for channel in document["channels"].values()}
    assert addresses >= PAYLOADS.keys() | schemas().keys()
    assert addresses >= {"session/state", "session/command", "session/reply", "session/status"}
    seen = list(references(document))
    assert len(seen) > 40
    for reference in seen:
        place: Any = document
        for part in reference.removeprefix("#/").split("/"):
            place = place[part]
    for name, operation in document["operations"].items():
        assert operation["action"] == ("receive" if name.startswith("receive_") else "send")
        assert name.endswith("command") == (operation["action"] == "receive")
    attitude = document["components"]["schemas"]["AttitudeMessage"]
    assert attitude["properties"].keys() == PAYLOADS["attitude"].model_fields.keys()


def test_topics_that_the_service_uses_are_in_the_document(pages: ModuleType, project_root: Path) -> None:
    sources = project_root / "src" / "highside"
    text = (sources / "service" / "app.py").read_text()
    used = set(re.findall(r"(?:_topic|_states|topic)\(\"([\w/]+)\"\)", text))
    used |= {f"{name}/reply" for name in re.findall(r"_replies\(\"(\w+)\"\)", text)}
    used |= {
        name for name in PAYLOADS if f'retained("{name}")' in (sources / "service" / "watch_keeper.py").read_text()
    }
    assert {
        "attitude",
        "health",
        "watch",
        "watch/history",
        "watch/command",
        "watch/reply",
        "drift",
        "drift/command",
    } <= used
    addresses = {
        channel["address"].removeprefix("{prefix}/{tool}/") for channel in pages.document()["channels"].values()
    }
    assert used <= addresses


def test_every_code_that_can_be_raised_is_on_the_page_with_cause_and_remedy(
    pages: ModuleType, texts: dict[str, str]
) -> None:
    assert RECORD.keys() == set(RecordReason) and CALIBRATION.keys() == set(Reason) and LINK.keys() == set(LinkReason)
    listed = {one.code: one for one in catalogue()}
    raised = {f"{kind}.{area}" for kind, area, *_ in pages.messages()}
    assert len(raised) > 20
    assert raised <= listed.keys(), "a package raises errors and has no entry in errors.AREAS"
    raised |= {f"record.{reason.value}" for reason in RecordReason}
    raised |= {f"calibration.{reason.value}" for reason in Reason} | {f"link.{reason.value}" for reason in LinkReason}
    for code in raised:
        one = listed[code]
        assert one.cause and one.remedy
        assert f"| `{code}` | {one.exit_status} |" in texts["errors.md"]


def test_every_message_is_on_the_page(texts: dict[str, str]) -> None:
    assert "| no such file |" in texts["errors.md"]
    assert "| cannot be read by this user | check its permissions |" in texts["errors.md"]
    assert len(re.findall(r"^\| .* \| .* \|$", texts["errors.md"], re.M)) > 450


def test_an_error_carries_the_code_of_who_made_it() -> None:
    with pytest.raises(InputError) as reading:
        size("many")
    assert reading.value.code == "input.reading"
    with pytest.raises(InputError) as config:
        validate({"link": {"kind": "simulated"}}, where="x.toml", environment=False)
    assert config.value.code == "input.config"
    with pytest.raises(InputError) as named, as_options("max_bytes"):
        size("many")
    assert named.value.code == "input.reading"
    assert RecordError(RecordReason.EXPIRED, "over").code == "record.expired"
    assert CalibrationRefused(Reason.SINGULAR, "no").code == "calibration.singular"
    assert LinkError(LinkReason.BUSY, "open elsewhere").code == "link.busy"
    assert (InputError("x").code, Refused("x").code) == ("input.outside", "refused.outside")
    assert set(AREAS) >= {"reading", "config", "outside"}


def test_every_name_of_the_api_is_on_its_page(texts: dict[str, str]) -> None:
    assert set(re.findall(r"^::: highside\.(\w+)$", texts["python.md"], re.M)) == set(highside.__all__) - {
        "__version__"
    }
