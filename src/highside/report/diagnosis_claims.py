"""The claims of a diagnosis as a reader wants them: what, how large, which share of the misfit, how sure, or what else.

Named effects and laws alike: a law is named by where it acts and what it follows, in words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.physics.covariates import covariate
from highside.physics.effects import title_of
from highside.physics.places import PLACES
from highside.report.diagnosis_words import sizes

__all__ = [
    "claim_size",
    "claim_title",
    "claims_table",
    "first_sentence",
    "is_law",
    "likelihood",
    "ordered",
    "title_of_any",
]

LAW = "law"
"""What the name of a claim begins with that is no effect of the library."""
PRACTICALLY_CERTAIN, VERY_SURE, SURE = 1e-9, 1e-4, 1e-2
"""Probabilities by chance below which a claim is called so; family-wise over all that was tried. Words of this page."""
PLACE_WORDS = {
    "offset": "an offset of {}",
    "scale": "a scale factor error of {}",
    "scale_all": "a scale factor error common to all channels",
    "matrix": "a cross-coupling into {}",
    "inclination": "an error of the inclination given",
    "toolface": "an error of the toolface given",
    "timing": "an error of the time stamps",
    "level": "a lean of the bench",
    "gyro_offset": "an offset of {}",
    "gyro_scale": "a scale factor error of {}",
    "channel_offset": "an offset of {}",
    "channel_factor": "a factor of {}",
    "channel_delay": "a delay of {}",
}
"""Where a law acts (names of `physics.places`), in words."""


def is_law(claim: Claim) -> bool:
    """Whether a claim is a law without a name."""
    return claim.effect == LAW or claim.effect.startswith(f"{LAW}:")


def claim_title(claim: Claim) -> str:
    """A claim's name in words: the title of an effect, or what a law does and follows."""
    if not is_law(claim):
        return title_of(claim.effect)
    return f"Unnamed: {law_words(claim)}"


def law_words(claim: Claim) -> str:
    """What a law does and follows."""
    return _law_words(claim.place, claim.channels, claim.depends_on)


def title_of_any(name: str) -> str:
    """The title of an effect, or of a law by its id (`law:PLACE_CHANNELS_COVARIATE_x_COVARIATE`) what it does."""
    if not name.startswith(f"{LAW}:"):
        return title_of(name).lower()
    rest = name.removeprefix(f"{LAW}:")
    place = next((one for one in sorted(PLACES, key=len, reverse=True) if rest.startswith(f"{one}_")), "")
    channels, _, follows = rest.removeprefix(f"{place}_").partition("_")
    if not place or not follows:
        return name
    triad = PLACES[place].triad and len(channels) == 1
    shown = (f"{'g' if place.startswith('gyro') else 'a'}{channels}",) if triad else (channels,)
    return _law_words(place, shown, follows.split("_x_"))


def _law_words(place: str, channels: Sequence[str], depends_on: Sequence[str]) -> str:
    words = PLACE_WORDS.get(place, f"something on {place}").format(", ".join(channels))
    return f"{words} that follows {follows_words(depends_on)}" if depends_on else words


def follows_words(depends_on: Sequence[str]) -> str:
    """Covariates of a law in words."""
    return " and ".join(covariate(name).title for name in depends_on)


def claim_size(claim: Claim) -> str:
    """Size with its interval: the parameters, or from where to where the curve of a law runs and over what range."""
    if claim.curve is None or not claim.curve.value:
        return sizes(claim)
    over = "; ".join(
        f"{covariate(name).title} {low:.3g} to {high:.3g} {covariate(name).unit}".rstrip()
        for name, (low, high) in zip(claim.depends_on, claim.range, strict=False)
    )
    return sizes(claim) + (f", over {over}" if over else "")


def likelihood(claim: Claim) -> str:
    """How sure a claim is, in words and as the probability by chance."""
    p = claim.p_familywise
    word = (
        "practically certain"
        if p < PRACTICALLY_CERTAIN
        else "very sure"
        if p < VERY_SURE
        else "sure"
        if p < SURE
        else "probable"
    )
    chance = "less than 1 in 10^12" if p < 1e-12 else f"{p:.0e}"
    return f"{word} (by chance: {chance})" + ("; its size changes over the session" if claim.stable is False else "")


def confounded(claim: Claim) -> str:
    """What this recording cannot tell a claim apart from, or that there is nothing."""
    others = [title_of_any(name) for name in claim.equivalence_class if name != claim.effect]
    if others:
        return f"this OR {' OR '.join(others)}"
    if claim.resembles:
        return f"resembles {', '.join(title_of_any(name) for name in claim.resembles)}, which fits worse"
    return "no other known effect fits as well"


def ordered(claims: Sequence[Claim], shares: Mapping[str, float]) -> list[Claim]:
    """Claims by their share of the misfit, the largest first."""
    return sorted(claims, key=lambda claim: -_share(claim, shares))


def claims_table(claims: Sequence[Claim], shares: Mapping[str, float]) -> tuple[list[str], list[list[str]]]:
    """Headers and a row for each claim."""
    rows = [
        [claim_title(claim), claim_size(claim), _percent(_share(claim, shares)), likelihood(claim), confounded(claim)]
        for claim in ordered(claims, shares)
    ]
    return ["what", "size (95 % interval)", "share of the misfit", "how sure", "or else"], rows


def first_sentence(diagnosis: DiagnosisResult, shares: Mapping[str, float], words: str) -> str:
    """The answer in one sentence: what the simulation omits, the largest first, then what it has at another size;
    `words` where nothing is claimed."""
    if not diagnosis.claims:
        return words
    omitted: list[str] = []
    resized: list[str] = []
    for claim in ordered(diagnosis.claims, shares):
        share = _share(claim, shares)
        title = law_words(claim) if is_law(claim) else claim_title(claim)
        part = (title[0].lower() + title[1:]) + (f" ({_percent(share)} of the misfit)" if share > 0 else "")
        (resized if claim.simulated else omitted).append(part)
    does = [f"omits {_listed(omitted)}"] if omitted else []
    does += [f"has {_listed(resized)} at another size"] if resized else []
    rest = {
        "named_plus": ", and something more",
        "implausible_fit": ", at sizes that are not plausible",
    }.get(diagnosis.verdict, "")
    return f"The simulation {', and '.join(does)}{rest}."


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def covariate_label(claim: Claim) -> str:
    """The axis along which a law is drawn."""
    if not claim.depends_on:
        return ""
    one = covariate(claim.depends_on[0])
    return f"{one.title}, {one.unit}".rstrip(", ")


def _share(claim: Claim, shares: Mapping[str, float]) -> float:
    return claim.share if claim.share is not None else shares.get(claim.effect, 0.0)


def _percent(share: float) -> str:
    if share <= 0.0:
        return "-"
    return "less than 1 %" if share < 0.005 else f"{min(share, 1.0):.0%}"
