"""Run `highside diagnose`, and `highside predict` on the second session, over cases of the open world.

    python -m studies.open_world.score [--seed HASH] [--engine COMMIT] [--groups law,null,...] [--every N]
                        [--only PREFIX] [--laws N] [--design poses|rotation] [--minutes M] [--rivals] [--keep FOLDER]
                        [--out FOLDER]

Without --seed the deck is that of the commit that froze the engine and the package as it was at that commit answers;
--engine lets another commit answer the same cases. Every case goes through the command itself: files in,
`diagnosis.json` and the written model out. Answers are kept line by line, so that an interrupted run goes on where it
was; the order is shuffled by the seed, so that a run that is cut short is one of the whole deck. A line holds the hash
of the case's sealed answer: `python -m studies.open_world.check` makes the cases again and compares.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import re
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest import mock

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from studies.sealed.deck import frozen_seed
from studies.sealed.score import leaving_out, use_frozen

from . import ablations, answers, beside_simulation, by_hand, deck, judging, section_one
from .answers import Case
from .deck import Makers

Row = dict[str, Any]
GROUPS = ("law", "null", "known", "sweep", "table", "hand", "beside", "real")
CHANNELS = ("ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps")


def every_case(seed: str, groups: tuple[str, ...] = GROUPS, laws: int = deck.Size.laws) -> Makers:
    """Makers of all cases of some groups; so many laws."""
    found: Makers = {}
    if {"law", "null", "known", "sweep"} & set(groups):
        found |= deck.cases(seed, deck.Size(laws=laws))
    if "table" in groups:
        found |= section_one.cases(seed)
    if "hand" in groups:
        found |= by_hand.cases(seed)
    if "beside" in groups:
        found |= beside_simulation.cases(seed)
    if "real" in groups:
        from . import real

        found |= real.cases(seed)
    return {name: make for name, make in found.items() if name.split("/")[0] in groups}


def ordered(seed: str, names: list[str]) -> list[str]:
    """The order in which cases are answered: shuffled, but the strengths of a sweep together."""
    heads = sorted({name if not name.startswith("sweep/") else name.rsplit("/", 1)[0] for name in names})
    random.Random(seed).shuffle(heads)
    by_head: dict[str, list[str]] = {}
    for name in names:
        by_head.setdefault(name if not name.startswith("sweep/") else name.rsplit("/", 1)[0], []).append(name)
    return [name for head in heads for name in by_head[head]]


def command(*words: str) -> str | None:
    """Run a command of highside in this process; what went wrong, or None."""
    from highside.api.diagnosis import Diagnosis
    from highside.cli.main import app

    # the report is not judged, and its figures take a fifth of the time
    without_report = mock.patch.object(Diagnosis, "html", return_value="")
    try:
        with without_report, contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            app(list(words), standalone_mode=False)
    except BaseException as error:
        # a case that ends in an error is a result, and is counted
        if type(error).__name__ == "Exit":
            return None
        if isinstance(error, KeyboardInterrupt):
            raise
        return f"{type(error).__name__}: {error}"
    return None


def run_case(case: Case, folder: Path, without: str | None = None) -> Row:
    """What the command answers to a case, with the sealed answer beside it, and what its model predicts elsewhere."""
    answers.write(case, folder)
    words = ["diagnose", str(folder / "a.csv"), "--model", str(folder / "model.toml"), "--out", str(folder)]
    found = folder / "found.toml"
    words += (
        ["--simulation", str(folder / "prediction.csv")]
        if case.prediction is not None
        else ["--write-model", str(found)]
    )
    began = time.perf_counter()
    with ablations.leaving_out(without) if without in ablations.PARTS else leaving_out(without):
        trouble = command(*words)
    seconds = time.perf_counter() - began
    path = folder / "diagnosis.json"
    answer = json.loads(path.read_text()) if path.exists() else None
    truth = case.answer()
    row: Row = {
        "name": case.name, "group": case.group, "truth": truth, "hash": answers.hash_of_answer(truth),
        "seconds": seconds, "trouble": None if answer is not None else trouble, "answer": shortened(answer),
    }  # fmt: skip
    if answer is not None and case.first is not None and case.hidden is not None:
        row |= measured_names(case, answer)
    if case.other is not None and case.kept_from is not None:
        row["closed"], row["predict_trouble"] = 0.0, None
        if found.exists():
            row["closed"], row["predict_trouble"] = confirmed(case, folder)
    return row


def confirmed(case: Case, folder: Path) -> tuple[float | None, str | None]:
    """Share of the true contribution on the second session that the written model predicts."""
    assert case.other is not None and case.kept_from is not None
    out = folder / "predicted.csv"
    trouble = command("predict", str(folder / "found.toml"), str(folder / "b.csv"), "-o", str(out))
    if trouble is not None or not out.exists():
        import highside

        try:
            table: Any = highside.predict(str(folder / "found.toml"), dict(case.second or {}))
        except Exception as error:
            return 0.0, f"{trouble}; {type(error).__name__}: {error}"
    else:
        with out.open() as lines:
            names = lines.readline().strip().split(",")
            values = np.genfromtxt(lines, delimiter=",")
        table = dict(zip(names, values.T, strict=True))
    reported = np.stack([np.asarray(table[name], dtype=float) for name in CHANNELS[: len(case.kept_from)]])
    reported[3:] = np.radians(reported[3:])
    return judging.closed(case.other, case.kept_from, reported, case.sigma), None


def shortened(answer: Row | None) -> Row | None:
    """The parts of an answer that are judged or told of."""
    if answer is None:
        return None
    kept = ("effect", "place", "depends_on", "channels", "equivalence_class", "share", "heldout_gain", "stable",
            "shape_within", "resembles", "formula", "parameters")  # fmt: skip
    claims = [{key: claim[key] for key in kept if key in claim} for claim in answer["claims"]]
    return {
        "verdict": answer["verdict"],
        "claims": claims,
        "resembles": answer.get("remainder", {}).get("resembles", []),
    }


def measured_names(case: Case, answer: Row) -> Row:
    """How much of what is hidden lies outside of the names that were given, and what share they hold."""
    names = [c for c in answer["claims"] if not judging.is_law(c)]
    if not names or case.first is None or case.hidden is None:
        return {}
    from highside.physics.forward import ForwardModel
    from highside.physics.state import ChainState

    state = ChainState.from_columns(
        case.recording, gravity_mps2=9.80665, latitude_rad=np.radians(52.0), azimuth_rad=np.radians(30.0)
    )  # fmt: skip
    parts = []
    for claim in names:
        values = {n: p["value"] for n, p in claim["parameters"].items() if p["value"] is not None}
        try:
            model = ForwardModel.of({claim["effect"]: values})
            accel = np.asarray(model.jacobian(state))
            gyro = np.asarray(model.gyro_jacobian(state)) if case.first.gyros else None
        except Exception:
            # an effect without derivatives has no column that could hold anything
            continue
        parts.append(accel if gyro is None else np.concatenate([accel, gyro], axis=1))
    columns = np.concatenate(parts) if parts else np.zeros((0, *case.hidden.shape))
    left = judging.outside(case.first, case.hidden, columns, case.sigma)
    whole = float(np.sum(case.hidden**2))
    return {"outside": left, "captured": 1.0 - left / whole if whole > 0 else 0.0}


def written(path: Path) -> list[Row]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", help="of the deck; the commit that froze the engine where absent")
    parser.add_argument("--engine", help="commit whose package answers, where it is not that of the seed")
    parser.add_argument("--groups", default=",".join(GROUPS))
    parser.add_argument("--laws", type=int, default=deck.Size.laws, help="cases of laws in the deck")
    parser.add_argument("--every", type=int, default=1, help="one case of so many, in the order of answering")
    parser.add_argument("--only", default="", help="cases whose name begins so, or so: separated by commas")
    parser.add_argument("--design", choices=deck.KINDS, help="of laws, nulls, known effects and sweeps: these alone")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after so long; a later run goes on")
    parser.add_argument(
        "--without", help="leave a part out: of `highside.diagnosis.core.method`, or floor, free_rivals, stability"
    )
    parser.add_argument(
        "--rivals", action="store_true", help="regressions of well-kept libraries on the pairs of sessions"
    )
    parser.add_argument("--keep", type=Path, help="keep the files of each case in this folder")
    parser.add_argument("--out", type=Path, default=Path("open-world"))
    given = parser.parse_args()
    seed = given.seed or frozen_seed()
    engine = given.engine or (seed if re.fullmatch("[0-9a-f]{40}", seed) else None)
    makers = every_case(seed, tuple(given.groups.split(",")), given.laws)
    asked = [name for name in makers if name.startswith(tuple(given.only.split(",")))]
    if given.design:
        asked = [name for name in asked if deck.kind_of(name) == given.design]
    names = ordered(seed, asked)[:: given.every]
    given.out.mkdir(parents=True, exist_ok=True)
    what = "rivals" if given.rivals else f"answers-{engine[:12] if engine else 'tree'}"
    what += f"-without-{given.without}" if given.without else ""
    path = given.out / f"{what}-of-{seed[:12]}.jsonl"
    done = {row["name"] for row in written(path)}
    todo = [name for name in names if name not in done]
    began = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="open-world-") as place, path.open("a") as file:
        if engine is not None and not given.rivals:
            use_frozen(engine, Path(place) / "frozen")
        for number, name in enumerate(todo, 1):
            if time.perf_counter() - began > 60.0 * given.minutes:
                break
            case = makers[name]()
            folder = (given.keep or Path(place)) / name.replace("/", "_")
            folder.mkdir(parents=True, exist_ok=True)
            for old in folder.iterdir():
                old.unlink()
            if given.rivals:
                from . import rivals

                row: Row | None = rivals.row_of(case)
            else:
                row = run_case(case, folder, given.without)
            if row is None:
                continue
            file.write(json.dumps(row, default=float) + "\n")
            file.flush()
            reported = row.get("ways") or _said(row)
            print(f"{number:4d} of {len(todo)} {time.perf_counter() - began:6.0f} s  {name}: {reported}", flush=True)


def _said(row: Row) -> str:
    found = judging.judged(row)
    hidden = [f"{law['place']}({', '.join(law['covariates'])})" for law in row["truth"]["laws"]] + list(
        row["truth"]["effects"]
    )
    truth = row["truth"]
    part = "" if found["closed"] is None else f" closed {found['closed']:.2f}"
    return (
        f"[{truth['noise']} {truth['strength']:.3g}] {hidden} {truth['note']} -> {found['verdict']} {found['names']}"
        f" {found['told']} = {found['bucket']}{part} ({row['seconds']:.1f} s) {row['trouble'] or ''}"
    )


if __name__ == "__main__":
    main()
