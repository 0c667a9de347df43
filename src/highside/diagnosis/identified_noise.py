"""A misfit that is noise after all: which one, by the noise that laws had to compete with and lost to.

The first diagnosis knows scatter of sensors and settings and a random walk of each channel. The search for laws learns
more kinds (errors of the set angles or of the whole level, first-order levels, 1/f) by evidence, beside no law at all.
Where one of them takes down to the floor what was "something without a name", that is the answer. And where errors of
the set angles take much in few poses, and are larger than a bench makes them, they may as well be a law of these
angles: that is no "nothing", it is not testable. Poses that scatter more than they repeat, with no memory from pose to
pose, are asked once more row by row: noise with a memory shows within them, something left out does not. Where the rows
speak for neither, that is not testable.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.finding_policy import FLOOR
from highside.diagnosis.core.floor import Excess
from highside.diagnosis.core.memory_policy import MEMORY
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.core.serial_correlation import RANDOM_WALK
from highside.diagnosis.core.set_angle_errors import TAKEN_FOR, in_words, instead, taken_for_set_angles
from highside.diagnosis.core.unexplained import TAKEN_FOR_NOISE, hinted, with_excess
from highside.diagnosis.law_answers import told_unnamed
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.free_rivals import leaves_most
from highside.diagnosis.laws.policy import LAW_VERDICT
from highside.diagnosis.laws.set_angles import enough_poses, may_hide_a_law, usual
from highside.diagnosis.poses.policy import ROWS_MEMORY
from highside.diagnosis.poses.session import PoseSession
from highside.diagnosis.poses.within import CHECK as WITHIN_POSE


def with_identified_noise(diagnosis: DiagnosisResult, found: Found) -> DiagnosisResult:
    """The diagnosis in which no law was found, by the noise that was; others as they are."""
    if found.terms:
        return diagnosis
    if found.problem.jitter is None:
        return _of_a_rotation(diagnosis, found)
    if diagnosis.verdict == "unknown" and _by_scatter_alone(diagnosis):
        diagnosis = _identified(diagnosis, found)
    if diagnosis.verdict == "nothing_left_out":
        return _undecided_memory(_far_above_floor(_undecided_angles(diagnosis, found), found), found)
    return _of_one_axis(diagnosis, found) if diagnosis.verdict == "wander" else diagnosis


def beside_floor(
    session: PoseSession, diagnosis: DiagnosisResult, report: ReportData, found: Excess | None, readings: str
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis of poses by what the base leaves beside the floor of their means, `found`.

    More than noise that is correlated from pose to pose leaves is no "nothing": what follows the settings is correlated
    from pose to pose as well. And where the misfit has no name, what was learned as noise may be the misfit: its size
    stands beside the floor.
    """
    if found is None or any(hint.startswith(TAKEN_FOR) for hint in diagnosis.remainder.hints):
        return diagnosis, report
    walks = diagnosis.verdict == "wander" and not diagnosis.claims
    if walks and session.n < enough_poses() and found.above(LAW_VERDICT.no_walk):
        # in few poses a random walk takes whatever there is, and of this size no sensor has one
        hints = tuple(h for h in diagnosis.remainder.hints if not h.startswith(TAKEN_FOR_NOISE))
        diagnosis = replace(diagnosis, verdict="unknown", remainder=replace(diagnosis.remainder, hints=hints))
    if diagnosis.verdict == "nothing_left_out" and found.above(LAW_VERDICT.far_above):
        diagnosis = with_excess(diagnosis, found, readings, LAW_VERDICT.far_above)
    fit, floor = diagnosis.fit, session.floor
    if diagnosis.verdict != "unknown" or fit is None or fit.noise_floor is None or not found.above(FLOOR.ratio):
        return diagnosis, report
    if floor is not None:
        own = np.sqrt(np.mean(floor.sigma**2, axis=1)).tolist()
        report = replace(report, sigma=tuple(map(min, own, report.sigma)))
    return replace(diagnosis, fit=replace(fit, noise_floor=min(fit.noise_floor, found.floor))), report


