"""The library of effects: every module of this package that holds an `EFFECT` is one, found by itself.

To add an effect, add a file here; simulation, calibration, diagnosis, the tests of the library and its documentation
page take it from the registry.
"""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from functools import cache

from highside.errors import InputError
from highside.physics.effect import Effect, Stage

__all__ = ["all_effects", "get"]


@cache
def all_effects() -> dict[str, Effect]:
    """All effects by id, in the order of the chain and then of their names."""
    order = list(Stage)
    found: list[Effect] = []
    for module in pkgutil.iter_modules(__path__):
        effect = importlib.import_module(f"{__name__}.{module.name}").EFFECT
        if effect.id != module.name:
            raise ValueError(f"the effect '{effect.id}' lives in {module.name}.py: file and id must have the same name")
        found.append(effect)
    found.sort(key=lambda effect: (order.index(effect.stage), effect.id))
    return {effect.id: effect for effect in found}


def get(effect_id: str) -> Effect:
    """The effect of that id. Raises InputError that names the nearest ids."""
    effects = all_effects()
    if effect_id not in effects:
        near = difflib.get_close_matches(effect_id, effects, n=3, cutoff=0.4)
        remedy = f"did you mean {' or '.join(near)}?" if near else f"known are: {', '.join(effects)}"
        raise InputError(f"unknown effect '{effect_id}'", remedy=remedy)
    return effects[effect_id]
