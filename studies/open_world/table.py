"""Every bar of the open world with its figure, its 95 % interval, and whether it is held, from the answers.

    python -m studies.open_world.table [--out FOLDER] ANSWERS [ANSWERS ...] [--rivals ANSWERS]

Each ANSWERS file is a column, named by the engine that answered. Shares stand with Wilson's intervals, medians with
those of 2,000 resamplings of the cases (bootstrap). A bar is held or missed by its figure; `not sure` where its
interval has the bar inside.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from studies.sealed.table import wilson

from . import noises
from .judging import STRONG, judged
from .score import written

Row = dict[str, Any]
RESAMPLED = 2000
FEW = 6
"""cases below which a resampled median has no interval of 95 % (1 - 2 / 2^n)"""
SOLID = ("white", "heavy", "modulated", "quantised")


def share(rows: Iterable[Row], what: Callable[[Row], bool], bar: float, *, most: bool) -> str:
    """'figure [interval] (hits of n) verdict' of a share; `most`: the bar is the largest that may be."""
    rows = list(rows)
    if not rows:
        return "no case"
    hits = sum(bool(what(row)) for row in rows)
    low, high = wilson(hits, len(rows))
    figure = hits / len(rows)
    return (
        f"{100 * figure:.1f} % [{100 * low:.1f}, {100 * high:.1f}] ({hits} of {len(rows)}), "
        f"{_held(figure, low, high, bar, most)}"
    )


def median(values: list[float], bar: float) -> str:
    """The median with its bootstrapped interval."""
    if not values:
        return "no case"
    given = np.array(values)
    rng = np.random.default_rng(0)
    each = np.median(given[rng.integers(0, given.size, (RESAMPLED, given.size))], axis=1)
    low, high = np.quantile(each, (0.025, 0.975))
    figure = float(np.median(given))
    if given.size < FEW:
        return f"{figure:.3f} ({given.size}: too few for an interval)"
    return f"{figure:.3f} [{low:.3f}, {high:.3f}] ({given.size}), {_held(figure, low, high, bar, False)}"


def _held(figure: float, low: float, high: float, bar: float, most: bool) -> str:
    if most:
        figure, low, high, bar = -figure, -high, -low, -bar
    sure = low >= bar or high < bar
    return f"{'held' if figure >= bar else '**missed**'}{'' if sure else ', not sure'}"


def repeatable(row: Row) -> bool:
    """Whether another session can confirm the laws of a case."""
    return all("time" not in law["covariates"] for law in row["truth"]["laws"])


def bars(rows: list[Row]) -> list[tuple[str, str]]:
    """Each bar of the deck and what of it an engine reaches."""
    law = [r for r in rows if r["group"] == "law" and r["truth"]["strength"] >= STRONG]
    again = [r for r in law if repeatable(r) and r["closed"] is not None]
    solid = [r for r in law if r["truth"]["noise"] in SOLID]
    serial = [r for r in law if r["truth"]["noise"] in noises.SERIAL]
    serial_again = [r for r in again if r["truth"]["noise"] in noises.SERIAL]
    nulls = [r for r in rows if r["group"] == "null"]
    known = [r for r in rows if r["group"] == "known"]
    hidden = [r for r in rows if r["truth"]["strength"] >= STRONG and r["group"] in ("law", "known", "sweep", "table")]
    sweeps = monotone(rows)
    found: list[tuple[str, str]] = []

    def put(text: str, chosen: list[Row], what: Callable[[Row], bool], bar: float, *, most: bool) -> None:
        found.append((f"{text} {'<=' if most else '>='} {100 * bar:g} %", share(chosen, what, bar, most=most)))

    for words, part in (("all noises", again), ("one law, white and its like", _single(again))):
        found.append(
            (f"closed on the other session, median, {words}: >= 0.95", median([r["closed"] for r in part], 0.95))
        )
        put(f"closed to 0.8 or more, {words}", part, lambda r: r["closed"] >= 0.8, 0.90, most=False)
    put("place and covariates exact, white and its like", solid, lambda r: r["exact"], 0.85, most=False)
    put("place and covariates in the class, white and its like", solid, lambda r: r["in_class"], 0.95, most=False)
    put("exact or in the class, coloured, 1/f, walk, jitter", serial, lambda r: r["in_class"], 0.85, most=False)
    put(
        "worse than nothing on the other session, the same",
        serial_again,
        lambda r: r["closed"] < -1e-6,
        0.02,
        most=True,
    )
    put("wrong library name on outsiders", law, lambda r: r["wrong_name"], 0.03, most=True)
    put("nothing_left_out at strength >= 400", hidden, lambda r: r["nothing"], 0.01, most=True)
    put("false laws on nulls", nulls, lambda r: bool(r["told"]), 0.03, most=True)
    put("any alarm on nulls", nulls, lambda r: r["alarm"], 0.03, most=True)
    put("library effects: a wrong name", known, lambda r: r["wrong_name"], 0.01, most=True)
    put("library effects: in the class", known, lambda r: r["named"], 0.95, most=False)
    put("sweeps of the strength that are monotone", sweeps, lambda r: r["monotone"], 1.0, most=False)
    put("ended in an error", rows, lambda r: r["failed"], 0.0, most=True)
    return found


def _single(rows: list[Row]) -> list[Row]:
    return [r for r in rows if len(r["truth"]["laws"]) == 1 and r["truth"]["noise"] in SOLID]


def monotone(rows: list[Row]) -> list[Row]:
    """Of each sweep with two strengths or more: whether what is told at one is told at every larger one."""
    by_sweep: dict[str, list[Row]] = {}
    for row in rows:
        if row["group"] == "sweep":
            by_sweep.setdefault(row["name"].rsplit("/", 1)[0], []).append(row)
    found = []
    for name, group in by_sweep.items():
        group.sort(key=lambda r: r["truth"]["strength"])
        reported = [r["in_class"] or (r["verdict"] == "implausible_fit" and bool(r["told"])) for r in group]
        quiet = [r["nothing"] for r in group]
        # told, then never again untold; something, then never again nothing
        falls = any(a and not b for a, b in pairwise(reported))
        silent = any(not a and b for a, b in pairwise(quiet))
        if len(group) > 1:
            found.append({"name": name, "monotone": not falls and not silent})
    return found


BUCKETS = ("right", "too weak", "near name", "other law", "refused", "wrong name", "nothing", "bad data", "error")


def buckets(rows: list[Row], group: str) -> list[tuple[str, Counter[str]]]:
    """What became of each row of a group, by the row's name."""
    found: dict[str, Counter[str]] = {}
    for row in rows:
        if row["group"] == group:
            found.setdefault(_row_name(row), Counter())[row["bucket"]] += 1
    return sorted(found.items())


