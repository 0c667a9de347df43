"""`highside diagnose --simulation` as a user runs it: real recordings beside what other programs predict for them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfiltfilt
from test_diagnose import highside

import studies.clock_offsets as study
from highside.recording.table import Recording, read_recording, write_recording

Array = np.ndarray[Any, np.dtype[np.float64]]
Columns = dict[str, Array]

FURTHER = pytest.mark.further

G = 9.80665
BAND_HZ = 10.0


def diagnose(folder: Path, recorded: Columns, predicted: Columns, status: int = 0) -> tuple[dict[str, Any], str]:
    """The answer and what was said on the terminal."""
    write_recording(folder / "rec.csv", Recording(recorded))
    write_recording(folder / "sim.csv", Recording(predicted))
    given, out, err = highside(
        "diagnose", folder / "rec.csv", "--simulation", folder / "sim.csv", "--out", folder / "out"
    )
    assert given == status, err
    found: dict[str, Any] = json.loads((folder / "out" / "diagnosis.json").read_text())
    assert found["schema"] == "highside.diagnosis/1"
    return found, out


def claims(found: dict[str, Any]) -> dict[str, Any]:
    return {claim["effect"]: claim for claim in found["claims"]}


@pytest.fixture(scope="module")
def broad(shared_data: Path) -> tuple[Columns, Columns]:
    """A hand-held sensor, and its acceleration as a program predicts it from optical tracking of the same body."""
    with np.load(shared_data / "broad" / "07_undisturbed_fast_rotation_B.npz") as z:
        acc, gyr = z["imu_acc"].T.astype(float) / G, np.degrees(z["imu_gyr"].T.astype(float))
        quat, pos, fs = z["opt_quat"].astype(float), z["opt_pos"].astype(float), float(z["fs"])
    t = np.arange(acc.shape[1]) / fs
    lost = np.isnan(quat).any(axis=1) | np.isnan(pos).any(axis=1)
    turned = np.flatnonzero(np.sum(quat[~lost][1:] * quat[~lost][:-1], axis=1) < 0)
    signs = np.ones(int((~lost).sum()))
    for k in turned:
        signs[k + 1 :] *= -1
    quat[~lost] *= signs[:, None]
    for values in (quat, pos):
        for column in values.T:
            column[lost] = np.interp(t[lost], t[~lost], column[~lost])
    w, x, y, z_ = (quat / np.linalg.norm(quat, axis=1)[:, None]).T
    to_lab = np.array([
        [1 - 2 * (y * y + z_ * z_), 2 * (x * y - w * z_), 2 * (x * z_ + w * y)],
        [2 * (x * y + w * z_), 1 - 2 * (x * x + z_ * z_), 2 * (y * z_ - w * x)],
        [2 * (x * z_ - w * y), 2 * (y * z_ + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    smooth = sosfiltfilt(butter(4, BAND_HZ, fs=fs, output="sos"), pos, axis=0)
    moved = np.gradient(np.gradient(smooth, 1 / fs, axis=0), 1 / fs, axis=0).T / G
    force = np.einsum("jin,jn->in", to_lab, moved + np.array([[0.0], [0.0], [1.0]]))
    force[:, lost] = np.nan
    recorded = {"t_s": t, "ax_g": acc[0], "ay_g": acc[1], "az_g": acc[2]}
    recorded |= {"gx_dps": gyr[0], "gy_dps": gyr[1], "gz_dps": gyr[2]}
    return recorded, {"t_s": t, "ax_g": force[0], "ay_g": force[1], "az_g": force[2]}


@pytest.fixture(scope="module")
def car(shared_data: Path, project_root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Columns, Columns]:
    """Yaw rate and lateral acceleration of a car's own sensors, and what a program that has the gyro of a phone in the
    same car predicts: the same yaw rate, and no lateral acceleration."""
    decoded = tmp_path_factory.mktemp("car") / "rec.csv"
    log, mapping = (
        shared_data / "can_comma2k19" / "candump_first30s.log.gz",
        project_root / "config/comma2k19-mapping.toml",
    )
    assert highside("decode", log, "--codec", "dbc", "--config", mapping, "-o", decoded)[0] == 0
    rows = read_recording(decoded)
    with np.load(shared_data / "can_comma2k19" / "phone_imu_first30s.npz") as phone:
        start = 46408.584930  # of the log, in the phone's time
        up = phone["acc"].mean(axis=0) / np.linalg.norm(phone["acc"].mean(axis=0))
        yaw, times = np.degrees(phone["gyr"] @ up), phone["t"] - start
        speed = np.interp(rows.t_s, phone["can_speed_t"] - start, phone["can_speed"])
    recorded = {"t_s": rows.t_s, "gz_dps": rows.columns["gz_dps"], "ay_g": rows.columns["ay_g"], "speed_mps": speed}
    return recorded, {"t_s": times, "gz_dps": yaw, "ay_g": np.zeros_like(yaw)}


def test_the_lever_arm_between_body_and_sensor_is_named_first(tmp_path: Path, broad: tuple[Columns, Columns]) -> None:
    found, said = diagnose(tmp_path, *broad)
    assert found["verdict"] in ("named", "named_plus")
    assert found["claims"][0]["effect"] == "lever_arm"
    arm = claims(found)["lever_arm"]
    size = {axis: arm["parameters"][f"r_{axis}"]["value"] for axis in "xyz"}
    # a least-squares fit by hand to the same data gives 0.8, -1.9 and 7.5 mm
    assert size["z"] == pytest.approx(7.6e-3, abs=0.5e-3)
    assert size["y"] == pytest.approx(-1.9e-3, abs=0.5e-3)
    assert arm["equivalence_class"] == ["lever_arm"]
    assert "time_offset" in claims(found)
    fit = found["fit"]
    assert fit["unit"] == "g"
    assert fit["heldout_rmse_before"] == pytest.approx(0.0748, rel=0.05)
    assert fit["heldout_rmse_after"] < 0.6 * fit["heldout_rmse_before"]
    assert fit["heldout_gain_low"] > 0.8
    alignment = found["noise"]["alignment"]
    assert alignment["same_clock"] and alignment["shift_s"] == 0
    assert alignment["lag_s"] == pytest.approx(0.0025, abs=0.001)
    assert alignment["overlap_s"] == pytest.approx(183.8, abs=0.5)
    assert 0.02 < alignment["omitted"] < 0.05  # the tracking is lost now and then
    assert "183.8 s compared" in said
    assert {"temperature_bias", "centripetal"} <= {entry["effect"] for entry in found["not_testable"]}
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Lever arm" in page.split("<h2>")[0] and "<svg" in page


@pytest.mark.parametrize("later_s", [0.0, pytest.param(731.25, marks=FURTHER)])
def test_yaw_rate_zero_and_centripetal_term_of_a_car(
    tmp_path: Path, car: tuple[Columns, Columns], later_s: float
) -> None:
    recorded, predicted = car
    found, _ = diagnose(tmp_path, recorded, predicted | {"t_s": predicted["t_s"] + later_s})
    assert found["verdict"] in ("named", "named_plus")
    zero = claims(found)["gyro_bias"]["parameters"]["b_gz_dps"]
    assert zero["value"] == pytest.approx(-0.44, abs=0.02)
    assert zero["unit"] == "deg/s"
    centripetal = claims(found)["centripetal"]["parameters"]["k_ay_g_z"]
    assert centripetal["value"] == pytest.approx(-0.95, abs=0.15)  # the car's y points the other way
    assert abs(centripetal["value"]) > 6 * centripetal["std"]
    alignment = found["noise"]["alignment"]
    assert alignment["same_clock"] == (later_s == 0)
    assert alignment["lag_s"] == pytest.approx(-later_s + 0.007, abs=0.02)
    lacking = {entry["effect"] for entry in found["not_testable"]}
    assert ("time_offset" in lacking) == (later_s != 0)


def moving(broad: tuple[Columns, Columns]) -> tuple[Columns, Array, float]:
    """The predicted motion without gaps, as if it were true, and what it takes to make a recording of it."""
    recorded, predicted = broad
    t = recorded["t_s"]
    whole = dict(predicted)
    for name in ("ax_g", "ay_g", "az_g"):
        good = ~np.isnan(predicted[name])
        whole[name] = np.interp(t, t[good], predicted[name][good])
    return whole, np.stack([whole[name] for name in ("ax_g", "ay_g", "az_g")]), float(np.median(np.diff(t)))


def noisy(values: Array, seed: int) -> Array:
    drawn = lfilter([1.0], [1.0, -0.95], np.random.default_rng(seed).standard_normal(values.shape), axis=1)
    return values + 0.01 * drawn / drawn.std()


def made(broad: tuple[Columns, Columns], values: Array, seed: int = 2) -> Columns:
    return broad[0] | dict(zip(("ax_g", "ay_g", "az_g"), noisy(values, seed), strict=True))


def test_nothing_is_said_of_a_right_prediction_in_coloured_noise(
    tmp_path: Path, broad: tuple[Columns, Columns]
) -> None:
    predicted, force, _ = moving(broad)
    found, _ = diagnose(tmp_path, made(broad, force), predicted)
    assert found["verdict"] == "nothing_left_out"
    assert found["claims"] == []
    assert found["minimum_detectable"]["lever_arm"]["value"] < 2e-3


@pytest.mark.parametrize(
    "effect",
    [
        "scale",
        pytest.param("misalignment", marks=FURTHER),
        "time_offset",
        pytest.param("bandwidth_lag", marks=FURTHER),
    ],
)
def test_an_effect_put_into_real_motion_is_named_alone(
    tmp_path: Path, broad: tuple[Columns, Columns], effect: str
) -> None:
    predicted, force, step = moving(broad)
    if effect == "scale":
        values, truth = force * np.array([[1.01], [1.0], [1.0]]), ("k_ax_g", 0.01)
    elif effect == "misalignment":
        values, truth = force + np.array([[0.0], [0.01], [0.0]]) * force[0], ("m_ay_g_ax_g", 0.01)
    elif effect == "time_offset":
        t = predicted["t_s"]
        values, truth = np.stack([np.interp(t - 0.004, t, row) for row in force]), ("t0", 0.004)
    else:
        decay = np.exp(-step / 0.02)
        # the middle of the step that the recursion holds is half of it earlier
        lagged = lfilter([(1 - decay) / 2, (1 - decay) / 2], [1.0, -decay], force - force[:, :1], axis=1)
        values, truth = lagged + force[:, :1], ("tau_accel", 0.02)
    found, _ = diagnose(tmp_path, made(broad, values), predicted)
    assert found["verdict"] in ("named", "named_plus")
    assert list(claims(found)) == [effect]
    fitted = found["claims"][0]["parameters"][truth[0]]
    assert fitted["value"] == pytest.approx(truth[1], abs=max(4 * fitted["std"], 0.03 * truth[1]))


def test_a_square_of_the_load_is_named(tmp_path: Path, broad: tuple[Columns, Columns]) -> None:
    """The effects of the chain act on channels too: it was a product without a name."""
    predicted, force, _ = moving(broad)
    found, _ = diagnose(tmp_path, made(broad, force + 0.01 * force**2), predicted)
    assert found["verdict"] in ("named", "named_plus")
    assert list(claims(found)) == ["quadratic"]
    for name in ("ax_g", "ay_g", "az_g"):
        assert claims(found)["quadratic"]["parameters"][f"k2_{name}"]["value"] == pytest.approx(0.01, abs=3e-3)


@pytest.mark.parametrize("effect", ["temperature_misalignment", pytest.param("reference_voltage", marks=FURTHER)])
def test_further_effects_of_the_chain_are_named_on_channels(
    tmp_path: Path, broad: tuple[Columns, Columns], effect: str
) -> None:
    predicted, force, _ = moving(broad)
    t = predicted["t_s"]
    # from the surface to the bottom of a hole and back, twice
    warm = 60.0 * np.cos(4.0 * np.pi * t / t[-1])
    values, name, size = {
        "temperature_misalignment": (
            force + np.array([[0.0], [1.5e-4], [0.0]]) * warm * force[0], "mt_ay_g_ax_g", 1.5e-4
        ),
        "reference_voltage": (force * (1.0 + 1e-4 * warm), "vt", 1e-4),
    }[effect]  # fmt: skip
    found, _ = diagnose(tmp_path, made(broad, values) | {"temp_c": 85.0 + warm}, predicted)
    assert found["verdict"] in ("named", "named_plus")
    assert list(claims(found)) == [effect]
    fitted = found["claims"][0]["parameters"][name]
    assert fitted["value"] == pytest.approx(size, abs=4 * fitted["std"])


@FURTHER
def test_a_product_that_no_effect_makes_is_given_no_name_of_the_library(
    tmp_path: Path, broad: tuple[Columns, Columns]
) -> None:
    predicted, force, _ = moving(broad)
    found, _ = diagnose(tmp_path, made(broad, force + 0.02 * force[[1, 2, 0]] * force[[2, 0, 1]]), predicted)
    assert found["verdict"] in ("unknown", "law")
    assert all(claim["effect"].startswith("law") for claim in found["claims"])


@pytest.mark.parametrize("late_s", [pytest.param(0.05, marks=FURTHER), 1.0])
def test_a_real_recording_beside_a_prediction_that_is_early(
    tmp_path: Path, broad: tuple[Columns, Columns], late_s: float
) -> None:
    """Whatever offset the files have of their own, it is larger by what was added."""
    recorded, predicted = broad
    found, said = diagnose(tmp_path, recorded, predicted | {"t_s": predicted["t_s"] - late_s})
    # the recording and the tracking are 2.7 ms apart as they were published
    assert claims(found)["time_offset"]["parameters"]["t0"]["value"] == pytest.approx(late_s + 2.7e-3, abs=1e-3)
    assert "bandwidth_lag" not in claims(found)
    assert " s after the prediction, which is left to be diagnosed" in said


@pytest.mark.parametrize(
    ("start_s", "late_s", "instead"),
    [
        # a filter's lag of 14 ms, alone in its class: the errors of optics at high frequency are attenuated with it
        (116.768, 0.01094, "bandwidth_lag"),
        # an offset of -5.2 ms and a lag of 3.8 ms, whose size is no constant: no name was given
        (116.768, -0.00417, "partial"),
        # a lag with a negative time constant: no name was given
        pytest.param(97.562, -0.0205, "implausible_fit", marks=FURTHER),
    ],
)
def test_a_small_shift_of_a_real_clock_is_no_filter(
    shared_data: Path, start_s: float, late_s: float, instead: str
) -> None:
    """What was answered `instead` before a shift of the clock and a filter's lag were compared by what they leave."""
    recorded, predicted = study.clock_files()
    found = study.reported(recorded, predicted, start_s, -late_s, laws=False)
    assert study.offset_of(found) == pytest.approx(study.OWN_S + late_s, abs=1e-3), instead
    assert "bandwidth_lag" not in [claim.effect for claim in found.claims]


