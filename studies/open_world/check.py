"""Make the cases of a scored deck again and compare: nobody has changed an answer or a case since.

    python -m studies.open_world.check FILE [--every N] [--seal MANIFEST]

FILE is a manifest (of `draw`, or `sealed-COMMIT.json` beside this module) or a file of answers (of `score`). Every case
is drawn again from its seed alone; its answer must have the SHA-256 that was written down. The seed is the hash of the
commit that froze the engine, so that no case existed while the engine was worked on. Exit status 1 where one differs.
--seal writes the manifest of a file of answers that is as it was sealed.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

from studies.sealed.deck import ROOT

from . import answers
from .score import every_case, written


def read(path: Path) -> tuple[str, dict[str, str]]:
    """Seed, and the hash of each answer."""
    if path.suffix == ".jsonl":
        short = re.search(r"-of-(.+)$", path.stem)
        if short is None:
            raise SystemExit(f"{path}: its name says no seed; give --seed")
        return _whole(short[1]), {row["name"]: row["hash"] for row in written(path)}
    manifest = json.loads(path.read_text())
    if answers.seal(manifest["answers"]) != manifest["seal"]:
        raise SystemExit(f"{path}: the seal is not that of its answers; somebody has changed it")
    return manifest["seed"], manifest["answers"]


def _whole(seed: str) -> str:
    """The commit that a file's name has the beginning of; another seed as it is."""
    if not re.fullmatch("[0-9a-f]{12}", seed):
        return seed
    found = subprocess.run(["git", "rev-parse", seed], cwd=ROOT, capture_output=True, text=True, check=False)
    return found.stdout.strip() if found.returncode == 0 else seed


def changed(seed: str, hashes: dict[str, str]) -> list[str]:
    """Names of cases whose answer is not what its hash says."""
    makers = every_case(seed, tuple({name.split("/")[0] for name in hashes}))
    return [
        name for name, known in hashes.items()
        if name not in makers or answers.hash_of_answer(makers[name]().answer()) != known
    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--seed", help="where the file says only the beginning of it")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--seal", type=Path, help="write seed, hashes and their one hash into this file")
    given = parser.parse_args()
    seed, hashes = read(given.file)
    seed = given.seed or seed
    hashes = dict(list(hashes.items())[:: given.every])
    wrong = changed(seed, hashes)
    for name in wrong:
        print(f"{name}: the answer is not what was sealed")
    print(f"{len(hashes) - len(wrong)} of {len(hashes)} answers as sealed")
    if given.seal and not wrong:
        manifest = {"seed": seed, "seal": answers.seal(hashes), "answers": hashes}
        given.seal.write_text(json.dumps(manifest, indent=1, sort_keys=True) + "\n")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
