"""The file of an effect that was learnt as a law: its Python text, from the law and what was reported of it.

A closed formula becomes the expression itself, a curve of one covariate a table, a law of several covariates its own
values. One unit of an amplitude is what the law does at its largest within the range that was visited, so that
amplitudes have the unit of the place; the gate is ten times the size that was learnt.
"""

from __future__ import annotations

import keyword
import pprint
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import AnyArray
from highside.errors import InputError
from highside.physics.covariates import COVARIATES, covariate, lag_of
from highside.physics.law import Axis, Law
from highside.physics.law_functions import MARGIN

BEYOND = 10.0
"""Gate of an amplitude in multiples of what was learnt. Source: chosen; a sensor of the same kind may show it larger,
one ten times as large is another fault"""
POINTS = 201
"""Points of a table: what the finest wave of a curve (14 over the range) loses between them is below 1 % of it"""
GRID = 41
"""values a covariate at which the largest of several covariates' law is looked for"""
WIDE = 120

CODE: dict[str, str] = {
    "one": "np.ones_like({u})",
    "cosine": "np.cos(np.pi * {0} * ({u} - {low}) / {span})",
    "cos": "np.cos({0} * np.radians({u}))",
    "sin": "np.sin({0} * np.radians({u}))",
    "linear": "({u} - {0})",
    "power": "np.abs({u} - {0}) ** {1}",
    "odd_power": "np.sign({u} - {0}) * np.abs({u} - {0}) ** {1}",
    "modulus": "np.abs({u} - {0})",
    "step": "np.where({u} >= {0}, 1.0, 0.0)",
    "sign": "np.sign({u})",
    "ramp": "np.maximum({u} - {0}, 0.0)",
    "decay": "np.where({u} >= {0}, np.exp(-np.maximum({u} - {0}, 0.0) / {1}), 0.0)",
    "exponential": "np.exp(({u} - {0}) / {1})",
    "sine": "np.sin(2 * np.pi * {u} / {0})",
    "straight": "((2 * {u} - 2 * {low}) / {span} - 1)",
    "square": "((2 * {u} - 2 * {low}) / {span} - 1) ** 2",
    "wide_cosine": f"np.cos(np.pi * {{0}} * (({{u}} - {{low}}) / {{span}} + {MARGIN}) / {1 + 2 * MARGIN})",
    "cosine_of": "np.cos(2 * np.pi * {u} / {0})",
    "bump": "np.exp(-0.5 * (({u} - {0}) / {1}) ** 2)",
    "dent": "np.exp(-0.5 * ((np.mod({u} - {0} + 180.0, 360.0) - 180.0) / {1}) ** 2)",
    "saturation": "np.tanh(({u} - {0}) / {1})",
}
"""the functions of a law (`law_functions.FUNCTIONS`) as Python"""
NEEDS = {
    "temp": ("temp_c",),
    "temp_rate": ("t_s", "temp_c"),
    "rate": ("rotor_rate_radps",),
    "rate_sign": ("direction",),
    "acceleration": ("rotor_accel_radps2",),
    "vibration": ("vibration_rms_g",),
    "time": ("t_s",),
    "time_since_move": ("t_s",),
}
"""fields of the chain's state without which a covariate says nothing"""


def _needs(name: str) -> tuple[str, ...]:
    return NEEDS["temp_rate" if lag_of(name) else name] if lag_of(name) or name in NEEDS else ()


LOADED = ("scale", "scale_all", "matrix", "gyro_scale")
"""places whose value is multiplied by the input of the stage"""


@dataclass(frozen=True)
class Words:
    """What stands in the file beside the law."""

    source: str
    """where the law comes from, in words"""
    confused_with: tuple[str, ...] = ()
    splitter: str = ""
    readings: Sequence[str] = ()
    """physics that would read like this"""


