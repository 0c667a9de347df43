"""The reference pages of the documentation, made of the code: commands, configuration, topics, effects, errors, API.

Nothing of them is written by hand; `build.py` puts them beside the pages that are.
"""

from __future__ import annotations

import ast
import enum
import json
import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

import highside
from highside.bench.mqtt import SESSION_TOPICS
from highside.bench.session.reasons import Fault, Refusal, Rejection
from highside.cli.examples import EXAMPLES
from highside.cli.main import app
from highside.config.bench import BenchFile
from highside.config.certificate import CertificateFields
from highside.config.model import Model
from highside.config.settings import Settings
from highside.physics.effects_page import markdown as effects_markdown
from highside.report.error_codes import catalogue
from highside.service.alarms import ALARMS
from highside.service.rig.surveys import REASON_TEXTS
from highside.service.topics import SERVICE_TOPICS, asyncapi

SOURCES = Path(highside.__file__).parent
MADE = "*Made from the code of highside {version}; not written by hand.*"


def pages() -> dict[str, str]:
    """Text of every file of the reference by its name."""
    makers: dict[str, Callable[[], str]] = {
        "commands.md": commands,
        "configuration.md": configuration,
        "topics.md": topics,
        "asyncapi.json": lambda: json.dumps(document(), indent=2) + "\n",
        "effects.md": effects_markdown,
        "errors.md": errors,
        "python.md": python,
    }
    return {name: make() for name, make in makers.items()}


def cell(text: object) -> str:
    """As one cell of a table."""
    return " ".join(str(text).split()).replace("|", "\\|").replace("<", "&lt;")


def table(header: tuple[str, ...], rows: list[tuple[object, ...]]) -> list[str]:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return [*lines, *("| " + " | ".join(cell(value) for value in row) + " |" for row in rows), ""]


def top(title: str, *words: str) -> list[str]:
    return [f"# {title}", "", MADE.format(version=highside.__version__), "", *words, ""]


# commands


