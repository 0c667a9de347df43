"""What a diagnosis says in plain words: the sentences that the page and the terminal share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from highside.diagnosis.core.result import Claim, DiagnosisResult, Fit, Location
from highside.diagnosis.core.unexplained import TAKEN_FOR_NOISE
from highside.physics.covariates import COVARIATES
from highside.physics.effect import Stage
from highside.physics.effects import all_effects, title_of
from highside.physics.law import Law
from highside.report.parameter_names import parameter_name
from highside.words import _, from_to, language, said_later, told

VERDICTS = {
    "nothing_left_out": said_later("Nothing was left out: the simulation explains this recording to within its noise."),
    "named": said_later("The simulation leaves out"),
    "named_plus": said_later("The simulation leaves out, and something more beside it"),
    "law": said_later("The simulation omits something that no effect of the library explains; found as a law"),
    "partial": said_later("Something was left out that the library does not fully explain; no name is given."),
    "unknown": said_later("Something was left out that the library has no name for."),
    "wander": said_later("The zero offsets follow a random walk; slow effects cannot be distinguished from it."),
    "implausible_fit": said_later(
        "The only explanation found has parameters that are not plausible; no name is given."
    ),
    "not_testable": said_later("This recording cannot show what was to be tested."),
    "bad_data": said_later("The data are not what they claim to be; physics was not tested."),
}
CORRELATED = said_later("What is left is correlated noise; slow effects cannot be distinguished from it.")
CORRELATED_NAME = said_later("correlated noise")
"""What `wander` is called where the noise that was learned is no random walk alone."""
VERDICT_NAMES = {
    "nothing_left_out": said_later("nothing left out"),
    "named": said_later("named"),
    "named_plus": said_later("named, and more"),
    "law": said_later("law"),
    "partial": said_later("partial"),
    "unknown": said_later("unknown"),
    "wander": said_later("random walk"),
    "implausible_fit": said_later("not plausible"),
    "not_testable": said_later("not testable"),
    "bad_data": said_later("bad data"),
}
"""The same in a word or two, for the badge."""
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
    "tf_ref_deg": said_later("toolface, deg"),
    "inc_ref_deg": said_later("inclination, deg"),
    "temp_c": said_later("temperature, C"),
    "t_s": said_later("time, s"),
    "direction": said_later("direction of approach"),
    "vibration_rms_g": said_later("vibration, g rms"),
    "reading_g": said_later("reading, g"),
    "rotor_rate_dps": said_later("rate of rotation, deg/s"),
    "gravity_direction": said_later("direction of gravity (drawn over inclination, deg)"),
}
SIDES = {
    Stage.POSE: said_later("the bench"),
    Stage.GRAVITY: said_later("the bench"),
    Stage.MOUNTING: said_later("the mounting"),
    Stage.KINEMATIC: said_later("where the triad sits"),
    Stage.TIMING: said_later("the timing"),
    Stage.GYRO: said_later("the gyros"),
}
THE_SENSOR = said_later("the sensor")
"""Who is to blame for what acts at a stage; the sensor for the others."""


def _shape_of(claim: Claim) -> str:
    """The shape of a law without a formula."""
    period = period_s(claim)
    return _("a curve") if period is None else _("a sine of %(period)s s", period=f"{period:.4g}")


def period_s(claim: Claim) -> float | None:
    """The period of a law that is a wave of time, s; None of every other claim."""
    axes = () if claim.law is None else Law.from_dict(claim.law).axes
    if len(axes) != 1 or axes[0].covariate != "time" or axes[0].functions[0].kind not in ("sine", "cosine_of"):
        return None
    return axes[0].functions[0].numbers[0]


def effect_name(effect_id: str) -> str:
    """The title of an effect in the reader's language; of what is no effect of the library, its id."""
    return _(title_of(effect_id))


def effect_within(effect_id: str) -> str:
    """The same within a sentence."""
    return within_sentence(effect_name(effect_id))


def within_sentence(title: str, *, first: bool = False) -> str:
    """A title within a sentence: in small letters, which German has not; `first`: but for names later in it."""
    if language() == "de":
        return title
    return title[:1].lower() + title[1:] if first or language() != "en" else title.lower()


