"""The acceptance figures of rotor-angle compensation on both simulated rotors, six seeds, three channels each."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from highside.errors import InputError, Refused
from highside.papers.rotation_scenarios import SCENARIOS, A, B, Draw, Scenario, draw
from highside.rotation import (
    CurveMethod,
    ErrorCurve,
    NetworkInput,
    Samples,
    auto,
    fit,
    four_positions,
    harmonics2,
    network,
    polynomial9,
    sine,
)
from highside.rotation.bases import fourier_rows, fourier_sum
from studies import rotation_gap

SEEDS = range(6)
CHANNELS = range(3)
THETA = draw(A, 0, 0).theta_rad
AT = np.linspace(0.0, 2 * np.pi, 90)
PURE = Scenario("two harmonics", (0.0140, 0.0135, 0.0145), 0.0, 0.0018)


def samples_of(one: Draw) -> Samples:
    return Samples.build(one.theta_rad, one.error)


def rms_to_truth(curve: ErrorCurve, one: Draw) -> float:
    return float(np.sqrt(np.mean((curve(one.theta_rad) - one.truth) ** 2)))


def mean_abs(curve: ErrorCurve, one: Draw) -> float:
    return float(np.mean(np.abs(one.error - curve(one.theta_rad))))


@cache
def curves(scenario: str, method: CurveMethod) -> dict[tuple[int, int], tuple[ErrorCurve, Draw]]:
    """Every seed and channel, fitted once for all tests."""
    drawn = {(seed, channel): draw(SCENARIOS[scenario], seed, channel) for seed in SEEDS for channel in CHANNELS}
    return {key: (fit(samples_of(one), method), one) for key, one in drawn.items()}


@cache
def table(scenario: str, method: CurveMethod) -> np.ndarray:
    """Mean absolute error left, (seeds, channels)."""
    made = curves(scenario, method)
    return np.array([[mean_abs(*made[seed, channel]) for channel in CHANNELS] for seed in SEEDS])


# --- closed forms


def test_least_squares_on_a_whole_turn_is_the_closed_form() -> None:
    one = draw(B, 3, 1)
    rows, n = fourier_rows(one.theta_rad, 2), one.error.size
    closed = rows @ one.error * np.array([1, 2, 2, 2, 2]) / n
    assert np.allclose(harmonics2(samples_of(one)).parameters, closed, rtol=0, atol=1e-10)
    assert np.allclose(sine(samples_of(one)).parameters, closed[:3], rtol=0, atol=1e-10)


def test_the_covariance_is_the_one_of_the_closed_form() -> None:
    one = draw(PURE, 0, 0)
    curve = harmonics2(samples_of(one))
    expected = curve.noise**2 / one.error.size * np.diag([1.0, 2.0, 2.0, 2.0, 2.0])
    assert np.allclose(curve.covariance, expected, atol=1e-6 * expected.max())
    assert curve.noise == pytest.approx(PURE.noise, rel=0.03)


def test_four_positions_cancel_the_second_harmonic_and_take_the_third_for_the_first() -> None:
    angles = np.array([0.0, 0.5, 1.0, 1.5]) * np.pi
    truth = np.array([0.012, 0.03, 0.02, 0.005, -0.004])
    curve = four_positions(fourier_sum(angles, truth), noise=0.001)
    # of the second harmonic only the cosine shows at the four angles, and it cancels in a and b and in the mean
    assert np.allclose(curve.parameters, truth[:3], atol=1e-15)
    assert np.allclose(np.diag(curve.covariance), 1e-6 * np.array([0.25, 0.5, 0.5]))
    third = np.concatenate([truth, [0.002, 0.003]])
    aliased = four_positions(fourier_sum(angles, third)).parameters
    assert np.allclose(aliased - truth[:3], [0.0, -0.002, 0.003], atol=1e-15)


def test_the_four_position_solution_is_nearly_as_good_as_least_squares_when_noise_is_averaged() -> None:
    one = draw(A, 0, 0)
    curve = four_positions(one.true_at(np.array([0.0, 0.5, 1.0, 1.5]) * np.pi))
    assert mean_abs(curve, one) < 1.05 * mean_abs(sine(samples_of(one)), one)


def test_evaluation_by_horner_is_the_sum_written_out() -> None:
    rng = np.random.default_rng(1)
    theta = rng.uniform(-20.0, 20.0, 500)
    for order in (0, 1, 2, 5, 12):
        coefficients = rng.normal(size=2 * order + 1)
        plain = coefficients[0] + sum(
            (
                coefficients[2 * k - 1] * np.sin(k * theta) + coefficients[2 * k] * np.cos(k * theta)
                for k in range(1, order + 1)
            ),
            start=np.zeros_like(theta),
        )
        assert np.allclose(fourier_sum(theta, coefficients), plain, atol=1e-12)
        assert np.allclose(coefficients @ fourier_rows(theta, order), plain, atol=1e-12)


# --- the paper's statements


def test_method_one_leaves_at_most_what_the_paper_says() -> None:
    made = curves("A", CurveMethod.SINE)
    for seed in SEEDS:
        worst = max(float(np.abs(one.error - curve(THETA)).max()) for curve, one in (made[seed, c] for c in CHANNELS))
        assert 0.018 <= worst <= 0.024


@pytest.mark.parametrize("scenario", ["A", "B"])
@pytest.mark.parametrize("method", [CurveMethod.HARMONICS2, CurveMethod.POLYNOMIAL9, CurveMethod.NETWORK])
def test_methods_two_to_four_are_sixty_percent_better(scenario: str, method: CurveMethod) -> None:
    better = 1.0 - table(scenario, method) / table(scenario, CurveMethod.SINE)
    assert better.mean(axis=0).min() >= 0.60


def test_methods_two_and_four_are_about_equal_where_noise_dominates_only() -> None:
    two, four = table("A", CurveMethod.HARMONICS2).mean(axis=0), table("A", CurveMethod.NETWORK).mean(axis=0)
    assert np.all(np.abs(two - four) <= 0.20 * two)
    two, four = table("B", CurveMethod.HARMONICS2).mean(axis=0), table("B", CurveMethod.NETWORK).mean(axis=0)
    assert np.all(four < 0.5 * two)


def test_mean_absolute_errors_are_those_of_the_specification() -> None:
    expected = {
        ("A", CurveMethod.SINE): (0.00903, 0.00870, 0.00930),
        ("A", CurveMethod.HARMONICS2): (0.00162, 0.00163, 0.00160),
        ("A", CurveMethod.POLYNOMIAL9): (0.00150, 0.00147, 0.00148),
        ("A", CurveMethod.NETWORK): (0.00143, 0.00143, 0.00143),
        ("A", CurveMethod.AUTO): (0.00143, 0.00143, 0.00143),
        ("B", CurveMethod.SINE): (0.00825, 0.00798, 0.00853),
        ("B", CurveMethod.HARMONICS2): (0.00262, 0.00268, 0.00248),
        ("B", CurveMethod.POLYNOMIAL9): (0.00161, 0.00140, 0.00148),
        ("B", CurveMethod.AUTO): (0.00079, 0.00079, 0.00079),
    }
    for (scenario, method), figures in expected.items():
        assert np.allclose(table(scenario, method).mean(axis=0), figures, rtol=0.03), (scenario, method)


# --- better than the paper


def test_auto_is_four_times_nearer_to_the_truth_than_two_harmonics_and_no_worse_than_the_network() -> None:
    ours, second, net = (curves("B", m) for m in (CurveMethod.AUTO, CurveMethod.HARMONICS2, CurveMethod.NETWORK))
    for key in ours:
        assert rms_to_truth(*ours[key]) <= 0.25 * rms_to_truth(*second[key])
        assert rms_to_truth(*ours[key]) <= rms_to_truth(*net[key])


def test_auto_is_no_worse_than_the_network_with_periodic_input_either() -> None:
    for seed in SEEDS:
        auto_curve, one = curves("B", CurveMethod.AUTO)[seed, 0]
        net = network(samples_of(one), network_input=NetworkInput.PERIODIC, iterations=100)
        assert rms_to_truth(auto_curve, one) <= 1.05 * rms_to_truth(net, one)


def test_the_order_found_is_the_one_that_is_there() -> None:
    found = [auto(samples_of(draw(PURE, seed, 0))).order for seed in range(10)]
    assert sum(order == 2 for order in found) >= 9
    assert all(6 <= curve.order <= 9 for curve, _ in curves("A", CurveMethod.AUTO).values())
    assert all(curve.order == 8 for curve, _ in curves("B", CurveMethod.AUTO).values())


def test_the_covariance_of_auto_tells_its_error() -> None:
    # over all draws: error over stated standard deviation at a fixed angle, with variance near one
    at = np.array([1.0])
    for scenario in ("A", "B"):
        made = curves(scenario, CurveMethod.AUTO).values()
        ratio = [((curve(at) - one.true_at(at)) / curve.std(at))[0] for curve, one in made]
        assert 0.5 < float(np.std(ratio)) < 2.0


def with_outliers(one: Draw, share: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    error = one.error.copy()
    hit = rng.random(error.size) < share
    error[hit] += rng.normal(0.05, 0.1, int(hit.sum()))
    return error


@pytest.mark.parametrize("scenario", [A, B], ids=["A", "B"])
@pytest.mark.parametrize("share", [0.01, 0.05])
def test_outliers_do_not_pull_auto(scenario: Scenario, share: float) -> None:
    for seed in range(10):
        one = draw(scenario, seed, 0)
        samples = Samples.build(one.theta_rad, with_outliers(one, share, seed))
        robust = auto(samples)
        assert rms_to_truth(robust, one) <= 0.0003
        assert robust.noise == pytest.approx(scenario.noise, rel=0.15)
        if share == 0.05:
            assert rms_to_truth(robust, one) < 0.2 * rms_to_truth(auto(samples, robust=False), one)
            assert any("held down" in remark for remark in robust.remarks)


def test_without_outliers_holding_down_costs_almost_nothing() -> None:
    robust = [rms_to_truth(auto(samples_of(draw(B, seed, 1))), draw(B, seed, 1)) for seed in SEEDS]
    plain = [rms_to_truth(auto(samples_of(draw(B, seed, 1)), robust=False), draw(B, seed, 1)) for seed in SEEDS]
    assert np.mean(robust) < 1.15 * np.mean(plain)


def test_sixty_rows_are_enough_for_auto() -> None:
    ours, theirs = [], []
    for seed in SEEDS:
        few, whole = draw(A, seed, 0, rows=60), draw(A, seed, 0)
        ours.append(rms_to_truth(auto(samples_of(few)), whole))
        theirs.append(rms_to_truth(harmonics2(samples_of(few)), whole))
    assert max(ours) < 0.0015
    assert np.mean(ours) < np.mean(theirs)


def test_the_network_overfits_few_rows_at_random_angles_and_says_so() -> None:
    one = draw(A, 0, 0, rows=60)
    theta = np.sort(np.random.default_rng(4).uniform(0.0, 2 * np.pi, 60))
    error = one.true_at(theta) + A.noise * np.random.default_rng(5).standard_normal(60)
    samples = Samples.build(theta, error)
    net, ours = network(samples), auto(samples)
    whole = draw(A, 0, 0)
    assert rms_to_truth(net, whole) > 1.5 * rms_to_truth(ours, whole)
    assert any("follows the noise" in remark for remark in net.remarks)


@pytest.mark.parametrize("start_deg", [0.0, 130.0, 270.0])
def test_a_quarter_of_the_turn_missing_is_bridged_with_a_warning(start_deg: float) -> None:
    for seed in SEEDS:
        for channel in CHANNELS:
            one = draw(A, seed, channel)
            into = np.mod(one.theta_rad - np.radians(start_deg), 2 * np.pi)
            gap = into < np.pi / 2
            curve = auto(Samples.build(one.theta_rad[~gap], one.error[~gap]))
            off = np.abs(curve(one.theta_rad[gap]) - one.truth[gap])
            assert off.max() <= 0.01
            assert off.max() <= 5.0 * curve.std(one.theta_rad[gap]).max()
            assert any("of the turn: the compensation is a guess" in remark for remark in curve.remarks)
            assert curve.coverage.largest_gap_rad == pytest.approx(np.pi / 2, abs=0.01)


@pytest.mark.parametrize("rows", [60, 600])
def test_a_gap_anywhere_under_strong_wobble_is_bridged_as_well_as_can_be(rows: int) -> None:
    # of many seeds 95 % (60 rows) and more are within 0.01' (rms over the gap); this is a part of that benchmark
    found = rotation_gap.score(B, rows, range(700, 706), np.arange(6) * (np.pi / 3))
    ours, informed = found["auto"], found["informed"]
    for name in ("rms", "worst"):
        share = [float(np.mean(np.array(getattr(one, name)) <= 0.01)) for one in (ours, informed)]
        assert share[0] >= share[1] - 0.08
        assert np.mean(getattr(ours, name)) < 1.15 * np.mean(getattr(informed, name))
    assert np.mean(np.array(ours.rms) <= 0.01) >= (0.88 if rows == 60 else 0.97)
    assert np.mean(ours.inside) > 0.88


def test_a_gap_where_it_was_always_looked_at() -> None:
    for seed in SEEDS:
        one = draw(B, seed, 0)
        gap = one.theta_rad > 1.5 * np.pi
        curve = auto(Samples.build(one.theta_rad[~gap], one.error[~gap]))
        off = np.abs(curve(one.theta_rad[gap]) - one.truth[gap])
        assert off.max() <= 0.01
        assert off.max() <= 5.0 * curve.std(one.theta_rad[gap]).max()


@pytest.mark.parametrize("rows", [60, 1200])
def test_outliers_do_not_pull_auto_in_a_gap(rows: int) -> None:
    clean, spoiled, plain = [], [], []
    for seed in SEEDS:
        one = draw(B, seed, 1, rows=rows)
        seen = one.theta_rad < 1.5 * np.pi
        theta, error = one.theta_rad[seen], one.error[seen].copy()

        def rms(values: np.ndarray, robust: bool = True, theta: np.ndarray = theta, one: Draw = one) -> float:
            curve = auto(Samples.build(theta, values), robust=robust)
            return float(np.sqrt(np.mean((curve(AT) - one.true_at(AT)) ** 2)))

        clean.append(rms(error))
        rng = np.random.default_rng(seed)
        bad = rng.random(error.size) < 0.05
        error[bad] += rng.normal(0.05, 0.1, int(bad.sum()))
        spoiled.append(rms(error))
        plain.append(rms(error, robust=False))
    assert np.mean(spoiled) < 2.0 * np.mean(clean)
    assert np.mean(spoiled) < 0.5 * np.mean(plain)


def test_a_gap_in_errors_without_noise_or_without_size_has_no_trouble() -> None:
    theta = np.linspace(0.0, 1.5 * np.pi, 300)
    curve = auto(Samples.build(theta, 0.02 * np.sin(theta) + 0.01))
    assert np.abs(curve(np.linspace(0, 6.28, 99)) - 0.02 * np.sin(np.linspace(0, 6.28, 99)) - 0.01).max() < 1e-4
    nothing = auto(Samples.build(theta, np.zeros(300)))
    assert np.abs(nothing(theta)).max() == 0.0
    assert np.isfinite(nothing.std(theta)).all()


def test_a_polynomial_does_not_bridge_a_gap() -> None:
    one = draw(A, 0, 0)
    gap = one.theta_rad > 1.5 * np.pi
    curve = polynomial9(Samples.build(one.theta_rad[~gap], one.error[~gap]))
    assert np.abs(curve(one.theta_rad[gap]) - one.truth[gap]).max() > 0.1
    assert any("guess" in remark for remark in curve.remarks)


# --- rate terms


def rate_runs(kind: str) -> tuple[Samples, np.ndarray]:
    """Four turns with an error of 0.02' per relative rate; gives the samples and the part that is of the angle."""
    n = 6000
    theta = np.arange(4 * n) * (2 * np.pi / n)
    base = draw(A, 0, 0)
    of_angle = base.true_at(theta)
    nominal = np.radians(6.0)
    turn = (theta / (2 * np.pi)).astype(int)
    relative = {
        "several": np.array([0.7, 0.9, 1.1, 1.3])[turn],
        "of the angle": 1.0 + 0.3 * np.sin(theta),
        "reversing": np.where(turn % 2 == 0, 1.0, -1.0),
        "constant": np.ones(theta.size),
    }[kind]
    rng = np.random.default_rng(3)
    error = of_angle + 0.02 * relative + A.noise * rng.standard_normal(theta.size)
    return Samples.build(theta, error, nominal * relative), of_angle


