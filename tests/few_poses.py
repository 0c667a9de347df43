"""The model of the bench with fewer poses: a diagnosis of its session names the same, in a third of the time."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
INSTEAD = {
    "inclinations_deg": "[3.006, 30.006, 59.994, 90.0]",
    "toolfaces_deg": "[0, 72, 144, 216, 288]",
    # so that the tilt stands out in 20 poses as it does in 44
    "tilt_x_deg": "0.05",
}


def model_of_few_poses(path: Path, instead: dict[str, str] = INSTEAD) -> Path:
    """Write `config/model-bench.toml` with some values in place of its own; the path."""
    text = (ROOT / "config" / "model-bench.toml").read_text()
    for name, value in instead.items():
        text, lines = re.subn(rf"^{name} = .*$", f"{name} = {value}", text, flags=re.MULTILINE)
        assert lines == 1, name
    path.write_text(text)
    return path
