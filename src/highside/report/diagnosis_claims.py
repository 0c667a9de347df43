"""The claims of a diagnosis as a reader wants them: what, how large, which share of the misfit, how sure, or what else.

Named effects and laws alike: a law is named by where it acts and what it follows, in words.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.physics.covariates import covariate, lag_of, parted
from highside.physics.law import AGAIN, Law
from highside.physics.places import PLACES
from highside.report.diagnosis_words import effect_name, period_s, sizes, within_sentence
from highside.words import _, from_to, said_later, told

__all__ = [
    "claim_size",
    "claim_title",
    "claims_table",
    "first_sentence",
    "is_law",
    "likelihood",
    "ordered",
    "shares_of_fit",
    "title_of_any",
]

LAW = "law"
"""What the name of a claim begins with that is no effect of the library."""
PRACTICALLY_CERTAIN, VERY_SURE, SURE = 1e-9, 1e-4, 1e-2
"""Probabilities by chance below which a claim is called so; family-wise over all that was tried. Words of this page."""
SHOWN = 3
"""Claims, at most, that the first sentence lists."""
PART_SAID = 0.05
"""Share of the misfit from which the first sentence says that it is no claim's alone, or that no claim explains it.
Words of this page."""
NOTHING_ELSE = frozenset({"named", "law"})
"""Verdicts that say that the claims explain the recording."""
ALTERNATIVES = 4
"""Covariates, at most, that are listed of the laws of one place that cannot be told apart."""
PLACE_WORDS = {
    "offset": said_later("an offset of {}"),
    "scale": said_later("a scale factor error of {}"),
    "scale_all": said_later("a scale factor error common to all channels"),
    "matrix": said_later("a cross-coupling into {}"),
    "inclination": said_later("an error of the reference inclination"),
    "toolface": said_later("an error of the reference toolface"),
    "timing": said_later("an error of the time stamps"),
    "level": said_later("a tilt of the bench"),
    "gyro_offset": "an offset of {}",
    "gyro_scale": "a scale factor error of {}",
    "channel_offset": "an offset of {}",
    "channel_factor": said_later("a factor of {}"),
    "channel_delay": said_later("a delay of {}"),
}
"""Where a law acts (names of `physics.places`), in words."""


def is_law(claim: Claim) -> bool:
    """Whether a claim is a law without a name."""
    return claim.effect == LAW or claim.effect.startswith(f"{LAW}:")


def claim_title(claim: Claim) -> str:
    """A claim's name in words: the title of an effect, or what a law does and follows."""
    if not is_law(claim):
        return effect_name(claim.effect)
    return _("Unnamed: %(law)s", law=law_words(claim))


def law_words(claim: Claim) -> str:
    """What a law does and follows, and since when if it set in midway."""
    law, any_lag = None if claim.law is None else Law.from_dict(claim.law), _of_any_lag(claim)
    if (period := period_s(claim)) is not None:
        what = _place_words(claim.place, claim.channels)
        return _("%(law)s that oscillates with a period of %(period)s s", law=what, period=f"{period:.4g}")
    if law is None or law.sets_in_s is None:
        return _law_words(claim.place, claim.channels, claim.depends_on, any_lag)
    words = _law_words(claim.place, claim.channels, law.lasting().depends_on, any_lag)
    return _("%(law)s, from %(at)s s on", law=words, at=f"{law.sets_in_s:.4g}")


def title_of_any(name: str) -> str:
    """The title of an effect, or of a law by its id (`law:PLACE_CHANNELS_COVARIATE_x_COVARIATE`) what it does."""
    parts = _of_law(name)
    if parts is None:
        return name if name.startswith(f"{LAW}:") else within_sentence(effect_name(name))
    words, follows = parts
    return _("%(law)s that follows %(what)s", law=words, what=follows_words(follows))


def _parts_of_law(name: str) -> tuple[str, str, tuple[str, ...]] | None:
    """Of the id of a law its place, its channels and what it follows; None: it is not the id of a law."""
    rest = name.removeprefix(f"{LAW}:").partition(AGAIN)[0]
    place = next((one for one in sorted(PLACES, key=len, reverse=True) if rest.startswith(f"{one}_")), "")
    channels, _, follows = rest.removeprefix(f"{place}_").partition("_")
    if not name.startswith(f"{LAW}:") or not place or not follows:
        return None
    return place, channels, tuple(parted(follows))


