"""A command whose output is one of its inputs is refused, and what was there is there."""

from __future__ import annotations

import gzip
import hashlib
import inspect
import itertools
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from daemon import HIGHSIDE
from inside import highside_inside

from highside.api.certificate import certify
from highside.cli import overwriting
from highside.cli.commands import app_of, run
from highside.cli.kinds import CERTIFICATE, DIGITAL, MODEL, MODEL_MARK, refuse_another_kind
from highside.errors import InputError
from highside.report.document import Sheets

CASES = {
    "apply": "calibrate apply cal.json rec.csv -o rec.csv",
    "apply to the record": "calibrate apply cal.json rec.csv -o cal.json",
    "by another path": "calibrate apply cal.json rec.csv -o ./sub/../rec.csv",
    "by a link": "predict model.toml rec.csv -o link.csv",
    "predict": "predict model.toml rec.csv -o rec.csv",
    "poses": "calibrate poses rec.csv -o rec.csv",
    "solve": "calibrate solve poses.csv --method joint -o poses.csv",
    "import": "import rec.csv --yes -o rec.csv",
    "export": "export rec.csv --to csv -o rec.csv",
    "learnt model": "diagnose rec.csv --model model.toml --out report --write-model model.toml",
    "simulate over its model": "simulate model.toml -o model.toml",
    "two answers": "simulate model.toml -o new.csv --poses new.csv",
    "verification": "calibrate verify cal.json poses.csv --limit-inc-deg 1 --limit-tf-deg 1 -o poses.csv",
    "page": "rotation compare rec.csv --html rec.csv",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, project_root: Path) -> Path:
    made = tmp_path_factory.mktemp("inputs")
    (made / "model.toml").write_bytes((project_root / "config/model-bench.toml").read_bytes())
    for words in (
        "simulate model.toml -o rec.csv --poses poses.csv",
        "calibrate solve poses.csv --method joint -o cal.json",
    ):
        assert highside_inside(*words.split(), cwd=made).returncode == 0
    (made / "link.csv").symlink_to("rec.csv")
    rows = "".join(f"{second},0,0,1,0.001,-0.001,0.004\n" for second in range(60))
    (made / "still.csv").write_text(f"t_s,ax_g,ay_g,az_g,gx_dps,gy_dps,gz_dps\n{rows}")
    (made / "sub").mkdir()
    return made


