"""Parts of the rotation diagnosis: noise with memory in state-space form, columns in chunks, inner products, noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.markov import LevelNoise, VectorNoise
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.rotation.lines import found_lines
from highside.diagnosis.rows.colour import with_long_memory
from highside.diagnosis.rows.design import ChainDesign, Line
from highside.diagnosis.rows.gram import HeldOutRows, RandomWalkGrams, Space, accumulate
from highside.diagnosis.rows.noise import RotationNoise, estimate
from highside.diagnosis.rows.policy import JITTER
from highside.diagnosis.rows.session import RotationSession, rotation_session
from highside.errors import InputError
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_jacobians
from highside.physics.noise import autoregressive
from highside.physics.plan import Profile, RotationPlan, Session, Site
from highside.physics.state import ChainState
from studies.scenario import random_sensor

Array = NDArray[np.float64]

FREE = ("bias", "scale", "misalignment")
SIGMA = 8e-5
FURTHER = pytest.mark.further
WAYS = pytest.mark.parametrize(
    "method",
    [
        pytest.param(ProcedureParts.without("laws"), id="names alone"),
        pytest.param(WHOLE, id="with laws", marks=FURTHER),
    ],
)
"""Of what the names settle among themselves; that laws leave them alone: `test_library_effects_rotation`."""


def kernel(places: Array, length: float) -> Array:
    if np.isinf(length):
        return np.minimum(places[:, None], places[None, :])
    return np.exp(-np.abs(places[:, None] - places[None, :]) / length)


def turning(
    hold_s: float = 8.0, hz: float = 50.0, vibration: tuple[float, ...] = (0.1, 0.5, 0.2, 0.4, 0.3)
) -> ChainState:
    plan = RotationPlan(
        62.0, tuple(2 * np.pi * np.array([0.5, -1.0, 2.0, -2.0, 1.0])), hold_s, 1.0, hz, 20.0, vibration
    )
    return Session(plan, Site(latitude_rad=0.9), Profile((25.0, 40.0, 28.0, 35.0))).rows().state


def recording(
    effects: dict[str, dict[str, float]], state: ChainState, seed: int = 0, *, gyros: bool = False, colour: float = 0.0
) -> RotationSession:
    rng = np.random.default_rng(seed)
    sensor = random_sensor(rng).with_effects(effects)
    readings = sensor.simulate(state, rng) + autoregressive((3, state.n), SIGMA, colour, rng)
    if gyros:
        rates = sensor.gyro(state) + 3e-4 * rng.standard_normal((3, state.n))
        readings = np.concatenate([readings, rates])
    return RotationSession(readings, state)


def fitted(session: RotationSession) -> tuple[ForwardModel, Array]:
    model, residual = base_fit(ForwardModel.of({}), Observed(session.state, session.readings), FREE)
    return model, residual


@pytest.fixture(scope="module")
def prepared() -> tuple[ChainDesign, RotationNoise, Array]:
    session = recording({"quadratic": {"k2_x": 3e-5}}, turning(), colour=0.6)
    model, residual = fitted(session)
    design = ChainDesign(session, model, FREE, [Line("tone", 13.0, 1000)])
    return design, estimate(design, residual, 1), residual


class TestNoiseWithMemory:
    def test_level_filter_whitens_as_the_covariance_matrix_does(self) -> None:
        rng = np.random.default_rng(0)
        places, white = np.cumsum(rng.uniform(0.5, 2, 40)), rng.uniform(1, 2, 40)
        places -= places[0]
        shares, lengths = np.array([0.3, 2.0, 0.1, 0.0]), np.array([1.5, 4.0, np.inf, np.inf])
        noise = LevelNoise.of(white, places, shares, lengths)
        columns = rng.standard_normal((3, 40))
        turned = noise.white(columns)
        for k in range(4):
            covariance = np.diag(white) + shares[k] * kernel(places, lengths[k])
            assert np.allclose(turned[k] @ turned[k].T, columns @ np.linalg.solve(covariance, columns.T))
            assert noise.log_determinant[k] == pytest.approx(np.linalg.slogdet(covariance)[1])
        began = LevelNoise.of(white, places, shares, lengths, walked=7.0)
        earlier = np.diag(white) + shares[2] * (7.0 + kernel(places, np.inf))
        turned = began.white(columns)[2]
        assert np.allclose(turned @ turned.T, columns @ np.linalg.solve(earlier, columns.T))

    def test_three_channels_that_hang_together_are_whitened_as_one(self) -> None:
        rng = np.random.default_rng(1)
        n = 30
        places = np.cumsum(rng.uniform(0.5, 2, n)) - 0.5
        places -= places[0]
        root = rng.standard_normal((n, 3, 3))
        white = root @ root.transpose(0, 2, 1) + np.eye(3)
        shares, lengths = np.array([0.5, 0.0, 0.2]), np.array([2.0, np.inf, np.inf])
        covariance = np.zeros((3, n, 3, n))
        covariance[:, np.arange(n), :, np.arange(n)] = white
        for c in range(3):
            covariance[c, :, c, :] += shares[c] * kernel(places, lengths[c])
        columns = rng.standard_normal((2, 3, n))
        turned = VectorNoise.of(white, places, shares, lengths).white(columns)
        flat = columns.reshape(2, -1)
        dense = covariance.reshape(3 * n, 3 * n)
        assert np.allclose(turned @ turned.T, flat @ np.linalg.solve(dense, flat.T))


class TestDesign:
    @pytest.mark.parametrize(
        ("effect", "size"),
        [
            ("lever_arm", 1e-4), ("bandwidth_lag", 1e-6), ("clock_skew", 1e-8), ("warmup", 1e-5), ("thermal_lag", 1e-6),
            ("encoder_first_harmonic", 1e-6), ("tone", 1e-5), ("wobble", 1e-6), ("bias_drift", 1e-7),
        ],
    )  # fmt: skip
    def test_columns_in_chunks_are_what_the_effect_adds(
        self, prepared: tuple[ChainDesign, RotationNoise, Array], effect: str, size: float
    ) -> None:
        design, _, _ = prepared
        candidate = next(c for c in design.candidates if c.id == effect)
        variant = next(v for v in candidate.variants if v.whole)
        state, model = design.session.state, design.model
        added = np.zeros((3, state.n))
        for part in (slice(0, 700), slice(700, 1501), slice(1501, state.n)):
            made = design.functions(part)
            for number in np.asarray(variant.columns):
                for c in range(3):
                    if number >= 0 and design.where[number, c] >= 0:
                        added[c, part] += size * made[c][design.where[number, c]]
        values = {**variant.shape, **dict.fromkeys(candidate.amplitudes, size)}
        expected = model.with_effects({effect: values}).predict(state) - model.predict(state)
        assert np.max(np.abs(added - expected)) < 2e-3 * np.max(np.abs(expected))

    def test_what_is_not_recorded_leaves_no_trace(self) -> None:
        state = turning(vibration=())
        session = recording({}, state)
        design = ChainDesign(session, fitted(session)[0], FREE)
        reasons = {blind.effect.id: blind.why for blind in design.unobservable}
        assert "vibration" in reasons["vibration_rectification"]
        assert "gyros" in reasons["gyro_scale"]


class TestInnerProducts:
    def test_coordinates_have_the_inner_products_of_the_whitened_columns(
        self, prepared: tuple[ChainDesign, RotationNoise, Array]
    ) -> None:
        design, noise, residual = prepared
        grams, _ = accumulate(design, noise, residual)
        space = Space(design, [gram.total for gram in grams])
        numbers = np.concatenate([design.base, np.asarray(design.candidates[3].variants[0].columns)])
        made = design.functions(slice(0, design.session.n))
        columns = np.zeros((numbers.size, 3, design.session.n))
        for i, number in enumerate(numbers):
            for c in range(3):
                if design.where[number, c] >= 0:
                    columns[i, c] = made[c][design.where[number, c]]
        white, target = noise.white(columns), noise.white(residual)
        found = space.columns(numbers)
        assert np.allclose(found @ found.T, white @ white.T, rtol=1e-6, atol=1e-9 * np.max(np.abs(white @ white.T)))
        size = np.linalg.norm(white, axis=1)
        assert np.allclose(found @ space.residual / size, white @ target / size, atol=1e-3)

    def test_held_out_errors_are_those_of_fits_without_the_fold(
        self, prepared: tuple[ChainDesign, RotationNoise, Array]
    ) -> None:
        design, noise, residual = prepared
        grams, segments = accumulate(design, noise, residual)
        held = HeldOutRows(design, grams)
        numbers = np.asarray(next(c for c in design.candidates if c.id == "quadratic").variants[0].columns)
        energies = held.energies(numbers, held.folds)
        made = design.functions(slice(0, design.session.n))
        every = np.concatenate([design.base, numbers])
        columns = np.zeros((every.size, 3, design.session.n))
        for i, number in enumerate(every):
            for c in range(3):
                if design.where[number, c] >= 0:
                    columns[i, c] = made[c][design.where[number, c]]
        white = noise.white(columns).reshape(every.size, 3, -1)
        target = noise.white(residual).reshape(3, -1)
        rest, scored = segments.fold != 4, (segments.fold == 4) & segments.core
        solution = np.linalg.lstsq(white[:, :, rest].reshape(every.size, -1).T, target[:, rest].ravel(), rcond=1e-6)[0]
        errors = target[:, scored] - np.tensordot(solution, white[:, :, scored], 1)
        assert energies[4] == pytest.approx(float(np.sum(errors**2)), rel=1e-5)

    def test_a_walk_of_no_size_changes_nothing(self, prepared: tuple[ChainDesign, RotationNoise, Array]) -> None:
        design, noise, residual = prepared
        gram = accumulate(design, noise, residual)[0][0]
        assert np.allclose(RandomWalkGrams.of(gram).grams[0], gram.total, atol=1e-9 * np.max(np.abs(gram.total)))


class TestNoise:
    def test_colour_is_found_beside_an_effect(self, prepared: tuple[ChainDesign, RotationNoise, Array]) -> None:
        _, noise, _ = prepared
        turned = np.exp(-1j * np.linspace(0, np.pi, 9)[1:])
        for polynomial in noise.filters:
            # whatever its order, and but for what is slower than any of this is fit for
            gain = np.abs(np.polyval(polynomial[::-1], turned))
            assert gain == pytest.approx(np.abs(1 - 0.6 * turned), rel=0.2)
        assert noise.sigma == pytest.approx(SIGMA * np.sqrt(1 - 0.6**2), rel=0.1)

    def test_sampling_jitter_shows_in_the_scatter_across_gravity(self) -> None:
        state = turning(20.0)
        rng = np.random.default_rng(3)
        sensor = random_sensor(rng)
        late = state.shifted(3e-5 * rng.standard_normal(state.n))
        session = RotationSession(sensor.predict(late) + SIGMA * rng.standard_normal((3, state.n)), state)
        model, residual = fitted(session)
        noise = estimate(ChainDesign(session, model, FREE), residual, 1)
        assert noise.jitter[:2, 0].min() > 30
        assert noise.jitter[:2, 1] == pytest.approx(3e-5, rel=0.15)
        assert noise.jitter[2, 0] == 0.0

    @pytest.mark.parametrize("kind", ["angles", "rate", "burst"])
    def test_scatter_of_another_kind_is_no_sampling_jitter(self, kind: str) -> None:
        """Random errors of the angles given and noise that follows the rate had that name, three times beyond doubt."""
        state = turning(20.0)
        rng = np.random.default_rng(0)
        session = recording({}, state)
        if kind == "angles":
            across = np.asarray(gravity_jacobians(state.inc_rad, state.tf_rad)[1])
            session.readings[:] += across * 3e-4 * rng.standard_normal(state.n)
        elif kind == "rate":
            session.readings[:] += 2e-5 * state.rotor_rate_radps * rng.standard_normal((3, state.n))
        else:
            within = np.abs(np.linspace(0, 1, state.n) - 0.4) < 0.02
            session.readings[:2] += 4e-4 * within * rng.standard_normal(state.n)
        model, residual = fitted(session)
        noise = estimate(ChainDesign(session, model, FREE), residual, 1)
        assert noise.jitter[:, 0].sum() < JITTER.certain / 2

    def test_impulses_count_for_nothing(self) -> None:
        session = recording({}, turning())
        session.readings[1, 777] += 40 * SIGMA
        model, residual = fitted(session)
        noise = estimate(ChainDesign(session, model, FREE), residual, 1)
        assert noise.impulses == 1
        assert noise.weight[1, 777] == 0.0


class TestLines:
    def test_a_hum_is_found_at_its_frequency(self) -> None:
        session = recording({"tone": {"c_x": 2e-5, "s_z": 2e-5, "f": 13.7}}, turning(20.0), colour=0.5)
        lines = found_lines(session, fitted(session)[1])
        assert any(line.effect == "tone" and line.value == pytest.approx(13.7, abs=2e-3) for line in lines)

    def test_an_order_is_found_by_the_angle(self) -> None:
        session = recording({"aliased_vibration": {"c_x": 2e-5, "s_y": 2e-5, "n": 7.3}}, turning(20.0))
        lines = found_lines(session, fitted(session)[1])
        assert any(line.effect == "aliased_vibration" and line.value == pytest.approx(7.3, abs=6e-3) for line in lines)

    @pytest.mark.parametrize("colour", [0.7, 0.9, 0.97])
    def test_steep_noise_has_none(self, colour: float) -> None:
        state = turning(4.0)
        for seed in range(20):
            noise = autoregressive((3, state.n), SIGMA, colour, np.random.default_rng(seed))
            tones = {line.value for line in found_lines(RotationSession(noise, state), noise) if line.effect == "tone"}
            assert tones <= {60.0}

    def test_noise_has_none(self) -> None:
        session = recording({}, turning(20.0))
        assert {line.value for line in found_lines(session, fitted(session)[1])} == {60.0}


class TestVerdicts:
    def test_nothing_left_out(self) -> None:
        diagnosis, _ = diagnose_rotation(recording({}, turning(), colour=0.7), ForwardModel.of({}), FREE)
        assert diagnosis.verdict == "nothing_left_out"
        assert not diagnosis.claims

    @pytest.mark.parametrize("seed", range(6))
    def test_colour_of_a_short_recording_is_no_random_walk(self, seed: int) -> None:
        """With what the projection of 170 functions takes of 1,200 rows given back, the filter is that of the noise."""
        session = recording({}, turning(4.0), seed, colour=0.7)
        parts = replace(WHOLE, laws=False)
        diagnosis, _ = diagnose_rotation(session, ForwardModel.of({}), FREE, method=parts)
        assert diagnosis.verdict == "nothing_left_out"
        assert [f[1] for f in diagnosis.noise["filters"]] == pytest.approx([-0.7] * 3, abs=0.1)

    @pytest.mark.parametrize("seed", [100, 101])
    def test_noise_that_remembers_a_thirtieth_of_a_recording_is_no_random_walk(self, seed: int) -> None:
        session = recording({}, turning(4.0), seed, colour=0.97)
        diagnosis, _ = diagnose_rotation(session, ForwardModel.of({}), FREE, method=ProcedureParts.without("laws"))
        assert diagnosis.verdict == "nothing_left_out"
        assert "independent stretches" in diagnosis.remainder.hints[0]

    @pytest.mark.parametrize("seed", [100, 101])
    def test_slow_noise_beside_white_noise_is_no_finding(self, seed: int) -> None:
        """The projection takes what is slow of it, and the filter is left with one to three terms."""
        state = turning(4.0)
        rng = np.random.default_rng(seed)
        noise = autoregressive((3, state.n), SIGMA / np.sqrt(2), 0.95, rng) + SIGMA / np.sqrt(2) * rng.standard_normal(
            (3, state.n)
        )
        session = RotationSession(random_sensor(rng).predict(state) + noise, state)
        diagnosis, _ = diagnose_rotation(session, ForwardModel.of({}), FREE, method=ProcedureParts.without("laws"))
        assert diagnosis.verdict == "nothing_left_out"

    @pytest.mark.parametrize(("lead", "verdict"), [(2.0, "not_testable"), (15.0, "wander")])
    def test_a_random_walk_is_claimed_where_it_is_distinguished_from_noise_that_forgets(
        self, lead: float, verdict: str
    ) -> None:
        noise = {"memory_evidence": [90.0, 3.0], "memory_poses": ["random_walk", 12.0], "memory_lead": [lead, 0.0]}
        found = with_long_memory(DiagnosisResult("wander", noise=noise), recording({}, turning(4.0)))
        assert found.verdict == verdict
        assert ("record ten times as long" in " ".join(found.remainder.hints)) == (verdict == "not_testable")

    @pytest.mark.parametrize(("others", "verdict"), [(0.5, "not_testable"), (300.0, "nothing_left_out")])
    def test_a_memory_of_one_axis_alone_may_be_something_left_out(self, others: float, verdict: str) -> None:
        """A law of temperature and acceleration on one axis, of 1,100 units of strength, was "nothing"."""
        noise = {
            "memory_evidence": [others, others, 1020.0],
            "memory_poses": [30.0, 30.0, 30.0],
            "memory_lead": [0.0, 0.0, 0.0],
        }
        found = with_long_memory(DiagnosisResult("nothing_left_out", noise=noise), recording({}, turning(4.0)))
        assert found.verdict == verdict

    @WAYS
    def test_a_lever_arm_is_named_with_its_size(self, method: ProcedureParts) -> None:
        truth = {"r_x": 6e-5, "r_y": -4e-5}
        session = recording({"lever_arm": truth}, turning(), colour=0.5)
        diagnosis, report_data = diagnose_rotation(session, ForwardModel.of({}), FREE, method=method)
        assert [claim.effect for claim in diagnosis.claims] == ["lever_arm"]
        assert "size_effect" in diagnosis.claims[0].equivalence_class
        for name, value in truth.items():
            found = diagnosis.claims[0].parameters[name]
            assert abs(found.value - value) < 4 * found.std
        assert diagnosis.location[0].channels == ("ax", "ay")
        assert diagnosis.location[0].covariate == "rotor_rate_dps"
        assert diagnosis.fit is not None
        assert (diagnosis.fit.heldout_gain_low or 0) > 0
        assert report_data.after.shape == session.readings.shape

    def test_what_the_library_lacks_is_a_law(self) -> None:
        state = turning(20.0)
        session = recording({}, state)
        session.readings[1] += 8e-5 * np.exp(-0.5 * ((np.mod(np.degrees(state.tf_rad), 360) - 130) / 20) ** 2)
        diagnosis, _ = diagnose_rotation(session, ForwardModel.of({}), FREE)
        assert diagnosis.verdict == "law"
        # at one inclination an offset that follows toolface and a scale factor that does are the same
        assert [(c.channels, c.depends_on) for c in diagnosis.claims] == [(("ay",), ("tf",))]
        assert "law:offset_y_tf" in (diagnosis.claims[0].effect, *diagnosis.claims[0].equivalence_class)
        assert diagnosis.location[0].channels == ("ay",)

    def test_a_walk_is_no_slow_effect(self) -> None:
        state = turning(20.0)
        session = recording({}, state)
        session.readings[:] += 0.03 * SIGMA * np.cumsum(np.random.default_rng(5).standard_normal((3, state.n)), axis=1)
        diagnosis, _ = diagnose_rotation(session, ForwardModel.of({}), FREE)
        assert diagnosis.verdict == "wander"
        assert diagnosis.noise["random_walk"]

    def test_gyros_split_a_time_offset_from_a_lag(self) -> None:
        session = recording({"time_offset": {"t0": 3e-5}}, turning(), gyros=True)
        diagnosis, _ = diagnose_rotation(session, ForwardModel.of({}), (*FREE, "gyro_bias", "gyro_scale"))
        assert [claim.effect for claim in diagnosis.claims] == ["time_offset"]

    @WAYS
    def test_the_earth_is_named_by_its_known_size_and_not_as_g_sensitivity(self, method: ProcedureParts) -> None:
        state = turning(20.0)
        rng = np.random.default_rng(2)
        model = random_sensor(rng).with_effects({"earth_rotation": {"share": 1.0}})
        gyro = model.gyro(state)
        for share, names in ((1.0, ["earth_rotation"]), (3.0, ["gyro_g_sensitivity"])):
            rates = share * gyro + (1 - share) * random_sensor(rng).gyro(state) + 2e-4 * rng.standard_normal(gyro.shape)
            readings = np.concatenate([model.predict(state) + SIGMA * rng.standard_normal(gyro.shape), rates])
            session, free = RotationSession(readings, state), (*FREE, "gyro_bias", "gyro_scale")
            diagnosis, _ = diagnose_rotation(session, ForwardModel.of({}), free, method=method)
            assert [claim.effect for claim in diagnosis.claims] == names

    def test_the_same_seed_gives_the_same_answer(self) -> None:
        session = recording({"cubic": {"k3_x": 1e-4}}, turning())
        first, second = (diagnose_rotation(session, ForwardModel.of({}), FREE)[0].to_dict() for _ in range(2))
        assert first == second


def test_too_few_rows_are_refused() -> None:
    short = {name: np.zeros(50) for name in ("t_s", "inc_ref_deg", "tf_ref_deg")}
    with pytest.raises(InputError, match="too few"):
        rotation_session(short, np.zeros((3, 50)), gravity_mps2=9.8)


def test_a_simulation_without_noise_says_nothing_is_left_out_or_what() -> None:
    state = turning()
    sensor = random_sensor(np.random.default_rng(3))
    nothing, _ = diagnose_rotation(RotationSession(sensor.predict(state), state), ForwardModel.of({}), FREE)
    assert nothing.verdict == "nothing_left_out"
    arm = sensor.with_effects({"lever_arm": {"r_x": 1e-4, "r_y": -5e-5}})
    found, _ = diagnose_rotation(RotationSession(arm.predict(state), state), ForwardModel.of({}), FREE)
    assert [c.effect for c in found.claims] == ["lever_arm"]
    assert found.claims[0].parameters["r_x"].value == pytest.approx(1e-4, rel=1e-6)
