"""The single words of a tool's messages are said in the reader's language: every one that the service can send."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import get_args

import pytest

from highside.link.base import LinkState
from highside.service.messages import DriftMessage
from highside.service.outputs import SurveyReason
from highside.service.recorder_stats import RecorderState
from highside.web.tools.signs import FLAGS, LINK, MOTION, REASONS, RECORDER, all_meant, event_words, meant
from highside.web.tools.state import Tools
from highside.web.tools.views import Broker, tool_page
from highside.words.catalogue import LANGUAGES, in_language

README = Path(__file__).parents[2] / "README.md"
HERE = Broker("here:1883", True, "", 0.0)


def test_every_state_and_reason_has_its_words() -> None:
    assert set(LINK) == {state.value for state in LinkState}
    assert set(RECORDER) == {state.value for state in RecorderState}
    assert set(MOTION) == set(get_args(DriftMessage.model_fields["motion"].annotation))
    assert set(REASONS) >= {reason.value for reason in SurveyReason}


def test_every_flag_of_the_readme_has_its_words() -> None:
    said = README.read_text(encoding="utf-8")
    listed = re.search(r"`flags` of an attitude: (.*?)An attitude refers", said, re.S)
    assert listed is not None
    named = set(re.findall(r"`([a-z_]+)`", listed[1])) - {"ay", "az"} | {"stuck_ay", "stuck_az"}
    assert len(named) > 20
    # `gyro_saturated` stands on the azimuth
    assert set(FLAGS) == named | {"gyro_saturated"}


@pytest.mark.parametrize("language", [code for code in LANGUAGES if code != "en"])
def test_no_word_stays_english(language: str) -> None:
    with in_language(language):
        for of in (LINK, RECORDER, MOTION, REASONS, FLAGS):
            left = {word for word in of if meant(word, of) == of[word]}
            assert not left, left


def test_an_unknown_word_is_shown_as_it_came() -> None:
    assert meant("of_another_version", FLAGS) == "of_another_version"
    assert all_meant(("moved", "<b>"), REASONS) == "moved, <b>"


def test_the_log_is_in_the_language_too() -> None:
    with in_language("de"):
        assert event_words("survey refused: moved, g_total_high") == "Survey abgelehnt: bewegt, Gtotal zu groß"
        assert event_words("flag outside_zone is over") == "Merkmal außerhalb der Zone der Kalibrierung ist vorbei"
        assert event_words("is online") != "is online"


def heard(tools: Tools, rms_g: list[float]) -> None:
    payload = json.dumps({"vibration": {"rms_g": rms_g}}).encode()
    tools.take("highside/a/health", payload, retained=False, mono=0.0, utc=1.7e9)


def test_a_quiet_tool_does_not_shake_by_zero() -> None:
    tools = Tools("highside")
    heard(tools, [0.00021, 0.0004, 0.00032])
    assert "0.21 · 0.40 · 0.32 mg" in tool_page(tools.tools["a"], HERE, 1.0).state
    heard(tools, [0.00021, 2.5, 0.3])
    assert "0.000 · 2.500 · 0.300 g" in tool_page(tools.tools["a"], HERE, 2.0).state
