"""Run `highside diagnose` over the sealed decks and write the table.

    python -m studies.sealed.score [--seed HASH] [--real] [--without colour|refit|refusal] [--rivals] [--small]
                                [--every N] [--jobs 2] [--only PREFIX] [--out FOLDER]

Without --seed the deck is that of the commit that froze the engine, and what answers is the package as it was at that
commit, taken out of the history: edits of the tree during a run of hours do not reach it. So it is with any --seed that
is a whole commit hash; with any other seed the tree itself answers. Every case goes through the command itself: files
in, `diagnosis.json` out. The answers are kept line by line in FOLDER, so an interrupted run goes on where it was:

    answers-SEED.jsonl                  the deck of simulated worlds
    real-SEED.jsonl                     --real: effects put into real recordings (real_noise.py)
    answers-SEED-without-PART.jsonl     --without: a part of the method left out (highside.diagnosis.core.method)
    rivals-SEED.jsonl                   --rivals: sparse regressions of well-kept libraries (baselines.py)

FOLDER/table.md is made anew from all of them that are there.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import multiprocessing
import os
import random
import re
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from . import deck, real_noise, table
from .judging import judged

Row = dict[str, Any]
PARTS = ("colour", "refit", "refusal")


def write_case(case: deck.Case, folder: Path) -> tuple[Path, Path]:
    """The files that the command gets."""
    recording, model = folder / "rec.csv", folder / "model.toml"
    names = list(case.columns)
    lines = [",".join(names)]
    lines += [",".join(map(repr, row)) for row in zip(*(case.columns[n].tolist() for n in names), strict=True)]
    recording.write_text("\n".join(lines) + "\n")
    model.write_text(case.model)
    return recording, model


_MADE: dict[str, Callable[[], deck.Case | None]] = {}
"""the deck, made before the workers are"""


def about(case: deck.Case) -> Row:
    """What a row says of its case."""
    return {
        "name": case.name, "group": case.group, "design": case.design, "noise": case.noise, "strength": case.strength,
        "truth": case.truth, "channels": case.channels, "interval": case.interval, "settings": case.settings,
        "legit": case.legit,
    }  # fmt: skip


@contextlib.contextmanager
def leaving_out(part: str | None) -> Iterator[None]:
    """The command `diagnose` without a part of the procedure; all of it for None."""
    from highside.api import diagnosis as api
    from highside.diagnosis.core.method import ProcedureParts

    if part is None:
        yield
        return
    with mock.patch.object(api, "diagnose", partial(api.diagnose, method=ProcedureParts.without(part))):
        yield


def run_case(name: str, without: str | None = None) -> Row:
    """What the command answers to a case, with the case's truth beside it."""
    from highside.cli.main import app

    case = _MADE[name]()
    if case is None:
        return {"name": name, "not_made": True, "answer": None, "trouble": "not made"}
    with tempfile.TemporaryDirectory(prefix="deck-") as place:
        folder = Path(place)
        recording, model = write_case(case, folder)
        words = ["diagnose", str(recording), "--model", str(model), "--out", str(folder)]
        began = time.perf_counter()
        trouble = None
        try:
            with leaving_out(without), contextlib.redirect_stdout(io.StringIO()):
                app(words, standalone_mode=False)
        except BaseException as error:
            # a case that ends in an error is a result, and is counted
            trouble = f"{type(error).__name__}: {error}"
        seconds = time.perf_counter() - began
        path = folder / "diagnosis.json"
        answer = json.loads(path.read_text()) if path.exists() else None
    return {**about(case), "seconds": seconds, "trouble": None if answer is not None else trouble, "answer": answer}


def run_rivals(name: str) -> Row:
    """What sparse regressions answer to a case."""
    from . import baselines

    case = _MADE[name]()
    assert case is not None
    began = time.perf_counter()
    return {**about(case), "names": baselines.names_of(case), "seconds": time.perf_counter() - began}


