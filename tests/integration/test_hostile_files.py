"""Commands given each kind of hostile file: one line that names it, exit status 2, soon, and nothing written."""

from __future__ import annotations

import gzip
import os
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from highside.cli import main as command
from highside.reading import files

DEEP = b"[" * 100_000
RECORDING = b"t_s,ax_g,ay_g,az_g\n" + b"".join(b"%g,0.1,0.2,0.97\n" % (0.1 * i) for i in range(20))
MODEL = b'[tool]\naxes = "xyz"\n'
SERVICE = b'[tool]\nid = "t1"\n[link]\nkind = "socketcan"\ninterface = "can0"\n[codec]\nname = "dbc"\n'
DBC = b'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ x : %s@1+ (%s,0) [0|0] "" A\n'


def bomb() -> bytes:
    """64 MB of zeros in 64 kB: as hostile as 3 GB, for the ratio is what tells."""
    packer = zlib.compressobj(6, zlib.DEFLATED, 31)
    return b"".join([*(packer.compress(bytes(1 << 20)) for _ in range(64)), packer.flush()])


TABLES = {
    "NUL": bytes(4096),
    "NUL inside": RECORDING[:60] + bytes(50) + RECORDING[60:],
    "gzip bomb": bomb(),
    "torn gzip": gzip.compress(RECORDING)[:-12],
    "UTF-16": RECORDING.decode().encode("utf-16"),
    "long header cell": b"t_s," + b"a" * 200_000 + b"\n0,1\n",
    "100,000 columns": b",".join(b"c%d" % i for i in range(100_000)) + b"\n1\n",
    "lone CR in the header": RECORDING.replace(b"ax_g,", b"ax_g\r,", 1),
    "lone CR at all line ends": RECORDING.replace(b"\n", b"\r"),
    "infinite number": RECORDING.replace(b"0.97", b"1e999", 1),
    "5,000 digits and a letter": RECORDING.replace(b"0.97", b"9" * 5000 + b"x", 1),
    "text for a time": RECORDING.replace(b"0.5,", b"2026-11-22T10:00:00,", 1),
    "terminal escape": b"\x1b[2J\x1b]0;owned\x07,ax_g\n1,2\n",
    "JSON": b'{"t_s": [1, 2]}',
    "empty": b"",
}
DOCUMENTS = {
    "NaN": b'{"schema":"highside.rotation/1","id":"x","unit":"arcmin","a":NaN}',
    "nested": DEEP,
    "nested objects": b'{"a":' * 50_000,
    "NUL": bytes(4096),
    "torn": b'{"schema":"highside.rotation/1","id":"x","unit',
    "5,000 digits": b'{"schema":"highside.rotation/1","id":' + b"9" * 5000 + b"}",
    "surrogate": b'{"schema":"\\ud800","id":"\\ud800"}',
    "gzip bomb": bomb(),
    "twice": b'{"schema":"highside.rotation/1","schema":"x","id":"x"}',
    "empty": b"",
}
SETTINGS = {
    "nested": b"a = " + DEEP,
    "NUL": bytes(4096),
    "5,000 digits": SERVICE + b"[pipeline]\noutput_rate_hz = " + b"1" * 5000 + b"\n",
    "NaN": SERVICE + b"[pipeline]\noutput_rate_hz = nan\n",
    "endless key": b"a." * 20_000 + b"a = 1\n",
    "torn": SERVICE[:30],
    "UTF-16": SERVICE.decode().encode("utf-16"),
    "gzip bomb": bomb(),
    "not text": b"\xff" * 100,
    "NUL in a name": SERVICE + b'dbc = "a\\u0000b"\n',
}
WIRES = {
    "nested header": b"HSWIRE1\n" + DEEP + b"\n",
    "nested short header": b"HSWIRE1\n" + b"[" * 5000 + b"\n",
    "NaN in the header": b'HSWIRE1\n{"tool": NaN}\n',
    "header of 5,000 digits": b'HSWIRE1\n{"tool": ' + b"9" * 5000 + b"}\n",
    "header that is no table": b"HSWIRE1\n[1]\n",
    "torn header": b'HSWIRE1\n{"tool"',
    "gzip bomb": bomb(),
}
DBCS = {
    "4 thousand million bits": DBC % (b"62|4294967295", b"1"),
    "factor beyond numbers": DBC % (b"0|8", b"1e309"),
    "factor of 310 digits": DBC % (b"0|8", b"9" * 310),
    "5,000 digits": DBC % (b"0|8", b"9" * 5000),
    "message of 4 GB": b'VERSION ""\nBO_ 1 M: 4294967295 A\n',
    "attribute": b'VERSION ""\nBA_DEF_ BO_ "X" INT 0 1;\nBA_DEF_DEF_ "X" 1e99999999;\n',
    "multiplexer": DBC % (b"0|8", b"1") + b"SG_MUL_VAL_ 1 x x 0-4294967295;\n",
    "NUL": bytes(4096),
    "nested": DEEP,
}
Command = Callable[[Path, Path], list[str]]
"""arguments from (the hostile file, a folder with sound ones)"""
JOINT = ("--method", "joint", "--tool", "t1")
OF_TABLES: dict[str, Command] = {
    "calibrate poses": lambda f, d: ["calibrate", "poses", str(f), "-o", str(d / "out.csv")],
    "calibrate solve": lambda f, d: ["calibrate", "solve", str(f), *JOINT, "-o", str(d / "out.json")],
    "drift": lambda f, d: ["drift", str(f), "--method", "none", "-o", str(d / "out.csv")],
    "diagnose": lambda f, d: ["diagnose", str(f), "--model", str(d / "model.toml"), "--out", str(d / "out")],
    "rotation fit": lambda f, d: ["rotation", "fit", str(f), "--method", "sine", "-o", str(d / "out.json")],
    "rotation compare": lambda f, d: ["rotation", "compare", str(f)],
    "export": lambda f, d: ["export", str(f), "--to", "csv", "-o", str(d / "out.csv")],
}  # fmt: skip
OF_DOCUMENTS: dict[str, Command] = {
    "rotation apply": lambda f, d: ["rotation", "apply", str(f), str(d / "recording.csv"), "-o", str(d / "out.csv")],
    "calibrate apply": lambda f, d: ["calibrate", "apply", str(f), str(d / "recording.csv"), "-o", str(d / "out.csv")],
    "calibrate show": lambda f, d: ["calibrate", "show", str(f)],
    "calibrate certificate": lambda f, d: ["calibrate", "certificate", str(f), "-o", str(d / "out.html")],
}
OF_SETTINGS: dict[str, Command] = {
    "check": lambda f, d: ["check", str(f)],
    "run": lambda f, d: ["run", "--config", str(f)],
    "simulate": lambda f, d: ["simulate", str(f), "-o", str(d / "out.csv")],
    "diagnose --model": lambda f, d: ["diagnose", str(d / "recording.csv"), "--model", str(f), "--out", str(d / "out")],
    "calibrate bench": lambda f, d: ["calibrate", "bench", "--config", str(f)],
    "decode --config": lambda f, d: ["decode", *_dbc(f, d)],
}  # fmt: skip
OF_WIRES: dict[str, Command] = {
    "decode": lambda f, d: ["decode", str(f), "--codec", "tool", "-o", str(d / "out.csv")],
    "replay": lambda f, d: ["replay", str(f), "--to", "pty", "--speed", "0"],
}
OF_DBCS: dict[str, Command] = {
    "check": lambda f, d: ["check", str(_naming(f, d))],
    "decode": lambda f, d: ["decode", *_dbc(_naming(f, d), d)],
}  # fmt: skip
CASES = [
    pytest.param(arguments, content, id=f"{name}: {kind}")
    for commands, hostile in (
        (OF_TABLES, TABLES),
        (OF_DOCUMENTS, DOCUMENTS),
        (OF_SETTINGS, SETTINGS),
        (OF_WIRES, WIRES),
        (OF_DBCS, DBCS),
    )
    for name, arguments in commands.items()
    for kind, content in [*hostile.items(), ("directory", None), ("absent", b"absent")]
    # raw bytes may be anything, and are played once somebody listens
    if (name, kind) != ("replay", "gzip bomb")
]


