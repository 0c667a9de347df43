"""What an effect is: one small unit of physics with a name, a story, parameters and a place in the chain.

The chain, in order, and what an effect adds at each stage (dimension x N rows):

    TIMING     s,   (1, N): how much later than its stamp a row was sampled
    POSE       rad, (3, N): increments of the inclination I, of the cross angle E and of the toolface T
    GRAVITY    1,   (3, N): increment of the lab's vertical (0, 0, 1)
    MOUNTING   rad, (3, 1): rotation vector from the tool frame to the triad's frame
    KINEMATIC  g,   (3, N): specific force of motion, in the triad's frame
    SENSOR     g,   (3, N): what the triad reports beyond its input f
    THERMAL    g,   (3, N): as SENSOR, following temperature or time
    GYRO       rad/s, (3, N): what the gyros report beyond the tool's rates
    NOISE      drawn at random, nothing to predict; each such effect disturbs the stage it names
    DIGITAL    what the converter, the link and the recorder make of the reported values, in order, at the very end

Effects of one stage act side by side (each sees the stage's input, not another's output), so their order does not
matter and the model stays `m = f + sum of terms(f)`, the form of the calibration equations.

Where another program predicts some channels, no chain is known, only its output. What an effect may have done to such
channels it says by `on_channels`; a `ChannelEffect` (module `channel_effect`) acts on those alone and
stands in no chain.

An effect is *one file* holding one instance named `EFFECT`; it is found by itself. It declares what it is: nothing is
read from the names of its parameters, and nothing else lists effects.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import Enum
from types import MappingProxyType

import numpy as np

from highside.arrays import AnyArray
from highside.errors import InputError
from highside.physics.channels import Channels, ChannelTerm
from highside.physics.parameter import AXES, Groups, Parameter, across, pairs, runs, singles, triad
from highside.physics.state import ChainState

__all__ = [
    "AXES",
    "REFERENCE_TEMP_C",
    "AxisEffect",
    "Effect",
    "Groups",
    "LinearEffect",
    "Modulated",
    "Parameter",
    "RandomEffect",
    "RecordEffect",
    "Stage",
    "across",
    "on_own_axis",
    "pairs",
    "runs",
    "singles",
    "triad",
]

REFERENCE_TEMP_C = 25.0
"""temperature at which the thermal effects vanish"""


class Stage(Enum):
    """Where in the chain an effect acts; the order of the members is that of the chain."""

    TIMING = "timing"
    POSE = "pose"
    GRAVITY = "gravity"
    MOUNTING = "mounting"
    KINEMATIC = "kinematic"
    SENSOR = "sensor"
    THERMAL = "thermal"
    GYRO = "gyro"
    NOISE = "noise"
    DIGITAL = "digital"


class Effect(ABC):
    """Base of all effects. Parameters travel as a vector (K,) in the order of `parameters`.

    A subclass gives the class attributes and `delta`. The derivatives come from a complex step (exact to rounding)
    unless `complex_safe` is False (central differences then) or the subclass knows them in closed form.
    """

    id: str
    title: str
    stage: Stage
    formula: str
    story: str
    parameters: tuple[Parameter, ...]
    confused_with: tuple[str, ...] = ()
    splitter: str = ""
    needs: tuple[str, ...] = ()
    """fields of ChainState that must vary (or be known) for the effect to show"""
    complex_safe: bool = True
    random: bool = False
    known_size: bool = False
    """True: the amplitude is no free number but has its typical value, or the effect is absent"""
    turns_the_tool: bool = True
    """whether what it adds to the angles of the bench is a motion that gyros feel"""
    remembers: bool = False
    """True: what it does at a row depends on the rows before it, not on that row and the first of all alone"""
    depends_on_input: bool = True
    """False: `delta` does not read the stage's input, so nothing before it passes through it"""
    groups: Groups = ()
    """amplitudes that may act without the others: those of one axis, of one order, a cosine with its sine. All
    together always may. So an effect on one axis is not judged as if it had needed three."""
    slow: bool = False
    """True: a function of time or temperature alone, as a random walk of the zero offset may look too. It is believed
    only where it beats such a random walk"""
    averages_out: str = ""
    """why it leaves no trace in the mean of a pose that is held, in words; empty if it does leave one"""
    constant: bool = False
    """True: it adds the same to every row"""
    lasting: Mapping[str, float] = MappingProxyType({})
    """parameters that have these values in a later recording: of what sets in once and stays"""
    calibrated: bool = False
    """True: part of the linear model that a plain calibration fits: the first that a rich model takes in"""
    next_order_of: str = ""
    """id of the effect of which this is the next order: judged by what it adds to that, believed where that is"""
    channel_story: str = ""
    """the story for channels beside another program's output, if that is another one"""
    channel_needs: str = ""
    """what such a comparison lacks, in words, if the effect cannot act there"""

    @abstractmethod
    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        """What it adds at its stage (shape: see the module), for parameters p (K,) and stage input x (3, N)."""

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        """d delta / d p, (K, 3, N)."""
        p = np.asarray(p, dtype=float)
        columns = []
        for k, parameter in enumerate(self.parameters):
            if self.complex_safe:
                step = p.astype(complex)
                step[k] += 1e-30j
                columns.append(np.imag(self.delta(state, step, x)) / 1e-30)
            else:
                h = 1e-5 * max(abs(p[k]), abs(parameter.typical))
                up, down = p.copy(), p.copy()
                up[k] += h
                down[k] -= h
                columns.append((self.delta(state, up, x) - self.delta(state, down, x)) / (2 * h))
        return np.stack(columns)

    def input_jacobian(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        """d delta / d x, (3, 3, N): [i, j] is the change of component i with component j of the stage's input."""
        jacobian = np.empty((3, 3, x.shape[1]))
        for j in range(3):
            step = x.astype(complex)
            step[j] += 1e-30j
            jacobian[:, j] = np.imag(self.delta(state, p, step)) / 1e-30
        return jacobian

    def renamed(self, values: Mapping[str, float]) -> dict[str, float]:
        """Named values of a file, which may use names of older versions, under the names of today."""
        former = {parameter.formerly: parameter.name for parameter in self.parameters if parameter.formerly}
        return {former.get(name, name): value for name, value in values.items()}

    def vector(self, values: Mapping[str, float] | None = None) -> AnyArray:
        """Parameter vector (K,) from named values; those not named take their default.

        Raises InputError for a name the effect does not have.
        """
        values = self.renamed(values or {})
        result = np.array([values.pop(parameter.name, parameter.default) for parameter in self.parameters], dtype=float)
        if values:
            known = ", ".join(parameter.name for parameter in self.parameters)
            raise InputError(f"effect '{self.id}' has no parameter '{next(iter(values))}'", remedy=f"it has: {known}")
        return result

    def outside_gate(self, p: AnyArray) -> list[str]:
        """Names of the parameters whose value is not finite or outside of the plausible range."""
        return [
            parameter.name
            for parameter, value in zip(self.parameters, p, strict=True)
            if not parameter.gate[0] <= value <= parameter.gate[1]
        ]

    def restarted(self, p: AnyArray, earlier_s: float) -> tuple[AnyArray, AnyArray]:
        """Factor and increment (K,) of each parameter p (K,) if its time is counted from so much earlier."""
        return np.ones(len(p)), np.array([earlier_s if parameter.epoch else 0.0 for parameter in self.parameters])

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        """What it may do to the channels that another program predicts; nothing unless an effect says so."""
        return ()

    @property
    def amplitudes(self) -> tuple[int, ...]:
        """Indices of the parameters that give the effect its size."""
        return tuple(k for k, parameter in enumerate(self.parameters) if not parameter.shape)

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """The parameters that form it."""
        return tuple(parameter for parameter in self.parameters if parameter.shape)

    @property
    def parts(self) -> Groups:
        """Which amplitudes may act: all, then the groups; the largest first."""
        everything = tuple(range(len(self.amplitudes)))
        return tuple(sorted({everything, *self.groups}, key=lambda part: (-len(part), part)))

    @property
    def line(self) -> Parameter | None:
        """The frequency, if the effect is a line of a spectrum."""
        return next((parameter for parameter in self.parameters if parameter.line_over), None)

    @property
    def follows_time_alone(self) -> bool:
        """Whether the clock is all it needs."""
        return self.needs == ("t_s",)

    @property
    def straight_in_time(self) -> bool:
        """Whether it is a straight line in time: slow, and nothing but a size and the clock make it."""
        return self.slow and self.follows_time_alone and not self.shapes


class LinearEffect(Effect):
    """An effect that is a sum of parameter times basis function: gives `basis`, and gets the rest from it."""

    @abstractmethod
    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        """(K, 3, N): what one unit of each parameter adds."""

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.tensordot(p, self.basis(state, x), 1)

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return self.basis(state, x)


class AxisEffect(LinearEffect):
    """A term of each sensor by itself, `p_i * h(f_i)` on axis i; gives the scalar function and its slope."""

    groups = singles(3)

    @abstractmethod
    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        """h(f), (3, N)."""

    @abstractmethod
    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        """dh/df, (3, N)."""

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return p[:, None] * self.term(state, x)

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return on_own_axis(self.term(state, x))

    def input_jacobian(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return on_own_axis(p[:, None] * self.slope(state, x))


class Modulated(LinearEffect):
    """An effect of the sensor whose parameters follow a known quantity: `factor` (N,) times the effect at each row."""

    id = "modulated"
    title = "An effect that follows a known quantity"
    stage = Stage.THERMAL
    formula = "factor times the effect"
    story = "A parameter of the sensor is not constant but in proportion to something known, such as temperature."

    def __init__(self, effect: LinearEffect, factor: AnyArray) -> None:
        self._effect, self._factor = effect, factor

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return self._factor * self._effect.basis(state, x)

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return self._factor * self._effect.delta(state, p, x)

    def input_jacobian(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return self._factor * self._effect.input_jacobian(state, p, x)


class RandomEffect(Effect):
    """Drawn, not predicted. The parameters are sizes of scatter; `draws_at` is the stage it disturbs."""

    random = True
    draws_at: Stage = Stage.SENSOR

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.zeros((3, state.n), dtype=np.result_type(p, float))

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.zeros((len(self.parameters), 3, state.n))

    @abstractmethod
    def draw(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        """One realisation, (3, N), in the units of the stage `draws_at`."""


class RecordEffect(Effect):
    """Acts on the finished values: rounding, clipping, loss. Found by detectors, not by regression."""

    random = True

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.zeros((3, state.n), dtype=np.result_type(p, float))

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.zeros((len(self.parameters), 3, state.n))

    def record(self, state: ChainState, p: AnyArray, values: AnyArray, rng: np.random.Generator) -> AnyArray:
        """The values (3, N) as they are written down."""
        return values

    def rows(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        """Indices of the rows that are written down, in order."""
        return np.arange(state.n)


def on_own_axis(values: AnyArray) -> AnyArray:
    """(3, N) -> (3, 3, N) with row i on the diagonal [i, i] and zeros elsewhere."""
    result = np.zeros((3, *values.shape), dtype=values.dtype)
    for axis in range(3):
        result[axis, axis] = values[axis]
    return result