def effect_source(law: Law, effect_id: str, words: Words) -> str:
    """The text of the file. Raises InputError for a law that acts in no chain."""
    stage = law.at.stage
    if stage is None:
        raise InputError(
            "acts on channels beside another program's output alone: there is no chain for an effect to stand in",
            field=law.id,
        )
    sizes = _sizes(law)
    names = _arguments(law)
    history = any(covariate(n).history for n in law.depends_on) or "temp_rate" in law.depends_on
    loaded = law.place in LOADED or any("load" in name for name in law.depends_on)
    needs = tuple(dict.fromkeys(field for name in law.depends_on for field in _needs(name)))
    confused = words.confused_with if words.splitter else ()
    title = f"{law.at.title}, following {' and '.join(covariate(n).title for n in law.depends_on)}"
    constant, body = _value(law, names, sizes)
    kind = "".join(part.capitalize() for part in effect_id.split("_"))
    formula = law.formula or f"a curve of {' and '.join(law.depends_on)}"
    lines = [
        *_head(title, words, constant),
        constant,
        "",
        "",
        f"class {kind}(LearntEffect):",
        f"    id = {effect_id!r}",
        f"    title = {title!r}",
        f"    stage = Stage.{stage.name}",
        f"    place = {law.place!r}",
        f"    channels = {law.channels!r}",
        f"    depends_on = {law.depends_on!r}",
        "    # the range in which it was learnt; beyond it nothing is known, and it falls to nothing",
        f"    visited = {tuple(_span(axis) for axis in law.axes)!r}".replace("inf", 'float("inf")'),
        f"    formula = {formula!r}",
        "    # to fill in: what it is in the words of those who will read reports, once it is understood",
        *_story(title, words),
        f"    # one unit is the law at its largest; gates: {BEYOND:g} times what was learnt",
        "    parameters = (",
        *(_parameter(channel, law.at.unit, size) for channel, size in zip(law.channels, sizes, strict=True)),
        "    )",
        f"    groups = singles({len(law.channels)})",
        *([f"    confused_with = {confused!r}", f"    splitter = {words.splitter!r}"] if words.splitter else []),
        *([f"    needs = {needs!r}"] if needs else []),
        *([] if loaded else ["    depends_on_input = False"]),
        *(["    remembers = True", "    complex_safe = False"] if history else []),
        "",
        f"    def value(self, channel: str, {', '.join(f'{n}: AnyArray' for n in names)}) -> AnyArray:",
        *body,
        "",
        "",
        f"EFFECT = {kind}()",
    ]
    return "\n".join(lines) + "\n"


def _head(title: str, words: Words, constant: str) -> list[str]:
    """What the file says of itself, and its imports."""
    return [
        f'"""{title[0].upper()}{title[1:]}: learnt as a law from {words.source}."""',
        "",
        "from __future__ import annotations",
        "",
        "import numpy as np",
        "",
        "from highside.arrays import AnyArray",
        "from highside.physics.effect import Parameter, Stage, singles",
        *(["from highside.physics.law import Law"] if "Law." in constant else []),
        "from highside.physics.learnt import LearntEffect",
        "",
    ]


def _parameter(channel: str, unit: str, size: float) -> str:
    gate = BEYOND * size
    return f"        Parameter({'a_' + channel!r}, {unit!r}, {size:.4g}, ({-gate:.4g}, {gate:.4g})),"


def _story(title: str, words: Words) -> list[str]:
    story = f"{title[0].upper()}{title[1:]}: found as a law in {words.source}."
    if words.readings:
        story += f" It may be: {'; '.join(words.readings)}."
    wrapped = textwrap.wrap(story, WIDE - 16, break_long_words=False)
    pieces = ["Not yet understood. "] + [part + (" " if k < len(wrapped) - 1 else "") for k, part in enumerate(wrapped)]
    return ["    story = (", *(f"        {piece!r}" for piece in pieces), "    )"]


def _span(axis: Axis) -> tuple[float, float]:
    return (-float("inf"), float("inf")) if axis.periodic else (_short(axis.low), _short(axis.high))


def _short(value: float) -> float:
    return float(f"{value:.6g}")


