"""What the watch over a tool's calibration says, in the reader's language."""

from __future__ import annotations

from markupsafe import Markup

from highside.web.tools.state import PARAMETERS_MAX, ToolState, number, text, texts
from highside.web.words import _, told
from highside.words.marked import in_words

AXES = ("x", "y", "z")
"""of a sensor: of no more is noise told"""


def duration(seconds: float) -> str:
    """In the unit that people would use."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    if seconds < 172_800:
        return f"{seconds / 3600:.0f} h"
    return _("%(count)s days") % {"count": f"{seconds / 86_400:.0f}"}


def advice(tool: ToolState) -> list[Markup | str]:
    """What the watch says is to be done, the first first."""
    return [in_words(line, of="watch") for line in texts(tool.watch.get("advice"))]


def watch_words(tool: ToolState) -> str:
    """What the watch says, in a sentence."""
    verdict = text(tool.watch.get("verdict"))
    if not verdict:
        return _("Nothing watches over the calibration of this tool, or it has said nothing yet.")
    hours = None if verdict == "off" else number(tool.watch.get("watched_s"))
    since = "" if hours is None else ", " + _("watched for %(time)s") % {"time": duration(hours)}
    began = told(text(tool.watch.get("began")), "watch")
    said = _("The watch says: %(verdict)s.") % {
        "verdict": f"{told(verdict, 'watch')}{since}{f'; {began}' if began else ''}"
    }
    return " ".join([said, *_noise_words(tool)])


def _noise_words(tool: ToolState) -> list[str]:
    """Of axes whose noise has changed, and where it is not known whether it has: a sentence each."""
    changes, words = tool.watch.get("noise_changes"), []
    found = [
        f"{text(one.get('axis'))} {factor:.2g} ×"
        for one in (changes if isinstance(changes, list) else [])[: len(AXES)]
        if isinstance(one, dict) and (factor := number(one.get("factor"))) is not None
    ]
    if found:
        words.append(_("At rest these axes scatter otherwise than before: %(axes)s.") % {"axes": ", ".join(found)})
    if (number(tool.watch.get("undecided")) or 0.0) > 0.0:
        words.append(_("The last measurements are noise that has grown or a departure; the next ones tell."))
    return words


def unseen(tool: ToolState) -> list[tuple[str, Markup | str]]:
    """What it would take to see the parameters that were not: the names, and the reason that they share."""
    reasons: dict[str, list[str]] = {}
    for name, why in list(found.items() if isinstance(found := tool.watch.get("not_observable"), dict) else ())[
        :PARAMETERS_MAX
    ]:
        reasons.setdefault(text(why), []).append(text(name))
    return [(", ".join(names), in_words(why, of="watch")) for why, names in reasons.items() if why]
