"""What a case is, its files, and its answer apart from them, with a hash that anyone can make again."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .laws import Law
from .world import AZIMUTH_DEG, G_MPS2, LATITUDE_DEG, Columns, Session

FIGURES = 6
"""of a number that goes into a hash: what every machine's library of functions agrees in"""


@dataclass
class Case:
    """One case: what the command is given, and what only the scorer may open."""

    name: str
    group: str
    """law | null | known | sweep | table | hand | beside | real"""
    design: str
    """poses | rotation | hand | rest | beside"""
    recording: Columns
    model: str
    noise: str = "white"
    strength: float = 0.0
    second: Columns | None = None
    """another session of the same sensor"""
    prediction: Columns | None = None
    """another program's output, for --simulation"""
    laws: tuple[Law, ...] = ()
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    """of the library, with their sizes"""
    right: tuple[str, ...] = ()
    """names that are right as well, with a star where any with that beginning is"""
    hidden: np.ndarray | None = None
    """(C, n) what is hidden in the first session, without noise, off the base fit, in units of the noise of a row"""
    kept_from: np.ndarray | None = None
    """(C, n) the same of the second, in g and rad/s; NaN where the first has not visited its covariates"""
    sigma: tuple[float, ...] = ()
    """of a row, g and rad/s"""
    first: Session | None = None
    other: Session | None = None
    note: str = ""

    def answer(self) -> dict[str, Any]:
        """What is sealed: the truth in plain numbers."""
        return {
            "name": self.name, "group": self.group, "design": self.design, "noise": self.noise,
            "strength": self.strength, "laws": [law.plain() for law in self.laws], "effects": self.effects,
            "right": list(self.right), "note": self.note,
        }  # fmt: skip


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.{FIGURES}g}")
    return int(value) if isinstance(value, np.integer) else value


def hash_of_answer(answer: dict[str, Any]) -> str:
    """SHA-256 of an answer, its numbers to six figures."""
    return hashlib.sha256(json.dumps(_rounded(answer), sort_keys=True).encode()).hexdigest()


def hash_of_files(folder: Path) -> str:
    """SHA-256 of the files of a case, by name and content."""
    found = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        found.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


def seal(hashes: dict[str, str]) -> str:
    """One hash of a deck from those of its cases."""
    return hashlib.sha256("\n".join(f"{name} {hashes[name]}" for name in sorted(hashes)).encode()).hexdigest()


def model_of(s: Session, *, noise_g: float | None = None, extra: str = "") -> str:
    """The model file that goes with a session on a bench."""
    free = ["bias", "scale", "misalignment"]
    included = "[]"
    if s.gyros:
        free += ["gyro_bias", "gyro_scale", "gyro_misalignment"]
        included = '["earth_rotation"]\n[effects.earth_rotation]\nshare = 1.0'
    reported = "" if noise_g is None else f"noise_g = {noise_g:.3e}\n"
    return (
        f"[sensor]\n{reported}free = {json.dumps(free)}\n[site]\n"
        f"gravity_mps2 = {G_MPS2}\nlatitude_deg = {LATITUDE_DEG}\n"
        f"azimuth_deg = {AZIMUTH_DEG}\n[effects]\nincluded = {included}\n{extra}"
    )


def write(case: Case, folder: Path) -> None:
    """The files that the command is given."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {"a.csv": case.recording, "b.csv": case.second, "prediction.csv": case.prediction}
    for name, columns in files.items():
        if columns is not None:
            (folder / name).write_text(_csv(columns))
    (folder / "model.toml").write_text(case.model)


def _csv(columns: Columns) -> str:
    lines = [",".join(columns)]
    lines += [",".join(map(repr, row)) for row in zip(*(v.tolist() for v in columns.values()), strict=True)]
    return "\n".join(lines) + "\n"