def test_laws_do_not_crowd_the_names_of_a_real_recording(shared_data: Path) -> None:
    """Seven laws, each below a fiftieth of its channel's misfit, stood beside the clock, with shares of the whole that
    added up to three times of it."""
    recorded, predicted = study.clock_files()
    found = study.reported(recorded, predicted, 40.0, 0.030, laws=True)
    assert study.offset_of(found) == pytest.approx(study.OWN_S - 0.030, abs=1e-3)
    laws = [claim for claim in found.claims if claim.effect.startswith("law")]
    assert all((claim.share or 0.0) > 0.002 for claim in laws) and len(laws) <= 2
    assert sum(claim.share or 0.0 for claim in found.claims) <= 1.0 + 1e-9


@pytest.mark.parametrize("kind", ["wrong_unit", "inverted_axis", "swapped_axis", "constant_channel"])
def test_files_that_do_not_speak_of_the_same_are_bad_data(
    tmp_path: Path, broad: tuple[Columns, Columns], kind: str
) -> None:
    recorded, predicted = (dict(side) for side in broad)
    if kind == "wrong_unit":
        recorded |= {name: recorded[name] * G for name in ("ax_g", "ay_g", "az_g")}
    elif kind == "inverted_axis":
        recorded["ay_g"] = -recorded["ay_g"]
    elif kind == "swapped_axis":
        recorded["ax_g"], recorded["ay_g"] = recorded["ay_g"], recorded["ax_g"]
    else:
        recorded["az_g"] = np.full_like(recorded["az_g"], 0.25)
    found, _ = diagnose(tmp_path, recorded, predicted, status=1)
    assert found["verdict"] == "bad_data"
    assert found["intake"][0]["check"] == kind
    assert found["claims"] == []


