"""The open world's generator against formulas of its own, its scoring on answers of known worth, and its seals."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from studies.open_world import (
    answers,
    by_hand,
    check,
    deck,
    designs,
    judging,
    laws,
    limit,
    noises,
    score,
    section_one,
    table,
    world,
)
from studies.open_world.laws import Law
from studies.open_world.noises import Noise
from studies.open_world.shapes import Shape

SIZE = 1e-5


def bench(kind: str = "poses", *, gyros: bool = False, seed: int = 4) -> world.Session:
    return designs.drawn(np.random.default_rng(seed), kind, gyros=gyros)


def law_at(place: str, s: world.Session, *, covariate: str = "inc", **more: object) -> Law:
    values = laws.covariate(s, covariate)
    ranges = ((float(values.min()), float(values.max())),)
    return Law(place, (covariate,), Shape("sine", {"frequency": 2.0, "phase": 0.4}), ranges, SIZE, **more)  # type: ignore[arg-type]


def expected(place: str, s: world.Session, value: np.ndarray) -> np.ndarray:
    """What a small departure does to (sin I cos T, sin I sin T, cos I), by differentiation on paper."""
    si, ci, st, ct = np.sin(s.inc), np.cos(s.inc), np.sin(s.tf), np.cos(s.tf)
    zero = np.zeros(s.n)
    by_inc, by_tf = np.stack([ci * ct, ci * st, -si]), np.stack([-si * st, si * ct, zero])
    return {
        "inclination": value * by_inc,
        "toolface": value * by_tf,
        "timing": value * s.rate * by_tf,
        # the bench leans along x: gravity has a part along the axis that inclination turns away from
        "level": value * by_inc,
        "offset": np.stack([zero, value, zero]),
        "scale": np.stack([zero, value * si * st, zero]),
        "matrix": np.stack([value * ci, zero, zero]),
    }[place]


@pytest.mark.parametrize("place", ["inclination", "toolface", "level", "offset", "scale", "matrix"])
def test_a_law_adds_to_the_readings_what_paper_says(place: str) -> None:
    s = bench()
    more = {
        "offset": {"weights": (0.0, 1.0, 0.0)},
        "scale": {"weights": (0.0, 1.0, 0.0)},
        "matrix": {"element": (0, 2)},
    }
    law = law_at(place, s, **more.get(place, {}))
    added = world.contribution(s, world.IDEAL, [law])
    assert np.abs(added).max() > 0.1 * SIZE
    assert added == pytest.approx(expected(place, s, law.values(s)), abs=20 * SIZE**2)


def test_a_late_row_of_a_rotation_is_seen_at_another_toolface() -> None:
    s = bench("rotation")
    law = law_at("timing", s, covariate="rate")
    added = world.contribution(s, world.IDEAL, [law])
    assert added == pytest.approx(expected("timing", s, law.values(s)), abs=1e3 * SIZE**2)


@pytest.mark.parametrize("kind", ["poses", "rotation"])
def test_the_plain_bench_is_that_of_the_library(kind: str) -> None:
    s = bench(kind, gyros=kind == "rotation")
    data = world.readings(s, world.IDEAL)
    state = ChainState.from_columns(
        world.columns(s, data), gravity_mps2=world.G_MPS2, latitude_rad=np.radians(world.LATITUDE_DEG),
        azimuth_rad=np.radians(world.AZIMUTH_DEG),
    )  # fmt: skip
    model = ForwardModel.of({"earth_rotation": {"share": 1.0}} if s.gyros else {})
    assert data[:3] == pytest.approx(model.predict(state), abs=1e-9)
    if s.gyros:
        assert data[3:] == pytest.approx(model.gyro(state), abs=1e-9)


def test_a_rotations_rate_is_the_slope_of_its_angle_and_its_acceleration_that_of_the_rate() -> None:
    for seed in range(4):
        s = bench("rotation", seed=seed)
        step = s.t[1] - s.t[0]
        if step > 0.03:
            continue
        inner = slice(5, -5)
        scale = np.abs(s.rate).max()
        assert np.gradient(s.tf, s.t)[inner] == pytest.approx(s.rate[inner], abs=0.03 * scale)
        scale = np.abs(s.acceleration).max()
        assert np.gradient(s.rate, s.t)[inner] == pytest.approx(s.acceleration[inner], abs=0.15 * scale)


def test_a_second_session_stays_within_what_the_first_has_visited() -> None:
    for seed, kind in ((1, "poses"), (2, "rotation"), (3, "poses")):
        first = bench(kind, seed=seed)
        other = designs.second(np.random.default_rng(9), first)
        for name in ("temp", "inc", "rate") if kind == "poses" else ("temp", "rate"):
            before, now = laws.covariate(first, name), laws.covariate(other, name)
            assert now.min() >= before.min() - 0.02 * np.ptp(before) - 1e-9
            assert now.max() <= before.max() + 0.02 * np.ptp(before) + 1e-9


# --- strength -------------------------------------------------------------------------------------------------------


def test_off_base_is_what_least_squares_leaves() -> None:
    s = bench()
    signal = np.random.default_rng(1).standard_normal((3, s.n))
    base = np.concatenate([np.ones((1, s.n)), world.loads(s)]).T
    left = np.stack([row - base @ np.linalg.lstsq(base, row, rcond=None)[0] for row in signal])
    assert world.off_base(s, signal) == pytest.approx(left, abs=1e-9)


def test_strength_in_white_noise_is_the_sum_of_squares() -> None:
    for kind in ("poses", "rotation"):
        s = bench(kind)
        signal = np.random.default_rng(1).standard_normal((3, s.n))
        noise = Noise("white", (2.0, 2.0, 2.0))
        assert noises.energy(s, noise, signal) == pytest.approx(np.sum(signal**2) / 4.0)


@pytest.mark.parametrize("kind", ["coloured", "one_over_f", "walk"])
@pytest.mark.parametrize("design", ["poses", "rotation"])
def test_strength_is_the_spread_of_the_best_estimate_of_a_size(kind: str, design: str) -> None:
    """d^T C^-1 d is what a size is known to: the inverse variance of its best linear estimate, here by brute force."""
    s = bench(design, seed=2)
    s = s.rows(np.arange(s.n) < 400)
    noise = replace(noises.drawn(np.random.default_rng(3), s, kind), sigma=(1.0, 1.0, 1.0))
    d = np.zeros((3, s.n))
    shape = np.sin(2 * np.pi * 3.0 * (s.t - s.t[0]) / np.ptp(s.t))
    d[0] = shape if design == "rotation" else np.bincount(s.pose, shape)[s.pose] / np.bincount(s.pose)[s.pose]
    apart = np.abs(s.t[:, None] - s.t[None])
    slow = {
        "coloured": lambda: np.exp(-apart / noise.tau),
        "one_over_f": lambda: np.mean([np.exp(-apart / tau) for tau in noises._taus(noise)], axis=0),
        "walk": lambda: np.minimum((s.t - s.t[0])[:, None], (s.t - s.t[0])[None]),
    }[kind]()
    covariance = noise.level**2 * slow + np.eye(s.n)
    best = float(d[0] @ np.linalg.solve(covariance, d[0]))
    assert noises.energy(s, noise, d) == pytest.approx(best, rel=0.25)


def test_a_case_has_the_strength_it_was_asked_for_and_is_the_same_when_made_again() -> None:
    made = [deck.sweep_case("sweep/000/10000", "test", 0, 1e4) for _ in range(2)]
    assert made[0].strength == pytest.approx(1e4, rel=0.45)  # rows may be lost after the law was sized
    for name, values in made[0].recording.items():
        assert np.array_equal(values, made[1].recording[name])
    larger = deck.sweep_case("sweep/000/10000", "test", 0, 1e5)
    assert larger.laws[0].covariates == made[0].laws[0].covariates and larger.laws[0].size > made[0].laws[0].size


def test_every_noise_is_as_large_as_it_says() -> None:
    s = bench("rotation")
    for kind in noises.KINDS:
        noise = noises.drawn(np.random.default_rng(1), s, kind)
        got = noises.added(np.random.default_rng(2), s, noise, world.readings(s, world.IDEAL)) - world.readings(
            s, world.IDEAL
        )
        rough = np.std(np.diff(got[:3], axis=1)) / np.sqrt(2)
        assert 0.7 * noise.sigma[0] < rough < 4.5 * noise.sigma[0], kind
        if kind == "quantised":
            counts = (got + world.readings(s, world.IDEAL))[:3] / noise.step
            assert counts == pytest.approx(np.round(counts), abs=1e-6)


# --- scoring --------------------------------------------------------------------------------------------------------


def test_the_share_that_is_closed_ignores_what_a_base_fit_takes_up() -> None:
    s = bench()
    law = law_at("offset", s, weights=(1.0, 0.0, 0.0))
    truth = world.contribution(s, world.IDEAL, [law])
    sensor = world.drawn_sensor(np.random.default_rng(5))
    plain = world.readings(s, sensor)
    sigma = (1e-4,) * 3
    assert judging.closed(s, truth, plain + truth, sigma) == pytest.approx(1.0)
    assert judging.closed(s, truth, plain, sigma) == pytest.approx(0.0, abs=1e-9)
    assert judging.closed(s, truth, plain + 0.5 * truth, sigma) == pytest.approx(0.75)
    assert judging.closed(s, truth, plain - truth, sigma) == pytest.approx(-3.0)
    gaps = np.where(np.arange(s.n) % 7 == 0, np.nan, plain + truth)
    assert judging.closed(s, truth, gaps, sigma) == pytest.approx(1.0)
    assert judging.closed(s, truth, np.full_like(truth, np.nan), sigma) is None


def test_what_lies_outside_of_a_name_is_what_its_columns_leave() -> None:
    s = bench()
    load = world.loads(s)[0]
    sigma = (1e-4,) * 3
    column, odd = np.zeros((1, 3, s.n)), np.zeros((3, s.n))
    column[0, 0], odd[0] = load**2, load**3
    hidden = world.off_base(s, 1e-3 * column[0]) / 1e-4
    assert judging.outside(s, hidden, column, sigma) == pytest.approx(0.0, abs=1e-6)
    assert judging.outside(s, hidden, np.zeros((0, 3, s.n)), sigma) == pytest.approx(np.sum(hidden**2))
    both = hidden + world.off_base(s, 1e-3 * odd) / 1e-4
    assert judging.outside(s, both, column, sigma) > judging.OUTSIDE


def claim(
    effect: str, place: str = "", depends_on: tuple[str, ...] = (), members: tuple[str, ...] = ()
) -> dict[str, object]:
    return {"effect": effect, "place": place, "depends_on": list(depends_on), "equivalence_class": list(members)}


def row(case: answers.Case, verdict: str, *claims: dict[str, object], **more: object) -> dict[str, object]:
    answer = {"verdict": verdict, "claims": list(claims)}
    return {"name": case.name, "group": case.group, "truth": case.answer(), "answer": answer, **more}


def outsider() -> answers.Case:
    s = bench()
    law = law_at("offset", s, covariate="temp", weights=(0.0, 1.0, 0.0))
    return answers.Case("law/x", "law", "poses", {}, "", strength=1e3, laws=(law,))


def test_an_answer_is_judged_by_place_covariates_and_what_lies_outside_of_its_names() -> None:
    case = outsider()
    right = judging.judged(row(case, "law", claim("law:offset_x_temp", "offset", ("temp",)), closed=0.97))
    assert right["exact"] and right["bucket"] == "right" and not right["wrong_name"] and right["closed"] == 0.97
    other = judging.judged(row(case, "law", claim("law:offset_x_time", "offset", ("time",))))
    assert not other["exact"] and not other["in_class"] and other["bucket"] == "other law"
    tied = claim("law:offset_x_time", "offset", ("time",), ("law:offset_x_temp",))
    assert judging.judged(row(case, "law", tied))["in_class"]
    two = judging.judged(
        row(case, "law", claim("law:offset_x_temp", "offset", ("temp",)), claim("law:scale_x_time", "scale", ("time",)))
    )
    assert not two["exact"], "something else is claimed beside it"
    wrong = judging.judged(row(case, "named", claim("temperature_bias"), outside=41.0))
    assert wrong["wrong_name"] and wrong["bucket"] == "wrong name"
    near = judging.judged(row(case, "named", claim("temperature_bias"), outside=39.0))
    assert not near["wrong_name"] and near["bucket"] == "near name"
    assert judging.judged(row(case, "nothing_left_out"))["bucket"] == "nothing"
    assert judging.judged(row(case, "unknown"))["bucket"] == "refused"
    assert judging.judged({**row(case, "unknown"), "answer": None})["bucket"] == "error"


def test_the_members_of_a_class_are_read() -> None:
    """Ids as the engine writes them; whatever is no law is none."""
    for label, key in {
        "law:level_x_temp": ("level", {"temp"}),
        "law:scale_all_xyz_load_z": ("scale_all", {"load_z"}),
        "law:inclination_inc_load_x_x_load_y": ("inclination", {"load_x", "load_y"}),
        "law:offset_y_load_x_inc": ("offset", {"load", "inc"}),
        "law:matrix_xz_temp_filtered_1200_x_time--2": ("matrix", {"temp_filtered", "time"}),
    }.items():
        assert judging.key_of_label(label) == (key[0], frozenset(key[1])), label
    assert judging.key_of_label("sag") is None
    told = {"effect": "law:inclination_inc_temp", "place": "inclination", "depends_on": ["temp"]}
    options = {("level", frozenset({"temp"}))}
    assert not judging._in_class(options, told)
    assert judging._in_class(options, {**told, "equivalence_class": ["law:inclination_inc_temp", "law:level_x_temp"]})


def test_nulls_known_effects_and_other_words_for_a_law_are_judged() -> None:
    null = answers.Case("null/0", "null", "poses", {}, "")
    assert not judging.judged(row(null, "nothing_left_out"))["alarm"]
    assert judging.judged(row(null, "unknown"))["alarm"]
    assert judging.judged(row(null, "law", claim("law:offset_x_temp", "offset", ("temp",))))["false_law"]
    assert judging.judged(row(null, "named", claim("sag"), outside=0.0))["wrong_name"]
    walk = replace(null, noise="walk")
    assert not judging.judged(row(walk, "wander"))["alarm"]
    shaken = judging.judged(row(replace(null, noise="jitter"), "named", claim("sampling_jitter"), outside=0.0))
    assert not shaken["alarm"] and not shaken["wrong_name"], "the noise is told as what it is"
    known = answers.Case("known/0", "known", "poses", {}, "", effects={"sag": {"s": 1e-3}})
    assert judging.judged(row(known, "named", claim("sag")))["known_exact"]
    assert judging.judged(row(known, "named", claim("base_tilt", members=("base_tilt", "sag"))))["named"]
    assert judging.judged(row(known, "named", claim("cubic")))["wrong_name"]
    assert judging.judged(row(known, "named", claim("sag"), claim("cubic"), outside=0.0))["wrong_name"]
    s = bench()
    by_load = replace(law_at("offset", s, covariate="load_y", weights=(0.0, 1.0, 0.0)))
    keys = judging.accepted(json.loads(json.dumps(by_load.plain())), "poses")
    assert ("offset", frozenset({"load"})) in keys and ("offset", frozenset({"load_x"})) not in keys


def test_an_angle_read_late_is_an_error_of_the_angle_by_the_rate() -> None:
    late = {
        "place": "timing", "covariates": ["temp"], "weights": [1.0, 0.0, 0.0], "element": [0, 1], "onset_s": None,
        "shape": {"kind": "process"},
    }  # fmt: skip
    keys = judging.accepted(late, "rotation")
    assert ("timing", frozenset({"temp"})) in keys
    assert ("toolface", frozenset({"temp", "rate"})) in keys
    assert ("toolface", frozenset({"temp"})) not in keys
    by_rate = {**late, "place": "toolface", "covariates": ["temp", "rate"]}
    assert ("timing", frozenset({"temp", "rate"})) in judging.accepted(by_rate, "rotation")
    assert ("timing", frozenset({"temp"})) not in judging.accepted({**late, "place": "toolface"}, "rotation")


def test_a_lean_about_the_axis_of_the_inclination_is_an_error_of_that() -> None:
    s = bench()
    lean = law_at("level", s, covariate="tf", weights=(1.0, 0.0, 0.0))
    as_inclination = replace(lean, place="inclination")
    other = world.contribution(s, world.IDEAL, [as_inclination])
    assert world.contribution(s, world.IDEAL, [lean]) == pytest.approx(other, abs=SIZE**3)
    both = {("level", frozenset({"tf"})), ("inclination", frozenset({"tf"}))}
    assert both <= judging.accepted(json.loads(json.dumps(lean.plain())), "poses")
    across = replace(lean, weights=(0.0, 1.0, 0.0))
    assert ("inclination", frozenset({"tf"})) not in judging.accepted(json.loads(json.dumps(across.plain())), "poses")


def test_a_sweep_that_forgets_what_it_knew_is_not_monotone() -> None:
    def at(strength: float, *, in_class: bool, nothing: bool = False) -> dict[str, object]:
        return {"name": f"sweep/1/{strength:.0f}", "group": "sweep", "truth": {"strength": strength},
                "in_class": in_class,
                "verdict": "law", "told": ["x"] if in_class else [], "nothing": nothing}  # fmt: skip

    good = [at(30, in_class=False, nothing=True), at(400, in_class=True), at(1e4, in_class=True)]
    assert table.monotone(good)[0]["monotone"]
    assert not table.monotone([*good, at(1e6, in_class=False)])[0]["monotone"]
    assert not table.monotone([at(30, in_class=False), at(400, in_class=False, nothing=True)])[0]["monotone"]


def test_a_bar_says_whether_it_is_held_and_how_surely() -> None:
    rows = [{"a": k < 1} for k in range(100)]
    assert table.share(rows, lambda r: r["a"], 0.03, most=True).endswith("(1 of 100), held, not sure")
    assert table.share(rows, lambda r: r["a"], 0.10, most=True).endswith("), held")
    assert table.share(rows, lambda r: r["a"], 0.005, most=True).endswith("**missed**, not sure")
    assert table.share([{"a": False}] * 50, lambda r: r["a"], 0.85, most=False).endswith("**missed**")
    assert table.median([0.9, 0.97, 0.99], 0.95) == "0.970 (3: too few for an interval)"


# --- seals ----------------------------------------------------------------------------------------------------------


def test_an_answer_that_was_changed_is_noticed(tmp_path: Path) -> None:
    case = deck.null_case("null/000", "test", 0)
    made = {"null/000": answers.hash_of_answer(case.answer())}
    assert check.changed("test", made) == []
    other = case.answer() | {"strength": 500.0}
    assert check.changed("test", {"null/000": answers.hash_of_answer(other)}) == ["null/000"]
    assert check.changed("another seed", {"law/000": made["null/000"]}) == ["law/000"]
    manifest = tmp_path / "manifest.json"
    manifest.write_text(json.dumps({"seed": "test", "seal": answers.seal(made), "answers": made}))
    assert check.read(manifest) == ("test", made)
    manifest.write_text(json.dumps({"seed": "test", "seal": answers.seal(made), "answers": {"null/000": "0" * 64}}))
    with pytest.raises(SystemExit, match="the seal is not"):
        check.read(manifest)


def test_a_law_comes_back_from_its_sealed_form() -> None:
    s = bench()
    for seed in range(6):
        law = laws.drawn_law(np.random.default_rng(seed), s)
        again = laws.restored(json.loads(json.dumps(law.plain())))
        assert np.array_equal(again.values(s), law.values(s))


def test_every_row_that_was_found_by_trying_is_a_case() -> None:
    makers = section_one.cases("test", 1)
    assert {name.split("/")[1] for name in makers} >= {
        "bench leaning with time, poses", "eccentric inclination encoder, poses", "12 bits", "16 poses", "rows missing",
        "three in rotation", "five effects", "few holds", "early", "frequency", "motion missing", "gyro warm-up",
    }  # fmt: skip
    step = makers["table/hand step/1"]()
    assert step.strength > 100 and step.group == "table"
    held = by_hand.held(np.random.default_rng(1))
    assert by_hand.strength(held, 1e-2 * held.up) == pytest.approx(0.0, abs=1e-6), "a scale is taken up by the base fit"


def test_the_order_of_answering_is_shuffled_but_keeps_a_sweep_together() -> None:
    names = [f"law/{k:03d}" for k in range(40)] + [f"sweep/{k:03d}/{s}" for k in range(5) for s in (30, 100, 400)]
    order = score.ordered("seed", names)
    assert sorted(order) == sorted(names) and order != names
    for k in range(5):
        places = [order.index(f"sweep/{k:03d}/{s}") for s in (30, 100, 400)]
        assert places == list(range(places[0], places[0] + 3))


@pytest.mark.parametrize("study", ["open_world.score", "sealed.score"])
def test_a_deck_is_answered_by_the_package_of_its_commit(study: str) -> None:
    """Not by one that the study has loaded before it could choose."""
    loads = f"import sys, studies.{study}; sys.exit('highside' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", loads], cwd=Path(__file__).parents[2], check=False).returncode == 0


def test_the_gain_that_theory_expects_is_the_mean_of_the_evidence() -> None:
    rng = np.random.default_rng(11)
    others, mine, truth = rng.standard_normal((9, 2)), rng.standard_normal((9, 3)), 1.5 * rng.standard_normal(9)
    null = np.eye(9) + others @ others.T
    full = null + mine @ mine.T
    # without the law the others are drawn, with it in force it is added
    drawn = truth + rng.standard_normal((20_000, 9)) @ np.linalg.cholesky(null).T

    def evidence(covariance: np.ndarray) -> np.ndarray:
        fit = np.einsum("ki,ij,kj->k", drawn, np.linalg.inv(covariance), drawn)
        return -0.5 * (fit + np.linalg.slogdet(covariance)[1])

    apart = evidence(full) - evidence(null)
    error = float(np.std(apart)) / np.sqrt(len(drawn))
    assert abs(limit.gain(mine, truth, [others]) - float(np.mean(apart))) < 4 * error


def test_what_theory_allows_of_a_case_lies_above_what_a_smooth_function_closes() -> None:
    parts = limit.made("limit-test", "law/004", 4)
    row = limit.limits(parts)
    assert len(row["form"]["gains"]) == len(parts.case.laws)
    assert row["smooth"]["closed"] - 0.05 < row["form"]["closed"] <= 1.0
    assert 0.0 <= row["form"]["to_0.8"] <= 1.0