def verdict_name(diagnosis: DiagnosisResult) -> str:
    """The verdict in a word or two."""
    return _(CORRELATED_NAME) if _is_correlated(diagnosis) else _(VERDICT_NAMES[diagnosis.verdict])


def _is_correlated(diagnosis: DiagnosisResult) -> bool:
    hints = diagnosis.remainder.hints
    return diagnosis.verdict == "wander" and any(one.startswith(TAKEN_FOR_NOISE) for one in hints)


def verdict_words(diagnosis: DiagnosisResult) -> str:
    """The verdict as a sentence. Where |g| alone is known, and beside another simulation, "nothing" holds down to what
    would have shown: the sizes."""
    moving = diagnosis.noise.get("hidden_motion", [])
    if diagnosis.verdict == "nothing_left_out" and moving:
        octaves = moving[0]["octaves"]
        return _(
            "No effect was found. A motion that the simulation lacks would not show where each octave of it, from"
            " %(low)s to %(high)s Hz, has less than %(what)s, nor where it is slower.",
            low=f"{octaves[0]['from_hz']:.2g}",
            high=f"{octaves[-1]['to_hz']:.2g}",
            what=_(" and ").join(_hidden(one) for one in moving),
        )
    if _is_correlated(diagnosis):
        return _(CORRELATED)
    if diagnosis.verdict in UNNAMED and diagnosis.fit is not None:
        size = what_is_left(diagnosis.fit, explained=diagnosis.verdict == "implausible_fit")
        return f"{_(VERDICTS[diagnosis.verdict])} {size}".rstrip()
    effects = all_effects()
    hidden = {n: s for n, s in diagnosis.minimum_detectable.items() if n in effects and effects[n].slow}
    if diagnosis.verdict != "nothing_left_out" or "repeats_g" not in diagnosis.noise or not hidden:
        return _(VERDICTS[diagnosis.verdict])
    sizes = ", ".join(f"{effect_within(name)} {quantity(size.value, size.unit)}" for name, size in hidden.items())
    return _("No effect was found. What is smaller than this would not show: %(sizes)s.", sizes=sizes)


def what_is_left(fit: Fit, *, explained: bool = False) -> str:
    """How large a misfit without a name is, as a sentence that gives the noise too; nothing where that is not known.
    `explained`: something would explain it."""
    noise = fit.noise_floor if fit.row_noise is None else fit.row_noise
    if not (math.isfinite(fit.rmse_before) and noise > 0.0):
        return ""
    beyond = math.sqrt(max(fit.rmse_before**2 - noise**2, 0.0))
    if beyond < HARDLY * noise:
        return _(
            "It is less than %(share)s of the noise of a reading, which is %(noise)s.",
            share=f"{HARDLY:g}",
            noise=shown(noise, fit.unit),
        )
    sizes = {"size": shown(beyond, fit.unit), "noise": shown(noise, fit.unit)}
    if explained:
        return _("The misfit is %(size)s rms beyond the noise of a reading, which is %(noise)s.", **sizes)
    return _("It is %(size)s rms beyond the noise of a reading, which is %(noise)s.", **sizes)


def _hidden(motion: Mapping[str, Any]) -> str:
    """Between which sizes, by the octave, a motion does not show."""
    sizes = sorted(one["rms"] for one in motion["octaves"])
    least, most = (quantity(size, motion["unit"]) for size in (sizes[0], sizes[-1]))
    channels = ", ".join(motion["channels"])
    return _("%(low)s to %(high)s rms, by the octave, of %(channels)s", low=least, high=most, channels=channels)


def axis_name(covariate: str) -> str:
    """A covariate, or a product of some, in words."""
    parts = [axis_title(part) or _covariate(part) for part in covariate.split(" x ")]
    if len(parts) == 1:
        return parts[0]
    others = _(" and ").join(part.split(",")[0].split(" (")[0] for part in parts[1:])
    return _("%(axis)s (what it does there turns with %(others)s)", axis=parts[0], others=others)


def axis_title(covariate: str) -> str:
    """A column in words with its unit; empty for one that has none."""
    known = AXIS_NAMES.get(covariate)
    return _(known) if known else ""