def leaves(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Every command that does something, with its words."""
    below = getattr(command, "commands", {})
    if path and (not below or command.invoke_without_command):
        yield " ".join(path), command
    for word, one in below.items():
        yield from leaves(one, (*path, word))


def commands() -> str:
    lines = top(
        "Commands",
        "What each prints with `--help`, with an example. Exit status: 0 done; 1 done, and the answer is bad news that",
        "scripts must see; 2 wrong usage or input, in one line; 70 a defect of highside.",
    )
    root = typer.main.get_command(app)
    lines += ["## Options of all commands", "", *_options(root), ""]
    for name, command in leaves(root):
        lines += [f"## `highside {name}`", "", " ".join((command.help or "").split()), ""]
        if name in EXAMPLES:
            lines += [f"```sh\nhighside {name} {EXAMPLES[name]}".rstrip() + "\n```", ""]
        lines += _options(command)
    return "\n".join(lines)


def _options(command: Any) -> list[str]:
    rows: list[tuple[object, ...]] = []
    for parameter in command.params:
        if parameter.hidden or parameter.name == "help":
            continue
        kind = parameter.type_descriptor.annotation
        choices = isinstance(kind, type) and issubclass(kind, enum.Enum)
        if parameter.param_type_name == "argument":
            name = f"`{parameter.metavar or parameter.name.upper()}`"
        else:
            name = " ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
        if choices:
            name += ": " + ", ".join(f"`{one.value}`" for one in kind)
        default = parameter.default.value if isinstance(parameter.default, enum.Enum) else parameter.default
        said = "required" if parameter.required else "" if default in (None, False, ()) else f"`{default}`"
        rows.append((name, parameter.help or "", said))
    return table(("option", "what", "default"), rows) if rows else []


# configuration


def configuration() -> str:
    lines = top(
        "Configuration",
        "Every table and field of the TOML files, with what is allowed and the default. Units stand in the names: `_s`",
        "seconds, `_deg` degrees, `_g` the local g, `_hz` per second, `_c` degrees Celsius. A field that is not named",
        "here is refused. `highside check FILE` names every mistake; `--set table.field=value` and the environment",
        "(`HIGHSIDE__TABLE__FIELD`) override the service's and the bench's file.",
    )
    seen: dict[str, str] = {}
    for title, what, model in (
        ("The service", "`highside run --config FILE`", Settings),
        ("A bench session", "`highside calibrate bench --config FILE`", BenchFile),
        ("A model", "`highside simulate MODEL`, `highside diagnose --model MODEL`", Model),
        ("Fields of a certificate", "`highside calibrate certificate --fields FILE`", CertificateFields),
    ):
        lines += [f"## {title}", "", f"For {what}.", ""]
        lines += _tables(model, "", title, seen)
    return "\n".join(lines)


def models_in(annotation: Any) -> list[type[BaseModel]]:
    """The models that a field may hold."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in models_in(part)]


def _tables(model: type[BaseModel], path: str, whole: str, seen: dict[str, str], kind: str = "") -> list[str]:
    """The section of a table, and those of the tables below it; one that an earlier file has too is named only."""
    place = f"[{path}] {kind} {model.__qualname__}"
    if (first := seen.setdefault(place, whole)) != whole:
        return [f"`[{path}]`{f' {kind}' if kind else ''}: as for {first.lower()}.", ""]
    fields = {info.alias or name: info for name, info in model.model_fields.items()}
    plain = {name: info for name, info in fields.items() if not models_in(info.annotation)}
    lines: list[str] = []
    if path:
        lines += [f"### `[{path}]`{f' {kind}' if kind else ''}", ""]
        lines += [" ".join((model.__doc__ or "").split()), ""]
    if plain:
        rows: list[tuple[object, ...]] = [
            (f"`{name}`", kind_of(info), default_of(info), info.description or "") for name, info in plain.items()
        ]
        lines += table(("field", "allowed", "default", "what"), rows)
    for name, info in fields.items():
        found = models_in(info.annotation)
        for part in found:
            tag = _tag(part) if len(found) > 1 else ""
            lines += _tables(part, f"{path}.{name}" if path else name, whole, seen, tag)
    return lines


def _tag(model: type[BaseModel]) -> str:
    for name in ("kind", "name"):
        if name in model.model_fields and get_origin(model.model_fields[name].annotation) is Literal:
            return f'{name} = "{get_args(model.model_fields[name].annotation)[0]}"'
    return model.__name__


def kind_of(info: FieldInfo) -> str:
    """Type and limits in words."""
    limits = [shown for one in info.metadata if (shown := _limit(one))]
    return ", ".join([_type(info.annotation), *limits])


def _limit(limit: Any) -> str:
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤", "min_length": "length ≥", "max_length": "length ≤"}
    reported = [
        f"{sign} {getattr(limit, name)}" for name, sign in signs.items() if getattr(limit, name, None) is not None
    ]
    if getattr(limit, "pattern", None):
        reported.append(f"`{limit.pattern}`")
    return ", ".join(reported)


def _type(annotation: Any) -> str:
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return " or ".join(f"`{json.dumps(part)}`" for part in parts)
    if origin is Annotated:
        return ", ".join([_type(parts[0]), *(shown for one in parts[1:] for shown in [_limit_of(one)] if shown)])
    if origin in (Union, UnionType):
        return " or ".join(_type(part) for part in parts if part is not type(None))
    if origin in (tuple, list):
        return f"list of {_type(parts[0])}"
    if origin is dict:
        return f"table of {_type(parts[1])}"
    names = {"str": "text", "int": "whole number", "float": "number", "bool": "`true` or `false`", "Path": "file"}
    name = getattr(annotation, "__name__", str(annotation))
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return " or ".join(f'`"{member.value}"`' for member in annotation)
    return names.get(name, name)


def _limit_of(one: Any) -> str:
    return ", ".join(filter(None, map(_limit, one.metadata))) if isinstance(one, FieldInfo) else _limit(one)


def default_of(info: FieldInfo) -> str:
    if info.is_required():
        return "required"
    if info.default is PydanticUndefined:
        return "made"
    value = info.default
    if value is None:
        return "absent"
    plain = list(value) if isinstance(value, tuple) else value.value if isinstance(value, enum.Enum) else value
    return f"`{json.dumps(plain, default=str)}`"


# topics


def document() -> dict[str, Any]:
    return asyncapi((*SERVICE_TOPICS, *SESSION_TOPICS))


def topics() -> str:
    lines = top(
        "MQTT topics",
        "All below `<prefix>/<tool>/` (`mqtt.prefix`, `tool.id`). As an AsyncAPI 3 document, for generators and",
        "viewers: [asyncapi.json](asyncapi.json), or `highside schema --asyncapi`.",
    )
    reported = (*SERVICE_TOPICS, *SESSION_TOPICS)
    rows: list[tuple[object, ...]] = [
        (f"[`{topic.name}`](#{topic.key})", "to the tool" if topic.to_us else "from the tool",
         "yes" if topic.retained else "no", topic.qos, topic.says)
        for topic in reported
    ]  # fmt: skip
    lines += table(("topic", "direction", "retained", "QoS", "what"), rows)
    schemas = document()["components"]["schemas"]
    for topic in reported:
        lines += [f"## `{topic.name}` {{ #{topic.key} }}", "", topic.says, ""]
        if isinstance(topic.payload, str):
            lines += [f"Plain text: `{topic.payload}`", ""]
        else:
            lines += _members(schemas[topic.payload.__name__])
    lines += ["## Parts of these messages", ""]
    roots = {topic.payload.__name__ for topic in reported if not isinstance(topic.payload, str)}
    for name, schema in sorted(schemas.items()):
        if name not in roots:
            lines += [f"### {name} {{ #{name.lower()} }}", "", " ".join(schema.get("description", "").split()), ""]
            lines += _members(schema)
    return "\n".join(lines)


def _members(schema: dict[str, Any]) -> list[str]:
    if "enum" in schema:
        return ["One of " + ", ".join(f"`{value}`" for value in schema["enum"]) + ".", ""]
    rows: list[tuple[object, ...]] = [
        (f"`{name}`", _json_type(one), one.get("description", "")) for name, one in schema.get("properties", {}).items()
    ]
    lines = ["| member | type | what |", "|---|---|---|"]
    return [*lines, *(f"| {name} | {kind} | {cell(what)} |" for name, kind, what in rows), ""]


def _json_type(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[-1]
        return f"[{name}](#{name.lower()})"
    for word in ("anyOf", "oneOf", "allOf"):
        if word in schema:
            return " or ".join(dict.fromkeys(_json_type(part) for part in schema[word]))
    if "enum" in schema or "const" in schema:
        return ", ".join(f"`{value}`" for value in schema.get("enum", [schema.get("const")]))
    if schema.get("type") == "array":
        return f"list of {_json_type(schema.get('items', {}))}"
    limits = [f"{sign} {schema[name]}" for name, sign in (("minimum", "≥"), ("maximum", "≤")) if name in schema]
    return " ".join([schema.get("type", "any"), *limits])


# errors


def errors() -> str:
    lines = top(
        "Errors and alarms",
        "An error is one line, `highside: FILE: FIELD: what is wrong; what to do`, and an exit status. In Python it is",
        "an exception with a `code` that does not change with the wording. To find one, search for its words.",
    )
    lines += ["## Exit status", ""]
    lines += table(("status", "what it means", "what to do"), [
        (0, "done", "nothing"),
        (1, "the input was read, and the answer is bad news: a record refused, a limit not held, `bad_data`",
         "the message, or the JSON that was written, says why"),
        (2, "wrong usage or input; nothing was half written", "correct what the line names"),
        (70, "a defect of highside", "`HIGHSIDE_DEBUG=1` shows where; report it"),
        (130, "interrupted by Ctrl-C", "nothing"),
    ])  # fmt: skip
    reported = sorted(messages())
    raised = {(kind, area) for kind, area, *_ in reported}
    codes = [one for one in catalogue() if one.code.count(".") != 1 or _is_raised(one.code, raised)]
    lines += ["## Codes", ""]
    lines += table(
        ("code", "exit status", "cause", "what to do"),
        [(f"`{one.code}`", one.exit_status, one.cause, one.remedy) for one in codes],
    )
    for title, words in _FURTHER:
        lines += [f"## {title}", "", *words()]
    lines += ["## Every message", "", "As they stand in the sources; `{...}` is filled in.", ""]
    for code in sorted({f"{kind}.{area}" for kind, area in raised}):
        rows: list[tuple[object, ...]] = [
            (what, remedy or next(one.remedy for one in codes if one.code == code))
            for kind, area, what, remedy in reported
            if f"{kind}.{area}" == code and not re.fullmatch(r"\{[^{}]*\}", what)  # handed on from below
        ]
        lines += [f"### `{code}`", "", *table(("message", "what to do"), list(dict.fromkeys(rows)))]
    return "\n".join(lines)


def _is_raised(code: str, raised: set[tuple[str, str]]) -> bool:
    kind, area = code.split(".")
    return kind not in ("input", "refused") or area == "outside" or (kind, area) in raised


def _alarms() -> list[str]:
    rows: list[tuple[object, ...]] = []
    for name, text in ALARMS.items():
        rows.append((f"`{name}`", text))
    return table(("alarm", "cause, and what to do"), rows)


def _said(*kinds: type[enum.Enum]) -> list[str]:
    rows = [(f"`{one.value}`", one.text) for kind in kinds for one in kind]  # type: ignore[attr-defined]
    return table(("code", "cause, and what to do"), list(dict.fromkeys(rows)))


_FURTHER: tuple[tuple[str, Callable[[], list[str]]], ...] = (
    ("Alarms of the service", lambda: ["In `alarms` of [`health`](topics.md#health).", "", *_alarms()]),
    ("Why a survey is refused", lambda: ["In `reasons` of [`survey`](topics.md#survey).", "", *table(
        ("code", "cause"), [(f"`{reason.value}`", text) for reason, text in REASON_TEXTS.items()])]),
    ("Why a pose is not taken", lambda: _said(Rejection)),
    ("Why a command to a session is refused", lambda: _said(Refusal)),
    ("What is wrong at the bench now", lambda: _said(Fault)),
)  # fmt: skip

KINDS = {"InputError": "input", "KeyLockedError": "input", "Refused": "refused"}


@cache
def messages() -> list[tuple[str, str, str, str]]:
    """Kind, part, message and remedy of every place in the sources that makes an error."""
    found: list[tuple[str, str, str, str]] = []
    for path in sorted(SOURCES.rglob("*.py")):
        parts = path.relative_to(SOURCES).parts
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in KINDS and node.args:
                remedy = next((one.value for one in node.keywords if one.arg == "remedy"), None)
                reported = _words(remedy) if remedy is not None else ""
                found.append((KINDS[node.func.id], parts[0].removesuffix(".py"), _words(node.args[0]), reported))
    return found


def _words(node: ast.expr) -> str:
    """A text as it stands in the sources; what is computed stands in braces."""
    if isinstance(node, ast.Constant):
        return "" if node.value is None else str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_words(part) for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _words(node.left) + _words(node.right)
    if isinstance(node, ast.IfExp):
        return f"{_words(node.body)} / {_words(node.orelse)}"
    name = ast.unparse(node.value if isinstance(node, ast.FormattedValue) else node)
    plain = re.fullmatch(r"[\w.]+", name)
    return f"{{{name.rsplit('.', 1)[-1]}}}" if plain else "{...}"


# the public API


def python() -> str:
    lines = top("Python API", "Every name of `import highside`. With examples: [From a program](../api.md).")
    for name in sorted(set(highside.__all__) - {"__version__"}):
        lines += [f"::: highside.{name}", ""]
    return "\n".join(lines)
