"""What readings do while a pose is held: laws of the time since the last move, from rows made without the product."""

import numpy as np
import pytest

from highside.api.diagnosis import diagnose
from highside.api.simulation import predict
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.laws.course import HeldRows
from highside.diagnosis.laws.since_move import laws_since_move
from highside.diagnosis.poses.session import pose_session, rows_of_poses
from highside.physics.forward import ForwardModel
from highside.report.misfit_steps import steps_of
from studies.open_world.score import every_case

FURTHER = pytest.mark.further
MODEL = {"sensor": {"free": ["bias", "scale", "misalignment"]}}
POSES, ROWS, STEP_S, ROW_G = 40, 12, 0.5, 1e-4
TAU_S = 1.6


def load_of(inc_deg: np.ndarray, tf_deg: np.ndarray) -> np.ndarray:
    inc, tf = np.radians(inc_deg), np.radians(tf_deg)
    return np.vstack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])


def recording(seed: int, kind: str) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns of rows, and what was added (3, N)."""
    rng = np.random.default_rng(seed)
    pose = np.repeat(np.arange(POSES), ROWS)
    since = np.tile(np.arange(ROWS) * STEP_S, POSES)
    inc, tf = rng.uniform(10, 170, POSES)[pose], rng.uniform(0, 360, POSES)[pose]
    load, added = load_of(inc, tf), np.zeros((3, pose.size))
    if kind == "decay":
        added[1] = 4e-4 * np.exp(-since / TAU_S)
    elif kind == "decay of the load":
        added[0] = 6e-4 * load[0] * np.exp(-since / TAU_S)
    elif kind == "there and back":
        added[1] = 4e-4 * np.exp(-0.5 * ((since - 2.4) / 0.7) ** 2)
    elif kind == "there and back with the load":
        added[0] = 6e-4 * load[0] * np.exp(-0.5 * ((since - 2.4) / 0.7) ** 2)
    elif kind == "drift":
        added[2] = 4e-4 * since / since.max()
    noise = rng.normal(0, ROW_G, (3, pose.size))
    if kind == "correlated":
        for k in range(1, pose.size):
            if pose[k] == pose[k - 1]:
                noise[:, k] = 0.7 * noise[:, k - 1] + np.sqrt(0.51) * noise[:, k]
    if kind == "walk":
        noise += np.cumsum(rng.normal(0, ROW_G, (3, pose.size)), axis=1)
    read = (np.eye(3) + rng.normal(0, 2e-3, (3, 3))) @ load + rng.normal(0, 3e-3, (3, 1)) + added + noise
    columns = {f"a{axis}_g": read[k] for k, axis in enumerate("xyz")}
    return columns | {"t_s": 30.0 * pose + since, "pose": pose * 1.0, "inc_ref_deg": inc, "tf_ref_deg": tf}, added


@pytest.mark.parametrize(
    ("kind", "places"),
    [
        ("decay", ["offset"]),
        ("decay of the load", ["scale"]),
        ("there and back", ["offset"]),
        ("there and back with the load", ["scale"]),
    ],
)
def test_a_course_while_poses_are_held_is_a_law_that_predicts_another_session(kind: str, places: list[str]) -> None:
    made = diagnose(recording(1, kind)[0], MODEL)
    assert made.verdict == "law"
    assert [claim.place for claim in made.claims] == places
    assert [claim.depends_on for claim in made.claims] == [("time_since_move",)]
    model = made.model()
    assert model is not None
    columns, added = recording(1, kind)
    size = np.std(
        added.reshape(3, POSES, ROWS) - added.reshape(3, POSES, ROWS).mean(axis=2, keepdims=True), axis=(1, 2)
    )
    assert made.claims[0].rms == pytest.approx(size.max(), rel=0.1)
    columns, added = recording(2, kind)
    told = predict(model, columns)
    plain = load_of(columns["inc_ref_deg"], columns["tf_ref_deg"])
    predicted = np.vstack([told[f"a{axis}_g"] for axis in "xyz"]) - plain
    about = [values.reshape(3, POSES, ROWS) for values in (added, predicted)]
    true, own = (values - values.mean(axis=2, keepdims=True) for values in about)
    assert np.sum((true - own) ** 2) < 0.02 * np.sum(true**2)


def test_it_is_not_said_to_leave_the_misfit_of_the_means_to_noise() -> None:
    made = diagnose(recording(1, "there and back")[0], MODEL)
    page = made.html()
    assert "follows time since the last move" in page
    assert "is taken for noise" not in page
    # the picture of the misfit step by step shows what it takes of the rows, of which the means know nothing
    assert isinstance(made.report_data, ReportData)
    steps = steps_of(made.report_data)
    assert steps.names == (made.claims[0].effect,)
    assert steps.left < 0.05 * steps.levels[0]


def test_beside_what_the_means_show_it_has_its_own_small_share() -> None:
    columns = recording(1, "decay")[0]
    load = load_of(columns["inc_ref_deg"], columns["tf_ref_deg"])
    made = diagnose({**columns, "ax_g": columns["ax_g"] + 4e-3 * load[0] ** 2}, MODEL)
    assert [claim.effect for claim in made.claims] == ["quadratic", "law:offset_y_time_since_move"]
    name, law = (claim.share or 0.0 for claim in made.claims)
    assert name + law == pytest.approx(1.0, abs=1e-9)
    assert 0.001 < law < 0.1


@pytest.mark.parametrize("kind", ["drift", "correlated", "walk", "nothing"])
def test_a_drift_and_noise_with_memory_are_no_course(kind: str) -> None:
    for seed in range(4):
        columns, _ = recording(seed, kind)
        accel = np.vstack([columns[f"a{axis}_g"] for axis in "xyz"])
        state = pose_session(columns, accel, gravity_mps2=9.81).state
        held = HeldRows(accel, columns["t_s"], rows_of_poses(columns, accel))
        assert laws_since_move(held, state, ForwardModel.of({})) is None


def test_what_moves_within_poses_by_many_noises_is_a_law_of_the_time_since_a_move_alone() -> None:
    # the inclination follows a temperature that goes on changing while poses are held, by 900 times the noise: products
    # of two quantities were tried for the amplitudes, and one that holds no time since the move ended in an error
    case = every_case("8d0136d146393ae05a8810eedbb5df439b5af3fc", ("law",))["law/120"]()
    columns = {name: np.asarray(column) for name, column in case.recording.items()}
    accel = np.stack([columns[name] for name in ("ax_g", "ay_g", "az_g")])
    held = HeldRows(accel, columns["t_s"], rows_of_poses(columns, accel))
    made = laws_since_move(held, pose_session(columns, accel, gravity_mps2=9.80665).state, ForwardModel.of({}))
    assert made is not None
    laws, _ = made
    assert all("time_since_move" in one.claim.depends_on for one in laws)


def test_what_a_temperature_does_that_runs_on_while_poses_are_held_is_no_law_of_the_time_since_a_move() -> None:
    # a scale factor over temperature, 320 times the noise of a row: told as a cross-coupling that follows temperature
    # and time since the last move, it predicted another session worse than nothing
    case = every_case("925c2d2d27532b4dde268f156b02263ff139bce2", ("law",))["law/022"]()
    made = diagnose({name: np.asarray(column) for name, column in case.recording.items()}, MODEL)
    assert [(claim.place, claim.depends_on) for claim in made.claims] == [("scale", ("temp",))]
    assert not any(finding.check == "within_pose" for finding in made.intake)


@FURTHER
@pytest.mark.parametrize("lost", [pytest.param(False, marks=FURTHER), True])
def test_a_course_of_few_rows_is_not_taken_for_their_noise(lost: bool) -> None:
    """Seven rows 5 s apart: from one to the next the course changes as much as over the pose. Where rows are lost, a
    pose that lost its first says not when it began."""
    rng = np.random.default_rng(8)
    pose, since = np.repeat(np.arange(POSES), 7), np.tile(np.arange(7) * 5.0, POSES)
    inc, tf = rng.uniform(10, 170, POSES)[pose], rng.uniform(0, 360, POSES)[pose]
    read = load_of(inc, tf) + rng.normal(0, 2e-3, (3, 1)) + rng.normal(0, ROW_G, (3, pose.size))
    read += rng.normal(0, 4e-4, (3, POSES))[:, pose]
    read[1] += 2e-3 * np.sin(since / 4.0)
    columns = {f"a{axis}_g": read[k] for k, axis in enumerate("xyz")}
    columns |= {"t_s": 60.0 * pose + since, "pose": pose * 1.0, "inc_ref_deg": inc, "tf_ref_deg": tf}
    kept = rng.random(pose.size) > (0.1 if lost else 0.0)
    made = diagnose({name: values[kept] for name, values in columns.items()}, MODEL)
    assert ("offset", ("time_since_move",)) in [(claim.place, claim.depends_on) for claim in made.claims]


def test_a_pose_that_lost_its_first_rows_began_when_its_readings_say() -> None:
    """Of 91 poses 23 are cut short. Counted from their first row that is left, a strong course left errors of their
    means, and a law of the session's time stood beside it from a strength of 1e5 on."""
    case = every_case("0abd63786343fc74eeb8bf119e28e294131d720c", ("sweep",))["sweep/024/100000"]()
    made = diagnose({name: np.asarray(column) for name, column in case.recording.items()}, MODEL)
    assert [(claim.place, claim.depends_on) for claim in made.claims] == [("offset", ("time_since_move",))]


def test_poses_that_drift_as_the_load_says_are_a_law_and_those_that_drift_alike_are_none() -> None:
    case = every_case("bbcbd3ba726080d8809ebc3f2aff1b361d111cf5", ("law",))["law/090"]()
    made = diagnose({name: np.asarray(column) for name, column in case.recording.items()}, MODEL)
    assert [(claim.place, claim.depends_on) for claim in made.claims] == [("offset", ("load_x", "time_since_move"))]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        columns, _ = recording(seed, "drift")
        for name, size in (("ax_g", 2e-4), ("ay_g", -5e-5)):
            columns[name] = columns[name] + size * (columns["t_s"] % 30.0) + 1e-4 * rng.normal(size=POSES * ROWS)
        accel = np.vstack([columns[f"a{axis}_g"] for axis in "xyz"])
        state = pose_session(columns, accel, gravity_mps2=9.81).state
        held = HeldRows(accel, columns["t_s"], rows_of_poses(columns, accel))
        assert laws_since_move(held, state, ForwardModel.of({})) is None