def _row_name(row: Row) -> str:
    return str(row["name"].split("/")[1])


def _cell(count: Counter[str] | None) -> str:
    if not count:
        return "not run"
    return ", ".join(f"{count[word]} {word}" for word in BUCKETS if count[word])


def markdown(columns: dict[str, list[Row]], rivals: list[Row]) -> str:
    """The whole table, a column for each engine."""
    answered = {name: [row | judged(row) for row in rows] for name, rows in columns.items()}
    counts = ", ".join(f"{name}: {len(rows)} cases" for name, rows in answered.items())
    lines = [f"{counts}.", "", f"| bar | {' | '.join(answered)} |", "|---" * (len(answered) + 1) + "|"]
    each = {name: bars(rows) for name, rows in answered.items()}
    for k, (text, _) in enumerate(next(iter(each.values()))):
        lines.append(f"| {text} | {' | '.join(found[k][1] for found in each.values())} |")
    for group in ("table", "hand", "beside", "real"):
        by_engine = {name: dict(buckets(rows, group)) for name, rows in answered.items()}
        names = sorted(set().union(*by_engine.values()))
        if names:
            lines += ["", f"| {TITLES[group]} | {' | '.join(answered)} |", "|---" * (len(answered) + 1) + "|"]
            lines += [f"| {n} | {' | '.join(_cell(b.get(n)) for b in by_engine.values())} |" for n in names]
            whole = [_cell(sum(b.values(), Counter())) for b in by_engine.values()]
            lines.append(f"| **all** | {' | '.join(whole)} |")
    clocks = {name: clock(rows) for name, rows in answered.items()}
    if any(clocks.values()):
        lines += [
            "",
            f"| real clock moved by 5 ms to 1 s | {' | '.join(answered)} |",
            "|---" * (len(answered) + 1) + "|",
        ]
        lines.append(f"| `time_offset` within 1 ms, in a class, neither | {' | '.join(clocks.values())} |")
    if rivals:
        lines += ["", *_rivals(rivals, answered)]
    return "\n".join(lines) + "\n"


