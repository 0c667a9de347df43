"""Run `highside diagnose` over the sealed deck and write the table.

    python tests/blind/score.py [--seed HASH] [--small] [--jobs 2] [--only PREFIX] [--out FOLDER]

Without --seed the deck is that of the commit that froze the engine. Every case goes through the command itself: files
in, `diagnosis.json` out. The answers are kept line by line in FOLDER/answers.jsonl, so an interrupted run goes on
where it was; FOLDER/table.md is made from them.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import deck
import numpy as np

Row = dict[str, Any]


# --- one case ------------------------------------------------------------------------------------------------------


def write_case(case: deck.Case, folder: Path) -> tuple[Path, Path]:
    """The files that the command gets."""
    recording, model = folder / "rec.csv", folder / "model.toml"
    names = list(case.columns)
    lines = [",".join(names)]
    lines += [",".join(map(repr, row)) for row in zip(*(case.columns[n].tolist() for n in names), strict=True)]
    recording.write_text("\n".join(lines) + "\n")
    model.write_text(case.model)
    return recording, model


_MADE: dict[str, Callable[[], deck.Case]] = {}
"""the deck, made before the workers are"""


def run_case(name: str) -> Row:
    """What the command answers to a case, with the case's truth beside it."""
    from highside.cli.main import app

    case = _MADE[name]()
    with tempfile.TemporaryDirectory(prefix="deck-") as place:
        folder = Path(place)
        recording, model = write_case(case, folder)
        began = time.perf_counter()
        trouble = None
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                app(["diagnose", str(recording), "--model", str(model), "--out", str(folder)], standalone_mode=False)
        except BaseException as error:
            # a case that ends in an error is a result, and is counted
            trouble = f"{type(error).__name__}: {error}"
        seconds = time.perf_counter() - began
        path = folder / "diagnosis.json"
        answer = json.loads(path.read_text()) if path.exists() else None
    return {
        "name": case.name, "group": case.group, "design": case.design, "noise": case.noise, "strength": case.strength,
        "truth": case.truth, "channels": case.channels, "interval": case.interval, "seconds": seconds,
        "trouble": None if answer is not None else trouble, "answer": answer,
    }  # fmt: skip


# --- judging -------------------------------------------------------------------------------------------------------

CLAIMING = ("named", "named_plus")


def judged(row: Row) -> Row:
    """What of an answer is right."""
    answer = row["answer"] or {"verdict": "failed", "claims": [], "not_testable": [], "location": [], "fit": {}}
    truth = list(row["truth"])
    claims = answer["claims"] if answer["verdict"] in CLAIMING else []
    classes = [set(c["equivalence_class"]) | {c["effect"]} for c in claims]
    inside = [any(t in members for members in classes) for t in truth]
    known = row["group"] in ("single", "pair")
    wrong = [c["effect"] for c, members in zip(claims, classes, strict=True) if not (known and members & set(truth))]
    found: Row = {
        "verdict": answer["verdict"],
        "names": [c["effect"] for c in claims],
        "alarm": answer["verdict"] not in ("nothing_left_out", "not_testable"),
        "detected": answer["verdict"] not in ("nothing_left_out", "not_testable", "failed"),
        "wrong": bool(wrong),
        "exact": {c["effect"] for c in claims} == set(truth) and bool(claims),
        "first": bool(claims) and claims[0]["effect"] in truth,
        "in_class": bool(inside) and all(inside),
        "refused": not claims and answer["verdict"] in ("partial", "unknown", "wander", "implausible_fit"),
        "said_blind": any(t in {n["effect"] for n in answer["not_testable"]} for t in truth),
        "channels_f1": _f1(answer["location"], row["channels"]),
        "iou": _iou(answer["location"], row["interval"]),
        "closed": _closed(answer["fit"]),
        "errors": [], "covered": [],
    }  # fmt: skip
    if row["group"] == "null":
        # a walk is something that the noise does; to say so is right, to name a cause is not
        found["alarm"] = found["alarm"] and not (row["noise"] == "walk" and answer["verdict"] == "wander")
    for claim in claims:
        if known and claim["effect"] in row["truth"]:
            _parameters(claim, row["truth"][claim["effect"]], found)
    return found


def _parameters(claim: Row, truth: deck.Values, found: Row) -> None:
    sizes = {n: v for n, v in truth.items() if not deck._is_shape(n, truth) and n in claim["parameters"]}
    if not sizes:
        return
    told = {name: claim["parameters"][name] for name in sizes}
    true = np.array(list(sizes.values()))
    factor = {n: _unit(told[n].get("unit", "")) for n in sizes}
    value = np.array([told[n]["value"] * factor[n] for n in sizes])
    if np.linalg.norm(true) > 0.0:
        found["errors"].append(float(np.linalg.norm(value - true) / np.linalg.norm(true)))
    for name, v in sizes.items():
        low, high = told[name]["low"], told[name]["high"]
        if low is not None and high is not None:
            found["covered"].append(bool(low * factor[name] <= v <= high * factor[name]))


