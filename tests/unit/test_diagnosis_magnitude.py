"""Still readings of which only |g| is known: large offsets, what only turns the reading, rests, intervals."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.core.result import DiagnosisResult, FittedParameter
from highside.diagnosis.engine import diagnose_magnitudes
from highside.diagnosis.magnitude.fit import from_the_start
from highside.diagnosis.magnitude.session import MagnitudeSession, magnitude_session
from highside.diagnosis.recording import Request, diagnose_columns
from highside.physics.effects import get
from highside.physics.forward import ForwardModel
from highside.physics.gravity import attitude_of
from highside.physics.plan import Site
from highside.physics.state import ChainState

FURTHER = pytest.mark.further

ROWS, RATE_HZ, SIGMA_G = 200, 50.0, 2e-4
FREE = ("bias", "scale", "misalignment")
REAL = {
    "bias": {"b_x": 0.09, "b_y": 0.12, "b_z": -0.1},
    "scale": {"s_x": 0.006, "s_y": 0.01, "s_z": 0.004},
    "misalignment": {"m_xy": 0.003, "m_yz": -0.008, "m_zx": 0.01},
}
"""A cheap sensor as it comes: an offset of a tenth of g."""


def session(sensor: dict[str, dict[str, float]], attitudes: np.ndarray, rng: np.random.Generator) -> MagnitudeSession:
    """One still reading in each of the attitudes (3, n), an equal time apart."""
    t_s = np.arange(attitudes.shape[1]) * 8.0 + 20.0
    inc, tf = attitude_of(attitudes)
    readings = ForwardModel.of(sensor).predict(ChainState.build(inc, tf, t_s=t_s - t_s[0]))
    # of the rows, so that a mean repeats to SIGMA_G: scatter that the rows do not have would be a finding
    accel = np.repeat(readings, ROWS, axis=1) + rng.normal(0, SIGMA_G * np.sqrt(ROWS), (3, ROWS * t_s.size))
    times = (t_s[:, None] + np.arange(ROWS) / RATE_HZ).reshape(-1)
    columns = {"t_s": times, "pose": np.repeat(np.arange(t_s.size, dtype=float), ROWS)}
    found = magnitude_session(columns, accel, gravity_mps2=9.80665)
    assert isinstance(found, MagnitudeSession)
    return found


def all_over(n: int) -> np.ndarray:
    """n directions spread over the sphere, in no order."""
    k = np.random.default_rng(n).permutation(n) + 0.5
    z, turn = 1 - 2 * k / n, np.pi * (1 + np.sqrt(5)) * k
    return np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])


def by_hand(withheld: tuple[str, ...], seed: int, **effects: dict[str, float]) -> DiagnosisResult:
    rng = np.random.default_rng(seed)
    free = tuple(name for name in FREE if name not in withheld)
    return diagnose_magnitudes(session({**REAL, **effects}, all_over(36), rng), ForwardModel.of({}), free)[0]


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("withheld", [("bias",), ("scale",), ("misalignment",)])
def test_what_the_model_lacks_is_named_alone_however_large(withheld: tuple[str, ...], seed: int) -> None:
    """The square of an offset of 0.1 g is 25 times the noise, and a turn of 0.1 rad would pass for the scale."""
    found = by_hand(withheld, seed)
    assert (found.verdict, [c.effect for c in found.claims]) == ("named", list(withheld))


def test_an_offset_that_was_left_out_is_reported_with_its_size() -> None:
    stated = by_hand(("bias",), 4).claims[0].parameters
    for axis in "xyz":
        assert stated[f"b_{axis}"].value == pytest.approx(REAL["bias"][f"b_{axis}"], abs=1.5e-3)


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_nothing_is_left_out_of_a_sensor_with_a_large_offset(seed: int) -> None:
    assert by_hand((), seed).verdict == "nothing_left_out"


def test_products_that_only_turn_the_reading_are_left_open() -> None:
    """Of the three coefficients of products of other axes' loads a magnitude shows the sum alone."""
    found = by_hand((), 7, cross_product={"k_x_yz": 4e-3, "k_y_yz": 2e-3})
    assert [c.effect for c in found.claims] == ["cross_product"]
    stated = found.claims[0].parameters
    assert stated["k_y_yz"].low < 2e-3 < stated["k_y_yz"].high < 5e-3
    for name in ("k_x_yz", "k_y_xz", "k_z_xy"):
        assert stated[name].value == pytest.approx(4e-3 / 3, abs=5e-4)
        assert stated[name].high - stated[name].low > 5e-3
    assert stated["k_x_yz"].low < 4e-3 < stated["k_x_yz"].high


def test_what_follows_time_is_distinguished_from_the_first_row_on() -> None:
    """A warm-up has been larger before the first reading, and a step comes later after the start than after it."""
    size, nothing = FittedParameter(1e-3, 1e-4, 8e-4, 1.2e-3, "g"), FittedParameter(0.0, 1e-4, -2e-4, 2e-4, "g")
    sizes = {"a_x": size, "a_y": nothing, "a_z": nothing}
    table = {**sizes, "tau": FittedParameter(50.0, 5.0, 40.0, 60.0, "s")}
    stated = from_the_start(table, get("warmup"), 25.0)
    assert stated["tau"] == table["tau"]
    assert stated["a_x"].value == pytest.approx(1e-3 * np.exp(0.5))
    assert stated["a_x"].high - stated["a_x"].low == pytest.approx(4e-4 * np.exp(0.5))
    step = {**sizes, "t0": FittedParameter(100.0, 0.0, 100.0, 100.0, "s")}
    later = {**step, "t0": FittedParameter(125.0, 0.0, 125.0, 125.0, "s")}
    assert from_the_start(step, get("bias_step"), 25.0) == later
    square = {f"k2_{axis}": size for axis in "xyz"}
    assert from_the_start(square, get("quadratic"), 25.0) == square


