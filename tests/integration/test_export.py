"""`highside export`: what is written opens in the formats' own libraries with equal values."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from daemon import HIGHSIDE
from inside import highside_inside
from mcap.reader import make_reader

from highside.recording.table import Recording, read_recording, write_recording


def export(*arguments: str) -> subprocess.CompletedProcess[str]:
    return highside_inside("export", *arguments)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    rng = np.random.default_rng(3)
    n = 3000
    columns = {
        "t_s": 1.7e9 + np.arange(n) / 100.0,
        "ax_g": rng.normal(size=n),
        "temp_c": np.where(np.arange(n) % 7, np.nan, rng.normal(60, 1, n)),
        "seq": np.arange(n, dtype=float),
    }
    table = Recording(columns, {"remark": tuple("a" if i % 2 else "b, c" for i in range(n))})
    path = tmp_path / "rec.csv.gz"
    write_recording(path, table)
    return path


def same(columns: dict[str, list[object]], table: Recording) -> None:
    assert list(columns) == list(table.order)
    for name in table.order:
        if name in table.texts:
            assert columns[name] == list(table.texts[name])
        else:
            got = np.array([np.nan if v is None else v for v in columns[name]], dtype=float)
            # bit for bit, missing values at the same places
            assert np.array_equal(got, table.columns[name], equal_nan=True), name


def test_parquet(recording: Path, tmp_path: Path) -> None:
    answer = export(str(recording), "--to", "parquet", "-o", str(tmp_path / "out.parquet"))
    assert answer.returncode == 0, answer.stderr
    table = pq.read_table(tmp_path / "out.parquet")
    same(table.to_pydict(), read_recording(recording))
    assert table.schema.field("ax_g").metadata[b"unit"] == b"standard gravity"


def test_mcap(recording: Path) -> None:
    answer = export(str(recording), "--to", "mcap")
    assert answer.returncode == 0, answer.stderr
    target = recording.with_name("rec.mcap")
    original = read_recording(recording)
    with target.open("rb") as file:
        messages = list(make_reader(file).iter_messages())
    assert len(messages) == original.n
    schema, channel, first = messages[0]
    assert (channel.topic, schema.encoding, channel.message_encoding) == ("/frame", "jsonschema", "json")
    assert set(json.loads(schema.data)["properties"]) == set(original.order)
    rows = [json.loads(message.data) for _, _, message in messages]
    same({name: [row[name] for row in rows] for name in original.order}, original)
    stamps = np.array([message.log_time for _, _, message in messages])
    assert np.abs(stamps / 1e9 - original.t_s).max() < 3e-7
    assert np.all(np.diff(stamps) > 0)
    assert first.sequence == 0


def test_csv_of_a_real_wire_recording(shared_data: Path, tmp_path: Path) -> None:
    wire = next((shared_data / "serial_vn100").glob("*.bin*"), None) or next((shared_data / "serial_vn100").iterdir())
    decoded = tmp_path / "decoded.csv"
    done = subprocess.run(
        [str(HIGHSIDE), "decode", str(wire), "--codec", "vn100", "-o", str(decoded)],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer = export(str(wire), "--codec", "vn100", "--to", "csv", "-o", str(tmp_path / "out.csv"))
    assert answer.returncode == 0, answer.stderr
    assert (tmp_path / "out.csv").read_bytes() == decoded.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        (["nothing.csv", "--to", "csv"], "no such file"),
        (["bad.csv", "--to", "mcap", "-o", "x.mcap"], "lacks the column t_s"),
        (["early.csv", "--to", "mcap", "-o", "x.mcap"], "t_s: MCAP knows times from 0"),
        (["early.csv", "--to", "csv", "-o", "early.csv"], "is a file that this command reads"),
        (["early.csv", "--to", "csv"], "is the recording itself"),
        (["early.csv", "--to", "parquet", "-o", "no/such/x"], "cannot be written"),
    ],
)
def test_what_cannot_be_exported_is_said_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], reported: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.csv").write_text("x\n1\n")
    Path("early.csv").write_text("t_s,ax_g\n-1.5,1\n-0.5,1\n")
    answer = export(*arguments)
    assert answer.returncode == 2, answer.stderr
    assert reported in answer.stderr
    assert answer.stderr.count("\n") == 1
    assert not Path("x.mcap").exists()
