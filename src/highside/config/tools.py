"""Several tools in one file: `[[tools]]`, each with what is its own; what stands beside them holds for all.

    [codec]                       # of all tools
    name = "vn100"
    [service]
    state_dir = "state"           # state/HS-1, state/HS-2

    [[tools]]
    id = "HS-1"
    link = { kind = "serial", port = "/dev/ttyUSB0" }

    [[tools]]
    id = "HS-2"
    link = { kind = "serial", port = "/dev/ttyUSB1" }
    calibration = { record = "hs2.json" }

An entry has the tables of a file with one tool, and its `id`. A table that both have is merged, the entry's fields
first; one of another kind (`link.kind`, `codec.name`) replaces the common one.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from highside.config.settings import Settings, anchor_paths, load, parse_overrides, validate
from highside.errors import InputError
from highside.reading import read_toml

__all__ = ["chosen_tools", "has_tools", "load_tool", "load_tools", "one_tool", "tool_ids"]

ENTRIES = "tools"
MOST = 1000
"""Entries of one file: a process is done with a fraction of them, and a slip of a generator is found early"""
_KINDS = {"link": "kind", "codec": "name"}
"""Tables whose other fields depend on one of them."""


def has_tools(path: Path) -> bool:
    """Whether a file is one of several tools. Raises InputError."""
    return ENTRIES in read_toml(path)


def tool_ids(path: Path) -> tuple[str, ...]:
    """The ids, in the order of the file. Raises InputError: no file of tools, an id that is missing or given twice."""
    return tuple(_entries(read_toml(path), path))


def load_tool(path: Path, overrides: Sequence[str] | None, tool_id: str) -> Settings:
    """The settings of one tool. Raises InputError for what is wrong with it or with what holds for all."""
    tables = read_toml(path)
    entries = _entries(tables, path)
    if tool_id not in entries:
        raise InputError("is not in the file any more", where=str(path), field=f"{ENTRIES}, id {tool_id!r}")
    common = {name: table for name, table in tables.items() if name != ENTRIES}
    return _settings(common, tool_id, entries[tool_id], path, overrides)


def load_tools(path: Path, overrides: Sequence[str] | None = None) -> tuple[Settings, ...]:
    """The settings of all tools. Raises InputError for the first that is wrong, or for two that want the same place."""
    tables = read_toml(path)
    common = {name: table for name, table in tables.items() if name != ENTRIES}
    found = tuple(_settings(common, key, entry, path, overrides) for key, entry in _entries(tables, path).items())
    _no_place_twice(found, path)
    return found


def chosen_tools(path: Path, overrides: Sequence[str] | None, tool_id: str | None) -> tuple[Settings, ...]:
    """The tools of a file of one tool or of several: `tool_id` alone, or all where it is None. Raises InputError."""
    every = load_tools(path, overrides) if has_tools(path) else (load(path, [*(overrides or ())]),)
    found = tuple(one for one in every if tool_id in (None, one.tool.id))
    if not found:
        names = ", ".join(one.tool.id for one in every)
        raise InputError(f"{tool_id!r} is not in {path}", field="--tool", remedy=f"one of {names}")
    return found


def one_tool(path: Path, overrides: Sequence[str] | None, tool_id: str | None) -> Settings:
    """As `chosen_tools`, for what goes with one tool: of several it must be said which. Raises InputError."""
    found = chosen_tools(path, overrides, tool_id)
    if len(found) > 1:
        names = ", ".join(one.tool.id for one in found)
        raise InputError(f"holds {len(found)} tools", where=str(path), field="--tool", remedy=f"say which: {names}")
    return found[0]


def _entries(tables: Mapping[str, Any], path: Path) -> dict[str, dict[str, Any]]:
    entries = tables.get(ENTRIES)
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise InputError("is no list of tables", where=str(path), field=ENTRIES, remedy="begin each with [[tools]]")
    if len(entries) > MOST:
        raise InputError(f"has more than {MOST} entries", where=str(path), field=ENTRIES, remedy="run several services")
    found: dict[str, dict[str, Any]] = {}
    for number, entry in enumerate(entries, start=1):
        field = f"{ENTRIES}, entry {number}: id"
        tool_id = entry.get("id")
        if not isinstance(tool_id, str) or not tool_id:
            raise InputError("is missing", where=str(path), field=field, remedy='name the tool: id = "HS-1"')
        if tool_id in found:
            raise InputError(f"{tool_id!r} is given twice", where=str(path), field=field, remedy="give each its own")
        found[tool_id] = {name: value for name, value in entry.items() if name != "id"}
    return found


def _settings(
    common: Mapping[str, Any], tool_id: str, entry: Mapping[str, Any], path: Path, overrides: Sequence[str] | None
) -> Settings:
    tables = _merged(common, entry)
    tool = tables.get("tool", {})
    if isinstance(tool, dict):
        tables["tool"] = {**tool, "id": tool_id}
    given = parse_overrides([*(overrides or ())])
    if "id" in given.get("tool", {}):
        raise InputError("goes with one tool alone", where="--set", field="tool.id", remedy="write the ids in the file")
    anchor_paths(tables, path.resolve().parent)
    service = tables.get("service", {})
    own = isinstance(entry.get("service"), dict) and "state_dir" in entry["service"]
    if isinstance(service, dict) and not own:
        # what holds for all is the folder of theirs
        folder = service.get("state_dir") or os.environ.get("STATE_DIRECTORY", "").split(":")[0]
        if isinstance(folder, str) and folder:
            tables["service"] = {**service, "state_dir": str(Path(folder) / tool_id)}
    return validate(tables, where=f"{path}, tool {tool_id}", overrides=[*(overrides or ())])


def _merged(common: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any]:
    merged: dict[str, Any] = {**common}
    for name, own in entry.items():
        shared = common.get(name)
        if not isinstance(own, dict) or not isinstance(shared, dict):
            merged[name] = own
            continue
        kind = _KINDS.get(name)
        other = kind is not None and kind in own and own[kind] != shared.get(kind)
        merged[name] = dict(own) if other else _merged(shared, own)
    return merged


def _no_place_twice(tools: Sequence[Settings], path: Path) -> None:
    """Two tools on one port, listener, connection or directory would fight for it as long as the service runs."""
    users: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for settings in tools:
        broker = f"{settings.mqtt.host}:{settings.mqtt.port}"
        places = {
            "link": settings.link.place,
            "service.state_dir": settings.service.state_dir,
            "metrics.port": settings.metrics.port if settings.metrics is not None else None,
            "mqtt.client_id": f"{settings.mqtt.client_id} at {broker}" if settings.mqtt.client_id else None,
        }
        for field, place in places.items():
            if place is not None:
                users[field, str(place)].append(settings.tool.id)
    for (field, place), ids in users.items():
        if len(ids) > 1:
            raise InputError(
                f"{place} is that of {' and '.join(ids[:2])}",
                where=str(path),
                field=field,
                remedy="give each tool its own, within its [[tools]]",
            )
