"""What problems of readings at rest have in common: parts whose sizes must agree, what is left, and their intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.problem import HasState, N, Problem, SelectionState
from highside.diagnosis.core.regression import outside
from highside.diagnosis.core.stability import Stability, splits_of, stability


class StillSession(HasState, Protocol):
    """Readings at rest, one of each still interval."""

    @property
    def n(self) -> int:
        """How many are used."""
        ...

    @property
    def expected(self) -> int:
        """About how many there are; 0 where that is not known."""
        ...


class StillProblem(Problem[N]):
    """A problem whose terms have their columns (k, C, n) at hand, a reading for each still interval."""

    if TYPE_CHECKING:

        @property
        def session(self) -> StillSession: ...

    def stability(self, selection: SelectionState[N], term: Term) -> Stability | None:
        selector = selection.selector
        others = selector.space_with([o for o in selection.terms if o != term])
        return stability(
            self.variant(term).columns,
            selection.noise.white,
            others,
            selector.residual,
            selector.freedom,
            splits_of(self.session.state),
        )

    def mean_square_left(self, selection: SelectionState[N]) -> float | None:
        space = selection.selector.space_with(selection.terms)
        left = outside(space, selection.selector.residual)
        return float(left @ left) / max(left.size - len(space), 1)

    @property
    def intervals(self) -> tuple[int, int] | None:
        return self.session.n, max(self.session.n, self.session.expected)
