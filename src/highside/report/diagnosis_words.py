"""What a diagnosis says in plain words: the sentences that the page and the terminal share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from highside.diagnosis.core.result import Claim, DiagnosisResult, Fit, Location
from highside.physics.covariates import COVARIATES
from highside.physics.effect import Stage
from highside.physics.effects import all_effects, title_of

VERDICTS = {
    "nothing_left_out": "Nothing was left out: the simulation explains this recording to within its noise.",
    "named": "The simulation leaves out",
    "named_plus": "The simulation leaves out (with a small remainder beyond it)",
    "law": "The simulation omits something that no effect of the library explains; found as a law",
    "partial": "Something was left out that the library does not fully explain; no name is given.",
    "unknown": "Something was left out that the library has no name for.",
    "wander": "The zero offsets follow a random walk; slow effects cannot be distinguished from it.",
    "implausible_fit": "The only explanation found has parameters that are not plausible; no name is given.",
    "not_testable": "This recording cannot show what was to be tested.",
    "bad_data": "The data are not what they claim to be; physics was not tested.",
}
KINDS = {
    "nothing_left_out": "good",
    "named": "found",
    "named_plus": "found",
    "law": "found",
    "bad_data": "bad",
    "implausible_fit": "bad",
}
"""Colour of a verdict; the others are open questions."""
AXIS_NAMES = {
    "tf_ref_deg": "toolface, deg",
    "inc_ref_deg": "inclination, deg",
    "temp_c": "temperature, C",
    "t_s": "time, s",
    "direction": "direction of approach",
    "vibration_rms_g": "vibration, g rms",
    "reading_g": "reading, g",
    "rotor_rate_dps": "rate of rotation, deg/s",
    "gravity_direction": "direction of gravity (drawn over inclination, deg)",
}
SIDES = {
    Stage.POSE: "the bench",
    Stage.GRAVITY: "the bench",
    Stage.MOUNTING: "the mounting",
    Stage.KINEMATIC: "where the triad sits",
    Stage.TIMING: "the timing",
    Stage.GYRO: "the gyros",
}
"""Who is to blame for what acts at a stage; the sensor for the others."""


def verdict_words(diagnosis: DiagnosisResult) -> str:
    """The verdict as a sentence. Where |g| alone is known, and beside another simulation, "nothing" holds down to what
    would have shown: the sizes."""
    moving = diagnosis.noise.get("hidden_motion", [])
    if diagnosis.verdict == "nothing_left_out" and moving:
        octaves = moving[0]["octaves"]
        return (
            "No effect was found. A motion that the simulation lacks would not show where each octave of it, from "
            f"{octaves[0]['from_hz']:.2g} to {octaves[-1]['to_hz']:.2g} Hz, has less than "
            f"{' and '.join(_hidden(one) for one in moving)}, nor where it is slower."
        )
    effects = all_effects()
    hidden = {n: s for n, s in diagnosis.minimum_detectable.items() if n in effects and effects[n].slow}
    if diagnosis.verdict != "nothing_left_out" or "repeats_g" not in diagnosis.noise or not hidden:
        return VERDICTS[diagnosis.verdict]
    sizes = ", ".join(f"{title_of(name).lower()} {quantity(size.value, size.unit)}" for name, size in hidden.items())
    return f"No effect was found. What is smaller than this would not show: {sizes}."


def _hidden(motion: Mapping[str, Any]) -> str:
    """Between which sizes, by the octave, a motion does not show."""
    sizes = sorted(one["rms"] for one in motion["octaves"])
    least, most = (quantity(size, motion["unit"]) for size in (sizes[0], sizes[-1]))
    return f"{least} to {most} rms, by the octave, of {', '.join(motion['channels'])}"


def claimed(diagnosis: DiagnosisResult) -> str:
    """Verdict and claims as a sentence: what the simulation leaves out, and what it has at another size."""
    left_out = ", ".join(claim.effect for claim in diagnosis.claims if not claim.simulated)
    resized = ", ".join(claim.effect for claim in diagnosis.claims if claim.simulated)
    words = verdict_words(diagnosis)
    if not resized or diagnosis.verdict not in ("named", "named_plus", "law"):
        names = ", ".join(claim.effect for claim in diagnosis.claims)
        return f"{words}: {names}" if names else words
    other = f"at another size than the simulation has it: {resized}"
    if left_out:
        return f"{words}: {left_out}; {other}"
    beyond = " (with a small remainder beyond it)" if diagnosis.verdict == "named_plus" else ""
    return f"{other[0].upper()}{other[1:]}{beyond}"


def axis_name(covariate: str) -> str:
    """A covariate, or a product of some, in words."""
    parts = [AXIS_NAMES.get(part) or _covariate(part) for part in covariate.split(" x ")]
    if len(parts) == 1:
        return parts[0]
    return (
        f"{parts[0]} (what it does there turns with {' and '.join(p.split(',')[0].split(' (')[0] for p in parts[1:])})"
    )


def _covariate(name: str) -> str:
    """A covariate of laws with its unit, or the name as it is."""
    known = COVARIATES.get(name)
    return name if known is None else f"{known.title}, {known.unit}".rstrip(", ")


PREFIXES = ((1.0, ""), (1e3, "m"), (1e6, "u"), (1e9, "n"))
PREFIXED = ("g", "m", "s", "rad")
"""units that are written in thousandths and millionths: these, and what is per something of them"""


def scale_of(size: float, unit: str) -> tuple[float, str]:
    """Factor and unit by which a size is a number between 1 and 1000, if the unit has such parts."""
    if unit.split("/")[0] not in PREFIXED or not size > 0.0 or not math.isfinite(size):
        return 1.0, "" if unit == "1" else unit
    factor, prefix = next((entry for entry in PREFIXES if size * entry[0] >= 0.9995), PREFIXES[-1])
    return factor, prefix + unit


def rounded(value: float, error: float) -> str:
    """A value with two digits of its error."""
    if not error > 0.0 or not math.isfinite(error):
        return f"{value:.3g}"
    places = 1 - math.floor(math.log10(error))
    return f"{value:.{min(max(places, 0), 9)}f}"


def quantity(value: float, unit: str) -> str:
    """A size with its unit, readable."""
    factor, shown_unit = scale_of(abs(value), unit)
    return f"{factor * value:.3g} {shown_unit}".rstrip()


def shown(value: float, unit: str) -> str:
    """A misfit with its unit, readable."""
    if unit == "sigma":
        return f"{value:.2f} sigma"
    factor, shown_unit = scale_of(abs(value), unit)
    return f"{factor * value:.4g} {shown_unit}"


def sureness(claim: Claim) -> str:
    """How sure a claim is, and from what it cannot be distinguished."""
    others = [name for name in claim.equivalence_class if name != claim.effect]
    alike = "No other known effect does as well."
    if others:
        alike = f"Cannot be distinguished here from: {', '.join(others)}."
    if not others and claim.rivals_ruled_out:
        rival = claim.rivals_ruled_out[0]
        alike += f" The nearest rival, {rival.effect}, loses by {rival.delta_bic:.0f} in BIC (beyond 10 is decisive)."
    p = (
        "in fewer than one of 1e12 recordings"
        if claim.p_familywise < 1e-12
        else f"in {claim.p_familywise:.1e} of recordings"
    )
    return f"By chance {p}. {alike}"


def sizes(claim: Claim) -> str:
    """Parameters with their 95 % intervals; shapes without. Of a law its formula, or how large its curve is."""
    words = []
    if claim.curve is not None and not claim.parameters:
        unit = "rad/s" if claim.place.startswith("gyro") else "g" if not claim.place.startswith("channel") else ""
        size, std, what = claim.rms, claim.rms_std or 0.0, " rms beside offset, scale and what else is free"
        if size is None:
            size, std = max(zip(claim.curve.value, claim.curve.std, strict=True), key=lambda pair: abs(pair[0]))
            unit, what = claim.curve.unit, " at its largest"
        factor, unit = scale_of(max(abs(size), std), unit)
        low_high = f" (+-{rounded(2 * factor * std, factor * std)})" if std > 0 else ""
        return f"{claim.formula or 'a curve'}: {rounded(factor * size, factor * std)} {unit}".rstrip() + what + low_high
    for name, p in claim.parameters.items():
        factor, unit = scale_of(max(abs(p.value), p.std), p.unit)
        value, low, high = (rounded(factor * v, factor * p.std) for v in (p.value, p.low, p.high))
        interval = f" ({low} to {high})" if p.std > 0 else ""
        simulated = ""
        if name in claim.simulated:
            simulated = f", in the simulation {rounded(factor * claim.simulated[name], factor * p.std)} {unit}".rstrip()
        words.append(f"{name} = {value} {unit}".rstrip() + interval + simulated)
    return (", " if not claim.simulated else "; ").join(words)


def ranges(place: Location) -> str:
    """Where along its covariate a mismatch is largest, with the digits that say something."""

    def written(value: float) -> str:
        return f"{float(f'{value:.4g}'):g}"

    return "; ".join(
        written(low) if low == high else f"{written(low)} to {written(high)}" for low, high in place.intervals
    )


def where(places: Sequence[Location]) -> str:
    """Channels, what the mismatch follows and where along it."""
    parts = []
    for place in places:
        harmonic = f", harmonic {place.harmonic}" if place.harmonic else ""
        axis = axis_name(place.covariate)
        parts.append(
            f"{', '.join(place.channels)} along {axis}{harmonic}"
            + (f": largest at {where}" if (where := ranges(place)) else "")
        )
    return ". ".join(parts)


def proof(fit: Fit) -> str:
    """Misfit before and after, in sample and on readings that the fit had not been given."""
    # each sentence in one unit of averaging: rows with the noise of a row, held-out means with that of such a mean
    row = fit.noise_floor if fit.row_noise is None else fit.row_noise
    one = "" if fit.row_noise is None else " of one row"
    words = (
        f"misfit{one} {shown(fit.rmse_before, fit.unit)} before, {shown(fit.rmse_after, fit.unit)} after; "
        f"noise{one} {shown(row, fit.unit)}."
    )
    if None not in (fit.heldout_rmse_before, fit.heldout_rmse_after, fit.heldout_gain_low, fit.heldout_gain_high):
        assert fit.heldout_rmse_before is not None and fit.heldout_rmse_after is not None
        assert fit.heldout_gain_low is not None and fit.heldout_gain_high is not None
        floor = "" if fit.row_noise is None else f", noise {shown(fit.noise_floor, fit.unit)} of such means"
        words += (
            f" On readings that the fit had not seen: {shown(fit.heldout_rmse_before, fit.unit)} before, "
            f"{shown(fit.heldout_rmse_after, fit.unit)} after{floor}; {_percent(fit.heldout_gain_low)} to "
            f"{_percent(fit.heldout_gain_high)} of the mean square removed ({fit.how_held_out})."
        )
    return words[0].upper() + words[1:]


def _percent(share: float) -> str:
    return f"{share:.0%}" if share < 0.985 else f"{share:.2%}"


def blame(diagnosis: DiagnosisResult, name: Callable[[Claim], str] = lambda claim: claim.effect) -> str:
    """Whether the bench or the sensor is to blame, by the stages of each claim's class; empty without claims.

    Beside another program's prediction of any channel that is not considered.
    """
    if "alignment" in diagnosis.noise:
        return ""
    effects = all_effects()
    sides: dict[str, list[str]] = {}
    for claim in diagnosis.claims:
        stages = {effects[e].stage for e in claim.equivalence_class if e in effects} or {Stage(claim.stage)}
        found = {SIDES.get(stage, "the sensor") for stage in stages}
        side = found.pop() if len(found) == 1 else f"{' or '.join(sorted(found))}, which cannot be distinguished here"
        sides.setdefault(side, []).append(name(claim))
    return "; ".join(f"{side} ({', '.join(names)})" for side, names in sides.items())


def tested(diagnosis: DiagnosisResult) -> str:
    """What the answer rests on, as a sentence after a blank."""
    covered = diagnosis.coverage
    if covered is None:
        return ""
    words = f" Tested: {covered.effects_tested} of {covered.effects_known} known effects"
    if covered.intervals_used is not None:
        words += f", on {covered.intervals_used} still intervals"
        if covered.intervals_expected is not None and covered.intervals_expected > covered.intervals_used:
            words += f" of about {covered.intervals_expected}"
    return f"{words}."
