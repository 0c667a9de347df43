"""The words of the commands, and their keys: one for buttons, keys, sentences and what is typed."""

from __future__ import annotations

from highside.bench.session.snapshot import CommandName

LABELS = {
    CommandName.START: ("Start", "s"),
    CommandName.CAPTURE: ("Take now", " "),
    CommandName.ACCEPT: ("Accept", "a"),
    CommandName.RESUME: ("Go on", "g"),
    CommandName.PAUSE: ("Pause", "p"),
    CommandName.REDO: ("Redo last", "r"),
    CommandName.SKIP: ("Skip", "k"),
    CommandName.UNDO: ("Undo", "u"),
    CommandName.REJECT: ("Reject", "x"),
    CommandName.ABORT: ("Abort", "Q"),
    CommandName.ACTIVATE: ("Put in force", "F"),
    CommandName.ROLLBACK: ("Roll back", "B"),
}
"""Word and key; what cannot be undone is a capital, so that no glove hits it."""


def label(name: CommandName) -> str:
    """The word on its button."""
    return LABELS[name][0]


def understood(line: str) -> tuple[CommandName, str | None] | None:
    """What somebody typed: a command by its name or its word ("redo 3", "go on"), and the rest; None: neither."""
    text = " ".join(line.split())
    known = {label(name): name for name in LABELS} | {name.value: name for name in CommandName}
    for word in sorted(known, key=len, reverse=True):
        if text.lower() == word.lower() or text.lower().startswith(f"{word.lower()} "):
            return known[word], text[len(word) :].strip() or None
    return None
