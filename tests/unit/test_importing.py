"""Recordings of other programs: every dialect gives back what was written, and what is not certain is not taken."""

from __future__ import annotations

import gzip
import io
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import highside
from highside.errors import InputError
from highside.importing.core.instants import instants
from highside.importing.core.proposal import Sure
from highside.importing.core.source import SourceColumn
from highside.importing.core.timing import read_time
from highside.importing.core.units import STANDARD_GRAVITY, Quantity, unit_named, unit_wanted
from highside.importing.core.wishes import Wishes
from highside.importing.files import open_foreign, recording_of
from highside.importing.forms.delimited import _column
from highside.recording.export import export
from highside.recording.export_format import ExportFormat
from highside.recording.table import Recording

ACCEL = ["ax_g", "ay_g", "az_g"]


def session(n: int = 200, rate_hz: float = 50.0, seed: int = 0) -> pd.DataFrame:
    """A tool that turns by hand: gravity and the rates that turn it, four poses of a bench as references."""
    rng = np.random.default_rng(seed)
    t = np.round(np.arange(n) / rate_hz, 6)
    inc, tf = np.radians(40 + 30 * np.sin(0.9 * t)), np.radians(50 + 40 * np.sin(0.7 * t + 1))
    u = np.vstack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])
    d_inc, d_tf = np.radians(27 * np.cos(0.9 * t)), np.radians(28 * np.cos(0.7 * t + 1))
    du = np.vstack([
        np.cos(inc) * np.cos(tf) * d_inc - np.sin(inc) * np.sin(tf) * d_tf,
        np.cos(inc) * np.sin(tf) * d_inc + np.sin(inc) * np.cos(tf) * d_tf,
        -np.sin(inc) * d_inc,
    ])  # fmt: skip
    # of all rates with du/dt = -w x u the smallest
    w = np.degrees(np.cross(du, u, axis=0)) * 1.0
    a = u + rng.normal(0, 1e-4, u.shape)
    columns = {"t_s": t} | dict(zip(ACCEL, a, strict=True))
    columns |= dict(zip(["gx_dps", "gy_dps", "gz_dps"], w, strict=True))
    columns |= {"temp_c": 25 + rng.normal(0, 0.1, n), "inc_ref_deg": np.degrees(inc), "tf_ref_deg": np.degrees(tf)}
    return pd.DataFrame(columns)


def read(path: Path, **wishes: object) -> highside.Recording:
    return highside.import_recording(path, **wishes)  # type: ignore[arg-type]


def same(found: Recording, frame: pd.DataFrame, *, columns: list[str] | None = None, atol: float = 1e-12) -> None:
    for name in columns or list(frame.columns):
        wanted = frame[name].to_numpy()
        wanted = wanted - wanted[0] + found[name][0] if name == "t_s" else wanted
        np.testing.assert_allclose(found[name], wanted, rtol=0, atol=atol, err_msg=name)