def _dbc(config: Path, folder: Path) -> list[str]:
    given = ["--codec", "dbc", "--config", str(config), "-o", str(folder / "out.csv")]
    return [str(folder / "recording.csv"), *given]


def _naming(dbc: Path, folder: Path) -> Path:
    config = folder / "naming.toml"
    config.write_bytes(SERVICE + b'dbc = "%s"\n' % str(dbc).encode())
    return config


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "sound"
    folder.mkdir()
    (folder / "recording.csv").write_bytes(RECORDING)
    (folder / "model.toml").write_bytes(MODEL)
    return folder


@pytest.mark.parametrize(("arguments", "content"), CASES)
def test_one_line_that_names_it_and_exit_status_2(
    arguments: Command,
    content: bytes | None,
    tmp_path: Path,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(files, "_configured", False)
    hostile = tmp_path / "hostile"
    if content is None:
        hostile.mkdir()
    elif content != b"absent":
        hostile.write_bytes(content)
    given = arguments(hostile, folder)
    before = sorted(folder.rglob("*"))
    monkeypatch.setattr(sys, "argv", ["highside", *given])
    with pytest.raises(SystemExit) as ended:
        command.main()
    said = capfd.readouterr().err.removesuffix("\n")
    assert ended.value.code == 2, said
    assert said.isprintable(), repr(said)
    assert said.startswith("highside: ")
    assert "hostile" in said, said
    assert "internal error" not in said
    assert sorted(folder.rglob("*")) == before


MEASURED = """
import resource, subprocess, sys
status = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(status)
"""
"""A small process between: a child is charged with the memory of the process that forked it, and pytest is large."""


@pytest.mark.parametrize(
    ("arguments", "content"),
    [
        pytest.param(OF_TABLES["calibrate poses"], None, id="3 GB of zeros in 3 MB"),
        pytest.param(OF_DBCS["check"], DBCS["4 thousand million bits"], id="a signal of 4 thousand million bits"),
        pytest.param(OF_SETTINGS["check"], SETTINGS["nested"], id="nested"),
    ],
)
def test_no_file_takes_the_memory(arguments: Command, content: bytes | None, tmp_path: Path, folder: Path) -> None:
    """In a process of its own that has 300 MB more than it needs to start."""
    hostile = tmp_path / "hostile"
    if content is None:
        packer = zlib.compressobj(1, zlib.DEFLATED, 31)
        with hostile.open("wb") as file:
            piece = bytes(16 << 20)
            for _ in range(192):
                file.write(packer.compress(piece))
            file.write(packer.flush())
    else:
        hostile.write_bytes(content)
    highside = Path(sys.executable).with_name("highside")
    given = arguments(hostile, folder)
    with (tmp_path / "said").open("w") as error:
        process = subprocess.run(
            [sys.executable, "-c", MEASURED, highside, *given], stdout=subprocess.PIPE, stderr=error, cwd=tmp_path
        )
    said = (tmp_path / "said").read_text()
    assert process.returncode == 2, said
    assert said.count("\n") == 1
    assert "hostile" in said
    # kilobytes; the command needs 35 to 200 MB to start
    assert int(process.stdout) < 600_000


@pytest.mark.parametrize(
    "arguments",
    [
        pytest.param(arguments, id=name)
        for commands in (OF_DOCUMENTS, OF_SETTINGS, OF_DBCS)
        for name, arguments in commands.items()
    ],
)
def test_a_file_whose_size_is_damaged_is_not_taken_into_the_memory(
    arguments: Command, tmp_path: Path, folder: Path
) -> None:
    """2 GB less a few, as a file system may state after a loss of power; behind it is nothing. Tools have 512 MB."""
    hostile = tmp_path / "hostile"
    hostile.touch()
    os.truncate(hostile, (2 << 30) - 4096)
    highside = Path(sys.executable).with_name("highside")
    command = [sys.executable, "-c", MEASURED, highside, *arguments(hostile, folder)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=60)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("\n") == 1 and "hostile" in done.stderr
    assert int(done.stdout) < 400_000  # kilobytes; 61,000 to 200,000 to start