def with_remembering_rows(
    session: PoseSession, base: Array, diagnosis: DiagnosisResult, report: ReportData
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis of poses that scatter more than they repeat, where the rows within them show that this is noise
    with a memory, or cannot tell it from something left out; `base` (P, 3, n) may be refitted."""
    if diagnosis.verdict != "unknown" or not _by_scatter_alone(diagnosis):
        return diagnosis, report
    from highside.diagnosis.poses.rows_memory import rows_memory

    known = rows_memory(session, base)
    if known is None or known.nats <= -ROWS_MEMORY.found:
        return diagnosis, report
    noise = {**diagnosis.noise, "rows_memory_evidence": known.nats, "rows_memory_s": known.length_s}
    diagnosis = replace(diagnosis, noise=noise)
    if known.nats >= ROWS_MEMORY.found:
        words = f"{TAKEN_FOR_NOISE}: a zero offset that wanders"
        return hinted(replace(diagnosis, verdict="wander"), words), report
    words = (
        "the rows within the poses do not tell whether the poses disagree by noise with a memory or by something that "
        "was left out: hold each pose longer, or record each several times"
    )
    return hinted(replace(diagnosis, verdict="not_testable"), words), report


def angles_may_hide_a_law(found: Found) -> bool:
    """Whether errors of the set angles were learned that in so few poses may as well be a law of these."""
    return found.problem.jitter is not None and may_hide_a_law(found.noise, found.problem.n)


def names_beside_set_angles(
    diagnosis: DiagnosisResult, report: ReportData, found: Found, names: frozenset[str], after: Array
) -> tuple[DiagnosisResult, ReportData] | None:
    """The answer where `names` leave nearly all of the misfit, (C, n) in g `after` them, to errors of the set angles
    that may as well be a law of these: that is not testable, whatever the names explain. None elsewhere."""
    if float(np.sum(after**2)) < (1.0 - LAW_VERDICT.least_explained) * float(np.sum(report.before**2)):
        return None
    unnamed, without = told_unnamed(diagnosis, report, names, left=True)
    made = _undecided_angles(replace(unnamed, verdict="nothing_left_out"), found)
    return None if made.verdict == "nothing_left_out" else (made, without)


def with_set_angles(diagnosis: DiagnosisResult, found: Found) -> DiagnosisResult:
    """The diagnosis with names or laws beside which errors of the set angles were learned, larger than any bench makes:
    what is left of the misfit is taken for these, and that is said."""
    noise = found.noise
    if found.problem.jitter is None or not diagnosis.claims or usual(noise):
        return diagnosis
    known = {**diagnosis.noise, "beside_laws_set_angles_rad": [float(size) for size in noise.jitter]}
    return taken_for_set_angles(replace(diagnosis, noise=known), noise.jitter)


def _by_scatter_alone(diagnosis: DiagnosisResult) -> bool:
    """Whether nothing but scatter above the floor speaks against "nothing"."""
    within = any(finding.check == WITHIN_POSE for finding in diagnosis.intake)
    return not (diagnosis.claims or diagnosis.location or diagnosis.remainder.changing or within)


def _identified(diagnosis: DiagnosisResult, found: Found) -> DiagnosisResult:
    noise = found.noise
    if noise.remembers and found.evidence > found.without_memory + LAW_VERDICT.memory:
        made = replace(diagnosis, verdict="wander")
        alone = _of_one_axis(made, found)
        return alone if alone is not made else hinted(made, f"{TAKEN_FOR_NOISE}: {noise.summary()}")
    repeats = float(noise.factor.max()) <= FLOOR.ratio
    if found.problem.n >= enough_poses() or usual(noise):
        repeats = repeats or found.to_the_floor > found.evidence - LAW_VERDICT.repeats
    if np.any(noise.jitter > 0) and repeats:
        return taken_for_set_angles(replace(diagnosis, verdict="nothing_left_out"), noise.jitter)
    if found.problem.n < enough_poses() and found.to_the_floor > found.evidence - LAW_VERDICT.memory:
        words = (
            f"in {found.problem.n} poses errors of the set angles cannot be distinguished from readings that repeat "
            f"badly, nor from something that the angles follow: record {enough_poses()} poses or more, or each pose "
            "several times"
        )
        return hinted(replace(diagnosis, verdict="not_testable"), words)
    return diagnosis


def _of_a_rotation(diagnosis: DiagnosisResult, found: Found) -> DiagnosisResult:
    """Something without a name, where noise with a memory takes all of it to the floor, and beside that noise no law is
    worth a tie (in 30 nulls of be5acced the best is worth 5.8 nats at most): the first diagnosis knows what a row does
    to those that follow it at once, and no more."""
    noise = found.noise
    if diagnosis.verdict != "unknown" or diagnosis.claims or diagnosis.remainder.changing or not noise.remembers:
        return diagnosis
    takes_all = float(noise.factor.max()) <= FLOOR.ratio and found.next_gain < LAW_VERDICT.each
    if not takes_all or found.evidence <= found.without_memory + LAW_VERDICT.memory:
        return diagnosis
    made = replace(diagnosis, verdict="wander", location=())
    made = replace(made, remainder=replace(made.remainder, location=(), hints=()))
    return hinted(made, f"{TAKEN_FOR_NOISE}: {noise.summary()}")


def _of_one_axis(diagnosis: DiagnosisResult, found: Found) -> DiagnosisResult:
    """A walk of one axis of a triad, many times larger than another's, may in few poses be what was left out of it."""
    above, enough, channels = found.noise.times_the_floor(found.problem), enough_poses(), found.problem.channels
    worst, least = int(np.argmax(above)), int(np.argmin(above))
    alone = above[worst] >= LAW_VERDICT.far_alone * max(float(above[least]), 1.0)
    if found.problem.n >= enough or not alone:
        return diagnosis
    words = (
        f"{channels[worst]} scatters {above[worst]:.0f} times more than it repeats, and {channels[least]} "
        f"{max(float(above[least]), 1.0):.1f} times: the zero offset of one axis wanders, or something that acts on it "
        f"was left out; record {enough} poses or more, at temperatures that are not in order"
    )
    return hinted(replace(diagnosis, verdict="not_testable", claims=()), words)


def _undecided_angles(diagnosis: DiagnosisResult, found: Found) -> DiagnosisResult:
    """Errors of the set angles that take much in few poses may be a law of the angles, if no bench explains them."""
    problem, noise = found.problem, found.noise
    taken = float(np.sum((problem.residual / problem.floor) ** 2)) - problem.residual.size
    enough = enough_poses()
    if not may_hide_a_law(noise, problem.n) or taken < LAW_VERDICT.hidden:
        return diagnosis
    words = (
        f"what is left is taken for errors of the set angles: {in_words(noise.jitter)}; in {problem.n} poses these "
        f"cannot be distinguished from something that the angles follow: record {enough} poses or more, or each pose "
        "several times"
    )
    return instead(replace(diagnosis, verdict="not_testable"), words)


def _far_above_floor(diagnosis: DiagnosisResult, found: Found) -> DiagnosisResult:
    """Means that scatter far more than their rows allow are no "nothing", whatever that scatter is taken for."""
    problem, factor = found.problem, found.noise.factor
    far = leaves_most(found) and float(factor.max()) > LAW_VERDICT.most_left  # not for the errors of the angles alone
    if not far or diagnosis.verdict != "nothing_left_out":
        return diagnosis
    worst, enough = int(np.argmax(factor)), enough_poses()
    channel, above = problem.channels[worst], factor[worst]
    if problem.n >= enough:
        words = f"{channel} scatters {above:.1f} times more than it repeats"
        return hinted(replace(diagnosis, verdict="unknown"), words)
    words = (
        f"{channel} scatters {above:.1f} times more than it repeats: in {problem.n} poses this cannot be distinguished "
        f"from something that the angles follow; record {enough} poses or more, or each pose several times"
    )
    return hinted(replace(diagnosis, verdict="not_testable"), words)


def _undecided_memory(diagnosis: DiagnosisResult, found: Found) -> DiagnosisResult:
    """Scatter that is correlated over so many poses that there are few independent ones may be something slow."""
    problem, noise = found.problem, diagnosis.noise
    names = ("memory_evidence", "memory_poses")
    known = zip(problem.channels, problem.residual, problem.floor, *(noise.get(n, ()) for n in names), strict=False)
    for channel, residual, floor, gain, poses in known:
        if gain <= MEMORY.found or poses == RANDOM_WALK or problem.n >= 2 * LAW_VERDICT.independent * poses:
            continue
        above = float(np.sqrt(np.sum((residual / floor) ** 2) / problem.n))
        if above > LAW_VERDICT.far_above:
            words = (
                f"{channel} scatters {above:.1f} times more than it repeats, correlated over {poses:.2g} poses: in "
                f"{problem.n} poses such noise cannot be distinguished from something slow, as what follows time or "
                f"temperature is; record {round(2 * LAW_VERDICT.independent * poses)} poses or more, at temperatures "
                "that are not in order"
            )
            return hinted(replace(diagnosis, verdict="not_testable"), words)
    return diagnosis