def test_runs_at_several_rates_tell_the_rate_from_the_angle() -> None:
    samples, of_angle = rate_runs("several")
    for curve in (auto(samples, rate_terms=2), polynomial9(samples, rate_terms=2)):
        assert curve.rate is not None
        assert curve.rate.powers == (1, 2)
        fitted = curve(samples.theta_rad, samples.rate_radps)
        true = of_angle + 0.02 * samples.rate_radps / np.radians(6.0)
        assert np.sqrt(np.mean((fitted - true) ** 2)) < 0.001
        slope = curve.parameters[-2] / curve.rate.spread_radps * np.radians(6.0)
        assert slope == pytest.approx(0.02, abs=0.001)
    with pytest.raises(InputError, match="depends on the rotor rate"):
        curve(samples.theta_rad)


def test_a_rate_that_follows_the_angle_is_refused() -> None:
    samples, _ = rate_runs("of the angle")
    for method in (auto, polynomial9):
        with pytest.raises(Refused, match="follows the angle"):
            method(samples, rate_terms=1)


def test_a_reversing_rotor_has_no_square_of_the_rate() -> None:
    samples, _ = rate_runs("reversing")
    for curve in (auto(samples, rate_terms=2), polynomial9(samples, rate_terms=2)):
        assert curve.rate is not None
        assert curve.rate.powers == (1,)
        assert any("rate term 2 omitted" in remark for remark in curve.remarks)


