"""Effects from outside of the library: files of a folder that the user names, and entry points of installed packages.

They are code, and run with the rights of the command: a folder is as trustworthy as who can write to it. What is no
effect, or one that the diagnosis could not use, is refused before anything is computed, with one line (file, what).
"""

from __future__ import annotations

import importlib.util
import math
import re
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path

import numpy as np

from highside.errors import InputError
from highside.physics.effect import Effect, Parameter, Stage
from highside.physics.state import ChainState
from highside.plugins import Plugin, plugins
from highside.printable import one_line

GROUP = "highside.effects"
MOST_SHAPES = 1000
"""Combinations of shapes that an effect may ask to have tried. Each is a column an amplitude in memory and in the race:
the library's largest (a step anywhere) requires 60, or among poses 300; a thousand take a minute of poses."""
EPOCHS = 60
"""Times of onset that are tried over rows, at most; among poses there are more where the other shapes leave room."""
WORDS = ("title", "formula", "story")
IDENTIFIER = re.compile(r"[a-z][a-z0-9_]*")


def effects_of_folder(folder: Path) -> list[tuple[str, Effect]]:
    """(file, effect) of every Python file of a folder, by name; files that begin with _ are left to the others."""
    if not folder.is_dir():
        raise InputError("is not a folder", where=str(folder), field="effects", remedy="name a folder of effects")
    files = sorted(path for path in folder.glob("*.py") if not path.name.startswith("_"))
    if not files:
        raise InputError("holds no effect", where=str(folder), field="effects", remedy="put NAME.py files into it")
    return [(str(path), effect_of_file(path)) for path in files]


@cache
def effects_of_packages() -> tuple[tuple[Plugin, Effect | None], ...]:
    """What installed packages name as effects; None, and the plugin's `fault`, where it is none."""
    found: list[tuple[Plugin, Effect | None]] = []
    for plugin in plugins(GROUP):
        value = plugin.value.EFFECT if hasattr(plugin.value, "EFFECT") else plugin.value
        try:
            effect = None if plugin.fault else check(value, plugin.name, str(plugin))
            if effect is not None:
                tried_out(effect, str(plugin))
            found.append((plugin, effect))
        except InputError as error:
            found.append((plugin.refused(error.what), None))
    return tuple(found)


def effect_of_file(path: Path) -> Effect:
    """The effect of one file, checked and tried out. Raises InputError (file, what)."""
    spec = importlib.util.spec_from_file_location(f"highside_effect_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise InputError(
            f"cannot be loaded: {_described(error, path)}", where=str(path), remedy="fix the file"
        ) from None
    if not hasattr(module, "EFFECT"):
        raise InputError(
            "holds no EFFECT", where=str(path), remedy="end it with EFFECT = YourEffect(), or begin its name with _"
        )
    effect = check(module.EFFECT, path.stem, str(path))
    tried_out(effect, str(path))
    return effect


def _described(error: BaseException, path: Path) -> str:
    """An error of a file in one line, with the line of the file that it comes from."""
    if isinstance(error, SyntaxError):
        return f"{error.msg} (line {error.lineno})"
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    line = f" (line {lines[-1]})" if lines else ""
    return f"{type(error).__name__}: {one_line(str(error))}{line}"


def check(effect: object, name: str, where: str) -> Effect:
    """The effect, if it declares all that is needed and nothing that contradicts itself. Raises InputError."""
    if not isinstance(effect, Effect):
        raise InputError(f"EFFECT is {type(effect).__name__}, not an Effect", where=where, remedy="make an instance")
    for what in _faults(effect, name):
        raise InputError(what, where=where, remedy="see docs/extending.md")
    return effect


def references_lacking(effect: Effect, known: Mapping[str, Effect]) -> list[str]:
    """What an effect says of others that are not there, in words."""
    named = [*effect.confused_with, *([effect.next_order_of] if effect.next_order_of else [])]
    return [f"names '{other}', which is no other effect" for other in named if other not in known or other == effect.id]


