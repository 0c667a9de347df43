"""Profiles with references: the second file of another recording is found again by its name, and its axes stay."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_importing_joins import ANGLES, turning, worst, written
from typer.testing import CliRunner

import highside
from highside.cli.main import app
from highside.errors import InputError
from highside.importing import profiles
from highside.importing.core.filenames import NameRule, rule_of, second_of
from highside.importing.core.wishes import Taken

WORDS = st.from_regex(r"[a-z]{1,6}", fullmatch=True)
RUN = st.from_regex(r"[0-9]{1,8}([-_][0-9]{1,3}){0,2}", fullmatch=True)


@pytest.fixture(autouse=True)
def settings_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    return tmp_path / "settings" / "highside" / "import"


def imported(*arguments: str | Path) -> str:
    done = CliRunner().invoke(app, ["import", *map(str, arguments)])
    assert done.exit_code == 0, (done.output, done.exception)
    return str(done.output)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    before=WORDS,
    other=WORDS,
    mark=st.sampled_from("_-. "),
    run=RUN,
    next_run=RUN,
    end=st.sampled_from([".csv", ".txt"]),
)
def test_the_second_file_of_the_next_recording_is_found_by_what_names_have_in_common(
    before: str, other: str, mark: str, run: str, next_run: str, end: str
) -> None:
    rule = rule_of(f"{before}{mark}{run}.csv", f"{other}{mark}{run}{end}")
    assert not rule.fixed
    assert second_of(rule, f"{before}{mark}{run}.csv") == f"{other}{mark}{run}{end}"
    assert second_of(rule, f"{before}{mark}{next_run}.csv") == f"{other}{mark}{next_run}{end}"


@settings(max_examples=300, deadline=None, derandomize=True)
@given(names=st.tuples(*[st.text(st.characters(exclude_characters="/\0"), min_size=1, max_size=20)] * 2))
def test_a_rule_always_leads_from_its_own_recording_to_its_own_second_file(names: tuple[str, str]) -> None:
    rule = rule_of(*names)
    assert second_of(rule, names[0]) == names[1], rule


@pytest.mark.parametrize(
    ("recording", "second", "rule"),
    [
        ("log_2025-07-12.csv", "bench_2025-07-12.csv", NameRule("log_{1}.csv", "bench_{1}.csv")),
        ("run7.csv.gz", "run7-encoder.xlsx", NameRule("{1}.csv.gz", "{1}-encoder.xlsx")),
        ("rig_log_3.csv", "rig_ref_3.csv", NameRule("{1}_log_{2}.csv", "{1}_ref_{2}.csv")),
        ("log.csv", "bench.csv", NameRule("", "bench.csv")),
        ("a{1}.csv", "b{2}.csv", NameRule("", "b{2}.csv")),
    ],
)
def test_rules_are_what_one_would_write(recording: str, second: str, rule: NameRule) -> None:
    assert rule_of(recording, second) == rule


def session_files(folder: Path, run: str, seed: int, *, turned: bool = False) -> tuple[pd.DataFrame, Path, Path]:
    folder.mkdir(exist_ok=True)
    own = turning(seed=seed)
    log, reference = written(folder, own, 0.0, epoch=True)
    if turned:
        table = pd.read_csv(log)
        table[["ax_g", "ay_g", "az_g"]] = np.column_stack([-table.ay_g, table.ax_g, table.az_g])
        table.to_csv(log, index=False)
    (folder / "bench").mkdir(exist_ok=True)
    return own, log.rename(folder / f"log_{run}.csv"), reference.rename(folder / "bench" / f"ref_{run}.csv")


def test_a_profile_joins_the_second_file_of_the_next_recording_too(tmp_path: Path, settings_folder: Path) -> None:
    _, log, reference = session_files(tmp_path / "a", "07", 1)
    said = imported(log, "-o", tmp_path / "a.csv", "--reference", reference, "--take", "nearest", "--lag", "0",
                    "--profile", "rig")  # fmt: skip
    assert "it joins log_{1}.csv with ref_{1}.csv" in said
    kept = (settings_folder / "rig.toml").read_text()
    assert 'file = "bench/ref_{1}.csv"' in kept and 'inc_ref_deg = "inclination (deg):deg"' in kept
    profile = profiles.load("rig")
    assert profile is not None and (profile.taken, profile.lag_s) == (Taken.NEAREST, 0.0)
    own, log, reference = session_files(tmp_path / "b", "08", 2)
    said = imported(log, "-o", tmp_path / "b.csv", "--profile", "rig")
    assert f"{reference} is joined: profile rig joins log_{{1}}.csv with ref_{{1}}.csv" in said
    from_python = highside.import_recording(log, profile="rig")
    assert any("is joined: profile rig" in note for note in from_python.notes)
    for found in (highside.read(tmp_path / "b.csv"), from_python, highside.read(log, profile="rig")):
        assert all(found.has(name) for name in ANGLES)
        assert worst(found, own) < 4.0, "nearest of every third row"
    # what is written beside a profile goes before it
    other = reference.rename(tmp_path / "elsewhere.csv")
    own_way = highside.import_recording(log, profile="rig", reference=other, take="interpolated")
    assert worst(own_way, own) < 0.1


def test_axes_that_the_reference_showed_are_those_of_the_profile(tmp_path: Path, settings_folder: Path) -> None:
    """The first import turns them by the reference; applied again it must not read them as they are in the file."""
    own, log, reference = session_files(tmp_path / "a", "1", 1, turned=True)
    first = tmp_path / "first.csv"
    assert "axes y-xz" in imported(log, "-o", first, "--reference", reference, "--yes", "--profile", "turned")
    assert 'axes = "y-xz"' in (settings_folder / "turned.toml").read_text()
    again = tmp_path / "again.csv"
    imported(log, "-o", again, "--profile", "turned")
    assert first.read_bytes() == again.read_bytes()
    np.testing.assert_allclose(highside.read(again)["ax_g"], own.ax_g, atol=1e-9)
    # a sensor that was mounted in another way is said
    _, other, _ = session_files(tmp_path / "b", "2", 2)
    assert "axes y-xz as given, though" in imported(other, "-o", tmp_path / "b.csv", "--profile", "turned")


def test_a_second_file_that_is_not_there_is_named_with_the_profile(tmp_path: Path) -> None:
    _, log, reference = session_files(tmp_path / "a", "1", 1)
    imported(log, "-o", tmp_path / "a.csv", "--reference", reference, "--profile", "rig")
    alone = tmp_path / "log_9.csv"
    os.link(log, alone)
    with pytest.raises(InputError, match=r"profile rig joins log_\{1\}\.csv with .*ref_9\.csv is not there; ref"):
        highside.import_recording(alone, profile="rig")
    odd = tmp_path / "session.csv"
    os.link(log, odd)
    with pytest.raises(InputError, match=r"profile rig joins .*, and it is not called so; reference="):
        highside.import_recording(odd, profile="rig")
    assert highside.import_recording(odd, profile="rig", reference=reference).has(*ANGLES)


def test_another_topic_of_the_same_file_is_kept_too(tmp_path: Path) -> None:
    own = turning()
    with pd.ExcelWriter(tmp_path / "book.xlsx") as book:
        own[["t_s", "ax_g", "ay_g", "az_g"]].to_excel(book, sheet_name="log", index=False)
        angles = own[["t_s"]].assign(**{"inclination (deg)": own.inc_ref_deg, "toolface (deg)": own.tf_ref_deg})
        angles.to_excel(book, sheet_name="bench", index=False)
    imported(tmp_path / "book.xlsx", "-o", tmp_path / "a.csv", "--join", "bench", "--profile", "book")
    assert worst(highside.import_recording(tmp_path / "book.xlsx", profile="book"), own) < 0.1


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("take = 'often'", "take: 'often' is none"),
        ("lag = 'soon'", "lag: 'soon' is no number"),
        ("reference = [1]", "reference: is no table"),
        ("[[reference]]\nfolder = 'x'", "folder: is no field"),
        ("[[reference]]\nfile = 'x'\ntable = 'y'", "needs a file or a table"),
        ("[[reference]]\nfile = 'x'\n[reference.map]\nax_g = 1", "holds something else than texts"),
    ],
)
def test_a_profile_that_is_not_in_order_is_refused_by_field(settings_folder: Path, text: str, match: str) -> None:
    settings_folder.mkdir(parents=True)
    (settings_folder / "odd.toml").write_text(text)
    with pytest.raises(InputError, match=match):
        profiles.load("odd")