def test_a_constant_rate_is_refused_where_rate_terms_are_asked_for() -> None:
    samples, _ = rate_runs("constant")
    with pytest.raises(Refused, match="rate is constant"):
        fit(samples, CurveMethod.POLYNOMIAL9, held_out=False, options=_rate_terms(2))
    with pytest.raises(InputError, match="harmonics2 has no rate terms"):
        fit(samples, CurveMethod.HARMONICS2, held_out=False, options=_rate_terms(1))
    with pytest.raises(InputError, match="need the rotor rate"):
        polynomial9(Samples.build(samples.theta_rad, samples.error), rate_terms=1)


def _rate_terms(count: int):  # type: ignore[no-untyped-def]
    from highside.rotation import FitOptions

    return FitOptions(rate_terms=count)


# --- turns, held out, bad samples


def test_the_held_out_error_is_of_whole_turns() -> None:
    one = draw(B, 0, 0, rows=6000, turns=3.0)
    curve = fit(samples_of(one), CurveMethod.AUTO)
    assert curve.held_out is not None
    assert curve.held_out.turns == 3
    assert curve.held_out.rms == pytest.approx(B.noise, rel=0.1)
    assert fit(samples_of(draw(B, 0, 0)), CurveMethod.AUTO).held_out is None


def test_the_held_out_error_sees_what_does_not_repeat() -> None:
    # a first harmonic of its own in every turn: each turn is fitted well, no turn foretells the next
    one = draw(B, 0, 0, rows=6000, turns=6.0)
    turn = (one.theta_rad / (2 * np.pi)).astype(int)
    own = np.random.default_rng(2).normal(0.0, 0.01, 6)[turn] * np.sin(one.theta_rad)
    curve = fit(Samples.build(one.theta_rad, one.error + own), CurveMethod.AUTO)
    assert curve.held_out is not None
    assert curve.held_out.rms > 3.0 * B.noise


