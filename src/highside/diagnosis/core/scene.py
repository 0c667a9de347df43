"""A recording prepared for the diagnosis: what the procedure of `engine` needs to ask of it, whatever kind it is.

Poses and rotation differ in how columns are made and whitened, how noise is learned and what a good next manoeuvre is.
What is chosen, compared and told is the same, and sees only this.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidates import Blind, Candidate, Variant
from highside.diagnosis.core.fit import JointFit, Seen
from highside.diagnosis.core.location import Scan
from highside.diagnosis.core.memory import Channel, Memory, SlowEffect
from highside.diagnosis.core.method import WHOLE, Method
from highside.diagnosis.core.pool import Member
from highside.diagnosis.core.result import Diagnosis, Fit, Location
from highside.diagnosis.core.rivals import Refitted, Rivalry
from highside.diagnosis.core.scene_policy import ScenePolicy
from highside.diagnosis.core.selection import Selector
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState


class Noise(Protocol):
    """The noise of a recording of any kind, as the procedure sees it."""

    @property
    def freedom(self) -> float:
        """Degrees of freedom by which its size is known."""
        ...

    def white(self, columns: Array) -> Array:
        """(..., C, n) readings -> (..., C n) in units of the noise."""
        ...


N = TypeVar("N", bound=Noise)
"""the noise of one kind of recording"""


class HasState(Protocol):
    """A session of any kind."""

    @property
    def state(self) -> ChainState:
        """Its n rows or poses."""
        ...


@dataclass(frozen=True)
class Picture:
    """What a report draws: residuals (C, n) after the base fit alone, and with the claims; g, gyros rad/s."""

    session: HasState
    before: Array
    after: Array
    channels: tuple[str, ...] = ("ax", "ay", "az")
    units: tuple[str, ...] = ()
    """of the channels, where these are no readings of the tool"""
    covariates: Mapping[str, Array] = field(default_factory=dict)
    """(n,) what residuals may be drawn over beside the state"""
    recorded: Array | None = None
    """(C, n) the readings themselves, where a simulation stands beside them"""
    parts: Mapping[str, Array] = field(default_factory=dict)
    """(C, n) what each claim alone does, at its fitted size, beside all the others"""
    sigma: tuple[float, ...] = ()
    """noise of one row of each channel"""


def parts_of(base: ForwardModel, fit: JointFit | None, seen: Seen) -> dict[str, Array]:
    """What each claim of a fit does to the readings, by effect: the fit's residual without it, less the residual."""
    if fit is None or fit.model is None:
        return {}
    known = base.parameters()
    found = {}
    for effect in fit.parameters:
        lacking = fit.model.with_effects({effect: known[effect]}) if effect in known else fit.model.without(effect)
        found[effect] = seen.residual(lacking) - fit.residual
    return found


@dataclass(frozen=True)
class Judged(Generic[N]):
    """What one noise model leads to: the race and the scan with their thresholds, and what was chosen."""

    selector: Selector
    scan: Scan
    scan_threshold: float
    members: list[Member]
    noise: N
    fit: JointFit | None = None
    """base and named members refitted together, where that has been done"""
    refits: Mapping[Member, Sequence[Refitted]] = field(default_factory=dict)
    """of members that are strong their nearest rivals, fitted in full"""


@dataclass(frozen=True)
class Scene(ABC, Generic[N]):
    """All that is prepared before anything is chosen."""

    candidates: list[Candidate]
    blind: list[Blind]
    free: tuple[str, ...]
    seed: int
    method: Method = field(default=WHOLE, kw_only=True)
    bend: Array | float = field(default=0.0, kw_only=True)
    """(C, n) what strong effects do beyond first order: taken out of the residual, as all is chosen to first order"""

    def variant(self, member: Member) -> Variant:
        """The variant that a member stands for."""
        return self.candidates[member.candidate].variants[member.variant]

    @property
    def bent(self) -> bool:
        """Whether anything beyond first order has been taken out."""
        return bool(np.any(self.bend))

    @property
    def straightens(self) -> bool:
        """Whether what strong effects do beyond first order can be taken out."""
        return False

    @property
    def slow_ids(self) -> frozenset[str]:
        """Ids of the effects that a walk may look like here."""
        return frozenset(c.id for c in self.candidates if c.slow)

    @property
    def policy(self) -> ScenePolicy:
        """What names must show here to be given."""
        return ScenePolicy()

    def believed(self, judged: Judged[N], members: list[Member]) -> list[Member]:
        """The members that are large enough to be more than what is left of others."""
        return members

    def holds_up(self, member: Member) -> bool:
        """Whether a slow effect predicts stretches that were left out: asked where a transient could be named."""
        return True

    @property
    @abstractmethod
    def channels(self) -> tuple[str, ...]:
        """Names of the channels."""

    @property
    @abstractmethod
    def noise(self) -> N:
        """The noise without any memory."""

    @abstractmethod
    def judge(self, noise: N) -> Judged[N]:
        """Prepare the race and the scan under a noise model; nothing is chosen yet."""

    @abstractmethod
    def likelihoods(self, members: Sequence[Member]) -> list[Channel]:
        """Each channel's likelihood under noise with memory, base and members projected off."""

    @abstractmethod
    def block(self, members: Sequence[Member]) -> NDArray[Any]:
        """(k, C, ...) what the likelihoods know the members' columns by."""

    @abstractmethod
    def slow(self) -> list[SlowEffect]:
        """The slow candidates, as the likelihoods know them."""

    @abstractmethod
    def with_memory(self, memories: Sequence[Memory]) -> N:
        """The noise with the memory of each channel."""

    @abstractmethod
    def fit(self, members: Sequence[Member], noise: N, *, bends: bool = True) -> JointFit:
        """Base and named members refitted together; without `bends` as far as the misfit shows."""

    def glance(self, members: Sequence[Member]) -> float | None:
        """Chi-square that base and members leave in some of the readings, where a fit to all takes long."""
        return None

    def straightened(self, bend: Array | float, *, learn: bool = True) -> Self | None:
        """The scene with another `bend` (C, n), its noise learned anew or kept; None where nothing is taken out."""
        return None

    @abstractmethod
    def locate(self, judged: Judged[N], signal: Array, space: Array, p: float, share: float) -> tuple[Location, ...]:
        """Where a whitened signal outside of a space sits."""

    def locate_whole(
        self, judged: Judged[N], signal: Array, members: Sequence[Member], p: float, share: float
    ) -> tuple[Location, ...]:
        """Where sits all that base and members leave, of which `signal` is what chance does not explain."""
        return self.locate(judged, signal, judged.selector.space_with(members), p, share)

    def completed(self, diagnosis: Diagnosis) -> Diagnosis:
        """The diagnosis with what is no regression: found by the scatter, not by the mean."""
        return diagnosis

    @abstractmethod
    def advice(self, member: Member, r: Rivalry, fit: JointFit) -> str:
        """What to measure next to split a claim's class, in words."""

    @abstractmethod
    def proof(self, members: Sequence[Member], fit: JointFit) -> Fit:
        """In-sample and held-out misfit."""

    @abstractmethod
    def picture(self, fit: JointFit | None) -> Picture:
        """Residuals before and after."""

    @abstractmethod
    def told_of_noise(self) -> dict[str, Any]:
        """The noise in plain values."""