def _unit(unit: str) -> float:
    """From the unit of a report to that of the deck (g, rad, s, m)."""
    return {"mrad": 1e-3, "urad": 1e-6, "deg": math.pi / 180, "ug": 1e-6, "mg": 1e-3, "ms": 1e-3, "mm": 1e-3}.get(
        unit, 1.0
    )


def _f1(location: list[Row], truth: list[str] | tuple[str, ...]) -> float | None:
    if not truth or not location:
        return None
    told = {c for place in location for c in place["channels"]}
    both = len(told & set(truth))
    return 2.0 * both / (len(told) + len(truth))


def _iou(location: list[Row], interval: list[Any] | None) -> float | None:
    if interval is None:
        return None
    covariate, low, high = interval
    best = 0.0
    for place in location:
        if place["covariate"] not in (covariate, {"tf_ref_deg": "rotor_deg"}.get(covariate)):
            continue
        told = [(float(a), float(b)) for a, b in place["intervals"] or []]
        common = sum(max(min(b, high) - max(a, low), 0.0) for a, b in told)
        union = sum(b - a for a, b in told) + (high - low) - common
        best = max(best, common / union if union > 0 else 0.0)
    return best


def _closed(fit: Row) -> float | None:
    names = ("heldout_rmse_before", "heldout_rmse_after", "noise_floor")
    if any(fit.get(name) is None for name in names):
        return None
    before, after, floor = (float(fit[name]) for name in names)
    room = before**2 - floor**2
    return (before**2 - after**2) / room if room > 0.02 * before**2 else None


# --- the table -----------------------------------------------------------------------------------------------------


