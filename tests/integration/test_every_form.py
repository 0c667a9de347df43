"""Every form that `export` writes is read by every command that takes a recording, with the same outcome."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from inside import highside_inside

from highside.api.diagnosis import diagnose
from highside.arrays import Array
from highside.diagnosis.core.method import ProcedureParts
from highside.physics.gravity import gravity_direction
from highside.recording.table import Recording, read_recording
from tests.few_poses import model_of_few_poses

FURTHER = pytest.mark.further
"""a case of a kind of which others stay in every run"""
FORMS = ("csv", "csv.gz", "parquet", "mcap")
"""what a recording may be: `simulate` writes the compressed one, `export` the others"""
COMMANDS = {
    "poses": ("calibrate", "poses", "{bench}", "-o", "{out}.csv"),
    "predict": ("predict", "{known}", "{bench}", "-o", "{out}.csv"),
    "export": ("export", "{bench}", "--to", "csv", "-o", "{out}.csv"),
    "apply": ("calibrate", "apply", "{cal}", "{bench}", "-o", "{out}.csv"),
    "diagnose": ("diagnose", "{bench}", "--model", "{known}", "--out", "{out}", "--no-report"),
    "beside": ("diagnose", "{turns}", "--model", "{known}", "--simulation", "{said}", "--out", "{out}", "--no-report"),
    "confirm": ("confirm", "{found}", "{bench}", "--json"),
    "import": ("import", "{bench}", "-o", "{out}.csv", "--yes"),
    "drift": ("drift", "{turns}", "--method", "kinematic", "--latitude-deg", "52", "-o", "{out}.csv"),
    "fit": ("rotation", "fit", "{turns}", "-o", "{out}.json"),
    "fit-self": ("rotation", "fit-self", "{turns}", "-o", "{out}.json"),
    "turntable": ("rotation", "turntable", "{turns}", "-o", "{out}.json"),
    "compare": ("rotation", "compare", "{turns}", "--json"),
    "compensate": ("rotation", "apply", "{comp}", "{turns}", "-o", "{out}.csv"),
    "watch": ("watch", "recording", "{turns}", "--calibration", "{cal}", "--out", "{out}"),
    "fleet": ("fleet", "diagnose", "{archive}", "--model", "{known}", "--out", "{out}", "--workers", "1"),
}
"""words of each; {out} is what it may write: a file, or a folder"""
NOT_OF_RECORDINGS = {
    "simulate", "decode", "replay", "demo", "docs", "examples", "detect", "doctor", "init", "run", "serve", "check",
    "schema", "fleet solve", "fleet drift", "fleet summary", "fleet archive", "fleet records", "effects", "effects new",
    "calibrate bench", "calibrate sessions", "calibrate solve", "calibrate show", "calibrate verify", "toolface set",
    "calibrate certificate", "calibrate iscwsa", "calibrate activate", "calibrate history", "calibrate rollback",
    "reproduce balance", "reproduce rotation", "reproduce drift", "keys new", "keys show", "keys sign", "keys verify",
    "surveys analyse", "surveys list", "surveys export", "toolface show", "watch propose",
    "users add", "users list", "users password", "users role", "users remove", "users acts",
}  # fmt: skip
"""They read the wire, tables of poses, records or nothing; `fleet drift` reads as `fleet diagnose` does."""
OF_THE_FILE = re.compile(r'"(id|sha256|name|source|file|path|recording|tool|made|created)": "[^"]*"')
"""What an outcome says of the file itself, or of the moment."""


def highside(*arguments: str | Path, statuses: tuple[int, ...] = (0,)) -> str:
    found = highside_inside(*arguments)
    assert found.returncode in statuses, found.stderr
    return found.stdout


def turns(path: Path) -> None:
    """Twelve turns at two inclinations, twelve seconds each, with what every command of the rotor's angle reads."""
    rng = np.random.default_rng(5)
    t = np.arange(4_800) * 0.03
    rotor = 30.0 * t % 360.0
    inc = np.where(t < 72.0, 40.0, 60.0)
    wrong = 0.05 * np.sin(np.radians(rotor) + 0.3)
    accel: Array = gravity_direction(np.radians(inc + wrong), np.radians(rotor))
    accel = accel + 5e-5 * rng.standard_normal(accel.shape)
    gyro = 0.01 * rng.standard_normal(accel.shape) + np.array([[0.0], [0.0], [-30.0]])
    columns = {
        "t_s": t, "ax_g": accel[0], "ay_g": accel[1], "az_g": accel[2],
        "gx_dps": gyro[0], "gy_dps": gyro[1], "gz_dps": gyro[2], "rotor_deg": rotor,
        "inc_ref_deg": inc, "tf_ref_deg": rotor, "inc_deg": inc + wrong, "tf_deg": rotor,
        "d_inclination_arcmin": 60.0 * wrong + 0.02 * rng.standard_normal(t.size),
        "d_toolface_arcmin": 0.02 * rng.standard_normal(t.size),
    }  # fmt: skip
    Recording(columns).write(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    made = tmp_path_factory.mktemp("forms")
    config = project_root / "config"
    highside("simulate", model_of_few_poses(made / "bench.toml"), "-o", made / "bench.csv.gz", "--seed", "3")
    turns(made / "turns.csv.gz")
    highside("predict", config / "model-known.toml", made / "turns.csv.gz", "-o", made / "said.csv.gz")
    for name in ("bench", "said", "turns"):
        for form in ("csv", "parquet", "mcap"):
            highside("export", made / f"{name}.csv.gz", "--to", form, "-o", made / f"{name}.{form}")
    highside("calibrate", "poses", made / "bench.csv.gz", "-o", made / "poses.csv")
    highside("calibrate", "solve", made / "poses.csv", "--method", "joint", "-o", made / "cal.json")
    highside("rotation", "fit", made / "turns.csv", "-o", made / "comp.json")
    highside(
        "diagnose", made / "bench.csv.gz", "--model", config / "model-known.toml", "--out", made / "report",
        "--no-report", "--write-model", made / "found.toml",
    )  # fmt: skip
    (claim,) = json.loads((made / "report" / "diagnosis.json").read_text())["claims"]
    assert claim["effect"] == "base_tilt"
    return made


def outcome(said: str, out: Path) -> dict[str, str]:
    """What was printed and written, without what is of the file itself. A page with plots is judged by its JSON."""
    found = {"": said}
    for path in sorted(out.parent.glob(f"{out.name}*")):
        files = sorted(path.rglob("*")) if path.is_dir() else [path]
        found |= {file.suffix: file.read_text() for file in files if file.suffix in (".csv", ".json")}
        found |= {
            file.suffix: rows(file) for file in files if file.suffix == ".parquet" and file.parent.name == "parts"
        }
    return {name: OF_THE_FILE.sub("", text) for name, text in found.items()}


def rows(path: Path) -> str:
    """Of a fleet's results, without what it took."""
    of_the_run = {"key", "seconds", "cpu_s"}
    found = [{k: v for k, v in row.items() if k not in of_the_run} for row in pq.read_table(path).to_pylist()]
    return json.dumps(found, default=str)


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", [*(name for name in COMMANDS if name != "fleet"), pytest.param("fleet", marks=FURTHER)]
)
def test_a_command_reads_every_form_alike(
    folder: Path, project_root: Path, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # laws are sought in numbers that have been read: most of the time of a diagnosis, and nothing of a form
    bare = partial(diagnose, method=ProcedureParts.without("laws"))
    monkeypatch.setattr("highside.api.diagnosis.diagnose", bare)
    outcomes: dict[str, dict[str, str]] = {}
    for form in FORMS:
        place = folder / f"{command}-{form}"
        place.mkdir()
        out = place / "out"
        places = {name: str(folder / f"{name}.{form}") for name in ("bench", "said", "turns")}
        (place / "archive").mkdir()
        (place / "archive" / f"bench.{form}").write_bytes((folder / f"bench.{form}").read_bytes())
        places |= {
            "archive": str(place / "archive"),
            "out": str(out),
            "cal": str(folder / "cal.json"),
            "comp": str(folder / "comp.json"),
        }
        places |= {"known": str(project_root / "config/model-known.toml"), "found": str(folder / "found.toml")}
        said = highside(*(word.format(**places) for word in COMMANDS[command]), statuses=(0, 1))
        # words for people name the file
        said = json.dumps(json.loads(said)) if "--json" in COMMANDS[command] else ""
        outcomes[form] = outcome(said, out)
        assert any(len(text) > 100 for text in outcomes[form].values())
    for form in FORMS:
        assert outcomes[form] == outcomes["csv"], form


def test_the_matrix_has_every_command() -> None:
    from highside.cli.examples import EXAMPLES

    read = {
        " ".join(words[:2]) if words[0] in ("calibrate", "rotation", "watch", "fleet") else words[0]
        for words in COMMANDS.values()
    }
    assert read.isdisjoint(NOT_OF_RECORDINGS)
    assert read | NOT_OF_RECORDINGS == set(EXAMPLES)


def test_the_forms_hold_the_same_numbers(folder: Path) -> None:
    first = read_recording(folder / "turns.csv")
    for form in FORMS[1:]:
        other = read_recording(folder / f"turns.{form}")
        assert other.order == first.order
        for name in first.order:
            np.testing.assert_array_equal(other.columns[name], first.columns[name])
