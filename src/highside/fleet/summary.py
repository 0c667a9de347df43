"""What stands in the results of a folder: tools, lots, verdicts; read through DuckDB, judged by `common`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.errors import InputError
from highside.fleet.common import Common, LotScores, LotTested, ToolScores, judge
from highside.fleet.parts import DAMAGED, PartStore
from highside.fleet.pooling import marginal

__all__ = ["FleetSummary", "LotView", "summarise"]

SCHEMA = "highside.fleet/1"


@dataclass(frozen=True)
class LotView:
    """What a report draws of an effect in a lot: of n tools k amplitudes each."""

    tools: tuple[str, ...]
    estimate: Array
    """(n, k)"""
    std: Array
    """(n, k); infinite where a tool says nothing of it"""
    units: tuple[str, ...]


@dataclass(frozen=True)
class FleetSummary:
    """The answer of `fleet summary`."""

    grouped_by: str
    recordings: int
    tools: int
    verdicts: dict[str, int]
    errors: tuple[tuple[str, str], ...]
    """recordings that failed, with why"""
    repeated: int
    """recordings whose content stands under more than one name"""
    lots: tuple[LotTested, ...]
    units: dict[str, tuple[str, ...]]
    """of the amplitudes of each effect"""
    parameters: dict[str, tuple[str, ...]]
    """their names"""
    views: dict[tuple[str, str], LotView]
    """of each effect that is in common, by lot and effect"""

    @property
    def common(self) -> list[Common]:
        """Over all lots, the surest first."""
        return sorted((one for lot in self.lots for one in lot.common), key=lambda one: one.q)

    def to_dict(self) -> dict[str, Any]:
        """What `--json` prints."""
        return {
            "schema": SCHEMA,
            "by": self.grouped_by,
            "recordings": self.recordings,
            "tools": self.tools,
            "verdicts": self.verdicts,
            "errors": [{"uri": uri, "error": error} for uri, error in self.errors],
            "repeated": self.repeated,
            "common": [self._common(one) for one in self.common],
            "outliers": [
                {
                    "lot": one.lot,
                    "tool": one.tool,
                    "effect": one.effect,
                    "class": list(one.same),
                    "p": one.p,
                    "departure": self._values(one.effect, one.departure),
                }
                for lot in self.lots
                for one in lot.outliers
            ],
            "not_testable": [
                {"lot": lot.lot, "tools": lot.tools, "why": lot.refused} for lot in self.lots if lot.refused
            ],
            "smallest": {
                lot.lot: {effect: self._values(effect, size) for effect, size in lot.smallest.items()}
                for lot in self.lots
                if not lot.refused
            },
        }

    def _values(self, effect: str, values: Array) -> dict[str, dict[str, Any]]:
        return {
            name: {"value": float(value), "unit": unit}
            for name, unit, value in zip(self.parameters[effect], self.units[effect], values, strict=True)
        }

    def _common(self, one: Common) -> dict[str, Any]:
        largest = int(np.argmax(np.abs(one.pooled.t)))
        units = self.units[one.effect]
        found = {
            "lot": one.lot,
            "effect": one.effect,
            "class": list(one.same),
            "parameter": one.parameters[largest],
            "value": float(one.pooled.mean[largest]),
            "std": float(one.pooled.std[largest]),
            "unit": units[largest],
            "q": one.q,
            "tools": one.pooled.tools,
            "parameters": {
                name: {"value": float(mean), "std": float(std), "scatter": float(scatter), "unit": unit}
                for name, mean, std, scatter, unit in zip(
                    one.parameters, one.pooled.mean, one.pooled.std, one.pooled.scatter, units, strict=True
                )
            },
            "proof": {"gain": one.proof.gain, "std": one.proof.std, "left_out": "one tool at a time"},
        }
        if one.change is not None:
            found["change"] = {
                "after": one.change.after,
                "p": one.change.p,
                "before": one.change.before.mean.tolist(),
                "behind": one.change.behind.mean.tolist(),
            }
        return found


def summarise(store: PartStore, *, by: str = "lot", order: str | None = None) -> FleetSummary:
    """Judge the diagnoses of a folder.

    `by`: the column of the catalogue that makes the lots (`month`: of its column `date`); `order`: the column along
    which a change is looked for. Raises InputError for a folder without results, and for columns it does not have.
    """
    rows = _rows(store, by, order)
    usable = [row for row in rows if row["score"]]
    names, entries, amplitudes, parameters, units = _layout(usable)
    lots: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for row in rows:
        tools = lots.setdefault(row["lot"] or "", {})
        if row["score"]:
            tools.setdefault(row["tool"], []).append(row)
    scores = []
    for lot, tools in sorted(lots.items()):
        kept = sorted(tools.items(), key=lambda item: _natural(item[1][0]["place"] if order else item[0]))
        made = tuple(_tool_scores(tool, own, names) for tool, own in kept)
        scores.append(LotScores(lot, entries, amplitudes, made, ordered=order is not None))
    tested = judge(scores, parameters)
    verdicts: dict[str, int] = {}
    for row in rows:
        verdicts[row["verdict"]] = verdicts.get(row["verdict"], 0) + 1
    keys = [row["key"] for row in rows]
    return FleetSummary(
        by,
        len(rows),
        len({row["tool"] for row in rows}),
        dict(sorted(verdicts.items(), key=lambda item: -item[1])),
        tuple((row["uri"], row["error"]) for row in rows if row["error"]),
        len(keys) - len(set(keys)),
        tuple(tested),
        {entry: tuple(units[k] for k in own) for entry, own in zip(entries, amplitudes, strict=True)},
        {entry: tuple(parameters[k] for k in own) for entry, own in zip(entries, amplitudes, strict=True)},
        {
            (one.lot, one.effect): _view(lot, one.effect, units)
            for lot, judged in zip(scores, tested, strict=True)
            for one in judged.common
        },
    )


def _view(lot: LotScores, effect: str, units: Sequence[str]) -> LotView:
    entry = lot.entries.index(effect)
    score, information, which = lot.of(entry)
    estimate, variance = marginal(score, information)
    own = tuple(units[k] for k in lot.amplitudes[entry])
    return LotView(tuple(lot.tools[i].tool for i in which), estimate, np.sqrt(variance), own)


def _rows(store: PartStore, by: str, order: str | None) -> list[dict[str, Any]]:
    """The diagnoses of the catalogue with lot and place, from the parts."""
    try:
        import duckdb
    except ImportError:
        raise InputError(
            "a summary needs duckdb, which is not installed", remedy="pip install 'highside[fleet]'"
        ) from None
    if not store.catalogue.exists():
        raise InputError(
            "holds no results", where=str(store.folder), field="DIR", remedy="run highside fleet diagnose first"
        )
    # a damaged file is named here, before the query
    store.look()
    store.read_catalogue()
    try:
        every = _joined(duckdb, store, by, order)
    except duckdb.Error as error:
        said = str(error).splitlines()[0]
        raise InputError(f"cannot be read: {said}", where=str(store.folder), field="DIR", remedy=DAMAGED) from None
    # two runs at the same time may both have written a result
    return list({row["uri"]: row for row in every}.values())


def _joined(duckdb: Any, store: PartStore, by: str, order: str | None) -> list[dict[str, Any]]:
    """Every diagnosis of the catalogue with each row of its result."""
    with duckdb.connect() as base:
        base.execute(
            "CREATE VIEW catalogue AS SELECT * FROM read_parquet(?)".replace("?", _quoted(str(store.catalogue)))
        )
        columns = {name for (name, *_) in base.execute("DESCRIBE catalogue").fetchall()}
        lot = _month(columns) if by == "month" else _column(by, columns, "--by")
        place = _column(order, columns, "--order") if order is not None else "NULL"
        base.execute(f"CREATE VIEW parts AS SELECT * FROM read_parquet({_quoted(store.pattern)}, union_by_name=true)")
        found = base.execute(
            f"SELECT c.uri, c.tool, {lot} AS lot, {place} AS place, p.* EXCLUDE (diagnosis)"
            " FROM catalogue c JOIN parts p USING (key) WHERE c.job = 'diagnose' AND p.job = 'diagnose' ORDER BY c.uri"
        )
        names = [about[0] for about in found.description or ()]
        return [dict(zip(names, row, strict=True)) for row in found.fetchall()]


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _column(name: str, columns: set[str], option: str) -> str:
    if name not in columns:
        raise InputError(
            f"{name!r} is no column of the catalogue", field=option, remedy=f"one of {', '.join(sorted(columns))}"
        )
    return 'CAST(c."' + name.replace('"', '""') + '" AS VARCHAR)'


def _month(columns: set[str]) -> str:
    return f"strftime(TRY_CAST({_column('date', columns, '--by month')} AS TIMESTAMP), '%Y-%m')"


def _natural(text: str | None) -> tuple[tuple[int, float, str], ...]:
    """A name by which tool 9 stands before tool 10."""
    parts: list[tuple[int, float, str]] = []
    digits = ""
    for c in (text or "") + "\0":
        if c.isdigit():
            digits += c
            continue
        if digits:
            parts.append((0, float(digits), ""))
            digits = ""
        parts.append((1, 0.0, c))
    return tuple(parts)


Layout = tuple[
    dict[tuple[str, str], int], tuple[str, ...], tuple[tuple[int, ...], ...], tuple[str, ...], tuple[str, ...]
]


def _layout(rows: Sequence[dict[str, Any]]) -> Layout:
    """All amplitudes of the fleet: their places by (entry, parameter), entries, places of each, names, units."""
    places: dict[tuple[str, str], int] = {}
    units: list[str] = []
    for row in rows:
        for entry, parameter, unit in zip(row["entry_of"], row["parameters"], row["units"], strict=True):
            key = row["entries"][entry], parameter
            if key not in places:
                places[key] = len(places)
                units.append(unit)
    entries = tuple(dict.fromkeys(entry for entry, _ in places))
    own = tuple(tuple(k for (of, _), k in places.items() if of == entry) for entry in entries)
    return places, entries, own, tuple(name for _, name in places), tuple(units)


def _tool_scores(tool: str, rows: Sequence[dict[str, Any]], places: dict[tuple[str, str], int]) -> ToolScores:
    """The sums over the recordings of one tool."""
    score, information = np.zeros(len(places)), np.zeros((len(places), len(places)))
    for row in rows:
        own = [places[row["entries"][e], name] for e, name in zip(row["entry_of"], row["parameters"], strict=True)]
        half = np.zeros((len(own), len(own)))
        half[np.triu_indices(len(own))] = row["information"]
        score[own] += row["score"]
        information[np.ix_(own, own)] += half + np.triu(half, 1).T
    return ToolScores(tool, score, information)
