"""`highside diagnose` on real recordings of which only the magnitude of gravity is known."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_diagnose import highside

from highside.recording.table import Recording, write_recording

Array = np.ndarray[Any, np.dtype[np.float64]]

G2 = {"quadratic", "cubic", "asymmetry", "cross_product"}
MULTI_POSE = ["imu_tk", "mpu9150_imu0", "mpu9150_imu1"]


def columns_of(data: Path, name: str) -> dict[str, Array]:
    """The recording in the columns of the Recording format, nominal scale."""
    if name == "imu_tk":
        with np.load(data / "accel_multipose" / "imu_tk_xsens_mti.npz") as z:
            return triad(z["t"], (z["acc"].T.astype(float) - 2**15) / 2**12)
    if name.startswith("mpu9150"):
        with gzip.open(data / "accel_multipose" / f"{name}.log.gz", "rt") as lines:
            a = np.loadtxt(lines)[:, :3].T / 9.80665
        return triad(np.arange(a.shape[1]) / 100.0, a)
    if name == "imucal":
        with gzip.open(data / "accel_multipose" / "imucal_annotated_session.csv.gz", "rt") as lines:
            rows = np.loadtxt(lines, delimiter=",", skiprows=1, usecols=range(1, 5))
        # the annotated parts in the order in which they were recorded
        rows = rows[np.argsort(rows[:, 0])]
        return triad(rows[:, 0] / 204.8, rows[:, 1:].T / 2048.0)
    if name == "sunsided":
        with np.load(data / "static_mpu6050" / "sunsided_static_10min.npz") as z:
            return triad(z["t"], z["acc"].T) | {"temp_c": np.interp(z["t"], z["temp_t"], z["temp"])}
    with gzip.open(data / "static_mpu6050" / "mpu6050_tomisuarez_static.csv.gz", "rt") as lines:
        rows = np.loadtxt(lines, delimiter=",", skiprows=5)
    return triad(np.arange(len(rows)) / 100.0, rows[:, :3].T / 16384.0)


def triad(t_s: Array, a: Array) -> dict[str, Array]:
    return {"t_s": np.asarray(t_s, dtype=float), "ax_g": a[0], "ay_g": a[1], "az_g": a[2]}


def diagnose(folder: Path, recording: Path, free: str) -> dict[str, Any]:
    """The answer where the effects `free` may be refitted."""
    names = ", ".join(f'"{name}"' for name in free.split())
    (folder / "model.toml").write_text(f'[sensor]\nfree = [{names}]\n[reference]\nkind = "magnitude"\n')
    status, _, err = highside("diagnose", recording, "--model", folder / "model.toml", "--out", folder / "out")
    assert status == 0, err
    found: dict[str, Any] = json.loads((folder / "out" / "diagnosis.json").read_text())
    assert found["schema"] == "highside.diagnosis/1"
    assert (folder / "out" / "report.html").stat().st_size > 1000
    return found


def diagnosed(folder: Path, data: Path, name: str, free: str) -> dict[str, Any]:
    write_recording(folder / "rec.csv", Recording(columns_of(data, name)))
    return diagnose(folder, folder / "rec.csv", free)


# rms of |a| over poses that were left out in turn, mg: with offset and scale alone, and with the misalignment
HELD_OUT = {"imu_tk": (3.98, 0.155), "mpu9150_imu0": (2.24, 0.27), "mpu9150_imu1": (1.91, 0.30)}


@pytest.mark.parametrize("name", MULTI_POSE)
def test_misalignment_that_the_model_lacks_is_named_alone(tmp_path: Path, shared_data: Path, name: str) -> None:
    found = diagnosed(tmp_path, shared_data, name, "bias scale")
    assert found["verdict"] == "named"
    assert [claim["effect"] for claim in found["claims"]] == ["misalignment"]
    claim = found["claims"][0]
    assert claim["equivalence_class"] == ["misalignment"]
    assert claim["p_familywise"] < 1e-6
    before, after = HELD_OUT[name]
    assert 1e3 * found["fit"]["heldout_rmse_before"] == pytest.approx(before, rel=0.05)
    assert 1e3 * found["fit"]["heldout_rmse_after"] < after
    assert found["fit"]["heldout_gain_low"] > 0.9
    assert "left out" in found["fit"]["how_held_out"]
    # |g| shows the symmetric part of the matrix alone; the rest is said not to show
    m = {pair: claim["parameters"][f"m_{pair}"]["value"] for pair in ("xy", "yx", "xz", "zx", "yz", "zy")}
    assert m["xy"] == pytest.approx(m["yx"], rel=0.05) and m["xz"] == pytest.approx(m["zx"], rel=0.05)
    assert m["yz"] == pytest.approx(m["zy"], rel=0.05)
    blind = {entry["effect"]: entry["why"] for entry in found["not_testable"]}
    assert {"mounting", "base_tilt", "encoder_first_harmonic", "sag"} <= set(blind)
    assert "turns" in blind["mounting"]


@pytest.mark.parametrize("name", MULTI_POSE)
def test_both_scale_and_misalignment_are_named_where_both_lack(tmp_path: Path, shared_data: Path, name: str) -> None:
    found = diagnosed(tmp_path, shared_data, name, "bias")
    assert sorted(claim["effect"] for claim in found["claims"]) == ["misalignment", "scale"]


@pytest.mark.parametrize("lacking", ["bias", "scale"])
@pytest.mark.parametrize("name", MULTI_POSE)
def test_an_offset_of_a_tenth_of_g_or_a_scale_that_lacks_is_named_alone(
    tmp_path: Path, shared_data: Path, name: str, lacking: str
) -> None:
    """To first order alone the square of the offset is products of loads, and a turn of 0.1 rad is the scale."""
    free = " ".join(effect for effect in ("bias", "scale", "misalignment") if effect != lacking)
    found = diagnosed(tmp_path, shared_data, name, free)
    assert (found["verdict"], [claim["effect"] for claim in found["claims"]]) == ("named", [lacking])
    assert found["fit"]["heldout_gain_low"] > 0.9


@pytest.mark.parametrize("name", MULTI_POSE)
def test_nothing_is_left_out_of_the_whole_model(tmp_path: Path, shared_data: Path, name: str) -> None:
    found = diagnosed(tmp_path, shared_data, name, "bias scale misalignment")
    assert found["verdict"] == "nothing_left_out"
    assert found["claims"] == []
    # a quadratic term would have been seen from a few mg/g^2 on
    assert found["minimum_detectable"]["quadratic"]["value"] < 3e-3


@pytest.mark.parametrize(
    ("name", "step_mg", "share"), [("imu_tk", 0.5, 0.5), ("mpu9150_imu0", 5.0, 0.3), ("mpu9150_imu1", 10.0, 0.5)]
)
def test_a_step_in_a_real_session_by_hand_is_not_nothing(
    tmp_path: Path, shared_data: Path, name: str, step_mg: float, share: float
) -> None:
    """From a share of the session on all axes read more: named, or refused with the size of what is left."""
    columns = columns_of(shared_data, name)
    later = columns["t_s"] >= columns["t_s"][0] + share * np.ptp(columns["t_s"])
    for axis, part in zip("xyz", (0.62, -0.49, 0.61), strict=True):
        columns[f"a{axis}_g"] = columns[f"a{axis}_g"] + 1e-3 * step_mg * part * later
    write_recording(tmp_path / "rec.csv", Recording(columns))
    found = diagnose(tmp_path, tmp_path / "rec.csv", "bias scale misalignment")
    assert found["verdict"] != "nothing_left_out"
    claimed = {effect for claim in found["claims"] for effect in claim["equivalence_class"]}
    assert "bias_step" in claimed or "more than they repeat" in found["remainder"]["hints"][0]


@pytest.mark.parametrize(("name", "from_s"), [("sunsided", 60.0), ("tomisuarez", 0.0)])
def test_nothing_is_invented_at_rest(tmp_path: Path, shared_data: Path, name: str, from_s: float) -> None:
    """Of `sunsided` without its first minute: it reads less after it was switched on (the next test)."""
    columns = columns_of(shared_data, name)
    kept = columns["t_s"] >= columns["t_s"][0] + from_s
    write_recording(tmp_path / "rec.csv", Recording({key: values[kept] for key, values in columns.items()}))
    found = diagnose(tmp_path, tmp_path / "rec.csv", "bias scale misalignment")
    assert found["verdict"] in ("nothing_left_out", "wander")
    assert found["claims"] == []
    assert not G2 & set(found["remainder"]["resembles"])
    assert {entry["effect"] for entry in found["not_testable"]} >= G2


def test_what_a_sensor_reads_less_at_first_is_named_with_all_that_looks_alike(
    tmp_path: Path, shared_data: Path
) -> None:
    """In means of 2.2 s the first 26 s of `sunsided` read 0.6 mg less than the rest, with 37 of chi-square, while the
    rest scatters as white noise down to means of 70 s (0.057 mg): no random walk. A warm-up of 15 s fits as well."""
    columns = columns_of(shared_data, "sunsided")
    size = 1e3 * np.linalg.norm([columns[f"a{axis}_g"] for axis in "xyz"], axis=0)
    t_s = columns["t_s"] - columns["t_s"][0]
    early, late = size[t_s < 26.0], size[t_s >= 26.0]
    step = late.mean() - early.mean()
    # rows next to one another are correlated: the error of a mean is taken from means of as many rows
    means = late[: late.size // early.size * early.size].reshape(-1, early.size).mean(axis=1)
    assert step > 5 * np.std(means, ddof=1)
    found = diagnosed(tmp_path, shared_data, "sunsided", "bias scale misalignment")
    assert len(found["claims"]) == 1
    claim = found["claims"][0]
    assert {"bias_step", "warmup", "temperature_bias"} <= set(claim["equivalence_class"])
    assert not G2 & set(claim["equivalence_class"])
    if claim["effect"] == "bias_step":
        along = np.linalg.norm([claim["parameters"][f"a_{axis}"]["value"] for axis in "xyz"])
        assert 1e3 * along == pytest.approx(step, rel=0.25)


def test_the_warm_up_follows_temperature_and_not_time(tmp_path: Path, shared_data: Path, project_root: Path) -> None:
    raw, mapping = shared_data / "serial_vn100" / "F00379_first60pct.bin", project_root / "config/vn100-mapping.toml"
    recording = tmp_path / "rec.csv"
    assert highside("decode", raw, "--codec", "vn100", "--config", mapping, "-o", recording)[0] == 0
    found = diagnose(tmp_path, recording, "bias scale misalignment")
    assert found["verdict"] in ("named", "named_plus")
    assert [claim["effect"] for claim in found["claims"]] == ["temperature_bias"]
    claim = found["claims"][0]
    assert "temperature_scale" in claim["equivalence_class"]
    assert "load the axis differently" in claim["next_manoeuvre"]
    ruled_out = {rival["effect"]: rival["delta_bic"] for rival in claim["rivals_ruled_out"]}
    # by noise that may wander, which explains a part of what a drift does not
    assert ruled_out["bias_drift"] > 20
    # the temperature itself runs up nearly as a warm-up would: one of just the right time constant is not ruled out
    assert "warmup" in claim["equivalence_class"] or ruled_out["warmup"] > 6
    assert found["location"][0]["covariate"] == "temp_c"
    assert found["fit"]["heldout_rmse_after"] < 0.25 * found["fit"]["heldout_rmse_before"]
    # 0.8 mg/C along gravity, which points almost along -z of the maker
    size = np.linalg.norm([claim["parameters"][f"bt_{axis}"]["value"] for axis in "xyz"])
    assert size == pytest.approx(8.3e-4, rel=0.1)


def test_turns_by_hand_are_declined(tmp_path: Path, shared_data: Path) -> None:
    found = diagnosed(tmp_path, shared_data, "imucal", "bias scale")
    assert found["verdict"] == "not_testable"
    assert found["claims"] == []
    assert "6 attitudes" in found["not_testable"][0]["why"]


def test_a_quadratic_term_put_into_a_real_session_is_found(tmp_path: Path, shared_data: Path) -> None:
    columns = columns_of(shared_data, "imu_tk")
    columns["ax_g"] = columns["ax_g"] + 5e-3 * columns["ax_g"] ** 2
    write_recording(tmp_path / "rec.csv", Recording(columns))
    found = diagnose(tmp_path, tmp_path / "rec.csv", "bias scale misalignment")
    assert found["verdict"] in ("named", "named_plus")
    assert "quadratic" in found["claims"][0]["equivalence_class"]


def test_a_recording_without_any_reference_is_reported_which_ones_there_are(tmp_path: Path, shared_data: Path) -> None:
    write_recording(tmp_path / "rec.csv", Recording(columns_of(shared_data, "mpu9150_imu0")))
    (tmp_path / "model.toml").write_text("")
    status, _, err = highside("diagnose", tmp_path / "rec.csv", "--model", tmp_path / "model.toml", "--out", tmp_path)
    assert status == 2
    assert len(err.strip().splitlines()) == 1
    for word in ("tf_ref_deg", "magnitude", "--simulation"):
        assert word in err
