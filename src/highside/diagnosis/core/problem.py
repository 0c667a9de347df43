"""A recording prepared for the diagnosis: what the procedure of `engine` needs of it, whatever kind it is.

Poses and rotation differ in how columns are made and whitened, how noise is learned and what a good next manoeuvre is.
What is chosen, compared and reported is the same, and sees only this.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np

from highside.arrays import AnyArray, Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import Candidate, Unobservable, Variant
from highside.diagnosis.core.effect_scores import EffectScores, WhiteLaw
from highside.diagnosis.core.fit import JointFit
from highside.diagnosis.core.floor import Excess
from highside.diagnosis.core.location import Scan
from highside.diagnosis.core.memory import Channel, Memory, SlowEffect
from highside.diagnosis.core.method import WHOLE, ProcedureParts
from highside.diagnosis.core.observed import ObservationModel
from highside.diagnosis.core.problem_policy import ProblemPolicy
from highside.diagnosis.core.repeatability import Remaining
from highside.diagnosis.core.result import Claim, DiagnosisResult, Fit, Location
from highside.diagnosis.core.rivals import Refitted, Rivalry
from highside.diagnosis.core.selection import Selector
from highside.diagnosis.core.stability import Stability
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
class ReportData:
    """What stands behind an answer: residuals (C, n) after the base fit alone, and with the claims; g, gyros rad/s."""

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
    within: Mapping[str, float] = field(default_factory=dict)
    """mean square, g^2, that laws of what rows do while poses are held take of the rows about the means of their poses:
    residuals are those of the means"""
    rows_per_independent: float = 1.0
    """rows that tell as much of the size of the noise as one would by itself: more than one where it has a memory"""
    scores: EffectScores | None = None
    """of every testable effect, for what is pooled over recordings"""
    withheld: tuple[Claim, ...] = ()
    """names at sizes that no instrument has: laws compete with them, and they are not claimed"""


def parts_of(base: ForwardModel, fit: JointFit | None, observed: ObservationModel) -> dict[str, Array]:
    """What each claim of a fit does to the readings, by effect: the fit's residual without it, less the residual."""
    if fit is None or fit.model is None:
        return {}
    known = base.parameters()
    found = {}
    for effect in fit.parameters:
        lacking = fit.model.with_effects({effect: known[effect]}) if effect in known else fit.model.without(effect)
        found[effect] = observed.residual(lacking) - fit.residual
    return found


@dataclass(frozen=True)
class SelectionState(Generic[N]):
    """What one noise model leads to: the score test and the scan with their thresholds, and what was chosen."""

    selector: Selector
    scan: Scan
    scan_threshold: float
    terms: list[Term]
    noise: N
    fit: JointFit | None = None
    """base and named terms refitted together, where that has been done"""
    refits: Mapping[Term, Sequence[Refitted]] = field(default_factory=dict)
    """of terms that are strong their nearest rivals, fitted in full"""
    to_the_floor: bool = False
    """whether the terms leave no more than how well the readings repeat: no random walk is a rival of them"""


