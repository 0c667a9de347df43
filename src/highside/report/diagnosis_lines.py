"""A diagnosis in lines: what a terminal shows of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from highside.diagnosis.core.result import DiagnosisResult
from highside.report.diagnosis_claims import claim_size, confounded, first_sentence, others_of
from highside.report.diagnosis_words import blame, tested, verdict_words
from highside.report.misfit_steps import shares_of
from highside.words import _, told

if TYPE_CHECKING:
    from highside.diagnosis.core.problem import ReportData
    from highside.diagnosis.table.engine import SummaryReportData


def lines_of(diagnosis: DiagnosisResult, report_data: ReportData | SummaryReportData | None) -> list[str]:
    """Verdict, claims, causes, what to look at."""
    # the shares that the page has
    said = first_sentence(diagnosis, shares_of(diagnosis, report_data), verdict_words(diagnosis))
    lines = [f"{diagnosis.verdict} - {said}{tested(diagnosis)}"]
    for claim in diagnosis.claims:
        lines.append(f"{claim.effect}: {claim_size(claim)}")
        if others_of(claim):
            lines.append(f"  {confounded(claim)}")
    if blame(diagnosis):
        lines.append(_("to blame: %(what)s", what=blame(diagnosis)))
    # beside a name the first says what is left, and the page the others
    hints = diagnosis.remainder.hints if not diagnosis.claims else diagnosis.remainder.hints[:1]
    lines += [f"  {told(hint)}" for hint in hints]
    lines += [f"{found.check} ({', '.join(found.channels)}): {told(found.remedy)}" for found in diagnosis.intake]
    return lines