def digests(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("case", CASES)
def test_an_input_is_not_written_over(folder: Path, case: str) -> None:
    before = digests(folder)
    done = highside_inside(*CASES[case].split(), cwd=folder)
    assert done.returncode == 2, done.stdout
    assert len(done.stderr.splitlines()) == 1 and "name another file" in done.stderr
    assert digests(folder) == before


def commands(app: typer.Typer) -> Iterator[Any]:
    yield from (command.callback for command in app.registered_commands)
    for group in app.registered_groups:
        assert group.typer_instance is not None
        yield from commands(group.typer_instance)


def test_every_command_that_names_an_output_is_guarded() -> None:
    guarded = {command.__name__ for command in commands(app_of()) if hasattr(command, overwriting.GUARDED)}
    written = {
        command.__name__ for command in commands(app_of()) if dict(overwriting._outputs(inspect.unwrap(command)))
    }
    assert guarded == written and len(guarded) > 20


FOREIGN = {
    "mine.csv": "depth,pressure\n1,2\n",
    "mine.csv.gz": "depth,pressure\n1,2\n",
    "mine.toml": '[tool]\nid = "a"\n',
    "mine.json": '{"schema": "mine/1"}\n',
    "mine.html": "<!DOCTYPE html><title>notes</title>\n",
    "mine.pdf": "%PDF-1.7\nstream\n\nendstream\n",
    "mine.parquet": "PAR1 depth PAR1",
    "notes": "what I did on Monday\n",
}


@pytest.mark.parametrize("name", FOREIGN)
def test_no_command_replaces_a_file_of_another_kind(tmp_path: Path, name: str) -> None:
    """Of all commands and their options that name an output; each names the option and the file."""
    looked_at = 0
    for command in commands(app_of()):
        inner = inspect.unwrap(command)
        outputs = dict(overwriting._outputs(inner))
        assert outputs.keys() == overwriting.ANSWERS.get(overwriting.name_of(inner), {}).keys()
        for parameter, option in outputs.items():
            for file, _ in overwriting.ANSWERS[overwriting.name_of(inner)][parameter](tmp_path / name, {"key": name}):
                file.parent.mkdir(exist_ok=True)
                file.write_bytes((gzip.compress if file.suffix == ".gz" else bytes)(FOREIGN[name].encode()))
                before = file.read_bytes()
                with pytest.raises(InputError, match="so is not replaced") as refused:
                    command(**{parameter: tmp_path / name, "key": name})
                assert refused.value.field == option and refused.value.where == str(file)
                assert file.read_bytes() == before
                file.unlink()
                looked_at += 1
            if (tmp_path / name).is_dir():
                (tmp_path / name).rmdir()
    assert looked_at > 30


ANSWERS = {
    "simulate model.toml -o new.csv.gz --poses new-poses.csv": "simulate.simulate",
    "drift still.csv --method none -o azimuths.csv --latitude-deg 60 --azimuth-deg 0": "drift.drift",
    "calibrate poses rec.csv -o found.csv": "calibrate.poses",
    "calibrate solve poses.csv --method joint -o cal.json": "calibrate.solve",
    "calibrate apply cal.json poses.csv -o corrected.csv": "calibrate.apply",
    "calibrate apply cal.json rec.csv -o corrected.csv.gz": "calibrate.apply",
    "calibrate verify cal.json poses.csv --limit-inc-deg 1 --limit-tf-deg 1 -o judged.json": "verification.verify",
    "calibrate iscwsa cal.json -o tool.json": "iscwsa.iscwsa",
    "predict model.toml rec.csv -o predicted.csv": "predict.predict",
    "export rec.csv --to parquet -o rec.parquet": "export.export",
    "export rec.csv --to mcap -o rec.mcap": "export.export",
    "export rec.csv --to csv -o again.csv.gz": "export.export",
    "import rec.csv --yes -o imported.parquet": "importing.import_file",
}


@pytest.mark.parametrize("words", ANSWERS)
def test_an_answer_may_take_the_place_of_one_of_its_kind(
    folder: Path, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert run(words.split()) in (0, 1)
    given = dict(itertools.pairwise(words.split()))
    (inner,) = {one for one in map(inspect.unwrap, commands(app_of())) if overwriting.name_of(one) == ANSWERS[words]}
    written = 0
    for parameter, option in overwriting._outputs(inner):
        if output := given.get("-o" if option == "--output" else option):
            for file, kind in overwriting.ANSWERS[ANSWERS[words]][parameter](Path(output), {}):
                written += file.exists()
                refuse_another_kind(file, kind, option)
    assert written


def test_certificates_are_told_from_other_documents(folder: Path, tmp_path: Path) -> None:
    sheets = Sheets("a certificate", ("left", "right"), "foot")
    sheets.paragraph("words")
    for name, data in (("c.pdf", sheets.pdf()[0]), ("c.html", sheets.html().encode())):
        (tmp_path / name).write_bytes(data)
        refuse_another_kind(tmp_path / name, CERTIFICATE, "--output")
        (tmp_path / name).write_bytes(data.replace(b"highside", b"somebody").replace(b"stream", b"trough"))
        with pytest.raises(InputError):
            refuse_another_kind(tmp_path / name, CERTIFICATE, "--output")
    fields = tmp_path / "fields.toml"
    fields.write_text('[issue]\ncountry = "NO"\n')
    (tmp_path / "c.xml").write_bytes(certify(folder / "cal.json", fields).dcc())
    refuse_another_kind(tmp_path / "c.xml", DIGITAL, "--dcc")


def test_a_signature_takes_the_place_of_a_signature_alone(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    Path("signed.csv.sig").write_text("mine")
    assert run(["keys", "new", "lab.key", "--name", "Lab"]) == 0
    Path("signed.csv").write_text("t_s\n")
    assert run(["keys", "sign", "signed.csv", "--key", "lab.key"]) == 2
    Path("signed.csv.sig").unlink()
    for _ in range(2):
        assert run(["keys", "sign", "signed.csv", "--key", "lab.key"]) == 0


def test_a_model_with_what_was_found_is_told_from_a_person_s(tmp_path: Path) -> None:
    model = tmp_path / "model.toml"
    model.write_text(f"{MODEL_MARK}\n[tool]\n")
    refuse_another_kind(model, MODEL, "--write-model")
    model.write_text("[tool]\n")
    with pytest.raises(InputError):
        refuse_another_kind(model, MODEL, "--write-model")


PRECIOUS = {
    "mine.key": b"-----BEGIN PRIVATE KEY-----\nMC4CAQ==\n-----END PRIVATE KEY-----\n",
    "wire.hsw": b"HSWIRE1\n{}\n",
    "outbox.sqlite": b"SQLite format 3\0" + b"\0" * 84,
    "bench.journal": b'{"n":0,"e":"session"}\n',
}


@pytest.mark.parametrize("name", PRECIOUS)
@pytest.mark.parametrize("words", ["calibrate poses rec.csv -o", "export rec.csv --to csv -o"])
def test_what_nobody_can_make_again_is_not_replaced(folder: Path, tmp_path: Path, name: str, words: str) -> None:
    there = tmp_path / name
    there.write_bytes(PRECIOUS[name])
    done = highside_inside(*words.split(), there, cwd=folder)
    assert done.returncode == 2, done.stdout
    assert len(done.stderr.splitlines()) == 1
    assert "is not replaced" in done.stderr and str(there) in done.stderr
    assert there.read_bytes() == PRECIOUS[name]


def test_a_command_replaces_its_own_earlier_answer(folder: Path, tmp_path: Path) -> None:
    for _ in range(2):
        command = [HIGHSIDE, "export", "rec.csv", "--to", "csv", "-o", str(tmp_path / "out.csv")]
        subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=120)