def test_turns_are_counted_forward_and_back_and_across_the_seam() -> None:
    forth = np.linspace(0.3, 0.3 + 4 * np.pi, 2001)
    theta = np.mod(np.concatenate([forth, forth[::-1]]), 2 * np.pi)
    samples = Samples.build(theta, np.sin(theta))
    assert samples.whole_revolutions == (0, 1, 2, 3)
    assert samples.coverage.turns == pytest.approx(4.0, abs=1e-9)
    shuffled = np.random.default_rng(0).permutation(theta)
    assert Samples.build(shuffled, np.sin(shuffled)).whole_revolutions == ()


@pytest.mark.parametrize(
    "method", [CurveMethod.SINE, CurveMethod.HARMONICS2, CurveMethod.POLYNOMIAL9, CurveMethod.NETWORK, CurveMethod.AUTO]
)
def test_less_than_half_a_turn_is_refused_by_every_method(method: CurveMethod) -> None:
    theta = np.linspace(0.0, 2.5, 500)
    with pytest.raises(Refused, match="143 deg of the turn are covered"):
        fit(Samples.build(theta, np.sin(theta)), method)


def test_a_rotor_that_stood_at_four_angles_only_is_refused_by_what_needs_more() -> None:
    theta = np.tile(np.array([0.0, 0.5, 1.0, 1.5]) * np.pi, 50)
    error = 0.03 * np.sin(theta)
    assert sine(Samples.build(theta, error)).parameters == pytest.approx([0.0, 0.03, 0.0], abs=1e-12)
    for method in (harmonics2, polynomial9):
        with pytest.raises(Refused, match="too few different angles"):
            method(Samples.build(theta, error))


