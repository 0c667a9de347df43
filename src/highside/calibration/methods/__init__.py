"""The calibration methods: every module of this package that holds a `METHOD` is one, found by itself; other installed
packages add theirs by an entry point of the group `highside.methods`, named as the method.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache

from highside.calibration.method import Method
from highside.errors import InputError
from highside.plugins import Plugin, plugins

GROUP = "highside.methods"
"""Entry points of this group are calibration methods."""

__all__ = ["GROUP", "all_methods", "faults", "get", "solves_by_inclination"]


@cache
def _found() -> tuple[dict[str, Method], dict[str, Plugin]]:
    """The methods by name, and the plugins that are none."""
    ours = [importlib.import_module(f"{__name__}.{module.name}").METHOD for module in pkgutil.iter_modules(__path__)]
    found = {method.name: method for method in ours}
    unusable: dict[str, Plugin] = {}
    for plugin in plugins(GROUP):
        fault = plugin.fault or _unfit(plugin, found)
        if fault:
            unusable[plugin.name] = plugin.refused(fault)
        else:
            found[plugin.name] = plugin.value
    return {method.name: method for method in sorted(found.values(), key=lambda m: (m.order, m.name))}, unusable


def all_methods() -> Mapping[str, Method]:
    """All methods by name, the simplest first."""
    return _found()[0]


def faults() -> Mapping[str, Plugin]:
    """What other packages call a method and is none, by its name: each says why."""
    return _found()[1]


def get(name: str, *, field: str = "method") -> Method:
    """The method of that name. Raises InputError, of the `field`, that names those there are."""
    if name in faults():
        broken = faults()[name]
        raise InputError(
            f"the method {broken} cannot be used: {broken.fault}", field=field, remedy="fix or remove that package"
        )
    if name not in all_methods():
        raise InputError(f"method {name!r} is none of {', '.join(all_methods())}", field=field)
    return all_methods()[name]


def solves_by_inclination(name: str) -> bool:
    """Whether it is the name of a method that solves each inclination alone; no name of a method: no."""
    method = all_methods().get(name)
    return method is not None and method.by_inclination


def _unfit(plugin: Plugin, others: Mapping[str, Method]) -> str:
    """Why what was loaded is no method of that name; empty if it is one."""
    if not isinstance(plugin.value, Method):
        return "it is no highside.calibration.method.Method"
    if plugin.value.name != plugin.name:
        return f"its name is {plugin.value.name!r}, not {plugin.name!r}"
    if plugin.name in others:
        return "there is a method of this name already"
    return ""