def _of_law(name: str) -> tuple[str, tuple[str, ...]] | None:
    """Of the id of a law, where it acts, in words, and what it follows; None: it is not the id of a law."""
    parts = _parts_of_law(name)
    if parts is None:
        return None
    place, channels, follows = parts
    letter = "g" if place.startswith("gyro") else "a"
    shown = [letter + axis for axis in channels] if PLACES[place].triad else [channels]
    return _place_words(place, shown), follows


def _place_words(place: str, channels: Sequence[str]) -> str:
    known = PLACE_WORDS.get(place)
    return _(known).format(", ".join(channels)) if known else _("something on %(place)s", place=place)


def _law_words(place: str, channels: Sequence[str], depends_on: Sequence[str], any_lag: bool = False) -> str:
    words = _place_words(place, channels)
    if not depends_on:
        return words
    return _("%(law)s that follows %(what)s", law=words, what=follows_words(depends_on, any_lag=any_lag))


def follows_words(depends_on: Sequence[str], *, any_lag: bool = False, lags: Sequence[int] = ()) -> str:
    """Covariates of a law in words; of a temperature that lags all `lags`, s, or that any lag, or none, may be it."""

    def words(name: str) -> str:
        if lag_of(name) and any_lag:
            return _("temperature (at once or with a lag)")
        if lag_of(name) and len(lags) > 1:
            return _("temperature with lags from %(low)s to %(high)s s", low=min(lags), high=max(lags))
        return told(covariate(name).title)

    return _(" and ").join(map(words, depends_on))


def _of_any_lag(claim: Claim) -> bool:
    """Whether a law of a temperature that lags cannot be told from the same of the temperature itself."""
    if not any(map(lag_of, claim.depends_on)):
        return False
    own = _parts_of_law(claim.effect)
    at_once = {"temp" if lag_of(name) else name for name in claim.depends_on}
    parts = filter(None, map(_parts_of_law, others_of(claim)))
    return own is not None and any(one[:2] == own[:2] and set(one[2]) == at_once for one in parts)


def claim_size(claim: Claim, *, named: bool = False) -> str:
    """Size with its interval: the parameters, or from where to where the curve of a law runs and over what range."""
    if claim.curve is None or not claim.curve.value:
        return sizes(claim, named=named)
    over = "; ".join(
        f"{told(covariate(name).title)} {from_to(f'{low:.3g}', f'{high:.3g}')} {covariate(name).unit}".rstrip()
        for name, (low, high) in zip(claim.depends_on, claim.range, strict=False)
    )
    return sizes(claim, named=named) + (_(", over %(range)s", range=over) if over else "")


def likelihood(claim: Claim) -> str:
    """How sure a claim is, in words and as the probability by chance."""
    p = claim.p_familywise
    word = (
        _("practically certain")
        if p < PRACTICALLY_CERTAIN
        else _("very sure")
        if p < VERY_SURE
        else _("sure")
        if p < SURE
        else _("probable")
    )
    chance = _("less than 1 in 10^12") if p < 1e-12 else f"{p:.0e}"
    words = _("%(word)s (by chance: %(chance)s)", word=word, chance=chance)
    return words + (_("; its size changes over the session") if claim.stable is False else "")


def others_of(claim: Claim) -> list[str]:
    """Effects and laws that this recording cannot tell from a claim, by their ids."""
    return [name for name in claim.equivalence_class if name != claim.effect]


def confounded(claim: Claim) -> str:
    """What this recording cannot tell a claim apart from, or that there is nothing."""
    if others := others_of(claim):
        return _("this, or %(others)s", others=_("; or ").join(_by_place(claim, others)))
    if claim.resembles:
        names = ", ".join(title_of_any(name) for name in claim.resembles)
        return _("resembles %(names)s, which fits worse", names=names)
    return _("no other known effect fits as well")