def test_bad_samples_are_refused_in_one_line() -> None:
    theta = np.linspace(0, 6, 100)
    with pytest.raises(InputError, match="one length"):
        Samples.build(theta, theta[:50])
    with pytest.raises(InputError, match="finite"):
        Samples.build(theta, np.where(theta > 3, np.nan, theta))
    with pytest.raises(InputError, match="too few"):
        Samples.build(theta[:4], theta[:4])


def test_errors_without_noise_are_reproduced_to_rounding() -> None:
    theta = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    truth = np.array([0.1, 0.2, -0.3, 0.05, 0.02, 0.0, 0.01])
    curve = auto(Samples.build(theta, fourier_sum(theta, truth)))
    assert curve.order >= 3
    assert np.allclose(curve.parameters[:7], truth, atol=1e-12)
    assert np.allclose(auto(Samples.build(theta, np.zeros(400)))(theta), 0.0)


def test_a_networks_curve_without_its_network_is_refused() -> None:
    """And a network beside another form: either would fail at its first use."""
    one = draw(A, 0, 0, rows=200)
    data = network(samples_of(one), iterations=5).to_dict()
    assert ErrorCurve.from_dict(data).form == "network"
    for changed in (data | {"network": None}, data | {"form": "fourier"}):
        with pytest.raises(ValueError, match="belong together"):
            ErrorCurve.from_dict(changed)