def _covariate(name: str) -> str:
    """A covariate of laws with its unit, or the name as it is."""
    known = COVARIATES.get(name)
    return name if known is None else f"{told(known.title)}, {known.unit}".rstrip(", ")


UNNAMED = ("unknown", "partial", "implausible_fit")
"""verdicts whose sentence gives the size of what has no name"""
HARDLY = 0.3
"""Share of the noise below which a misfit beside it is not told to a digit: it then adds 4 % to the rms."""
OPEN = 4.0
"""Standard deviations in an interval of 95 %."""
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
    alike = _("No other known effect does as well.")
    if others:
        alike = _("Cannot be distinguished here from: %(others)s.", others=", ".join(others))
    if not others and claim.rivals_ruled_out:
        rival = claim.rivals_ruled_out[0]
        loses = {"rival": rival.effect, "bic": f"{rival.delta_bic:.0f}"}
        alike += " " + _("The nearest rival, %(rival)s, loses by %(bic)s in BIC (beyond 10 is decisive).", **loses)
    chance = (
        _("By chance in fewer than one of 1e12 recordings.")
        if claim.p_familywise < 1e-12
        else _("By chance in %(share)s of recordings.", share=f"{claim.p_familywise:.1e}")
    )
    return f"{chance} {alike}"


def sizes(claim: Claim, *, named: bool = False) -> str:
    """Parameters with their 95 % intervals; shapes without. Of a law its formula, or how large its curve is. `named`:
    parameters in words, not by their names in formulas and files."""
    words = []
    if claim.curve is not None and not claim.parameters:
        unit = "rad/s" if claim.place.startswith("gyro") else "g" if not claim.place.startswith("channel") else ""
        size, std, what = claim.rms, claim.rms_std or 0.0, " " + _("rms beyond what offset and scale absorb")
        if size is None:
            size, std = max(zip(claim.curve.value, claim.curve.std, strict=True), key=lambda pair: abs(pair[0]))
            unit, what = claim.curve.unit, " " + _("at its largest")
        factor, unit = scale_of(max(abs(size), std), unit)
        low_high = f" (+-{rounded(2 * factor * std, factor * std)})" if std > 0 else ""
        number = f"{rounded(factor * size, factor * std)} {unit}".rstrip()
        return f"{number}{low_high}{what}: {claim.formula or _shape_of(claim)}"
    for name, p in claim.parameters.items():
        factor, unit = scale_of(max(abs(p.value), p.std), p.unit)
        # what a magnitude leaves open is wider than any noise: digits below a hundredth of it say nothing
        error = max(p.std, (p.high - p.low) / OPEN) if p.std > 0 else p.std
        value, low, high = (rounded(factor * v, factor * error) for v in (p.value, p.low, p.high))
        interval = f" ({from_to(low, high)})" if p.std > 0 else ""
        simulated = ""
        if name in claim.simulated:
            known = f"{rounded(factor * claim.simulated[name], factor * p.std)} {unit}".rstrip()
            simulated = ", " + _("in the simulation %(size)s", size=known)
        called = parameter_name(claim.effect, name) if named else name
        words.append(f"{called} = {value} {unit}".rstrip() + interval + simulated)
    return (", " if not claim.simulated else "; ").join(words)


def ranges(place: Location) -> str:
    """Where along its covariate a mismatch is largest, with the digits that say something."""

    def written(value: float) -> str:
        return f"{float(f'{value:.4g}'):g}"

    return "; ".join(
        written(low) if low == high else from_to(written(low), written(high)) for low, high in place.intervals
    )


def along(place: Location) -> str:
    """Channels, and what the mismatch follows."""
    harmonic = ", " + _("harmonic %(order)s", order=place.harmonic) if place.harmonic else ""
    channels, axis = ", ".join(place.channels), axis_name(place.covariate)
    return _("%(channels)s along %(axis)s", channels=channels, axis=axis) + harmonic


def where(places: Sequence[Location]) -> str:
    """Channels, what the mismatch follows and where along it."""
    parts = []
    for place in places:
        largest = ranges(place)
        parts.append(along(place) + (": " + _("largest at %(range)s", range=largest) if largest else ""))
    return ". ".join(parts)