def _by_place(claim: Claim, names: Sequence[str]) -> list[str]:
    """Effects and laws in words, laws of one place together; that of the claim itself first."""
    own = _place_words(claim.place, claim.channels) if is_law(claim) else ""
    # laws that differ in the lag of a temperature alone are one to a reader
    follow: dict[str, dict[tuple[str, ...], tuple[tuple[str, ...], list[int]]]] = {}
    named: list[str] = []
    for name in names:
        if (parts := _of_law(name)) is None:
            named.append(title_of_any(name))
            continue
        alike = tuple("" if lag_of(one) else one for one in parts[1])
        _follows, lags = follow.setdefault(parts[0], {}).setdefault(alike, (parts[1], []))
        lags += filter(None, map(lag_of, parts[1]))
    laws = []
    for words in sorted(follow, key=lambda one: one != own):
        every = [follows_words(follows, lags=lags) for follows, lags in follow[words].values()]
        listed = every[:ALTERNATIVES]
        more = len(every) - len(listed)
        shown = _(", or ").join([*listed, *([_("%(count)s more", count=more)] if more else [])])
        same = _("the same following %(what)s", what=shown)
        laws.append(same if words == own else _("%(law)s that follows %(what)s", law=words, what=shown))
    return named + laws


def ordered(claims: Sequence[Claim], shares: Mapping[str, float]) -> list[Claim]:
    """Claims by their share of the misfit, the largest first."""
    return sorted(claims, key=lambda claim: -_share(claim, shares))


def claims_table(claims: Sequence[Claim], shares: Mapping[str, float]) -> tuple[list[str], list[list[str]]]:
    """Headers and a row for each claim."""
    rows = [
        [
            claim_title(claim),
            claim_size(claim, named=True),
            _percent(_share(claim, shares)),
            likelihood(claim),
            confounded(claim),
        ]
        for claim in ordered(claims, shares)
    ]
    headers = [
        _("what"),
        _("size (95 %% interval)") % {},
        _("share of the misfit"),
        _("how sure"),
        _("not told apart from"),
    ]
    return headers, rows


def shares_of_fit(diagnosis: DiagnosisResult) -> dict[str, float]:
    """Share of the whole misfit of each claim, of the sizes that `fit` has: its share of what is explained, times how
    much that is of all beyond the noise. Empty where a claim has no share of its own."""
    fit = diagnosis.fit
    if fit is None:
        return {}
    noise = (fit.row_noise or fit.noise_floor) ** 2
    before, after = max(fit.rmse_before**2 - noise, 0.0), max(fit.rmse_after**2 - noise, 0.0)
    if not before or any(claim.share is None for claim in diagnosis.claims):
        return {}
    explained = max(1.0 - after / before, 0.0)
    return {claim.effect: explained * (claim.share or 0.0) for claim in diagnosis.claims}


def first_sentence(diagnosis: DiagnosisResult, shares: Mapping[str, float], words: str) -> str:
    """The answer in one sentence: what the simulation omits, the largest first, then what it has at another size;
    `words` where nothing is claimed."""
    if not diagnosis.claims:
        return words
    # laws of the same place and covariate are one thing to a reader, whatever their functions
    parts: dict[tuple[str, bool], list[Claim]] = {}
    for claim in ordered(diagnosis.claims, shares):
        title = law_words(claim) if is_law(claim) else claim_title(claim)
        parts.setdefault((title, bool(claim.simulated)), []).append(claim)
    explained = _explained(diagnosis.claims, shares)
    sizes = (
        [explained]
        if len(parts) == 1 < len(diagnosis.claims) and explained
        else [sum(_share(claim, shares) for claim in claims) for claims in parts.values()]
    )
    omitted: list[str] = []
    resized: list[str] = []
    # the table has them all: a sentence that lists ten is none
    shown = len(parts) if len(parts) <= SHOWN + 1 else SHOWN
    for ((title, simulated), claims), share in list(zip(parts.items(), sizes, strict=True))[:shown]:
        part = within_sentence(title, first=True)
        if any(not is_law(claim) and others_of(claim) for claim in claims):
            part += _(", or what cannot be told from it here")
        if any(is_law(claim) and _may_be_time(claim) for claim in claims):
            part += _(", or the time of the session")
        part += " " + _("(%(share)s of the misfit)", share=_percent(share)) if share > 0 else ""
        (resized if simulated else omitted).append(part)
    does = [_("omits %(what)s", what=_listed(omitted))] if omitted else []
    does += [_("has %(what)s at another size", what=_listed(resized))] if resized else []
    if shown < len(parts):
        does.append(_("%(count)s smaller things", count=len(parts) - shown))
    rest = {
        "named_plus": "" if any(map(is_law, diagnosis.claims)) else _(", and something more"),
        "implausible_fit": _(", at sizes that are not plausible"),
    }.get(diagnosis.verdict, "")
    said = _listed(does) if len(does) > 2 else _(", and ").join(does)
    sentence = _("The simulation %(does)s%(rest)s.", does=said, rest=rest)
    return sentence + _overlap(sizes, explained) + _taken_for_noise(diagnosis, explained, shares)


