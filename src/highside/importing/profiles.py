"""Mappings kept by name in the user's folder of settings (`~/.config/highside/import/NAME.toml`), with what is joined:
a second file is found by the rule that its name follows from that of the recording."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from platformdirs import user_config_path

from highside.errors import InputError
from highside.importing.core.filenames import NameRule, rule_of, second_of
from highside.importing.core.proposal import Proposal
from highside.importing.core.units import Unit
from highside.importing.core.wishes import Taken, Wishes
from highside.importing.joins import Joins, Second
from highside.reading import parse_toml, read_document
from highside.recording.files import make_directory, write_whole

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_Kinds: TypeAlias = Mapping[str, type | tuple[type, ...]]
_FIELDS: _Kinds = {
    "map": dict,
    "units": list,
    "axes": str,
    "table": str,
    "rate_hz": (int, float),
    "poses": bool,
    "take": str,
    "lag": (str, int, float),
    "reference": list,
}
_OF_REFERENCE: _Kinds = {"recording": str, "file": str, "table": str, "map": dict}
MEASURED = "measured"


@dataclass(frozen=True, slots=True)
class KeptSecond:
    """A table to be joined: by the rule that leads from the name of a recording to its file, which lies in `folder`
    seen from the recording; or (None) the table of that name of the same file."""

    rule: NameRule | None
    place: str
    mapping: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Profile:
    """What is kept under a name: what was said of the recording, what is joined to it, and how."""

    name: str
    wishes: Wishes
    seconds: tuple[KeptSecond, ...] = ()
    taken: Taken | None = None
    lag_s: float | None = None

    def joins(self, recording: Path, given: Joins) -> Joins:
        """What is joined to a recording; what is `given` beside the profile goes before it.

        Raises InputError for a recording whose name leads to no second file, or to one that is not there.
        """
        taken = given.taken or self.taken
        lag_s = self.lag_s if given.lag_s is None else given.lag_s
        if given.seconds:
            return Joins(given.seconds, taken, lag_s)
        return Joins(tuple(self._second(kept, recording) for kept in self.seconds), taken, lag_s)

    def _second(self, kept: KeptSecond, recording: Path) -> Second:
        wishes = Wishes(dict(kept.mapping))
        if kept.rule is None:
            return Second(kept.place, None, wishes, f"table {kept.place} is joined by profile {self.name}")
        by = f"profile {self.name} joins {kept.rule}"
        name = second_of(kept.rule, recording.name)
        if name is None:
            raise InputError(f"{by}, and it is not called so", where=str(recording), remedy="--reference FILE")
        file = recording.parent / kept.place / name
        if not file.is_file():
            raise InputError(f"{by}: {file} is not there", where=str(recording), remedy="--reference FILE")
        return Second(file.name, file, wishes, f"{file} is joined: {by}")


def place(name: str) -> Path:
    """The file of a profile. Raises InputError for a name that is none."""
    if not _NAME.fullmatch(name):
        raise InputError(f"{name!r} is no name of a profile", field="--profile", remedy="letters, digits, . _ -")
    return user_config_path("highside", appauthor=False) / "import" / f"{name}.toml"


def load(name: str) -> Profile | None:
    """The profile of that name, None where there is none yet. Raises InputError for a file that is not in order."""
    path = place(name)
    if not path.exists():
        return None
    where = str(path)
    found = parse_toml(read_document(path), where=where)
    _check(found, _FIELDS, where)
    rate = found.get("rate_hz")
    wishes = Wishes(
        _mapping(found, where),
        tuple(map(str, found.get("units", []))),
        found.get("axes"),
        None if rate is None else float(rate),
        found.get("table"),
        poses=found.get("poses", False),
    )
    taken = found.get("take")
    if taken is not None and taken not in list(Taken):
        raise InputError(f"{taken!r} is none", where=where, field="take", remedy=f"give {', '.join(Taken)}")
    lag = found.get("lag")
    if isinstance(lag, str) and lag != MEASURED:
        raise InputError(f"{lag!r} is no number of seconds", where=where, field="lag", remedy="give 0.12, or measured")
    seconds = tuple(_kept_second(entry, where) for entry in found.get("reference", []))
    lag_s = None if lag is None else math.nan if lag == MEASURED else float(lag)
    return Profile(name, wishes, seconds, None if taken is None else Taken(taken), lag_s)


def _check(found: Mapping[str, object], fields: _Kinds, where: str) -> None:
    for key, value in found.items():
        kind = fields.get(key)
        if kind is None or not isinstance(value, kind) or isinstance(value, bool) is not (kind is bool):
            raise InputError("is no field of a profile", where=where, field=key, remedy="take it out")


def _mapping(found: Mapping[str, Any], where: str) -> dict[str, str]:
    mapping = dict(found.get("map", {}))
    if not all(isinstance(text, str) for text in mapping.values()):
        raise InputError(
            "holds something else than texts", where=where, field="map", remedy='write ax_g = "COLUMN:unit"'
        )
    return mapping


def _kept_second(entry: object, where: str) -> KeptSecond:
    if not isinstance(entry, dict):
        raise InputError("is no table", where=where, field="reference", remedy="write [[reference]]")
    _check(entry, _OF_REFERENCE, where)
    if ("file" in entry) == ("table" in entry):
        raise InputError("needs a file or a table", where=where, field="reference", remedy='write file = "bench.csv"')
    mapping = _mapping(entry, where)
    if "table" in entry:
        return KeptSecond(None, entry["table"], mapping)
    folder, name = os.path.split(entry["file"])
    return KeptSecond(NameRule(entry.get("recording", ""), name), folder, mapping)


def store(
    name: str, recording: Path, proposal: Proposal, wishes: Wishes, joins: Joins, others: Sequence[Proposal], axes: str
) -> Path:
    """Keep what was used of a recording under a name; an earlier one of that name is replaced.

    `others`: the proposals of what was joined; `axes`: as they are after that. Raises InputError.
    """
    path = place(name)
    lines = []
    if proposal.rate_hz is not None:
        lines.append(f"rate_hz = {proposal.rate_hz!r}")
    if wishes.table is not None:
        lines.append(f"table = {_quoted(wishes.table)}")
    if proposal.poses:
        lines.append("poses = true")
    lines.append(f"axes = {_quoted(axes)}")
    if joins.taken is not None:
        lines.append(f"take = {_quoted(joins.taken)}")
    if joins.lag_s is not None:
        lines.append(f"lag = {_quoted(MEASURED) if math.isnan(joins.lag_s) else repr(joins.lag_s)}")
    lines += ["[map]", *_map_lines(proposal, wishes)]
    for second, other in zip(joins.seconds, others, strict=True):
        lines += ["[[reference]]", *_place_lines(second, recording), "[reference.map]"]
        lines += _map_lines(other, second.wishes)
    try:
        make_directory(path.parent)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", where=str(path.parent), field="--profile") from None
    write_whole(path, ("\n".join(lines) + "\n").encode())
    return path


def _map_lines(proposal: Proposal, wishes: Wishes) -> list[str]:
    used = {guess.target for guess in proposal.guesses}
    lines = [f'{target} = "none"' for target, text in wishes.mapping.items() if text == "none" and target not in used]
    return lines + [f"{guess.target} = {_quoted(guess.column + _unit(guess.unit))}" for guess in proposal.guesses]


def joined_by(joins: Joins, recording: Path) -> tuple[str, ...]:
    """The rules by which the second files of a recording are found again, in words."""
    files = [second.file for second in joins.seconds if second.file is not None]
    return tuple(str(rule_of(recording.name, file.name)) for file in files)


def _place_lines(second: Second, recording: Path) -> list[str]:
    if second.file is None:
        return [f"table = {_quoted(second.name)}"]
    rule = rule_of(recording.name, second.file.name)
    folder = os.path.relpath(second.file.parent.resolve(), recording.parent.resolve())
    file = rule.second if folder == "." else f"{folder}/{rule.second}"
    return [*([] if rule.fixed else [f"recording = {_quoted(rule.recording)}"]), f"file = {_quoted(file)}"]


def merged(profile: Wishes, wishes: Wishes) -> Wishes:
    """What a profile says with what was given beside it, which goes before it."""
    return Wishes(
        {**profile.mapping, **wishes.mapping},
        wishes.units or profile.units,
        wishes.axes or profile.axes,
        wishes.rate_hz if wishes.rate_hz is not None else profile.rate_hz,
        wishes.table or profile.table,
        wishes.part,
        wishes.reference,
        wishes.poses or profile.poses,
    )


def _unit(unit: Unit | None) -> str:
    """`:unit` as `--map` reads it; nothing for what has none, or what its own text shows (a date)."""
    from highside.importing.core.units import unit_wanted

    if unit is None:
        return ""
    try:
        unit_wanted(unit.name, unit.quantity)
    except InputError:
        return ""
    return f":{unit.name}"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=True)
