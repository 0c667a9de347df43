"""Laws: what a recording shows that no effect of the library is, as smooth functions of covariates in some place.

`problem.LawProblem` is what the search sees of a session, `groups` what is tried, `noise` the rival, `search` the way,
`claims` what is reported, `formulas` and `readings` what a curve may be. The room knows no kind of session: `chain`
makes the problem of one with known attitudes, and who calls it gives the readings.
"""

from __future__ import annotations

__all__ = ["chain", "claims", "problem", "search"]
"""the ways in: modules, loaded when they are asked for"""
