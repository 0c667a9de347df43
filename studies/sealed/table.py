"""The table of a deck as Markdown, from the answers: bars with intervals, nulls by noise, each effect, rivals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from .judging import judged

Row = dict[str, Any]
What = str | Callable[[Row], bool]

DESIGNS = {"poses": "stepped session", "rotation": "rotation"}
REAL_DESIGNS = {"hand": "by hand, abs(g)", "rest": "at rest, abs(g)", **DESIGNS}
STRONG, STRONGER = 99.0, 399.0


def wilson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if n == 0:
        return 0.0, 1.0
    z, p = 1.959964, hits / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def share(rows: Iterable[Row], what: What) -> str:
    """'share [interval] (hits of n)' of rows."""
    rows = list(rows)
    hits = sum(bool(what(r) if callable(what) else r[what]) for r in rows)
    if not rows:
        return "no case"
    low, high = wilson(hits, len(rows))
    return f"{100 * hits / len(rows):.1f} % [{100 * low:.1f}, {100 * high:.1f}] ({hits} of {len(rows)})"


class _Bars:
    """Lines of one figure for each design and for all; a line without any case is left out."""

    def __init__(self, designs: dict[str, str]) -> None:
        self._designs = designs
        self.lines = [f"| bar | {' | '.join(designs.values())} | all |", "|---" * (len(designs) + 2) + "|"]

    def _line(self, text: str, cases: Sequence[Row], cell: Callable[[list[Row]], str]) -> None:
        if cases:
            parts = [[r for r in cases if r["design"] == d] for d in self._designs]
            self.lines.append(f"| {text} | {' | '.join(cell(part) for part in (*parts, list(cases)))} |")

    def bar(self, text: str, cases: Sequence[Row], what: What) -> None:
        self._line(text, cases, lambda part: share(part, what))

    def middle(self, text: str, cases: Sequence[Row], what: str, how: Callable[[list[float]], Any] = np.median) -> None:
        def cell(part: list[Row]) -> str:
            each = [v for r in part for v in (r[what] if isinstance(r[what], list) else [r[what]]) if v is not None]
            return f"{how(each):.3g} ({len(each)})" if each else "no case"

        self._line(text, cases, cell)


def deck_table(rows: list[Row], designs: dict[str, str]) -> str:
    """All of one deck, answered by the whole method."""
    made = [r for r in rows if not r.get("not_made")]
    both = [r | judged(r) for r in made]
    groups = {
        g: [r for r in both if r["group"] == g]
        for g in ("null", "single", "pair", "open", "blind", "withheld", "fault")
    }
    strong = [r for r in groups["single"] if r["strength"] >= STRONG]
    stronger = [r for r in strong if r["strength"] >= STRONGER]
    bars = _Bars({d: words for d, words in designs.items() if any(r["design"] == d for r in both)})
    bar, middle = bars.bar, bars.middle
    bar("any alarm on nulls <= 3 %", groups["null"], "alarm")
    bar("a name on nulls", groups["null"], lambda r: bool(r["names"]))
    bar("a name on nulls with a walk <= 5 %", [r for r in groups["null"] if r["noise"] == "walk"],
        lambda r: bool(r["names"]))  # fmt: skip
    bar("confident and wrong, of all <= 1 %", both, "wrong")
    bar("truth in the class, strength >= 100: >= 98 %", strong, "in_class")
    bar("truth first, strength >= 100: >= 92 %", strong, "first")
    bar("exact and alone, strength 30", [r for r in groups["single"] if r["strength"] < STRONG], "exact")
    bar("exact and alone, strength 100", [r for r in strong if r["strength"] < 200], "exact")
    bar("exact and alone, strength >= 400", stronger, "exact")
    bar("in the class, strength >= 400", stronger, "in_class")
    bar("pairs exact >= 88 %", groups["pair"], "exact")
    bar("pairs: two names, each truth in the class of one", groups["pair"],
        lambda r: bool(r["in_class"] and len(r["names"]) == 2 and not r["wrong"]))  # fmt: skip
    bar("outside of the library refused >= 97 %", groups["open"], "refused")
    bar("what a design cannot show is said >= 95 %", groups["blind"], "said_blind")
    bar("withheld from the model, named first and alone", groups["withheld"], "exact")
    bar("a fault of the data is told", groups["fault"], "seen")
    bar("a fault of the data gets the name of an effect: 0", groups["fault"], lambda r: bool(r["names"]))
    middle("error of parameters, median, strength >= 400: <= 8 %", stronger, "errors")
    bar("95 % intervals hold the truth: 93 to 97 %",
        [{"design": r["design"], "holds": c} for r in strong for c in r["covered"]], "holds")  # fmt: skip
    middle("located interval, IoU, median >= 0.7", [r for r in both if r["interval"]], "iou")
    middle("channels, F1, mean >= 0.95", strong, "channels_f1", np.mean)
    middle("share of the explainable misfit closed on held-out data, median >= 0.85", strong, "closed")
    middle("seconds a case, median", both, "seconds")
    bar("ended in an error", both, lambda r: r["trouble"] is not None)
    lines = [*bars.lines, "", *_nulls(groups["null"], designs), "", *_effects(groups["single"], designs)]
    heads = {"open": ("outside of the library", "refused"), "blind": ("cannot be shown", "said_blind"),
             "withheld": ("withheld from the model", "exact"), "fault": ("fault of the data", "seen")}  # fmt: skip
    for group, (head, right) in heads.items():
        lines += _sorts(groups[group], head, right)
    absent = sorted(r["name"].removeprefix("real/single/") for r in rows if r.get("not_made"))
    if absent:
        lines += ["", f"Not made, since a plausible size would not be as strong: {', '.join(absent)}."]
    return "\n".join(lines) + "\n"


def _answers(rows: Iterable[Row]) -> str:
    reported = [r["verdict"] + (": " + "+".join(r["names"]) if r["names"] else "") for r in rows]
    return "; ".join(f"{answer} x{count}" if count > 1 else answer
                     for answer, count in sorted({a: reported.count(a) for a in reported}.items()))  # fmt: skip


def _nulls(rows: list[Row], designs: dict[str, str]) -> list[str]:
    lines = ["| null: design | noise | alarm | a name | answers |", "|---|---|---|---|---|"]
    for design, noise in dict.fromkeys((r["design"], r["noise"]) for r in rows):
        chosen = [r for r in rows if (r["design"], r["noise"]) == (design, noise)]
        lines.append(f"| {designs[design]} | {noise} | {share(chosen, 'alarm')} |"
                     f" {share(chosen, lambda r: bool(r['names']))} | {_answers(chosen)} |")  # fmt: skip
    return lines


def _effects(rows: list[Row], designs: dict[str, str]) -> list[str]:
    lines = [
        "| effect | design | strength | exact | in class | wrong | other answers |",
        "|---|---|---|---|---|---|---|",
    ]

    def key(r: Row) -> tuple[str, str, float]:
        return next(iter(r["truth"])), r["design"], round(r["strength"], -1) if r["strength"] > STRONG else 30

    for effect, design, strength in sorted({key(r) for r in rows}):
        chosen = [r for r in rows if key(r) == (effect, design, strength)]
        counts = " | ".join(f"{sum(r[w] for r in chosen)}/{len(chosen)}" for w in ("exact", "in_class", "wrong"))
        others = _answers(r for r in chosen if not r["exact"])
        lines.append(f"| {effect} | {designs[design]} | {strength:g} | {counts} | {others} |")
    return lines


def _sorts(rows: list[Row], head: str, right: str) -> list[str]:
    if not rows:
        return []
    lines = ["", f"| {head} | design | right | wrong | other answers |", "|---|---|---|---|---|"]

    def key(r: Row) -> tuple[str, str]:
        return "+".join(r["truth"]), r["design"]

    for sort in sorted({key(r) for r in rows}):
        chosen = [r for r in rows if key(r) == sort]
        others = _answers(r for r in chosen if not r[right])
        lines.append(f"| {sort[0]} | {sort[1]} | {sum(r[right] for r in chosen)}/{len(chosen)} |"
                     f" {sum(r['wrong'] for r in chosen)} | {others} |")  # fmt: skip
    return lines


def methods_table(answered: dict[str, dict[str, Row]]) -> str:
    """Ways to answer side by side, each on the cases that all of them were given: name of the way -> case -> answer.

    An answer is `judged`, or what `plain` makes of the bare names of a regression.
    """
    common = set.intersection(*(set(rows) for rows in answered.values()))
    lines = [
        "| way | design | any alarm on nulls | a name on nulls | exact and alone, 100 | 400"
        " | confident and wrong, of all | outside of the library: a name | names a case (nulls aside)"
        " | error of parameters, median, >= 400 |",
        "|---" * 10 + "|",
    ]
    for design, words in DESIGNS.items():
        for way, rows in answered.items():
            chosen = [r for name, r in sorted(rows.items()) if name in common and r["design"] == design]
            if not chosen:
                continue
            single = [r for r in chosen if r["group"] == "single"]
            stronger = [r for r in single if r["strength"] >= STRONGER]
            errors = [e for r in stronger for e in r["errors"]]
            named = [len(r["names"]) for r in chosen if r["group"] != "null"]
            cells = [
                share([r for r in chosen if r["group"] == "null"], "alarm"),
                share([r for r in chosen if r["group"] == "null"], lambda r: bool(r["names"])),
                share([r for r in single if STRONG <= r["strength"] < 200], "exact"),
                share(stronger, "exact"),
                share(chosen, "wrong"),
                share([r for r in chosen if r["group"] == "open"], lambda r: bool(r["names"])),
                f"{np.mean(named):.2f}" if named else "no case",
                f"{np.median(errors):.3g} ({len(errors)})" if errors else "-",
            ]
            lines.append(f"| {way} | {words} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def plain(row: Row, names: list[str]) -> Row:
    """A row as the comparison wants it, from names alone: nothing is refused, no class is told."""
    truth = set(row["truth"]) if row["group"] in ("single", "pair") else set()
    return row | {
        "alarm": bool(names), "names": names, "exact": bool(names) and set(names) == truth,
        "wrong": bool(set(names) - truth), "errors": [],
    }  # fmt: skip
