"""Whole sessions, with what goes wrong in them, in another language: every sentence that a face would show is known."""

from __future__ import annotations

import pytest
from rehearsal import Rehearsal

from highside.bench.session import plans
from highside.bench.session.plans import Limits, SessionPlan
from highside.bench.session.view import View
from highside.bench.simulated_operator import OperatorMistake
from highside.web import words
from highside.web.parts import parts_of
from highside.web.viewer import in_language

QUICK = Limits(std_error_g=3e-5, min_hold_s=1.5, max_hold_s=4.0)
SAME_IN_GERMAN = frozenset({"Plan", "Start"})
MISTAKES = [
    (1, OperatorMistake.SHOCK),
    (2, OperatorMistake.UNDO),
    (3, OperatorMistake.UNPLUG),
    (4, OperatorMistake.REPEAT),
    (5, OperatorMistake.WRONG_TF),
    (6, OperatorMistake.MOVE),
]


@pytest.mark.parametrize(
    "plan",
    [
        plans.balance_plan([12.0, 40.0], QUICK),
        plans.conventional_plan(6, QUICK),
        plans.unguided_plan(QUICK),
    ],
    ids=lambda plan: plan.kind.value,
)
def test_every_sentence_of_a_session_is_known(plan: SessionPlan) -> None:
    done = Rehearsal(plan, mistakes=MISTAKES)
    view, said = View(done.session), set[str]()

    def look(_now_s: float) -> None:
        snapshot = view.snapshot()
        said.update((snapshot.prompt, snapshot.plan.title, snapshot.last_rejection or ""))
        said.update(part for fault in snapshot.faults for part in (fault.text, fault.detail))
        said.update(row.text or "" for row in snapshot.poses)

    done.run(on_step=look)
    look(0.0)
    with in_language("de"):
        unknown = {text for text in said if text and words.told(text) == text} - SAME_IN_GERMAN
        page = parts_of(view.snapshot())
    assert len(said) > 12
    # a number of seconds is a number
    assert {text for text in unknown if any(letter.isalpha() for letter in text.replace(" s", ""))} == set()
    assert "angenommen" in page.sign