def _arguments(law: Law) -> list[str]:
    """A name of an argument for each covariate: its own, where that is one."""
    return [n if n.isidentifier() and not keyword.iskeyword(n) else f"u{k}" for k, n in enumerate(law.depends_on)]


def _grids(law: Law, points: int) -> list[AnyArray]:
    spans = [(0.0, 360.0) if covariate(a.covariate).periodic else (a.low, a.high) for a in law.axes]
    each = np.meshgrid(*(np.linspace(*span, points) for span in spans), indexing="ij")
    return [axis.ravel() for axis in each]


def _sizes(law: Law) -> list[float]:
    """The largest that the law does to each channel within the range."""
    grids = _grids(law, POINTS if len(law.axes) == 1 else GRID)
    found = [float(np.max(np.abs(law.value(grids, k)))) for k in range(len(law.channels))]
    if not all(np.isfinite(found)) or not all(found):
        raise InputError("does nothing, or no finite amount, within the range it was learnt in", field=law.id)
    return found


def _value(law: Law, names: Sequence[str], sizes: Sequence[float]) -> tuple[str, list[str]]:
    """A constant of the module, and the body of `value`."""
    if all(len(axis.functions) == 1 for axis in law.axes):
        return _closed(law, names, sizes)
    if len(law.axes) == 1:
        return _table(law, names[0], sizes)
    unit = {**law.to_dict(), "covariance": []}
    unit.pop("covariance")
    unit["coefficients"] = [[_short(v / size) for v in row] for row, size in zip(law.coefficients, sizes, strict=True)]
    text = (
        f"LAW = Law.from_dict(\n{textwrap.indent(pprint.pformat(unit, width=WIDE - 8, sort_dicts=False), '    ')}\n)\n"
    )
    return text + '"""the law, each channel 1 at its largest"""', [
        f"        return LAW.value([{', '.join(names)}], self.channels.index(channel))"
    ]


def _closed(law: Law, names: Sequence[str], sizes: Sequence[float]) -> tuple[str, list[str]]:
    """One function of each covariate: the expression itself."""
    pieces = []
    for axis, name in zip(law.axes, names, strict=True):
        function = axis.functions[0]
        numbers = [repr(_short(v)) for v in function.numbers]
        pieces.append(
            CODE[function.kind].format(*numbers, u=name, low=_short(axis.low), span=_short(axis.high - axis.low))
        )
    # the same expression on every channel: it is at its largest where each is
    largest = sizes[0] / abs(law.coefficients[0][0])
    signs = {c: 1.0 if row[0] > 0 else -1.0 for c, row in zip(law.channels, law.coefficients, strict=True)}
    constant = f'SIGN = {signs!r}\nLARGEST = {largest:.6g}\n"""of the expression within the range that was visited"""'
    return constant, [f"        return np.asarray(SIGN[channel] * {' * '.join(pieces)} / LARGEST)"]


def _table(law: Law, name: str, sizes: Sequence[float]) -> tuple[str, list[str]]:
    """A curve: points of it, and straight lines between them."""
    (grid,) = _grids(law, POINTS)
    curves = {
        channel: [float(f"{v / size:.4g}") for v in law.value([grid], k)]
        for k, (channel, size) in enumerate(zip(law.channels, sizes, strict=True))
    }
    unit = COVARIATES[law.depends_on[0]].unit if law.depends_on[0] in COVARIATES else ""
    low, high = float(grid[0]), float(grid[-1])
    text = "\n".join(
        [
            f"AT = np.linspace({low:.6g}, {high:.6g}, {POINTS})",
            f'"""{law.depends_on[0]}{", " + unit if unit else ""}"""',
            f"CURVE = {pprint.pformat(curves, width=WIDE, compact=True)}",
            '"""each channel 1 at its largest"""',
        ]
    )
    period = ", period=360.0" if covariate(law.depends_on[0]).periodic else ""
    return text, [f"        return np.interp({name}, AT, CURVE[channel]{period})"]