# --- dialects of text ------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 10_000),
    separator=st.sampled_from([";", "\t", "|", ","]),
    comma=st.booleans(),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"]),
    line_end=st.sampled_from(["\n", "\r\n", "\r"]),
    index=st.booleans(),
    zipped=st.booleans(),
    units=st.sampled_from(["g", "m/s2", "mg"]),
    place=st.sampled_from(["brackets", "parentheses", "line"]),
    time=st.sampled_from(["s", "ms", "us", "iso", "european", "epoch s", "epoch ms", "epoch us", "epoch ns"]),
)
def test_a_recording_comes_back_through_every_dialect(
    tmp_path: Path, seed: int, separator: str, comma: bool, encoding: str, line_end: str, index: bool, zipped: bool,
    units: str, place: str, time: str,
) -> None:  # fmt: skip
    own = session(40, seed=seed)
    factor = {"g": 1.0, "m/s2": STANDARD_GRAVITY, "mg": 1000.0}[units]
    start = 1_752_345_678_000_000_000
    ns = np.rint(own.t_s * 1e9).astype(np.int64)
    stamps: dict[str, tuple[str, list[object]]] = {
        "s": ("Time {s}", list(own.t_s)),
        "ms": ("Time {ms}", list(own.t_s * 1e3)),
        "us": ("Time {us}", list(ns // 1000)),
        "iso": ("timestamp", [pd.Timestamp(start + k).isoformat() for k in ns]),
        "european": ("Datum", [pd.Timestamp(start + k).strftime("%d.%m.%Y %H:%M:%S.%f") for k in ns]),
        "epoch s": ("time", [f"{(start + k) // 10**9}.{(start + k) % 10**9:09d}" for k in ns]),
        "epoch ms": ("time", list((start + ns) // 10**6)),
        "epoch us": ("time", list((start + ns) // 10**3)),
        "epoch ns": ("time", list(start + ns)),
    }
    label, times = stamps[time]
    mark = {"brackets": " [{}]", "parentheses": " ({})", "line": ""}[place]
    named = [
        ("Accel " + axis + mark.format(units), own[name] * factor) for axis, name in zip("XYZ", ACCEL, strict=True)
    ]
    columns = {label.replace("{", "(").replace("}", ")") if "{" in label else label: times} | dict(named)
    if time == "european":
        columns = {"Time": times} | dict(named)
    second = [] if place != "line" else [[""] * index + ["" if "(" not in name and k == 0 else units if k else time
                                                       for k, name in enumerate(columns)]]  # fmt: skip
    point = "," if comma and separator != "," else "."

    def cell(value: object) -> str:
        if isinstance(value, str):
            return value.replace(".", point) if time == "epoch s" else value
        return (repr(float(value)) if isinstance(value, float) else str(value)).replace(".", point)

    rows = [list(map(cell, row)) for row in zip(*columns.values(), strict=True)]
    if index:
        rows = [[str(k), *row] for k, row in enumerate(rows)]
    lines = [[""] * index + list(columns), *second, *rows]
    data = line_end.join(separator.join(line) for line in lines).encode(encoding)
    path = tmp_path / ("x.csv.gz" if zipped else "x.csv")
    path.write_bytes(gzip.compress(data) if zipped else data)
    found = read(path)
    same(found, own, columns=["t_s", *ACCEL], atol=1e-9)
    assert set(found.order) == {"t_s", *ACCEL}


def test_names_without_units_are_taken_only_when_accepted(tmp_path: Path) -> None:
    own = session()
    frame = pd.DataFrame({"timestamp": pd.to_datetime(own.t_s * 1e9 + 1.75e18), "accel_x": own.ax_g * STANDARD_GRAVITY,
                          "accel_y": own.ay_g * STANDARD_GRAVITY, "accel_z": own.az_g * STANDARD_GRAVITY})  # fmt: skip
    frame.to_csv(tmp_path / "dump.csv")
    with pytest.raises(InputError, match=r"rests on its values alone.*units=.*accept=True"):
        read(tmp_path / "dump.csv")
    same(read(tmp_path / "dump.csv", accept=True), own, columns=ACCEL)
    same(read(tmp_path / "dump.csv", units=["m/s2"]), own, columns=["t_s", *ACCEL], atol=1e-6)


def test_a_name_that_the_values_contradict_is_never_taken(tmp_path: Path) -> None:
    own = session()
    own[ACCEL] *= STANDARD_GRAVITY
    own.to_csv(tmp_path / "x.csv", index=False)
    for accept in (False, True):
        with pytest.raises(InputError, match=r"named g, but then \|a\| is 9\.81 g; units="):
            read(tmp_path / "x.csv", accept=accept)
    same(read(tmp_path / "x.csv", units=["m/s2"]), session(), columns=ACCEL)


@pytest.mark.parametrize(("named", "factor"), [("gyro_x_rads", np.pi / 180), ("gyro_x", np.pi / 180), ("gyro_x", 1.0)])
def test_the_turn_of_gravity_shows_the_unit_of_the_rates(tmp_path: Path, named: str, factor: float) -> None:
    own = session()
    frame = own.rename(columns={f"g{a}_dps": named.replace("x", a, 1) for a in "xyz"})
    frame[[named.replace("x", a, 1) for a in "xyz"]] *= factor
    frame.to_csv(tmp_path / "x.csv", index=False)
    same(read(tmp_path / "x.csv", accept=True), own, columns=["gx_dps", "gy_dps", "gz_dps"], atol=1e-9)


def test_rates_that_gravity_contradicts_are_never_taken(tmp_path: Path) -> None:
    own = session()
    own[["gx_dps", "gy_dps", "gz_dps"]] *= np.pi / 180
    own.to_csv(tmp_path / "x.csv", index=False)
    with pytest.raises(InputError, match=r"named deg/s, but gravity turns 57\.[34] times as fast"):
        read(tmp_path / "x.csv", accept=True)


def test_rates_at_rest_without_a_unit_stay_open(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    frame = pd.DataFrame({"time_s": np.arange(200) / 100, "acc_x": 0.0, "acc_y": 0.0, "acc_z": 1.0})
    frame[["gyr_x", "gyr_y", "gyr_z"]] = rng.normal(0, 0.1, (200, 3))
    frame.to_csv(tmp_path / "x.csv", index=False)
    with pytest.raises(InputError, match=r"gx_dps from gyr_x: its unit is not named.*units="):
        read(tmp_path / "x.csv", accept=True)
    out = read(tmp_path / "x.csv", accept=True, mapping=dict.fromkeys(("gx_dps", "gy_dps", "gz_dps"), "none"))
    assert not out.has("gx_dps")
    assert out.has("gyr_x"), "they go over under their own name"


def test_counts_are_a_guess_of_their_resolution(tmp_path: Path) -> None:
    own = session()
    counts = pd.DataFrame(
        {"ms": (own.t_s * 1000).round().astype(int)}
        | {f"a{a}": (own[f"a{a}_g"] * 8192).round().astype(int) for a in "xyz"}
    )
    counts.to_csv(tmp_path / "x.csv", index=False)
    proposal = open_foreign(tmp_path / "x.csv", Wishes(mapping={"t_s": "ms:ms"}))
    guess = proposal.guess("ax_g")
    assert guess is not None
    assert (guess.sure, guess.unit and guess.unit.name) == (Sure.LIKELY, "lsb/8192")
    same(recording_of(proposal).recording, own, columns=ACCEL, atol=1 / 8192)
    # 1024 counts and 1000 mg are too near to one another
    near = counts.assign(**{f"a{a}": (own[f"a{a}_g"] * 1024).round().astype(int) for a in "xyz"})
    near.to_csv(tmp_path / "y.csv", index=False)
    with pytest.raises(InputError, match="its unit may be mg or lsb/1024"):
        read(tmp_path / "y.csv", accept=True, mapping={"t_s": "ms:ms"})


def test_axes_are_held_against_the_reference(tmp_path: Path) -> None:
    own = session()
    turned = own.assign(ax_g=-own.ay_g, ay_g=own.ax_g).drop(columns=["gx_dps", "gy_dps", "gz_dps"])
    turned.to_csv(tmp_path / "x.csv", index=False)
    with pytest.raises(InputError, match=r"axes y-xz agree with the reference"):
        read(tmp_path / "x.csv")
    same(read(tmp_path / "x.csv", accept=True), own, columns=ACCEL)
    mirrored = own.assign(ay_g=-own.ay_g).drop(columns=["gx_dps", "gy_dps", "gz_dps"])
    mirrored.to_csv(tmp_path / "y.csv", index=False)
    with pytest.raises(InputError, match="is a mirror"):
        read(tmp_path / "y.csv", accept=True)


def test_phone_loggers(tmp_path: Path) -> None:
    own = session()
    a = own[ACCEL].to_numpy() * STANDARD_GRAVITY
    # phyphox, "Acceleration (with g)"
    phyphox = pd.DataFrame({"Time (s)": own.t_s} | {f"Acceleration {x} (m/s^2)": a[:, k] for k, x in enumerate("xyz")})
    phyphox.assign(**{"Absolute acceleration (m/s^2)": np.linalg.norm(a, axis=1)}).to_csv(
        tmp_path / "Raw Data.csv", index=False, quoting=2
    )
    same(read(tmp_path / "Raw Data.csv"), own, columns=["t_s", *ACCEL])
    # the same program without gravity: nothing to calibrate by
    linear = phyphox.copy()
    linear.iloc[:, 1:] -= a.mean(axis=0)
    linear.iloc[:, 1:] *= 0.01
    linear.columns = [name.replace("Acc", "Linear Acc") for name in linear.columns]
    linear.to_csv(tmp_path / "linear.csv", index=False)
    with pytest.raises(InputError, match="named m/s2, but then"):
        read(tmp_path / "linear.csv", accept=True)
    # Sensor Logger: TotalAcceleration.csv
    ns = 1_752_345_678_000_000_000 + np.rint(own.t_s * 1e9).astype(np.int64)
    total = pd.DataFrame({"time": ns, "seconds_elapsed": own.t_s, "z": a[:, 2], "y": a[:, 1], "x": a[:, 0]})
    total.to_csv(tmp_path / "TotalAcceleration.csv", index=False)
    same(read(tmp_path / "TotalAcceleration.csv", accept=True), own, columns=["t_s", *ACCEL])


# --- time and rows ---------------------------------------------------------------------------------------------------


def test_microseconds_that_wrap_go_on(tmp_path: Path) -> None:
    own = session()
    frame = pd.DataFrame({"micros": (np.rint(own.t_s * 1e6).astype(np.int64) + (1 << 32) - 1_000_000) % (1 << 32)})
    frame[["ax_mg", "ay_mg", "az_mg"]] = own[ACCEL] * 1000
    frame.to_csv(tmp_path / "x.csv", index=False)
    proposal = open_foreign(tmp_path / "x.csv", Wishes())
    assert "a counter of 32 bits wrapped 1 times" in proposal.guesses[0].evidence
    same(recording_of(proposal).recording, own, columns=["t_s"], atol=1e-6)


def test_rows_are_counted_and_named(tmp_path: Path) -> None:
    own = session(60)
    rows = [k for k in range(60) if k not in (20, 21, 40)]
    rows = [*rows[:10], 11, 10, *rows[12:], 59]  # two out of order, the last given twice
    own.iloc[rows].to_csv(tmp_path / "x.csv", index=False)
    found = recording_of(open_foreign(tmp_path / "x.csv", Wishes()))
    text = "\n".join(found.findings)
    assert "1 rows out of order, put where their time belongs: line 13" in text
    assert "1 rows given twice, omitted once: line 59" in text
    assert "2 gaps of the time (3 rows of 20 ms lost), before: line 22, line 40" in text
    assert found.recording.n == 57
    assert (np.diff(found.recording.t_s) > 0).all()


def test_a_session_of_stops_has_pauses_and_no_lost_rows(tmp_path: Path) -> None:
    own = session(60)
    own["t_s"] = np.concatenate([stop * 40 + np.arange(10) / 50 for stop in range(6)])
    own[["t_s", *ACCEL]].to_csv(tmp_path / "x.csv", index=False)
    found = recording_of(open_foreign(tmp_path / "x.csv", Wishes()))
    assert found.findings == (
        "5 pauses of 39.82 to 39.82 s in which no row was written, before: line 12, line 22, line 32, line 42, line 52",
    )


def test_steps_that_are_uneven_are_not_called_lost_rows(tmp_path: Path) -> None:
    own = session(60)
    own["t_s"] = np.cumsum(np.where(np.arange(60) % 3 == 0, 0.05, 0.02))
    own[["t_s", *ACCEL]].to_csv(tmp_path / "x.csv", index=False)
    found = recording_of(open_foreign(tmp_path / "x.csv", Wishes()))
    assert found.findings == ("its steps of time are uneven: 20 to 50 ms for 9 of 10 rows; none is called lost",)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    bits=st.sampled_from([16, 24, 31, 32]),
    begin=st.integers(0, 1 << 32),
    tick=st.sampled_from([1000, 1024, 5000, 10_000]),
    n=st.integers(40, 400),
    lost=st.sets(st.integers(5, 35), max_size=3),
)
def test_a_counter_of_a_device_that_wraps_goes_on(bits: int, begin: int, tick: int, n: int, lost: set[int]) -> None:
    from highside.importing.core.source import number_column
    from highside.importing.core.timing import read_time, rows_of

    kept = np.array([k for k in range(n) if k not in lost])
    counter = (begin + kept * tick) % (1 << bits)
    reading = read_time(number_column("micros", counter), unit_wanted("us", Quantity.TIME))
    assert reading is not None
    np.testing.assert_array_equal(reading.ns - reading.ns[0], kept * tick * 1000 - kept[0] * tick * 1000)
    found = rows_of(reading.ns, np.zeros(kept.size - 1, dtype=bool), lambda row: str(row + 1))
    said = [line for line in found.lines if "gaps" in line]
    assert bool(said) == bool(lost)
    if lost:
        assert f"({len(lost)} rows of" in said[0]
    assert len(found.parts) == 1


def test_a_command_for_our_recordings_names_the_one_for_others(tmp_path: Path) -> None:
    own = session(20)
    own.rename(columns={"t_s": "time"}).to_csv(tmp_path / "x.csv", index=False)
    own.to_csv(tmp_path / "y.csv", sep=";", decimal=",")
    np.savez(tmp_path / "z.npz", t=own.t_s)
    for name in ("x.csv", "y.csv", "z.npz"):
        with pytest.raises(InputError, match=rf"of another program: highside import .*{name} -o REC"):
            Recording.read(tmp_path / name)
    own.drop(columns="ax_g").to_csv(tmp_path / "x.csv", index=False)
    with pytest.raises(InputError, match=r"lacks the column ax_g.*highside import"):
        Recording.read(tmp_path / "x.csv").accel()


def test_a_clock_that_begins_again_is_two_recordings(tmp_path: Path) -> None:
    own = session(300)
    pd.concat([own, own.iloc[:150]]).to_csv(tmp_path / "x.csv", index=False)
    with pytest.raises(InputError, match=r"begins again at line 302: 2 recordings.*part=N \(1 to 2\)"):
        read(tmp_path / "x.csv")
    assert read(tmp_path / "x.csv", part=2).n == 150
    assert read(tmp_path / "x.csv", part=1).n == 300


def test_a_file_without_time_needs_a_rate(tmp_path: Path) -> None:
    own = session(50)
    own[ACCEL].to_csv(tmp_path / "x.csv", index=False)
    with pytest.raises(InputError, match="no column is a time; rate_hz=HZ"):
        read(tmp_path / "x.csv", accept=True)
    same(read(tmp_path / "x.csv", rate_hz=50), own, columns=["t_s", *ACCEL])


@pytest.mark.parametrize(
    ("cells", "seconds", "written"),
    [
        (("2026-01-31T23:59:59.5Z", "2026-02-01T00:00:00.25+00:00"), 0.75, "ISO 8601"),
        (("2026-01-31 23:59:59,500", "2026-02-01 01:00:00+01:00"), 0.5, "ISO 8601"),
        (("31.01.2026 23:59:59", "01.02.2026 00:00:01"), 2.0, "day.month.year"),
        (("01/31/2026 11:59:59 PM", "02/01/2026 12:00:01 AM"), 2.0, "month/day/year"),
        (("10:00:00", "10:00:00.125"), 0.125, "time of day"),
    ],
)  # fmt: skip
def test_written_times(cells: tuple[str, ...], seconds: float, written: str) -> None:
    found = instants(cells)
    assert found is not None
    assert (int(found.ns[1] - found.ns[0]) / 1e9, found.written, found.doubt) == (seconds, written, None)


def test_a_date_that_may_be_two_stays_open() -> None:
    found = instants(("02/03/2026 10:00:00", "03/03/2026 10:00:00"))
    assert found is not None
    assert found.doubt is not None
    assert instants(("2026-13-01T00:00:00",)) is None
    assert instants(("2026-01-01T25:00:00",)) is None


def test_times_further_apart_than_is_read_stay_open_and_never_wrap() -> None:
    """Of nanoseconds in 64 bits a difference may be none: year 9999 was read as some other, and an end was overrun."""
    late = instants(("2026-01-01T00:00:00Z", "9999-01-01T00:00:00Z"))
    assert late is not None and late.ns[1] > late.ns[0]
    ends = np.array([-9_000_000_000_000_000_000, 9_000_000_000_000_000_000])
    reading = read_time(SourceColumn("t", numbers=ends.astype(float), integers=ends), unit_named("ns", Quantity.TIME))
    assert reading is not None and reading.open is not None and "146 years" in reading.open
    assert np.diff(reading.ns) > 0


@pytest.mark.parametrize("cells", [("0.01", "", "0.02"), ("0.006.2e16", "0.01"), ("1", "1.", ".5", "+1e-3", "-2E+2")])
def test_a_column_of_numbers_is_what_each_cell_is(cells: tuple[str, ...]) -> None:
    """On Python before 3.11.5, too: there one look at the whole column said yes to what is none."""
    found = _column("x", cells, False, 2, "a.csv")
    if "0.006.2e16" in cells:
        assert found.texts == cells
    else:
        np.testing.assert_array_equal(found.numbers, [float(cell or "nan") for cell in cells])


def test_no_regular_expression_repeats_a_group_without_a_way_back() -> None:
    """`(...)*+` matches what it should not in Python before 3.11.5."""
    places = Path(highside.__file__).parent.rglob("*.py")
    assert [path.name for path in places if re.search(r"\)(?:[*+?]|\{[\d,]+\})\+|\(\?>", path.read_text())] == []


# --- other forms -----------------------------------------------------------------------------------------------------


def _parquet(frame: pd.DataFrame, path: Path) -> None:
    frame.to_parquet(path)


def _feather(frame: pd.DataFrame, path: Path) -> None:
    frame.to_feather(path)


def _npz(frame: pd.DataFrame, path: Path) -> None:
    np.savez(path.open("wb"), **{name: frame[name].to_numpy() for name in frame})


def _packed_npz(frame: pd.DataFrame, path: Path) -> None:
    np.savez_compressed(path.open("wb"), **{name: frame[name].to_numpy() for name in frame})


def _npy(frame: pd.DataFrame, path: Path) -> None:
    np.save(path.open("wb"), frame.to_records(index=False))


def _mcap(frame: pd.DataFrame, path: Path) -> None:
    export(Recording({name: frame[name].to_numpy() for name in frame}), path, ExportFormat.MCAP)


@pytest.mark.parametrize("write", [_parquet, _feather, _npz, _packed_npz, _npy, _mcap])
def test_other_forms_come_back(tmp_path: Path, write: Callable[[pd.DataFrame, Path], None]) -> None:
    own = session()
    write(own, tmp_path / "x.bin")  # known by its content, not by its name
    same(read(tmp_path / "x.bin"), own)


@pytest.mark.parametrize("to", [ExportFormat.PARQUET, ExportFormat.MCAP])
def test_every_reader_takes_what_export_writes(tmp_path: Path, to: ExportFormat) -> None:
    own = session()
    texts = {"remark": tuple("a" if k % 2 else "b, c" for k in range(len(own)))}
    recording = Recording(
        {name: own[name].to_numpy() for name in own} | {"seq": np.arange(len(own), dtype=float)}, texts
    )
    recording.columns["temp_c"] = np.where(np.arange(len(own)) == 3, np.nan, recording["temp_c"])
    export(recording, tmp_path / "x", to)
    found = highside.read(tmp_path / "x")
    assert found.order == recording.order
    assert found.texts == recording.texts
    for name, values in recording.columns.items():
        assert np.array_equal(found[name], values, equal_nan=True), name


def test_arrays_of_three_columns_and_their_rate(tmp_path: Path) -> None:
    own = session()
    np.savez(tmp_path / "x.npz", imu_acc=own[ACCEL].to_numpy() * STANDARD_GRAVITY, fs=50.0, note=np.zeros((4, 4)))
    with pytest.raises(InputError, match="the file says 50 rows/s"):
        read(tmp_path / "x.npz", units=["m/s2"])
    for rate in (None, 50.0):
        same(read(tmp_path / "x.npz", accept=True, rate_hz=rate), own, columns=["t_s", *ACCEL])


# --- hostile ---------------------------------------------------------------------------------------------------------

GOOD = session(30).to_csv(index=False)
HOSTILE: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "is empty"),
    "blank": (b"\n\n \n", "is empty"),
    "header alone": (b"t_s,ax_g,ay_g,az_g\n", "no rows|is no table"),
    "binary": (bytes(range(256)) * 40, "no text|is no table|not text"),
    "million columns": (b",".join(b"c%d" % k for k in range(1_000_000)) + b"\n", "no end|columns"),
    "a million numbers": (b",".join([b"1.5"] * 1_000_000) + b"\n", "no end|columns"),
    "short row": (GOOD.replace("\n", "\n1,2\n", 4).encode(), "has 2 cells where the others have 10"),
    "one row, short": (b"t_s,ax_g,ay_g,az_g\n0,1,2\n", "line 2: has 3 cells where the header has 4"),
    "units and one row, short": (b"t,ax,ay,az\ns,g,g,g\n0,1,2\n", "line 3: has 3 cells where the others have 4"),
    "all rows short": (b"t_s,ax_g,ay_g,az_g\n0,1,2\n1,2,3\n", "line 1: the header has 4 cells where the rows have 3"),
    "a text among numbers": (GOOD.replace("0.1,", "zero,", 1).encode(), "'zero' is no number"),
    "underscores": (GOOD.replace("0.1,", "1_0.1,", 1).encode(), "'1_0.1' is no number"),
    "infinite": (GOOD.replace("0.1,", "1e999,", 1).encode(), "not a finite number"),
    "comma and point": (b"t_s;ax_g;ay_g;az_g\n0,01;0;0.5;1\n0,02;0;0.5;1\n", "with comma and with point"),
    "thousands": (b"t_s;ax_g;ay_g;az_g\n1,000;0;0;1\n2,000;0;0;1\n", "decimals or thousands"),
    "grouped": (b"t_s;ax_g;ay_g;az_g\n1.000,5;0;0;1\n1.001,5;0;0;1\n", "groups its digits"),
    "twice": (b"t_s,ax_g,ax_g\n1,2,3\n2,3,4\n", "names this column twice"),
    "NUL": (GOOD.replace("0.1,", "\0,", 1).encode(), "bytes that are no text"),
    "torn gzip": (gzip.compress(GOOD.encode())[:-20], "damaged gzip"),
    "torn UTF-16": (GOOD.encode("utf-16")[:-1], "is not text in UTF-16"),
    "Parquet": (b"PAR1 and nothing", "damaged Parquet"),
    "Arrow": (b"ARROW1\0\0 and nothing", "damaged Arrow"),
    "MCAP": (b"\x89MCAP0\r\n and nothing", "damaged MCAP"),
    "NumPy": (b"\x93NUMPY\x01\x00E\x00{'descr': '<f8', 'fortran_order': False, 'shape': (9999,), }     \n", "no NumPy"),
    "archive": (b"PK\x03\x04 x.npy and nothing", "damaged archive"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_in_one_line(tmp_path: Path, name: str) -> None:
    data, says = HOSTILE[name]
    (tmp_path / "x").write_bytes(data)
    with pytest.raises(InputError, match=says) as caught:
        read(tmp_path / "x", accept=True)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path))


def test_pickled_objects_and_bombs_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="Python objects"):
        read(tmp_path / "x.npy")
    packed = io.BytesIO()
    np.savez_compressed(packed, t=np.zeros(4_000_000))
    (tmp_path / "x.npz").write_bytes(packed.getvalue())
    with pytest.raises(InputError, match="times its size"):
        read(tmp_path / "x.npz")


def test_a_torn_last_line_is_omitted_and_said(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text(GOOD[: GOOD.rstrip().rindex(",")])
    proposal = open_foreign(tmp_path / "x.csv", Wishes())
    assert proposal.table.remarks == ("line 31 is torn and was omitted",)
    assert proposal.table.n == 29


@pytest.mark.parametrize("cut", range(0, len(GOOD), 211))
def test_a_file_cut_anywhere_is_read_or_refused(tmp_path: Path, cut: int) -> None:
    (tmp_path / "x.csv").write_text(GOOD[:cut])
    try:
        found = read(tmp_path / "x.csv", accept=True)
    except InputError:
        return
    whole = session(30)
    for name in ACCEL:
        # the last number may be cut short, which nothing shows; all before it are as written
        np.testing.assert_array_equal(found[name][:-1], whole[name].to_numpy()[: found.n - 1])


# --- what the user says ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mapping", "says"),
    [
        ({"ax": "a"}, "'ax' is no column of a recording"),
        ({"t_s": "nope"}, "no such column"),
        ({"ax_g": "t_s:m/s2"}, "ay_g is missing"),
        ({"t_s": "t_s:furlong"}, "'furlong' is no unit of time"),
    ],
)
def test_a_wish_that_cannot_be_met_is_named(tmp_path: Path, mapping: dict[str, str], says: str) -> None:
    (tmp_path / "x.csv").write_text(GOOD)
    with pytest.raises(InputError, match=says):
        read(tmp_path / "x.csv", mapping=mapping)


def test_units_that_are_given() -> None:
    assert unit_wanted("lsb/16384", Quantity.ACCELERATION).factor == 1 / 16384
    assert unit_wanted("lsb/131@-20", Quantity.RATE).zero == -20
    assert unit_wanted("ticks/10000", Quantity.TIME).factor == 1e5
    with pytest.raises(InputError, match="no unit of acceleration"):
        unit_wanted("ticks/10", Quantity.ACCELERATION)


def test_columns_that_may_be_the_setting_of_the_bench_are_pointed_at(tmp_path: Path) -> None:
    """What a name alone cannot tell (set, or computed by the tool) is asked for, and taken only when it is said."""
    d = session()
    d["Inclination [deg]"], d["toolface"] = 12.0, np.linspace(0.0, 300.0, len(d))
    path = tmp_path / "angles.csv"
    d.drop(columns=[name for name in d if "ref" in name]).to_csv(path, index=False)
    command = [str(Path(sys.executable).with_name("highside")), "import", str(path), "--inspect"]
    shown = subprocess.run(command, capture_output=True, text=True, check=False).stderr
    options = "--map inc_ref_deg='Inclination [deg]' --map tf_ref_deg=toolface"
    assert options in shown
    answer = subprocess.run([*command, "--json"], capture_output=True, text=True, check=False).stdout
    assert json.loads(answer)["possible_references"] == {"inc_ref_deg": "Inclination [deg]", "tf_ref_deg": "toolface"}
    told = subprocess.run(command + shlex.split(options), capture_output=True, text=True, check=False).stderr
    assert "where the bench was set" not in told
