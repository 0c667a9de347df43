"""No command writes over a file that it reads, nor two answers to one place: a recording is made once.

An answer takes the place of one of its own kind, so that scripts can be run again, and of no other file: `ANSWERS` says
for each command what it writes, beside the place that is named, too. Of the same form as an answer may be what nobody
can make a second time, and that is not replaced either: keys, recordings of the wire, journals of sessions, messages
that wait for the broker.
"""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

from typer.models import OptionInfo

from highside.cli import kinds
from highside.cli.kinds import Kind, refuse_another_kind
from highside.errors import InputError

WRITTEN = ("--output", "--out", "--html", "--write-model", "--poses", "--dcc")
"""Options that name what is written, wherever their value is a path."""
_Place = Callable[[Path, dict[str, Any]], Iterator[tuple[Path, Kind]]]
"""The value of an option and all values given to a command -> what is written, and its kind."""


def _file(kind: Kind) -> _Place:
    return lambda output, given: iter([(output, kind)])


def _folder(*names: str) -> _Place:
    """A folder of answers by these names."""
    return lambda output, given: ((output / name, kinds.ANALYSIS.get(name, kinds.PAGE)) for name in names)


def _paper(name: str) -> _Place:
    return lambda output, given: iter([(output / f"{name}.html", kinds.PAGE), (output / f"{name}.json", kinds.PAPER)])


def _kept(output: Path, given: dict[str, Any]) -> Iterator[tuple[Path, Kind]]:
    """A folder whose writer looks itself what is there, and keeps it."""
    return iter(())


def _signed(kind: Kind) -> _Place:
    """A file, and beside it its signature, if there is a key."""

    def places(output: Path, given: dict[str, Any]) -> Iterator[tuple[Path, Kind]]:
        yield output, kind
        if given.get("key") is not None:
            yield output.with_name(output.name + ".sig"), kinds.SIGNATURE

    return places


def _simulated(output: Path, given: dict[str, Any]) -> Iterator[tuple[Path, Kind]]:
    """A recording, and beside it its truth."""
    stem = output.name.removesuffix(".gz").removesuffix(".csv")
    yield output, kinds.RECORDING
    yield output.with_name(f"{stem}.truth.json"), kinds.TRUTH
    yield output.with_name(f"{stem}.truth.csv.gz"), kinds.TABLE


ANSWERS: dict[str, dict[str, _Place]] = {
    "calibrate.poses": {"output": _file(kinds.POSES)},
    "calibrate.solve": {"output": _file(kinds.RECORD)},
    "calibrate.apply": {"output": _file(kinds.CORRECTED)},
    "certificate.certificate": {"output": _signed(kinds.CERTIFICATE), "dcc": _signed(kinds.DIGITAL)},
    "decode.decode": {"output": _file(kinds.RECORDING)},
    "diagnose.diagnose": {
        "out": _folder("diagnosis.json", "report.html"),
        "write_model": _file(kinds.MODEL),
    },
    "documentation.examples": {"folder": _kept},
    "drift.drift": {"output": _file(kinds.AZIMUTHS)},
    "effects.new": {"folder": _kept},
    "export.export": {"output": _file(kinds.TABLE)},
    "fleet.archive_command": {"out": _kept},
    "fleet.diagnose_command": {"out": _kept},
    "fleet.drift_command": {"out": _kept},
    "fleet.solve_command": {"out": _kept},
    "fleet.summary_command": {"html": _file(kinds.PAGE)},
    "fleet.records_command": {"html": _file(kinds.PAGE)},
    "importing.import_file": {"output": _file(kinds.TABLE)},
    "iscwsa.iscwsa": {"output": _file(kinds.ERROR_MODEL)},
    "predict.predict": {"output": _file(kinds.TABLE)},
    "reproduce.balance": {"output": _paper("balance")},
    "reproduce.drift": {"output": _paper("drift")},
    "reproduce.rotation": {"output": _paper("rotation")},
    "rotation.fit_command": {"output": _file(kinds.COMPENSATION), "html": _file(kinds.PAGE)},
    "rotation.apply": {"output": _file(kinds.COMPENSATED)},
    "rotation.compare": {"html": _file(kinds.PAGE)},
    "self_fit.fit_self": {"output": _file(kinds.COMPENSATION)},
    "simulate.simulate": {"output": _simulated, "poses": _file(kinds.POSES)},
    "surveys.analyse": {"out": _folder("surveys.json", "report.html")},
    "surveys.export": {"output": _file(kinds.STATIONS)},
    "turntable.turntable": {"output": _file(kinds.COMPENSATION)},
    "verification.verify": {"output": _file(kinds.VERIFICATION)},
    "watch.recording": {"out": _folder("watch.json", "report.html")},
    "watch.propose": {"output": _file(kinds.RECORD)},
}
"""MODULE.FUNCTION of a command -> parameter -> what is written there."""