CLOCK_S = 1e-3


def clock(rows: list[Row]) -> str:
    """Of real recordings whose clock was moved: how many say by how much. What all have in common is the delay that the
    recording had before; its median is taken off."""
    moved = [r for r in rows if r["name"].startswith("real/clock/") and r["truth"]["effects"]]
    if not moved:
        return ""
    found, tied = {}, 0
    for row in moved:
        for claim in (row["answer"] or {"claims": []})["claims"]:
            if claim["effect"] == "time_offset":
                value = next(iter(claim["parameters"].values()))["value"]
                found[row["name"]] = (row["truth"]["effects"]["time_offset"]["t0"], value)
            elif "time_offset" in claim["equivalence_class"]:
                tied += 1
    right = 0
    for sign in (1.0, -1.0):
        apart = np.array([sign * value - t0 for t0, value in found.values()])
        if apart.size:
            right = max(right, int(np.sum(np.abs(apart - np.median(apart)) <= CLOCK_S)))
    return f"{right} within 1 ms, {tied} in a class, {len(moved) - right - tied} neither (of {len(moved)})"


TITLES = {
    "table": "found by trying", "hand": "by hand and at rest, simulated", "beside": "beside another simulation",
    "real": "real recordings",
}  # fmt: skip


def _rivals(rivals: list[Row], answered: dict[str, list[Row]]) -> list[str]:
    """The same pairs of sessions, closed by each way; cases of strength 400 and more that all were given."""
    by_way: dict[str, dict[str, float]] = {}
    for name, rows in answered.items():
        by_way[name] = {r["name"]: r["closed"] for r in rows if r["group"] == "law" and r["closed"] is not None}
    for row in rivals:
        if row["truth"]["strength"] >= STRONG:
            for way, closed in row["ways"].items():
                by_way.setdefault(way, {})[row["name"]] = closed
    # an engine that answered another deck has no case in common: it stands in its own column above
    given = {r["name"] for r in rivals}
    by_way = {way: values for way, values in by_way.items() if len(given & set(values)) > 0}
    common = set.intersection(*(set(values) for values in by_way.values())) if by_way else set()
    lines = [
        "| way, on the same pairs of sessions | closed, median | closed to 0.8 or more | worse than nothing |",
        "|---" * 4 + "|",
    ]
    for way, values in by_way.items():
        chosen = [{"closed": values[name]} for name in sorted(common)]
        lines.append(
            f"| {way} | {median([c['closed'] for c in chosen], 0.95)} |"
            f" {share(chosen, lambda r: r['closed'] >= 0.8, 0.9, most=False)} |"
            f" {share(chosen, lambda r: r['closed'] < -1e-6, 0.02, most=True)} |"
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("answers", nargs="+", help="NAME=FILE, or a file of answers")
    parser.add_argument("--rivals", type=Path)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    columns: dict[str, list[Row]] = {}
    for word in given.answers:
        name, _, path = word.rpartition("=")
        rows = written(Path(path))
        if not rows:
            parser.error(f"{path}: no answers")
        columns.setdefault(name or Path(path).stem, []).extend(rows)
    text = markdown(columns, written(given.rivals) if given.rivals else [])
    if given.out:
        given.out.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
