"""The page that describes the library of effects, in Markdown, made from the effects themselves."""

from __future__ import annotations

from highside.physics import effects as package
from highside.physics.channel_effect import ChannelEffect
from highside.physics.effect import Effect, RandomEffect, Stage

STAGES = {
    Stage.TIMING: "When a row was sampled",
    Stage.POSE: "Where the bench truly points",
    Stage.GRAVITY: "The vertical in the room",
    Stage.MOUNTING: "The triad in its housing",
    Stage.KINEMATIC: "Forces of motion",
    Stage.SENSOR: "The sensors",
    Stage.THERMAL: "Temperature and time",
    Stage.GYRO: "The gyros",
    Stage.NOISE: "What is random",
    Stage.DIGITAL: "The converter, the link, the recorder",
}


CHANNELS = (
    "Where another program predicts some channels (`highside diagnose --simulation`) no chain is known. These effects",
    "act there alone, with a parameter for each channel or pair of channels. Of those above, these act there too:",
    "{shared}.",
)


def markdown() -> str:
    """The whole page: the effects in the order of the chain."""
    lines = [
        "# The library of effects",
        "",
        "Simulation, calibration and diagnosis share these. Each effect is one file of this folder and is found by",
        "itself; this page is made from them (`highside effects`). Units: g, rad, s, m, C. The range is the plausible",
        "one: a fit outside of it is not believed, a model outside of it is refused. Parameters marked `*` give an",
        "effect its shape, the others its size.",
        "",
    ]
    effects = list(package.all_effects().values())
    for stage, heading in STAGES.items():
        lines += [f"## {heading}", ""]
        for effect in (e for e in effects if e.stage is stage):
            lines += _entry(effect)
    shared = ", ".join(f"`{e.id}`" for e in package.on_channels() if not isinstance(e, ChannelEffect))
    lines += ["## Channels beside another program's output", "", *(line.format(shared=shared) for line in CHANNELS), ""]
    for effect in (e for e in package.on_channels() if isinstance(e, ChannelEffect)):
        lines += _entry(effect)
    return "\n".join(lines).rstrip() + "\n"


def _entry(effect: Effect) -> list[str]:
    lines = [f"### `{effect.id}`: {effect.title}", "", effect.story, "", f"    {effect.formula}", ""]
    if effect.parameters:
        lines += _parameters(effect)
    if isinstance(effect, RandomEffect):
        lines += [f"Disturbs the stage: {effect.draws_at.value}.", ""]
    if effect.needs:
        lines += [f"Shows where these are recorded and vary: {', '.join(f'`{n}`' for n in effect.needs)}.", ""]
    if effect.confused_with:
        rivals = ", ".join(f"`{rival}`" for rival in effect.confused_with)
        lines += [f"Confused with {rivals}. What splits them: {effect.splitter}.", ""]
    if not effect.parameters:
        lines += [f"To tell it from others: {effect.splitter}.", ""]
    return lines


def _parameters(effect: Effect) -> list[str]:
    lines = ["| parameter | unit | typical | range |", "|---|---|---|---|"]
    lines += [
        f"| `{p.name}`{' *' if p.shape else ''} | {p.unit} | {p.typical:g} | {p.gate[0]:g} to {p.gate[1]:g} |"
        for p in effect.parameters
    ]
    return [*lines, ""]