@dataclass(frozen=True)
class Problem(ABC, Generic[N]):
    """All that is prepared before anything is chosen."""

    candidates: list[Candidate]
    unobservable: list[Unobservable]
    free: tuple[str, ...]
    seed: int
    method: ProcedureParts = field(default=WHOLE, kw_only=True)
    second_order: Array | float = field(default=0.0, kw_only=True)
    """(C, n) what strong effects do beyond first order: taken out of the residual, as all is chosen to first order"""

    def variant(self, term: Term) -> Variant:
        """The variant that a term stands for."""
        return self.candidates[term.candidate].variants[term.variant]

    def pooled_laws(self, noise: N) -> list[WhiteLaw]:
        """Laws whose scores are told beside those of the effects; none where their columns are not at hand."""
        return []

    @property
    def has_second_order(self) -> bool:
        """Whether anything beyond first order has been taken out."""
        return bool(np.any(self.second_order))

    @property
    def relinearises(self) -> bool:
        """Whether what strong effects do beyond first order can be taken out."""
        return False

    @property
    def slow_ids(self) -> frozenset[str]:
        """Ids of the effects that a random walk may look like here."""
        return frozenset(c.id for c in self.candidates if c.slow)

    @property
    def policy(self) -> ProblemPolicy:
        """What names must show here to be given."""
        return ProblemPolicy()

    def believed(self, selection: SelectionState[N], terms: list[Term]) -> list[Term]:
        """The terms that are large enough to be more than what is left of others."""
        return terms

    def remaining(self, terms: Sequence[Term]) -> Remaining | None:
        """What base and terms leave beside how well the readings repeat; None where that is not known."""
        return None

    def beyond_memory(self, selection: SelectionState[N], terms: Sequence[Term], cell: int, dof: int) -> bool:
        """Whether a cell of the scan, of `dof` directions beside the terms, is more than a noise with memory explains:
        asked where noise is learned from what is left."""
        return True

    def holds_up(self, term: Term) -> bool:
        """Whether a slow effect predicts stretches that were held out: tested where a transient could be named."""
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
    def prepare(self, noise: N) -> SelectionState[N]:
        """Prepare the score test and the scan under a noise model; nothing is chosen yet."""

    @abstractmethod
    def likelihoods(self, terms: Sequence[Term]) -> list[Channel]:
        """Each channel's likelihood under noise with memory, base and terms projected off."""

    @abstractmethod
    def block(self, terms: Sequence[Term]) -> AnyArray:
        """(k, C, ...) what the likelihoods know the terms' columns by."""

    @abstractmethod
    def slow(self) -> list[SlowEffect]:
        """The slow candidates, as the likelihoods know them."""

    @abstractmethod
    def with_memory(self, memories: Sequence[Memory]) -> N:
        """The noise with the memory of each channel."""

    @abstractmethod
    def fit(self, terms: Sequence[Term], noise: N, *, with_second_order: bool = True) -> JointFit:
        """Base and named terms refitted together; without `with_second_order` as far as the misfit shows."""

    def subsample_chi_square(self, terms: Sequence[Term]) -> float | None:
        """Chi-square that base and terms leave in a subsample, where a fit to all takes long."""
        return None

    def relinearised(self, second_order: Array | float, *, learn: bool = True) -> Self | None:
        """The problem with another `second_order` (C, n), its noise learned anew or kept; None where none is."""
        return None

    def learned_beside(self, selection: SelectionState[N]) -> Self | None:
        """The problem with its noise learned beside the terms, where these leave far less than it; None where not."""
        return None

    @abstractmethod
    def locate(
        self, selection: SelectionState[N], signal: Array, space: Array, p: float, share: float
    ) -> tuple[Location, ...]:
        """Where a whitened signal outside of a space sits."""

    def locate_whole(
        self, selection: SelectionState[N], signal: Array, terms: Sequence[Term], p: float, share: float
    ) -> tuple[Location, ...]:
        """Where sits all that base and terms leave, of which `signal` is what chance does not explain."""
        return self.locate(selection, signal, selection.selector.space_with(terms), p, share)

    readings = "readings"
    """what a fit explains here, in words"""

    def floor_excess(self, terms: Sequence[Term], *, pose_errors: bool = True) -> Excess | None:
        """What base and terms leave beside the floor of the noise; None where no floor is known. With `pose_errors`
        only what errors of the set angles, where the noise has them, cannot make."""
        return None

    def stability(self, selection: SelectionState[N], term: Term) -> Stability | None:
        """Whether the size of a term agrees over parts of the recording; None where that is not looked at."""
        return None

    def steady(self, selection: SelectionState[N], terms: list[Term]) -> tuple[list[Term], dict[str, Stability]]:
        """The terms without those that are small and change over the recording, and how these do, by id; where a change
        withdraws every name, as a rule, all stay."""
        return terms, {}

    @property
    def in_steps(self) -> tuple[Array, Array] | None:
        """(C,) step of the lattice on which each channel's rows lie (0.0: none), and what the base leaves of a row,
        both in the channel's unit; None where rows are averaged."""
        return None

    def mean_square_left(self, selection: SelectionState[N]) -> float | None:
        """What base and terms leave of a reading, in variances of the noise; None where sizes allow for it already."""
        return None

    @property
    def intervals(self) -> tuple[int, int] | None:
        """Still intervals that are used, and about how many there are; None where there are no such."""
        return None

    def completed(self, diagnosis: DiagnosisResult) -> DiagnosisResult:
        """The diagnosis with what is no regression: found by the scatter, not by the mean."""
        return diagnosis

    @abstractmethod
    def advice(self, term: Term, r: Rivalry, fit: JointFit) -> str:
        """What to measure next to split a claim's class, in words."""

    @abstractmethod
    def proof(self, terms: Sequence[Term], fit: JointFit) -> Fit:
        """In-sample and held-out misfit."""

    @abstractmethod
    def report_data(self, fit: JointFit | None) -> ReportData:
        """Residuals before and after."""

    @abstractmethod
    def noise_summary(self) -> dict[str, Any]:
        """The noise in plain values."""
