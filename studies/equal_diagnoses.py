"""The JSON of fifty diagnoses, for a change of the code that may not change an answer.

    python -m studies.equal_diagnoses FOLDER                  before the change: one NAME.json a case, and digests.json
    python -m studies.equal_diagnoses FOLDER --against OLD    after it: and compare; exit status 1 where one differs

Poses, rotations, hand sessions of |g|, recordings beside another program's output; nulls, effects of the library and
laws, under every noise; short ones, so that all of them take minutes. The cases are those of the
decks by a fixed seed, and every case goes through the command itself.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

from studies.open_world import answers, score
from studies.open_world.answers import Case
from studies.sealed import deck as library_deck

SEED = "equal diagnoses"
GROUPS = {"law": (10, 2100), "null": (12, 2500), "known": (6, 2000), "hand": (9, 13000), "beside": (5, 13000)}
"""cases of each group of the open world, and the rows that each may have"""
BEGINNINGS = (
    "single/poses/cogging/400/", "single/poses/thermal_lag/400/", "single/poses/bias_step/400/", "pair/poses/",
    "open/poses/bump at one toolface/", "open/poses/one ring off/", "null/poses/walk/", "blind/0/sag/",
)  # fmt: skip
"""of the names of the cases of the library's deck"""


def cases() -> Iterable[Case]:
    """All of them, in one order."""
    for group, (count, most) in GROUPS.items():
        makers = score.every_case(SEED, (group,))
        made = (makers[name]() for name in score.ordered(SEED, list(makers)))
        yield from islice((case for case in made if case.recording["t_s"].size <= most), count)
    makers = library_deck.cases(SEED, library_deck.Size())
    for beginning in BEGINNINGS:
        case = makers[next(name for name in makers if name.startswith(beginning))]()
        assert case is not None
        yield Case(case.name, case.group, case.design, case.columns, case.model)


def diagnosis(case: Case) -> str:
    """The command's `diagnosis.json`, or what went wrong."""
    with tempfile.TemporaryDirectory(prefix="equal-") as place:
        folder = Path(place)
        answers.write(case, folder)
        words = ["diagnose", str(folder / "a.csv"), "--model", str(folder / "model.toml"), "--out", str(folder)]
        words += [] if case.prediction is None else ["--simulation", str(folder / "prediction.csv")]
        trouble = score.command(*words)
        path = folder / "diagnosis.json"
        return path.read_text() if path.exists() else f"{trouble}\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--against", type=Path, help="folder of a run before")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    digests: dict[str, str] = {}
    for case in cases():
        text = diagnosis(case)
        (given.folder / f"{case.name.replace('/', '_').replace(' ', '-')}.json").write_text(text)
        digests[case.name] = hashlib.sha256(text.encode()).hexdigest()
        print(f"{len(digests):3d} {digests[case.name][:12]} {case.name}", flush=True)
    (given.folder / "digests.json").write_text(json.dumps(digests, indent=1) + "\n")
    if given.against is None:
        return
    before = json.loads((given.against / "digests.json").read_text())
    changed = [name for name in {**before, **digests} if before.get(name) != digests.get(name)]
    for name in changed:
        print(f"differs: {name}")
    print(f"{len(digests) - len(changed)} of {len(digests)} equal")
    sys.exit(1 if changed else 0)


if __name__ == "__main__":
    main()