def _may_be_time(claim: Claim) -> bool:
    """Whether a law cannot be told from the same that follows the time in the place of something else."""
    for other in others_of(claim):
        parts = _parts_of_law(other)
        if parts is None or parts[0] != claim.place or len(parts[2]) != len(claim.depends_on):
            continue
        if set(parts[2]) - set(claim.depends_on) == {"time"}:
            return True
    return False


def _explained(claims: Sequence[Claim], shares: Mapping[str, float]) -> float:
    """Of the misfit, what all claims explain together; 0 where that is not known."""
    alone = sum(claim.share or 0.0 for claim in claims)
    return sum(_share(claim, shares) for claim in claims) / alone if alone > 0.0 else 0.0


def _overlap(sizes: Sequence[float], explained: float) -> str:
    """What is explained but in no share: where claims run alike each takes over a part of another's."""
    other = explained - sum(round(size, 2) for size in sizes)
    if len(sizes) < 2 or other < PART_SAID:
        return ""
    if len(sizes) == 2:
        return " " + _("Either of them explains the other %(share)s.", share=_percent(other))
    return " " + _("Several of them explain the other %(share)s alike.", share=_percent(other))


def _taken_for_noise(diagnosis: DiagnosisResult, explained: float, shares: Mapping[str, float]) -> str:
    """What is left where the verdict says that nothing else is: noise was learnt that is as large, slow or of the set
    angles."""
    left = 1.0 - explained
    if all("time_since_move" in claim.depends_on for claim in diagnosis.claims):
        # laws of what rows do while poses are held: shares are of the misfit of the means, which knows nothing of it
        return ""
    if diagnosis.verdict not in NOTHING_ELSE or not shares or left < PART_SAID:
        return ""
    if _angles_are_off(diagnosis.noise):
        return " " + _(
            "What is left, %(share)s of the misfit, is taken for errors of the set angles.", share=_percent(left)
        )
    return " " + _("What is left, %(share)s of the misfit, is taken for noise that wanders.", share=_percent(left))


def _angles_are_off(noise: Mapping[str, Any]) -> bool:
    """Whether the set angles scatter by more than any bench makes, or than the sensors do: in g per radian, across
    gravity."""
    sizes = [noise.get(f"bench_{name}_rad") or 0.0 for name in ("inclination", "toolface", "across")]
    beside = max(noise.get("beside_laws_set_angles_rad") or [0.0])
    return beside > 0.0 or bool(max(sizes) > max(noise.get("sigma_g") or [0.0]))


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + _(" and ") + parts[-1]


def covariate_label(claim: Claim) -> str:
    """The axis along which a law is drawn."""
    if not claim.depends_on:
        return ""
    one = covariate(claim.depends_on[0])
    return f"{told(one.title)}, {one.unit}".rstrip(", ")


def _share(claim: Claim, shares: Mapping[str, float]) -> float:
    """Of the misfit where it is known, else of what is explained."""
    return shares.get(claim.effect, claim.share or 0.0)


def _percent(share: float) -> str:
    if share <= 0.0:
        return "-"
    return _("less than 1 %%") % {} if share < 0.005 else f"{min(share, 1.0):.0%}"