def use_frozen(commit: str, folder: Path) -> None:
    """Take the package of a commit into a folder and let it be the one that is imported."""
    packed = subprocess.run(["git", "archive", commit, "src"], cwd=deck.ROOT, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as files:
        files.extractall(folder, filter="data")
    sys.path.insert(0, str(folder / "src"))
    import highside

    found = Path(str(highside.__file__)).resolve()
    if folder.resolve() not in found.parents:
        raise SystemExit(f"{found} would answer in place of the package of {commit}")


def written(path: Path) -> list[Row]:
    """Rows of an answers file."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def whole_table(folder: Path, seed: str) -> str:
    """The table of everything that was answered for a seed."""
    short = seed[:12]
    lines = [f"Seed `{short}`. Shares with their 95 % intervals (Wilson); medians and means with the number of values."]
    simulated, real = written(folder / f"answers-{short}.jsonl"), written(folder / f"real-{short}.jsonl")
    if simulated:
        lines += ["", f"## Simulated worlds: {len(simulated)} cases", "", table.deck_table(simulated, table.DESIGNS)]
    if real:
        lines += ["", f"## Real noise: {len(real)} cases", "", table.deck_table(real, table.REAL_DESIGNS)]
    whole = {"this engine": {r["name"]: r | judged(r) for r in simulated}}
    words = {"colour": "white noise assumed", "refit": "no joint refit", "refusal": "no refusal rule"}
    left_out = {words[part]: written(folder / f"answers-{short}-without-{part}.jsonl") for part in PARTS}
    ways = {way: {r["name"]: r | judged(r) for r in rows} for way, rows in left_out.items() if rows}
    if simulated and ways:
        lines += ["", "## What the parts of the method are worth", "", table.methods_table(whole | ways)]
    rivals = written(folder / f"rivals-{short}.jsonl")
    if simulated and rivals:
        names = rivals[0]["names"]
        ways = {way: {r["name"]: table.plain(r, r["names"][way]) for r in rivals} for way in names}
        lines += ["", "## Sparse regressions beside it", "", table.methods_table(whole | ways)]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", help="of the deck; the commit that froze the engine where absent")
    parser.add_argument("--real", action="store_true", help="the deck on real recordings")
    parser.add_argument("--without", choices=PARTS, help="leave a part of the method out")
    parser.add_argument("--rivals", action="store_true", help="sparse regressions in place of the command")
    parser.add_argument("--small", action="store_true", help="a tenth of the deck")
    parser.add_argument("--every", type=int, default=1, help="one case of so many, of each group and design")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", help="cases whose name begins so")
    parser.add_argument("--out", type=Path, default=Path("blind-deck"))
    given = parser.parse_args()
    if given.real and (given.without or given.rivals):
        parser.error("--without and --rivals are measured on the simulated worlds")
    seed = given.seed or deck.frozen_seed()
    if given.real:
        size = real_noise.Size((400.0,), 1, 2, 1) if given.small else real_noise.Size()
        _MADE.update(real_noise.cases(seed, size))
    else:
        _MADE.update(deck.cases(seed, deck.Size(3, 1, (100.0, 400.0), 0, 4, 2, 1) if given.small else deck.Size()))
    file_name = "real" if given.real else "rivals" if given.rivals else "answers"
    ending = f"-without-{given.without}" if given.without else ""
    given.out.mkdir(parents=True, exist_ok=True)
    answers = given.out / f"{file_name}-{seed[:12]}{ending}.jsonl"
    done = {row["name"] for row in written(answers)}
    wanted = [name for name in _MADE if name.startswith(given.only)]
    if given.without or given.rivals:
        # a design that cannot show an effect says nothing of the method's parts
        wanted = [name for name in wanted if not name.startswith("blind/")]
    todo = [name for name in wanted[:: given.every] if name not in done]
    random.Random(seed).shuffle(todo)  # cut short, the table is still one of the whole deck
    began = time.perf_counter()
    run = run_rivals if given.rivals else partial(run_case, without=given.without)
    frozen = tempfile.TemporaryDirectory(prefix="frozen-")
    if re.fullmatch("[0-9a-f]{40}", seed):
        use_frozen(seed, Path(frozen.name))
    with frozen, multiprocessing.Pool(given.jobs, maxtasksperchild=200) as pool, answers.open("a") as file:
        for number, row in enumerate(pool.imap_unordered(run, todo, chunksize=1), 1):
            file.write(json.dumps(row) + "\n")
            file.flush()
            reported = row["names"] if given.rivals else row["answer"]["verdict"] if row["answer"] else row["trouble"]
            print(
                f"{number:4d} of {len(todo)}  {time.perf_counter() - began:6.0f} s  {row['name']}: {reported}",
                flush=True,
            )
    text = whole_table(given.out, seed)
    (given.out / "table.md").write_text(text)
    print(text, flush=True)


if __name__ == "__main__":
    main()
