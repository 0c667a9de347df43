"""Mappings kept by name in the user's folder of settings (`~/.config/highside/import/NAME.toml`)."""

from __future__ import annotations

import json
import re
from pathlib import Path

from platformdirs import user_config_path

from highside.errors import InputError
from highside.importing.core.proposal import Proposal
from highside.importing.core.units import Unit
from highside.importing.core.wishes import Wishes
from highside.reading import parse_toml, read_bytes
from highside.recording.files import make_directory, write_whole

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_FIELDS: dict[str, type | tuple[type, ...]] = {
    "map": dict,
    "units": list,
    "axes": str,
    "table": str,
    "rate_hz": (int, float),
}


def place(name: str) -> Path:
    """The file of a profile. Raises InputError for a name that is none."""
    if not _NAME.fullmatch(name):
        raise InputError(f"{name!r} is no name of a profile", field="--profile", remedy="letters, digits, . _ -")
    return user_config_path("highside", appauthor=False) / "import" / f"{name}.toml"


def load(name: str) -> Wishes | None:
    """The profile of that name, None where there is none yet. Raises InputError for a file that is not in order."""
    path = place(name)
    if not path.exists():
        return None
    where = str(path)
    found = parse_toml(read_bytes(path), where=where)
    for key, value in found.items():
        kind = _FIELDS.get(key)
        if kind is None or not isinstance(value, kind):
            raise InputError("is no field of a profile", where=where, field=key, remedy="take it out")
    mapping = found.get("map", {})
    if not all(isinstance(text, str) for text in mapping.values()):
        raise InputError(
            "holds something else than texts", where=where, field="map", remedy='write ax_g = "COLUMN:unit"'
        )
    rate = found.get("rate_hz")
    return Wishes(
        dict(mapping),
        tuple(map(str, found.get("units", []))),
        found.get("axes"),
        None if rate is None else float(rate),
        found.get("table"),
    )


def store(name: str, proposal: Proposal, wishes: Wishes) -> Path:
    """Keep what was used under a name; an earlier one of that name is replaced. Raises InputError."""
    path = place(name)
    lines = []
    if proposal.rate_hz is not None:
        lines.append(f"rate_hz = {proposal.rate_hz!r}")
    if wishes.table is not None:
        lines.append(f"table = {_quoted(wishes.table)}")
    lines.append(f"axes = {_quoted(proposal.axes.axes)}")
    lines.append("[map]")
    used = {guess.target for guess in proposal.guesses}
    lines += [f'{target} = "none"' for target, text in wishes.mapping.items() if text == "none" and target not in used]
    lines += [f"{guess.target} = {_quoted(guess.column + _unit(guess.unit))}" for guess in proposal.guesses]
    try:
        make_directory(path.parent)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", where=str(path.parent), field="--profile") from None
    write_whole(path, ("\n".join(lines) + "\n").encode())
    return path


def merged(profile: Wishes | None, wishes: Wishes) -> Wishes:
    """A profile with what was given beside it, which goes before it."""
    if profile is None:
        return wishes
    return Wishes(
        {**profile.mapping, **wishes.mapping},
        wishes.units or profile.units,
        wishes.axes or profile.axes,
        wishes.rate_hz if wishes.rate_hz is not None else profile.rate_hz,
        wishes.table or profile.table,
        wishes.part,
        wishes.reference,
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
