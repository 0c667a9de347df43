"""Keys and signatures as a laboratory and a rig use them: the commands, the bench's store, the service."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest
from inside import highside_inside

from highside.calibration.record import content_id
from highside.recording.calibration_store import CalibrationStore

POSES = """inc_ref_deg,tf_ref_deg,ax,ay,az,n
{}"""


def highside(*args: object, status: int = 0, **environment: str) -> subprocess.CompletedProcess[str]:
    done = highside_inside(*args, environment=environment)
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    assert status != 2 or done.stderr.count("\n") == 1, done.stderr
    return done


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A laboratory with a key, a stranger with another, and a pose table."""
    from math import cos, radians, sin

    folder = tmp_path_factory.mktemp("keys")
    rows = [
        f"{inc},{tf},{sin(radians(inc)) * cos(radians(tf))!r},{sin(radians(inc)) * sin(radians(tf))!r},"
        f"{cos(radians(inc))!r},100"
        for inc in (5, 45, 120)
        for tf in range(0, 360, 45)
    ]
    (folder / "poses.csv").write_text(POSES.format("\n".join(rows)) + "\n")
    for name in ("lab", "stranger"):
        highside("keys", "new", folder / f"{name}.key", "--name", f"Laboratory {name}")
    (folder / "trusted").write_text((folder / "lab.key.pub").read_text())
    return folder


def test_from_a_key_to_a_service_that_accepts_nothing_else(folder: Path) -> None:
    record, store, trusted = folder / "cal.json", folder / "store", folder / "trusted"
    solve = ("calibrate", "solve", folder / "poses.csv", "--method", "conventional", "--tool", "t-1", "--store", store)
    highside(*solve, "--key", folder / "lab.key", "-o", record)
    assert "Laboratory lab" in highside("calibrate", "show", record).stdout
    assert "signed by Laboratory lab" in highside("keys", "verify", record, "--trusted", trusted).stdout
    highside("calibrate", "activate", record, "--store", store, "--trusted", trusted)

    service = folder / "service.toml"
    service.write_text(
        '[tool]\nid = "t-1"\n[link]\nkind = "simulated"\n[codec]\nname = "tool"\n'
        f'[calibration]\nstore = "{store}"\ntrusted_keys = "trusted"\n'
    )
    assert json.loads(record.read_text())["id"][:12] in highside("check", service).stdout

    # somebody who can write the store, knows how to hash, and has no key
    kept = next((store / "records").glob("*.json"))
    data = json.loads(kept.read_text())
    del data["id"], data["signature"]
    data["tool"]["serial"] = "forged"
    forged = store / "records" / f"{content_id(data)}.json"
    forged.write_text(json.dumps({"id": content_id(data), **data}))
    CalibrationStore(store).activate(CalibrationStore(store).get(content_id(data)), now_s=2e9)
    printed = highside("check", service, status=1).stderr
    assert "unsigned" in printed and printed.count("\n") == 1
    highside("keys", "sign", forged, "--key", folder / "stranger.key")
    assert "untrusted" in highside("check", service, status=1).stderr
    assert "untrusted" in highside("keys", "verify", forged, "--trusted", trusted, status=1).stdout
    refused = highside("calibrate", "activate", forged, "--store", store, "--trusted", trusted, status=1).stderr
    assert "untrusted" in refused
    highside("calibrate", "rollback", "--store", store, "--tool", "t-1", "--trusted", trusted)
    highside("check", service)


def test_a_certificate_is_signed_beside_it(folder: Path) -> None:
    record, page = folder / "cal2.json", folder / "certificate.html"
    highside("calibrate", "solve", folder / "poses.csv", "--method", "joint", "--tool", "t-2", "-o", record)
    highside("keys", "sign", record, "--key", folder / "lab.key")
    highside("calibrate", "certificate", record, "-o", page, "--key", folder / "lab.key")
    assert "Laboratory lab" in page.read_text() and "SHA256:" in page.read_text()
    verify = ("keys", "verify", page, record, "--trusted", folder / "trusted", "--json")
    rows = json.loads(highside(*verify).stdout)["files"]
    assert [row["valid"] for row in rows] == [True, True]
    page.write_text(page.read_text().replace("Laboratory lab", "Laboratory x"))
    rows = json.loads(highside(*verify, status=1).stdout)["files"]
    assert [row["valid"] for row in rows] == [False, True]


def test_wrong_use_is_a_line(folder: Path) -> None:
    key = folder / "lab.key"
    assert "is there already" in highside("keys", "new", key, "--name", "x", status=2).stderr
    assert "--name" in highside("keys", "new", folder / "n.key", "--name", " ", status=2).stderr
    assert "nothing: cannot be read" in highside("keys", "sign", folder / "nothing", "--key", key, status=2).stderr
    assert "no such file" in highside("keys", "sign", folder / "poses.csv", "--key", folder / "no.key", status=2).stderr
    (folder / "words").write_text("nothing but words\n")
    assert "line 1" in highside("keys", "verify", key, "--trusted", folder / "words", status=2).stderr
    assert (
        "no signature" in highside("keys", "verify", folder / "words", "--trusted", folder / "trusted", status=1).stdout
    )


def test_a_bench_session_signs_its_record(folder: Path) -> None:
    bench = folder / "bench.toml"
    bench.write_text(
        '[tool]\nid = "t-3"\n[simulated]\nspeed = 60.0\nrate_hz = 100.0\n'
        '[plan]\nkind = "conventional"\npositions = 6\n'
        '[store]\ndirectory = "bench-store"\nsessions = "bench-sessions"\nsigning_key = "lab.key"\n'
        'trusted_keys = "trusted"\n'
    )
    highside("calibrate", "bench", "--config", bench, "--auto", "--plain")
    (record,) = (folder / "bench-store" / "records").glob("*.json")
    assert "Laboratory lab" in highside("keys", "verify", record, "--trusted", folder / "trusted").stdout
    journals = set((folder / "bench-sessions").iterdir())
    (folder / "lab.key").chmod(0o640)
    try:
        refused = highside("calibrate", "bench", "--config", bench, "--auto", "--plain", status=2).stderr
        checked = highside("check", bench, status=2).stderr
    finally:
        (folder / "lab.key").chmod(0o600)
    assert "lab.key" in refused and "read by others" in refused
    assert "lab.key" in checked and "read by others" in checked
    assert set((folder / "bench-sessions").iterdir()) == journals, "no empty session is left behind"


def test_what_has_no_end_and_does_not_stay_is_not_signed(folder: Path, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.json"
    os.mkfifo(pipe)
    for place in (pipe, Path("/dev/zero")):
        for command in (
            ("sign", place, "--key", folder / "lab.key"),
            ("verify", place, "--trusted", folder / "trusted"),
        ):
            said = highside("keys", *command, status=2).stderr
            assert said.startswith(f"highside: {place}: is a pipe, a socket or a device"), said
    for place in (Path("/"), Path(".."), tmp_path):
        said = highside("keys", "verify", place, "--trusted", folder / "trusted", status=2).stderr
        assert said == f"highside: {place}: is a directory, not a file\n"
