"""Intake checks: each fault by its own name with a small p, and none on healthy recordings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.diagnosis.intake.checks import Intake, chance, check
from highside.diagnosis.intake.clock import duplicates
from highside.physics.gravity import gravity_direction

Array = NDArray[np.float64]
STRAIGHT = ((0, 1.0), (1, 1.0), (2, 1.0))


def healthy(seed: int = 0, step: float = 0.0, sigma: float = 1e-4, seq: bool = True) -> dict[str, Array]:
    """72 poses of 10 rows; `step` of the converter in g (0: none)."""
    rng = np.random.default_rng(seed)
    inc, tf = (np.repeat(a.ravel(), 10) for a in np.meshgrid([5.0, 30, 60, 90, 120, 150], np.arange(0, 360, 30.0)))
    accel = gravity_direction(np.radians(inc), np.radians(tf)) * 1.01 + 2e-3
    accel = accel + sigma * rng.standard_normal(accel.shape)
    accel = np.round(accel / step) * step if step else accel
    n = inc.size
    pose = np.repeat(np.arange(n // 10), 10)
    columns = dict(zip(("ax_g", "ay_g", "az_g"), accel, strict=True))
    columns |= {"t_s": np.arange(n) + 20.0 * pose, "inc_ref_deg": inc, "tf_ref_deg": tf, "pose": pose.astype(float)}
    return columns | ({"seq": np.arange(n, dtype=float)} if seq else {})


def checked(columns: dict[str, Array]) -> Intake:
    return check(columns, ("inc_ref_deg", "tf_ref_deg"), STRAIGHT)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("step", [0.0, 6.1e-5, 1e-3])
@pytest.mark.parametrize("seq", [True, False])
def test_a_healthy_recording_passes_with_any_converter(seed: int, step: float, seq: bool) -> None:
    found = checked(healthy(seed, step, seq=seq))
    assert not found.spoiled
    assert {finding.check for finding in found.findings} <= {"quantisation"}


def test_a_coarse_converter_is_reported_but_spoils_nothing() -> None:
    found = checked(healthy(step=2e-3))
    assert {f.check for f in found.findings} == {"quantisation"}
    assert {"ax", "ay"} <= {channel for f in found.findings for channel in f.channels}
    assert not found.spoiled


def test_few_clipped_readings_are_reported_with_their_share_and_limit() -> None:
    columns = healthy()
    columns["ax_g"] = np.minimum(columns["ax_g"], 0.8)
    found = checked(columns)
    assert [f.check for f in found.findings] == ["clipping"]
    assert found.clipped[0][1] == pytest.approx(0.8)
    assert not found.spoiled


def _swap(columns: dict[str, Array]) -> None:
    columns["ay_g"], columns["az_g"] = columns["az_g"], columns["ay_g"]


def _mg(columns: dict[str, Array]) -> None:
    columns |= {name: 1e3 * columns[name] for name in ("ax_g", "ay_g", "az_g")}


def _turn(columns: dict[str, Array]) -> None:
    columns["ay_g"] = -columns["ay_g"]


def _nan(columns: dict[str, Array]) -> None:
    columns["ay_g"] = np.where(np.arange(columns["ay_g"].size) == 7, np.nan, columns["ay_g"])


def _hold(columns: dict[str, Array]) -> None:
    columns["ax_g"] = np.zeros_like(columns["ax_g"])


def _backwards(columns: dict[str, Array]) -> None:
    columns["t_s"] = columns["t_s"][::-1]


def _shuffle(columns: dict[str, Array]) -> None:
    t = columns["t_s"].copy()
    t[50:60] = t[50:60][::-1]
    columns["t_s"] = t


def _lose(columns: dict[str, Array]) -> None:
    keep = np.arange(columns["t_s"].size) % 17 != 3
    columns |= {name: column[keep] for name, column in columns.items()}


def _repeat(columns: dict[str, Array]) -> None:
    rows = np.sort(np.concatenate([np.arange(columns["t_s"].size), np.arange(0, columns["t_s"].size, 25)]))
    columns |= {name: column[rows] for name, column in columns.items()}


def _noise_only(columns: dict[str, Array]) -> None:
    rng = np.random.default_rng(5)
    accel = rng.standard_normal((3, columns["t_s"].size))
    accel /= np.linalg.norm(accel, axis=0)
    columns |= dict(zip(("ax_g", "ay_g", "az_g"), accel, strict=True))


def _stick(columns: dict[str, Array]) -> None:
    columns["ay_g"] = 6.1e-5 * (np.round(columns["ay_g"] / 6.1e-5).astype(int) & ~(1 << 4))


def _drop_column(columns: dict[str, Array]) -> None:
    del columns["tf_ref_deg"]


@pytest.mark.parametrize(
    ("spoil", "name"),
    [
        (_swap, "swapped_axis"), (_mg, "wrong_unit"), (_turn, "inverted_axis"), (_nan, "missing_values"),
        (_hold, "constant_channel"), (_backwards, "reversed_time"), (_shuffle, "reordered_frames"),
        (_repeat, "duplicated_frames"), (_noise_only, "not_gravity"),
        (_stick, "stuck_bit"), (_drop_column, "missing_column"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("seed", range(3))
def test_each_fault_has_its_own_name_and_spoils_the_data(
    spoil: Callable[[dict[str, Array]], None], name: str, seed: int
) -> None:
    columns = healthy(seed)
    spoil(columns)
    found = checked(columns)
    assert found.spoiled
    assert found.findings[0].check == name
    assert found.findings[0].p < 1e-6
    assert found.findings[0].remedy


def test_lost_frames_are_reported_and_spoil_nothing_until_most_are_lost() -> None:
    columns = healthy(0)
    _lose(columns)
    found = checked(columns)
    assert not found.spoiled
    assert found.findings[0].check == "dropped_frames"
    assert found.findings[0].p < 1e-6
    kept = np.random.default_rng(1).random(columns["t_s"].size) < 0.4
    assert checked({name: column[kept] for name, column in columns.items()}).spoiled


@pytest.mark.parametrize(("spoil", "name"), [(_lose, "dropped_frames"), (_repeat, "duplicated_frames")])
def test_lost_and_repeated_frames_are_seen_without_a_counter(
    spoil: Callable[[dict[str, Array]], None], name: str
) -> None:
    columns = healthy(seq=False)
    spoil(columns)
    assert name in [f.check for f in checked(columns).findings]


@pytest.mark.parametrize("copies", [0, 120])
def test_a_tool_that_turns_slowly_for_a_while_on_a_coarse_converter_repeats_no_frames(copies: int) -> None:
    """There neighbours are on one step, more often than rows two apart, and it was a fault of the link."""
    rng = np.random.default_rng(3)
    n = 6000
    t_s = np.arange(n) / 200.0
    tf = np.cumsum(np.where(t_s % 15.0 < 2.0, 18.0, 800.0)) / 200.0
    accel = gravity_direction(np.full(n, np.radians(60.0)), np.radians(tf)) + 1e-4 * rng.standard_normal((3, n))
    accel = np.round(accel / 2e-3) * 2e-3
    held = np.zeros(n, dtype=bool)
    again = rng.choice(np.arange(1, n), copies, replace=False)
    accel[:, again] = accel[:, again - 1]
    assert np.any(np.all(np.diff(accel, axis=1) == 0, axis=0))
    found = duplicates({"t_s": t_s}, held, accel)
    assert [f.check for f in found] == (["duplicated_frames"] if copies else [])


@pytest.mark.parametrize("copies", [0, 240])
def test_poses_that_drift_by_a_part_of_a_step_of_a_coarse_converter_repeat_no_frames(copies: int) -> None:
    """A bench that leans with the temperature by 4 deg moves readings of 12 bits by a third of a step from row to row:
    neighbours are equal more often than rows two apart, and it was bad data."""
    rng = np.random.default_rng(5)
    poses, rows = 60, 9
    pose = np.repeat(np.arange(poses), rows)
    within = np.tile(np.arange(rows), poses)
    start = gravity_direction(rng.uniform(0.3, 2.8, poses), rng.uniform(0, 6.28, poses))[:, pose]
    accel = start + rng.uniform(-4e-4, 4e-4, (3, poses))[:, pose] * within + 1e-4 * rng.standard_normal(pose.size)
    accel = np.round(accel / 6e-4) * 6e-4
    again = rng.choice(np.flatnonzero(within > 0), copies, replace=False)
    accel[:, again] = accel[:, again - 1]
    # on the way from pose to pose a row has no number, and is not among the readings
    columns = {"pose": np.insert(pose.astype(float), [0, 9, 18], np.nan)}
    found = duplicates(columns, ~np.isnan(columns["pose"]), accel)
    assert [f.check for f in found] == (["duplicated_frames"] if copies else [])


def test_the_binomial_tail_is_exact() -> None:
    assert chance(0, 10, 0.1) == 1.0
    assert chance(1, 2, 0.5) == pytest.approx(0.75)
    assert chance(2, 2, 0.1) == pytest.approx(0.01)