def _faults(effect: Effect, name: str) -> Iterator[str]:
    """What is wrong with the declarations of an effect, in words."""
    lacking = [word for word in ("id", *WORDS) if not isinstance(getattr(effect, word, None), str)]
    if lacking:
        yield f"lacks {', '.join(lacking)}"
        return
    if not IDENTIFIER.fullmatch(effect.id) or effect.id != name:
        yield f"the id is '{effect.id}' and the name '{name}': file and id must have one name, of a-z, 0-9 and _"
    if not isinstance(getattr(effect, "stage", None), Stage):
        yield "lacks stage, one of " + ", ".join(f"Stage.{stage.name}" for stage in Stage)
    if bool(effect.confused_with) > bool(effect.splitter):
        yield "names what it is confused with, but no splitter"
    unknown = set(effect.needs) - {field.name for field in fields(ChainState)}
    if unknown:
        yield f"needs {', '.join(sorted(unknown))}, which no recording has"
    parameters = getattr(effect, "parameters", None)
    if not isinstance(parameters, tuple) or not all(isinstance(p, Parameter) for p in parameters):
        yield "parameters must be a tuple of Parameter"
        return
    for parameter in parameters:
        yield from (f"parameter '{parameter.name}' {what}" for what in _parameter_faults(parameter, effect.random))
    if len({parameter.name for parameter in parameters}) < len(parameters):
        yield "two parameters have the same name"
    if parameters and not effect.amplitudes:
        yield "has no parameter that gives it size: all are shapes"
    count = len(effect.amplitudes)
    if any(not group or len(set(group)) < len(group) or not set(group) <= set(range(count)) for group in effect.groups):
        yield f"groups speak of amplitudes that there are not: there are {count}, numbered from 0"
    tried = math.prod(EPOCHS if p.epoch else max(len(p.grid), 1) for p in effect.shapes)
    if tried > MOST_SHAPES:
        yield f"its shapes have {tried} combinations, and {MOST_SHAPES} can be tried: give shorter grids"
    if effect.line is not None and (len(effect.shapes) > 1 or not effect.averages_out):
        yield "a line has one shape, its frequency, and says in averages_out why poses do not show it"


def _parameter_faults(parameter: Parameter, random: bool) -> Iterator[str]:
    low, high = parameter.gate
    if not low < high:
        yield f"has the gate {low:g} to {high:g}, which holds nothing"
    if not low <= parameter.typical <= high or not low <= parameter.default <= high or parameter.typical == 0:
        yield f"must have its typical size (not 0) and its default between {low:g} and {high:g}"
    if not parameter.shape:
        if parameter.default != 0:
            yield "gives size, so that its default must be 0"
        if parameter.grid or parameter.epoch or parameter.time_constant or parameter.line_over:
            yield "has a grid, or is a time or a frequency, but is no shape: add shape=True"
        return
    if (
        not random
        and sum((bool(parameter.grid) and not parameter.line_over, parameter.epoch, bool(parameter.line_over))) != 1
    ):
        yield "is a shape: say what is to be tried, by a grid, by epoch=True or by line_over"
    if parameter.time_constant and not parameter.grid:
        yield "is a time constant: give the grid to begin with"
    if any(not low <= value <= high for value in parameter.grid):
        yield f"has a grid that leaves its gate, {low:g} to {high:g}"