def proof(fit: Fit, noise: Mapping[str, Any] | None = None) -> str:
    """Misfit before and after, in sample and on readings that the fit had not been given; one figure each where nothing
    was taken in. `noise` as in a diagnosis says what scatters besides the sensor."""
    # each sentence in one unit of averaging: rows with the noise of a row, held-out means with that of such a mean
    row = fit.noise_floor if fit.row_noise is None else fit.row_noise
    changed = fit.rmse_after != fit.rmse_before
    sizes = {
        "misfit": _before_after(fit.rmse_before, fit.rmse_after, fit.unit, changed=changed),
        "noise": shown(row, fit.unit) + _of_the_bench(noise or {}),
    }
    words = (
        _("Misfit %(misfit)s; noise %(noise)s.", **sizes)
        if fit.row_noise is None
        else _("Misfit of one row %(misfit)s; noise of one row %(noise)s.", **sizes)
    )
    if None not in (fit.heldout_rmse_before, fit.heldout_rmse_after, fit.heldout_gain_low, fit.heldout_gain_high):
        assert fit.heldout_rmse_before is not None and fit.heldout_rmse_after is not None
        assert fit.heldout_gain_low is not None and fit.heldout_gain_high is not None
        size = shown(fit.noise_floor, fit.unit)
        floor = "" if fit.row_noise is None else ", " + _("noise %(size)s of such means", size=size)
        held = _before_after(fit.heldout_rmse_before, fit.heldout_rmse_after, fit.unit, changed=changed)
        how = told(fit.how_held_out.partition("; gain")[0], "diagnosis")
        gain = {"low": _percent(fit.heldout_gain_low), "high": _percent(fit.heldout_gain_high)}
        removed = "; " + _("%(low)s to %(high)s of the mean square removed", **gain) if changed else ""
        held += f"{floor}{removed} ({how})"
        words += " " + _("On readings that the fit had not seen: %(misfit)s.", misfit=held)
    return words


def _before_after(before: float, after: float, unit: str, *, changed: bool) -> str:
    both = {"before": shown(before, unit), "after": shown(after, unit)}
    return _("%(before)s before, %(after)s after", **both) if changed else both["after"]


def _of_the_bench(noise: Mapping[str, Any]) -> str:
    """By how much the angles that were set scatter, in words; empty where that was not found."""
    sizes = {
        said_later("inclination"): noise.get("bench_inclination_rad"),
        "toolface": noise.get("bench_toolface_rad"),
        said_later("the direction across the plane of the tilt"): noise.get("bench_across_rad"),
    }
    found = [
        _("%(size)s in %(angle)s", size=quantity(size, "rad"), angle=_(angle)) for angle, size in sizes.items() if size
    ]
    if not found:
        return ""
    both = _(" and ").join(found)
    return " " + _("of the sensor; the set angles scatter by %(sizes)s, which the misfit contains", sizes=both)


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
        found = {_(SIDES.get(stage, THE_SENSOR)) for stage in stages}
        side = found.pop()
        if found:
            both = _(" or ").join(sorted({side, *found}))
            side = _("%(sides)s, which cannot be distinguished here", sides=both)
        sides.setdefault(side, []).append(name(claim))
    if len(diagnosis.claims) == 1:
        # which claim it is stands above
        return next(iter(sides))
    return "; ".join(f"{side} ({', '.join(names)})" for side, names in sides.items())


def tested(diagnosis: DiagnosisResult) -> str:
    """What the answer rests on, as a sentence after a blank."""
    covered = diagnosis.coverage
    if covered is None:
        return ""
    effects = {"tested": covered.effects_tested, "known": covered.effects_known}
    words = " " + _("Tested: %(tested)s of %(known)s known effects", **effects)
    used, expected = covered.intervals_used, covered.intervals_expected
    if used is not None and expected is not None and expected > used:
        words += ", " + _("on %(used)s still intervals of about %(expected)s", used=used, expected=expected)
    elif used is not None:
        words += ", " + _("on %(used)s still intervals", used=used)
    return f"{words}."