@pytest.mark.parametrize("lack", ["channel", "overlap", "likeness", "copy", "scaled copy"])
def test_files_that_cannot_be_compared_are_one_clear_line(
    tmp_path: Path, car: tuple[Columns, Columns], lack: str
) -> None:
    recorded, predicted = (dict(side) for side in car)
    if lack == "channel":
        predicted = {"t_s": predicted["t_s"], "yaw_dps": predicted["gz_dps"]}
    elif lack == "overlap":
        predicted = {name: values[:20] for name, values in predicted.items()}
    elif lack == "copy":
        # an "internal error" once: nothing is left that a noise could be learnt from
        predicted = recorded
    elif lack == "scaled copy":
        predicted = {**recorded, "gz_dps": 1.01 * recorded["gz_dps"] + 0.3}
    else:
        rng = np.random.default_rng(3)
        predicted |= {"t_s": predicted["t_s"] + 500.0, "gz_dps": rng.standard_normal(predicted["t_s"].size)}
    write_recording(tmp_path / "rec.csv", Recording(recorded))
    write_recording(tmp_path / "sim.csv", Recording(predicted))
    status, _, err = highside(
        "diagnose", tmp_path / "rec.csv", "--simulation", tmp_path / "sim.csv", "--out", tmp_path / "out"
    )
    assert status == 2
    assert len(err.strip().splitlines()) == 1
    assert "sim.csv" in err
    assert not (tmp_path / "out").exists()