def tried_out(effect: Effect, where: str) -> None:
    """Raises InputError if an effect cannot be computed, adds something of the wrong size, or what it adds without any
    size is not nothing: what the tests of the library ask of its own effects."""
    state = _sample_rows()
    x = np.stack([np.sin(state.tf_rad), np.cos(state.tf_rad), np.full(state.n, 0.5)])
    typical = np.array([p.default or p.typical if p.shape else p.typical for p in effect.parameters], dtype=float)
    nothing = typical.copy()
    nothing[list(effect.amplitudes)] = 0.0
    if not len(typical):
        return
    try:
        added, empty = (np.asarray(effect.delta(state, p, x)) for p in (typical, nothing))
        slopes = np.asarray(effect.derivative(state, typical, x))
    except (Exception, SystemExit) as error:
        raise InputError(f"cannot be computed: {type(error).__name__}: {one_line(str(error))}", where=where) from None
    rows = 1 if effect.stage is Stage.TIMING else 3
    if added.shape not in {(rows, 1), (rows, state.n)} or not np.all(np.isfinite(added)):
        raise InputError(f"delta gives an array {added.shape}, or no number; ({rows}, N) is needed", where=where)
    if np.any(np.abs(empty) > 1e-15):
        raise InputError("adds something while all that gives it size is 0", where=where)
    if effect.random:
        return
    if effect.line is not None:
        wave_of(effect)
    for k, parameter in enumerate(effect.parameters):
        if parameter.fitted and not parameter.line_over:
            step = 1e-5 * abs(parameter.typical) * np.eye(len(typical))[k]
            ahead, back = (np.asarray(effect.delta(state, typical + sign * step, x)) for sign in (1, -1))
            slope = np.broadcast_to((ahead - back) / (2 * step[k]), slopes[k].shape)
            least = np.max(np.abs(added)) / abs(parameter.typical)
            if np.max(np.abs(slope - slopes[k])) > 1e-3 * max(float(np.max(np.abs(slope))), 1e-3 * least):
                raise InputError(
                    f"the derivative by '{parameter.name}' is not that of delta",
                    where=where,
                    remedy="write delta for complex numbers (no abs, no comparison), or set complex_safe = False",
                )


def wave_of(effect: Effect) -> tuple[tuple[int, int], ...]:
    """Of each amplitude of a line the axis it acts on, and whether it is the cosine (0) or the sine (1) of the phase.

    Raises InputError for what is neither, or is on several axes.
    """
    frequency = effect.line
    assert frequency is not None
    value = frequency.default or frequency.typical
    cycles = np.linspace(0.0, 2.2, 60)
    angle = 2 * np.pi * cycles / value
    state = ChainState.build(np.full(60, 0.3), angle, t_s=cycles / value)
    waves = [np.cos(value * angle), np.sin(value * angle)]
    found = []
    for at in effect.amplitudes:
        p = effect.vector({frequency.name: value})
        p[at] = 1.0
        added = np.asarray(effect.delta(state, p, np.zeros((3, state.n))), dtype=float)
        axes = np.flatnonzero(np.any(added != 0, axis=1))
        fits = [phase for phase, wave in enumerate(waves) if axes.size == 1 and np.allclose(added[axes[0]], wave)]
        if not fits:
            what = f"'{effect.parameters[at].name}' is neither a cosine nor a sine on one axis"
            raise InputError(what, where=effect.id)
        found.append((int(axes[0]), fits[0]))
    return tuple(found)


def _sample_rows() -> ChainState:
    """Rows in which every covariate varies."""
    k = np.arange(60.0)
    return ChainState.build(
        0.3 + 0.02 * k,
        0.37 * k,
        t_s=7.3 * k,
        direction=np.where(k % 2, 1.0, -1.0),
        temp_c=30 + 10 * np.sin(k / 9),
        rotor_rate_radps=2 + np.sin(k / 7),
        rotor_accel_radps2=np.cos(k / 7),
        inc_rate_radps=0.01 * np.cos(k / 5),
        vibration_rms_g=0.2 + 0.1 * np.sin(k / 3),
        vibration_x_rms_g=0.1 + 0.05 * np.sin(k / 3),
        vibration_y_rms_g=0.1 + 0.05 * np.cos(k / 5),
        vibration_z_rms_g=0.1 + 0.05 * np.sin(k / 11),
        since_move_s=5.0 + k % 7,
        stay_s=1.0,
        latitude_rad=0.7,
        azimuth_rad=0.4,
    )
