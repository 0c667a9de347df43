"""Draw cases: their files, and apart from these their answers, with the hashes that seal both.

    python -m studies.open_world.draw [--seed HASH] [--groups ...] [--every N] [--only PREFIX] [--out FOLDER]

FOLDER/cases/NAME/ has what the command is given (`a.csv`, `b.csv`, `prediction.csv`, `model.toml`),
FOLDER/answers/NAME.json what is hidden, FOLDER/manifest.json the seed and a SHA-256 of each of both.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from studies.sealed.deck import frozen_seed

from . import answers
from .score import GROUPS, every_case, ordered


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed")
    parser.add_argument("--groups", default=",".join(GROUPS))
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--only", default="")
    parser.add_argument("--out", type=Path, default=Path("open-world-deck"))
    given = parser.parse_args()
    seed = given.seed or frozen_seed()
    makers = every_case(seed, tuple(given.groups.split(",")))
    names = ordered(seed, [name for name in makers if name.startswith(given.only)])[:: given.every]
    (given.out / "answers").mkdir(parents=True, exist_ok=True)
    hashes: dict[str, str] = {}
    files: dict[str, str] = {}
    for name in names:
        case = makers[name]()
        folder = given.out / "cases" / name.replace("/", "_")
        answers.write(case, folder)
        answer = case.answer()
        (given.out / "answers" / f"{name.replace('/', '_')}.json").write_text(json.dumps(answer, default=float))
        hashes[name], files[name] = answers.hash_of_answer(answer), answers.hash_of_files(folder)
    manifest = {"seed": seed, "seal": answers.seal(hashes), "answers": hashes, "files": files}
    (given.out / "manifest.json").write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n")
    print(f"{len(names)} cases, sealed by {manifest['seal']}")


if __name__ == "__main__":
    main()
