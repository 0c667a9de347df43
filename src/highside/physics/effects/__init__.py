"""The library of effects: every module of this package that holds an `EFFECT` is one, found by itself.

To add an effect, add a file here; simulation, calibration, diagnosis, the tests of the library and its documentation
page take it from the registry. An effect of one's own needs no place here: it is found in a folder that the user names
(`highside diagnose --effects DIR`), or in an installed package that names it as an entry point `highside.effects`.
"""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from highside.errors import InputError
from highside.physics.channel_effect import ChannelEffect
from highside.physics.effect import Effect, Stage
from highside.physics.outside_effects import check, effects_of_folder, effects_of_packages, references_lacking

_folders: tuple[Path, ...] = ()


def use_folders(folders: Sequence[Path]) -> None:
    """Take in the effects of these folders too, in place of those named before. They are code, and are run.

    Raises InputError (file, what) for a file that is no effect; nothing is taken in then.
    """
    global _folders
    before, _folders = _folders, tuple(Path(folder).resolve() for folder in folders)
    registry.cache_clear()
    try:
        registry()
    except InputError:
        _folders = before
        registry.cache_clear()
        raise


__all__ = ["all_effects", "get"]


@cache
def registry() -> dict[str, Effect]:
    """All there are, by id, in the order of the chain and then of their names."""
    found: dict[str, Effect] = {}
    for module in pkgutil.iter_modules(__path__):
        effect = importlib.import_module(f"{__name__}.{module.name}").EFFECT
        check(effect, module.name, f"{module.name}.py")
        found[effect.id] = effect
    # a package must not stop those who do not use it; a folder is requested
    for _, own in effects_of_packages():
        if own is not None and not (own.id in found or references_lacking(own, found)):
            found[own.id] = own
    outside = [pair for folder in _folders for pair in effects_of_folder(folder)]
    for where, effect in outside:
        if effect.id in found:
            raise InputError(f"there is an effect '{effect.id}' already", where=where, remedy="give it another id")
        found[effect.id] = effect
    for where, effect in outside:
        for lacking in references_lacking(effect, found):
            raise InputError(lacking, where=where, field="confused_with, next_order_of")
    order = list(Stage)
    return {e.id: e for e in sorted(found.values(), key=lambda effect: (order.index(effect.stage), effect.id))}


@cache
def _of_chain(every: tuple[Effect, ...]) -> dict[str, Effect]:
    return {effect.id: effect for effect in every if not isinstance(effect, ChannelEffect)}


def all_effects() -> dict[str, Effect]:
    """Those that a forward model may have, by id, in the order of the chain and then of their names."""
    return _of_chain(tuple(registry().values()))


def on_channels() -> list[Effect]:
    """Those that may act on channels beside another program's output, in the order of the chain."""
    return [effect for effect in registry().values() if type(effect).on_channels is not Effect.on_channels]


def unusable() -> list[str]:
    """Of the effects of installed packages those that cannot be used, and why, one line each."""
    lines = []
    for plugin, own in effects_of_packages():
        if own is None or registry().get(own.id) is not own:
            why = plugin.fault or "an effect of this id is there already, or it names one that is not there"
            lines.append(f"the effect {plugin} is omitted: {why}")
    return lines


def title_of(effect_id: str) -> str:
    """What an effect is called, in words; of what is no effect of the library, a law, its id."""
    known = registry().get(effect_id)
    return effect_id if known is None else known.title


def get(effect_id: str) -> Effect:
    """The effect of that id. Raises InputError that names the nearest ids."""
    effects = all_effects()
    if effect_id in effects:
        return effects[effect_id]
    if effect_id in registry():
        raise InputError(
            f"the effect '{effect_id}' acts on channels beside another program's output alone",
            remedy="it is for diagnose with simulation=",
        )
    near = difflib.get_close_matches(effect_id, effects, n=3, cutoff=0.4)
    remedy = f"did you mean {' or '.join(near)}?" if near else f"known are: {', '.join(effects)}"
    unfit = [line for line in unusable() if line.startswith(f"the effect '{effect_id}' ")]
    if unfit:
        remedy = unfit[0]
    elif not _folders:
        remedy += "; effects of your own: highside diagnose --effects DIR, or highside.physics.effects.use_folders"
    raise InputError(f"unknown effect '{effect_id}'", remedy=remedy)