def rest(seed: int, step_g: float, walk_g: float = 0.0) -> DiagnosisResult:
    """Ten minutes in one attitude with a step of the offset along gravity after four."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0, 600, 0.1)
    along = np.array([0.2, -0.1, 0.0])
    along[2] = np.sqrt(1 - along @ along)
    level = step_g * (t_s >= 240.0) + np.cumsum(rng.normal(0, walk_g, t_s.size))
    accel = along[:, None] * (1 + level) + rng.normal(0, 1e-3, (3, t_s.size))
    found = magnitude_session({"t_s": t_s}, accel, gravity_mps2=9.80665)
    assert isinstance(found, MagnitudeSession) and found.rest
    return diagnose_magnitudes(found, ForwardModel.of({}), FREE)[0]


def test_in_one_attitude_offset_scale_and_matrix_are_not_testable() -> None:
    lacking = {entry.effect: entry.why for entry in rest(1, 0.0).not_testable}
    assert set(FREE) <= set(lacking) and "quadratic" in lacking
    assert "adjusted" in lacking["misalignment"]


def test_at_rest_what_acts_across_gravity_stays_open() -> None:
    found = rest(2, 1e-3)
    assert [c.effect for c in found.claims] == ["bias_step"]
    stated = found.claims[0].parameters
    assert stated["a_z"].value == pytest.approx(1e-3 * np.sqrt(0.95), abs=1.5e-4)
    assert stated["a_x"].value == pytest.approx(1e-3 * 0.2, abs=3e-5)
    # any plausible step of x or y would show no more than z can make up for
    assert stated["a_x"].high - stated["a_x"].low > 0.09
    assert stated["t0"].value == pytest.approx(240.0, abs=4.0)


@FURTHER
def test_intervals_at_rest_allow_for_a_walk_that_hardly_shows() -> None:
    """A walk of 0.15 mg over the record is hardly seen beside a step of 1 mg, and moves it by more than the noise."""
    misses = []
    for seed in range(12):
        found = rest(100 + seed, 1e-3, 1.5e-4 / np.sqrt(6000))
        if [c.effect for c in found.claims] == ["bias_step"]:
            stated = found.claims[0].parameters["a_z"]
            misses.append(abs(stated.value - 1e-3 * np.sqrt(0.95)) > 2.0 * stated.std)
    assert len(misses) >= 8 and sum(misses) <= 2


FACES = np.array([[1, -1, 0, 0, 0, 0, 1, 1], [0, 0, 1, -1, 0, 0, 1, -1], [0, 0, 0, 0, 1, -1, 1, 1]], dtype=float)


def averages(
    sensor: dict[str, dict[str, float]], count: int, free: tuple[str, ...], attitudes: np.ndarray = FACES
) -> DiagnosisResult:
    """Of a table of averages of 64 readings each, which says how well they repeat: the whole diagnosis."""
    rng = np.random.default_rng(3)
    inc, tf = attitude_of(attitudes[:, :count] / np.linalg.norm(attitudes[:, :count], axis=0))
    readings = ForwardModel.of(sensor).predict(ChainState.build(inc, tf)) + rng.normal(0, 1e-4, (3, count))
    columns = {
        "t_s": 60.0 * np.arange(count),
        "pose": np.arange(count, dtype=float),
        "n": np.full(count, 64.0),
        **dict(zip(("ax_g", "ay_g", "az_g"), readings, strict=True)),
        **{f"std_a{axis}": np.full(count, 8e-4) for axis in "xyz"},
    }
    request = Request(
        columns=columns,
        complete=lambda *names: np.stack([columns[name] for name in names]),
        forward=ForwardModel.of({}),
        free=free,
        site=Site(),
        reference="magnitude",
    )
    return diagnose_columns(request).diagnosis


@pytest.mark.parametrize(("effect", "size"), [("bias", {"b_x": 4e-3}), ("scale", {"s_y": 4e-3})])
def test_a_table_of_eight_averages_that_says_how_well_they_repeat_is_named(effect: str, size: dict[str, float]) -> None:
    found = averages({effect: size}, 8, ())
    assert (found.verdict, [c.effect for c in found.claims]) == ("named", [effect])
    assert averages({}, 8, ()).verdict == "nothing_left_out"


def test_six_faces_show_that_they_disagree_more_than_they_repeat() -> None:
    found = averages({"scale": {"s_y": 4e-3}}, 6, ("bias",))
    assert found.verdict == "unknown"
    assert "disagree" in found.remainder.hints[0]
    assert not found.claims


def test_six_faces_of_which_all_is_refitted_are_not_testable() -> None:
    found = averages({}, 6, ("bias", "scale"))
    assert found.verdict == "not_testable"
    assert found.remainder.hints == (
        "6 averages in 6 attitudes, of which bias, scale, which may be refitted, take up 6",
    )
    assert found.not_testable[0].needs.startswith("measure at least 9 attitudes")


def test_a_model_of_which_nothing_may_be_refitted_is_diagnosed_with_laws() -> None:
    """Nothing is free: the laws' columns begin with none."""
    assert averages({}, 24, (), all_over(24)).verdict == "nothing_left_out"