IRREPLACEABLE = {
    b"-----BEGIN": "a key or a certificate",
    b"HSWIRE1\n": "a recording of the wire",
    b"SQLite format 3\0": "a database",
}
"""First bytes of a file -> what it is; no output of a command begins like this."""
GUARDED = "guards_its_outputs"
"""Attribute of a command that does."""
JOURNAL = ".journal"
"""Ends the name of a session's journal, which begins like other JSON."""


def name_of(function: Callable[..., Any]) -> str:
    """As in `ANSWERS`."""
    return f"{function.__module__.rpartition('.')[2]}.{function.__name__}"


def own_outputs(function: Callable[..., Any]) -> Callable[..., Any]:
    """A command that refuses an output that is one of its inputs, or a file of another kind."""
    written = dict(_outputs(function))
    answers = ANSWERS[name_of(function)] if written else {}

    @functools.wraps(function)
    def guarded(*args: Any, **given: Any) -> Any:
        read = [path for name, value in given.items() if name not in written for path in _paths(value)]
        others: dict[str, str] = {}
        for name, option in written.items():
            for output in _paths(given.get(name)):
                if output.is_file() and any(path.exists() and output.samefile(path) for path in read):
                    raise _no(output, option, "is a file that this command reads")
                if kind := _irreplaceable(output):
                    raise InputError(
                        f"is there already and is {kind}, which is not replaced",
                        where=str(output),
                        field=option,
                        remedy="name another file, or take this one away",
                    )
                # of links that lead round in a circle `Path.resolve` makes an error
                place = os.path.realpath(output)
                if other := others.get(place):
                    raise _no(output, option, f"is what {other} names, too")
                others[place] = option
                for file, of in answers[name](output, given):
                    refuse_another_kind(file, of, option)
        return function(*args, **given)

    if not written:
        return function
    setattr(guarded, GUARDED, True)
    return guarded


def _irreplaceable(path: Path) -> str | None:
    """What the file is if no answer of a command may take its place."""
    if not path.is_file():
        return None
    if path.suffix == JOURNAL:
        return "the journal of a session"
    longest = max(map(len, IRREPLACEABLE))
    try:
        with path.open("rb") as file:
            start = file.read(longest)
    except OSError:
        return None  # whoever writes will say why it cannot be
    return next((kind for begin, kind in IRREPLACEABLE.items() if start.startswith(begin)), None)


def _no(output: Path, option: str, what: str) -> InputError:
    return InputError(what, where=str(output), field=option, remedy="name another file")


def _outputs(function: Callable[..., Any]) -> Iterator[tuple[str, str]]:
    """(parameter, option) of what is written."""
    for name, parameter in inspect.signature(function, eval_str=True).parameters.items():
        if get_origin(parameter.annotation) is Annotated and get_args(parameter.annotation)[0] is not bool:
            for info in get_args(parameter.annotation)[1:]:
                # a single name stands where a default would
                names = (info.default, *(info.param_decls or ())) if isinstance(info, OptionInfo) else ()
                yield from ((name, option) for option in WRITTEN if option in names)


def _paths(value: object) -> tuple[Path, ...]:
    values = value if isinstance(value, list | tuple) else (value,)
    return tuple(one for one in values if isinstance(one, Path))
