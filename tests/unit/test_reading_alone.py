"""Parsers of what comes from outside are called in `highside.reading` alone, where their limits are."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

WITH_LIMITS = "reading"
"""the package that may"""
FORBIDDEN = {
    "json": {"load", "loads", "JSONDecoder"},
    "tomllib": {"*"},
    "tomli": {"*"},
    "csv": {"reader", "DictReader"},
    "gzip": {"open", "decompress", "GzipFile"},
    "bz2": {"*"},
    "lzma": {"*"},
    "zipfile": {"*"},
    "tarfile": {"*"},
    "zlib": {"decompress", "decompressobj"},
    "numpy": {"load", "loadtxt", "genfromtxt", "fromfile"},
    "pickle": {"*"},
    "marshal": {"*"},
    "shelve": {"*"},
    "yaml": {"*"},
    "configparser": {"*"},
    "xml": {"*"},
    "openpyxl": {"*"},
    "h5py": {"*"},
    "pyulog": {"*"},
    "rosbags": {"*"},
    "pydantic_core": {"from_json"},
    "builtins": {"eval", "exec"},
    "ast": {"literal_eval"},
}
FORBIDDEN_METHODS = {"model_validate_json", "validate_json", "model_validate_strings", "parse_raw", "add_dbc_string"}
"""of pydantic's models and adapters, which parse JSON themselves"""
WRITING = {("xml.etree.ElementTree", name) for name in ("Element", "SubElement", "tostring")}
"""what makes a document and reads none"""
FOREIGN = ("openpyxl", "h5py", "pyulog", "rosbags")
"""readers of other programs' files: within `importing/forms`, which hold sizes against the limits"""
MAY = {("codec/can_dbc.py", "add_dbc_string"), ("service/payload.py", "exec"), ("fleet/spread.py", "pickle")}
"""behind `check_dbc`; of a text made of the fields of our own models when the module is imported; of tasks that a
diagnosis gives to the processes of its own cluster, to which dask sends them so as well, in a folder of mode 0700"""


def violations(source: str, name: str = "") -> list[str]:
    """What a module uses that it must not, as `line: module.function`."""
    tree = ast.parse(source)
    modules, names = dict(_imported(tree)), dict(_imported_names(tree))
    out = []
    for node in ast.walk(tree):
        line = getattr(node, "lineno", 0)
        if isinstance(node, ast.Import | ast.ImportFrom):
            writes = isinstance(node, ast.ImportFrom) and {(node.module, a.name) for a in node.names} <= WRITING
            roots = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""][writes:]
            roots = [root for root in roots if not (root.startswith(FOREIGN) and name.startswith("importing/forms/"))]
            out += [
                f"{line}: {root}"
                for root in roots
                if FORBIDDEN.get(root.split(".")[0]) == {"*"} and (name, root) not in MAY
            ]
        called = node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else ""
        if called in FORBIDDEN["builtins"] and (name, called) not in MAY:
            out.append(f"{line}: {called}")
        if isinstance(node, ast.Name) and node.id in names and isinstance(node.ctx, ast.Load):
            out.append(f"{line}: {names[node.id]}")
        if isinstance(node, ast.Attribute):
            module = modules.get(node.value.id) if isinstance(node.value, ast.Name) else None
            if module is not None and node.attr in FORBIDDEN.get(module, ()) and not _writes(tree, node):
                out.append(f"{line}: {module}.{node.attr}")
            if node.attr in FORBIDDEN_METHODS and (name, node.attr) not in MAY:
                out.append(f"{line}: .{node.attr}")
    return out


def _imported(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """(name here, module)"""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.asname or alias.name.split(".")[0], alias.name.split(".")[0]) for alias in node.names)


def _imported_names(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """(name here, forbidden function)"""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 0:
            for alias in node.names:
                if alias.name in FORBIDDEN.get((node.module or "").split(".")[0], ()):
                    yield alias.asname or alias.name, f"{node.module}.{alias.name}"


def _writes(tree: ast.AST, function: ast.Attribute) -> bool:
    """Whether it is `gzip.GzipFile(..., mode="wb")`, which packs."""
    return any(
        isinstance(node, ast.Call)
        and node.func is function
        and any(
            word.arg == "mode" and isinstance(word.value, ast.Constant) and word.value.value == "wb"
            for word in node.keywords
        )
        for node in ast.walk(tree)
    )


def test_no_module_but_reading_parses_what_comes_from_outside(project_root: Path) -> None:
    package = project_root / "src" / "highside"
    found = []
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package).as_posix()
        if not name.startswith(f"{WITH_LIMITS}/"):
            found += [f"{name}:{line}" for line in violations(path.read_text(), name)]
    assert not found, f"use highside.reading: {found}"


@pytest.mark.parametrize(
    "source",
    [
        "import json\njson.loads('1')",
        "import json as j\nj.load(f)",
        "from json import loads\nloads('1')",
        "from json import loads as read\nread('1')",
        "import tomllib",
        "from tomllib import loads",
        "import csv\nfor row in csv.reader(f): pass",
        "import gzip\ngzip.open('x')",
        "import gzip\ngzip.GzipFile(fileobj=f, mode='rb')",
        "import gzip\ngzip.GzipFile(fileobj=f)",
        "import numpy as np\nnp.load('x')",
        "from pydantic_core import from_json\nfrom_json(b'')",
        "Model.model_validate_json(data)",
        "import pickle",
        "import h5py",
        "import xml.etree.ElementTree",
        "from xml.etree.ElementTree import Element, fromstring",
        "from rosbags.rosbag1 import Reader",
        "eval('1')",
        "def f():\n    import json\n    return json.loads('1')",
    ],
)
def test_the_lint_finds(source: str) -> None:
    assert violations(source)


@pytest.mark.parametrize(
    "source",
    [
        "import json\njson.dumps({})",
        "import gzip\ngzip.GzipFile(fileobj=f, mode='wb')",
        "import gzip\ntry: pass\nexcept gzip.BadGzipFile: pass",
        "import csv\ncsv.writer(f)",
        "from xml.etree.ElementTree import Element, tostring",
        "from pydantic_core import ErrorDetails",
        "Compensation.from_json(data)",
    ],
)
def test_the_lint_lets_pass(source: str) -> None:
    assert not violations(source)
