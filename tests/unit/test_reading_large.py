"""The reader of large texts gives what the reader of small ones gives, or leaves the text to it."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import highside.importing.forms.delimited as foreign
import highside.recording.table as own
from highside.errors import InputError
from highside.importing.core.source import SourceTable
from highside.reading.large import columns_at_once

CELLS = st.one_of(
    st.integers(-(10**6), 10**6).map(str),
    st.floats(-1e6, 1e6).map(repr),
    st.sampled_from(["", " ", "nan", "NaN", "NA", "inf", "-inf", "1e999", "007", "1_0", "0x10", "1,5", "1.000,5",
                     "abc", '"a b"', '"3"', "10:00:00", "2026-01-31T23:59:59.5Z", "true", "12345678901234567890", "-",
                     ".5", "5.", "1e5", "1d5", "é", "\xa05", "  7 ", "#N/A", '"', "a\"b", "null", "0b1", "infinity"]),
)  # fmt: skip
"""what stands in files, and what parsers may disagree on"""


def rows_of(seed: int, odd: list[str], separator: str) -> str:
    """Twelve columns of one kind each, with some odd cells put anywhere."""
    rng = random.Random(seed)
    point = "," if separator == ";" and seed % 2 else "."
    kinds = [
        lambda k: repr(rng.gauss(0, 1)).replace(".", point),
        lambda k: str(k),
        lambda k: rng.choice(["", "1.5".replace(".", point)]),
        lambda k: rng.choice(["move", "rest"]),
        lambda k: f"2026-01-31 23:59:{k % 60:02d}",
    ]
    rows = [[kinds[place % 5](k) for place in range(1, 6)] for k in range(12)]
    for cell in odd:
        rows[rng.randrange(12)][rng.randrange(5)] = cell
    return "".join(separator.join(row) + "\n" for row in rows)


def outcome(read: object, *arguments: object) -> object:
    assert callable(read)
    try:
        found = read(*arguments)
    except InputError as error:
        return str(error)
    if isinstance(found, tuple):
        table: SourceTable = found[0]
        return [
            (c.name, c.texts, None if c.numbers is None else repr(c.numbers.tolist()),
             None if c.integers is None else c.integers.tolist())
            for c in table.columns
        ]  # fmt: skip
    return [
        (name, repr(found.columns[name].tolist()) if name in found.columns else found.texts[name])
        for name in found.order
    ]


@settings(
    max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    seed=st.integers(0, 10**6),
    odd=st.lists(CELLS, max_size=3),
    separator=st.sampled_from([",", ";", "\t", " "]),
    line_end=st.sampled_from(["\n", "\r\n"]),
)
def test_both_readers_say_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int, odd: list[str], separator: str, line_end: str
) -> None:
    header = separator.join(["seq", "temp_c", "note", "t_s", "ax_g"])
    text = (header + "\n" + rows_of(seed, odd, separator)).replace("\n", line_end)
    data = text.encode()
    (tmp_path / "x.csv").write_bytes(data)
    found = []
    for limit in (0, 1 << 40):
        monkeypatch.setattr(foreign, "LARGE_BYTES", limit)
        monkeypatch.setattr(own, "LARGE_BYTES", limit)
        found.append(
            (outcome(foreign.read_delimited, data, "x", "x"), outcome(own.SolverTable.read, tmp_path / "x.csv"))
        )
    assert found[0] == found[1], text


@pytest.mark.parametrize(
    "body",
    [b"", b"\n1,2\n", b"1,2\n\n3,4\n", b"1,2\n3\n", b"1,2,3\n", b"1,inf\n", b"1,1e999\n",
     b"1,0x10\n", b"1,\0\n", b"1,\xff\n"],
)  # fmt: skip
def test_what_it_may_not_read_is_left_to_the_other(body: bytes) -> None:
    assert columns_at_once(body, ["a", "b"]) is None


def test_whole_numbers_of_19_digits_stay_exact_and_gaps_are_no_number() -> None:
    found = columns_at_once(b"head\n1752345678000000001,1.5,a\n1752345678000000003,,b\n", ["t", "x", "s"], begin=5)
    assert found is not None
    assert found[0].integers is not None
    assert found[0].integers.tolist() == [1752345678000000001, 1752345678000000003]
    assert found[1].numbers is not None
    assert np.array_equal(found[1].numbers, [1.5, np.nan], equal_nan=True)
    assert found[2].texts == ("a", "b")


PEAK = (
    "import sys; from highside.cli.main import app;"
    " app(['import', *sys.argv[1:]], standalone_mode=False);"
    " print(int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0]) // 1024)"
)
"""the import as a process of its own, which prints the most memory that it had at any time, MB; `ru_maxrss` of a new
process begins with that of who started it"""


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize(("form", "most"), [(".parquet", 390), (".csv", 450)])
def test_an_import_of_half_a_million_rows_stays_within_its_memory(tmp_path: Path, form: str, most: int) -> None:
    """2,000,000 rows (141 MB of text) take 684 MB at most to Parquet and 954 MB to CSV; with every copy of the text
    kept, and all cells made texts at once, 1,140 and 2,474. Of these 500,000 rows: 403 and 811 MB then."""
    if not Path("/proc/self/status").exists():
        pytest.skip("the kernel tells the memory of a process elsewhere")
    n = 500_000
    t = np.arange(n) / 100
    up = np.vstack([np.sin(t / 7) * np.cos(t / 5), np.sin(t / 7) * np.sin(t / 5), np.cos(t / 7)])
    columns = np.vstack([t, 9.80665 * up, np.random.default_rng(0).normal(0, 0.1, (3, n)), 25 + 0 * t]).T
    header = "t_s,accel_x (m/s2),accel_y (m/s2),accel_z (m/s2),gyro_x (deg/s),gyro_y (deg/s),gyro_z (deg/s),temp (C)"
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import csv

    table = pyarrow.table(dict(zip(header.split(","), np.round(columns, 6).T, strict=True)))
    csv.write_csv(table, tmp_path / "big.csv", csv.WriteOptions(quoting_style="none"))
    command = [sys.executable, "-c", PEAK, "big.csv", "-o", f"out{form}", "--yes"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=280, check=True)
    assert f"{n} of {n} rows" in done.stderr
    assert int(done.stdout) < most, f"{done.stdout.strip()} MB"