def wilson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a share."""
    if n == 0:
        return 0.0, 1.0
    z, p = 1.959964, hits / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def share(rows: Iterable[Row], what: str | Callable[[Row], bool]) -> str:
    """'hits of n, share [interval]' of rows."""
    rows = list(rows)
    hits = sum(bool(what(r) if callable(what) else r[what]) for r in rows)
    if not rows:
        return "no case"
    low, high = wilson(hits, len(rows))
    return f"{100 * hits / len(rows):.1f} % [{100 * low:.1f}, {100 * high:.1f}] ({hits} of {len(rows)})"


def table(rows: list[Row], seed: str) -> str:
    """The whole table as Markdown."""
    both = [r | judged(r) for r in rows]
    groups = {g: [r for r in both if r["group"] == g] for g in ("null", "single", "pair", "open", "blind")}
    strong = [r for r in groups["single"] if r["strength"] >= 99.0]
    lines = [
        f"Deck of seed `{seed[:12]}`: {len(both)} cases; shares with their 95 % intervals (Wilson).",
        "",
        "| bar | stepped session | rotation | both |",
        "|---|---|---|---|",
    ]

    def bar(text: str, cases: list[Row], what: str | Callable[[Row], bool]) -> None:
        cells = [share([r for r in cases if r["design"] == d], what) for d in ("poses", "rotation")]
        lines.append(f"| {text} | {cells[0]} | {cells[1]} | {share(cases, what)} |")

    def middle(text: str, cases: list[Row], what: str, unit: str = "") -> None:
        cells = []
        for chosen in (*([r for r in cases if r["design"] == d] for d in ("poses", "rotation")), cases):
            values = [v for r in chosen for v in (r[what] if isinstance(r[what], list) else [r[what]]) if v is not None]
            cells.append(f"{np.median(values):.3g}{unit} ({len(values)})" if values else "no case")
        lines.append(f"| {text} | {' | '.join(cells)} |")

    bar("any alarm on nulls <= 3 %", groups["null"], "alarm")
    bar("a name on nulls", groups["null"], lambda r: bool(r["names"]))
    bar("a name on nulls with a walk <= 5 %", [r for r in groups["null"] if r["noise"] == "walk"],
        lambda r: bool(r["names"]))  # fmt: skip
    bar("confident and wrong, of all <= 1 %", both, "wrong")
    bar("truth in the class, strength >= 100: >= 98 %", strong, "in_class")
    bar("truth first, strength >= 100: >= 92 %", strong, "first")
    bar("exact and alone, strength 100", [r for r in strong if r["strength"] < 200], "exact")
    bar("exact and alone, strength >= 400", [r for r in strong if r["strength"] >= 399], "exact")
    bar("exact and alone, strength 30", [r for r in groups["single"] if r["strength"] < 99], "exact")
    bar("pairs exact >= 88 %", groups["pair"], "exact")
    bar("outside of the library refused >= 97 %", groups["open"], "refused")
    bar("what a design cannot show is said >= 95 %", groups["blind"], "said_blind")
    middle(
        "error of parameters, median, strength >= 400: <= 8 %", [r for r in strong if r["strength"] >= 399], "errors"
    )
    intervals = [{"design": r["design"], "holds": c} for r in strong for c in r["covered"]]
    bar("95 % intervals hold the truth: 93 to 97 %", intervals, "holds")
    middle("located interval, IoU, median >= 0.7", [r for r in both if r["interval"]], "iou")
    lines.append(
        f"| channels, F1, mean >= 0.95 | {_mean(strong, 'poses')} | {_mean(strong, 'rotation')} | {_mean(strong)} |"
    )
    middle("share of the explainable misfit closed on held-out data, median >= 0.85", strong, "closed")
    middle("seconds a case, median", both, "seconds")
    bar("ended in an error", both, lambda r: r["trouble"] is not None)
    lines += ["", "| null, noise | stepped session: alarm | named | rotation: alarm | named |", "|---|---|---|---|---|"]
    for noise in deck.NOISES:
        cells = []
        for design in ("poses", "rotation"):
            chosen = [r for r in groups["null"] if r["noise"] == noise and r["design"] == design]
            cells += [share(chosen, "alarm"), share(chosen, lambda r: bool(r["names"]))]
        lines.append(f"| {noise} | {' | '.join(cells)} |")
    lines += [
        "",
        "| effect | design | strength | exact | in class | wrong | other answers |",
        "|---|---|---|---|---|---|---|",
    ]
    keys = sorted({(next(iter(r["truth"])), r["design"], round(r["strength"], -1) if r["strength"] > 99 else 30)
                   for r in groups["single"]})  # fmt: skip
    for effect, design, strength in keys:
        chosen = [r for r in groups["single"] if next(iter(r["truth"])) == effect and r["design"] == design
                  and (round(r["strength"], -1) if r["strength"] > 99 else 30) == strength]  # fmt: skip
        others = [
            f"{r['verdict']}{': ' + '+'.join(r['names']) if r['names'] else ''}" for r in chosen if not r["exact"]
        ]
        counts = [sum(r[w] for r in chosen) for w in ("exact", "in_class", "wrong")]
        lines.append(
            f"| {effect} | {design} | {strength:g} | " + " | ".join(f"{c}/{len(chosen)}" for c in counts)
            + f" | {'; '.join(others)} |"
        )  # fmt: skip
    for group, head in (("open", "outside of the library"), ("blind", "a design that cannot show it")):
        lines += ["", f"| {head} | design | right | wrong | answers |", "|---|---|---|---|---|"]
        right = "refused" if group == "open" else "said_blind"
        for key in sorted({(r["name"].rsplit("/", 1)[0], r["design"]) for r in groups[group]}):
            chosen = [r for r in groups[group] if (r["name"].rsplit("/", 1)[0], r["design"]) == key]
            others = [
                f"{r['verdict']}{': ' + '+'.join(r['names']) if r['names'] else ''}" for r in chosen if not r[right]
            ]
            lines.append(f"| {key[0].split('/', 2)[2]} | {key[1]} | {sum(r[right] for r in chosen)}/{len(chosen)} |"
                         f" {sum(r['wrong'] for r in chosen)} | {'; '.join(others)} |")  # fmt: skip
    return "\n".join(lines) + "\n"


def _mean(rows: list[Row], design: str | None = None) -> str:
    values = [r["channels_f1"] for r in rows if r["channels_f1"] is not None and design in (None, r["design"])]
    return f"{np.mean(values):.3f} ({len(values)})" if values else "no case"


# --- running -------------------------------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", help="of the deck; the commit that froze the engine where absent")
    parser.add_argument("--small", action="store_true", help="a tenth of the deck")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", help="cases whose name begins so")
    parser.add_argument("--out", type=Path, default=Path("blind-deck"))
    given = parser.parse_args()
    seed = given.seed or deck.frozen_seed()
    size = deck.Size(3, 1, (100.0, 400.0), 0, 4, 2, 1) if given.small else deck.Size()
    given.out.mkdir(parents=True, exist_ok=True)
    answers = given.out / f"answers-{seed[:12]}.jsonl"
    kept = [json.loads(line) for line in answers.read_text().splitlines()] if answers.exists() else []
    done = {row["name"]: row for row in kept}
    _MADE.update(deck.cases(seed, size))
    todo = [name for name in _MADE if name.startswith(given.only) and name not in done]
    began = time.perf_counter()
    with multiprocessing.Pool(given.jobs, maxtasksperchild=200) as pool, answers.open("a") as file:
        for number, row in enumerate(pool.imap_unordered(run_case, todo, chunksize=1), 1):
            file.write(json.dumps(row) + "\n")
            file.flush()
            done[row["name"]] = row
            verdict = row["answer"]["verdict"] if row["answer"] else row["trouble"]
            print(
                f"{number:4d} of {len(todo)}  {time.perf_counter() - began:6.0f} s  {row['name']}: {verdict}",
                flush=True,
            )
    chosen = [row for name, row in done.items() if name.startswith(given.only)]
    text = table(chosen, seed)
    (given.out / "table.md").write_text(text)
    print(text, flush=True)


if __name__ == "__main__":
    main()
