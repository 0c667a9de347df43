"""Who the answer being made is for: known to all that is called for a request, templates and threads included."""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass

from highside.web.signin.acts import Person
from highside.words.catalogue import in_language as in_language
from highside.words.catalogue import language as present_language
from highside.words.catalogue import speak


@dataclass(frozen=True, slots=True)
class Viewer:
    """`person`: who is signed in, or has shown the token; None: nobody. `signs_in`: whether people sign in here."""

    person: Person | None = None
    signs_in: bool = False

    @property
    def language(self) -> str:
        """What the words are in."""
        return present_language()


_CURRENT: ContextVar[Viewer] = ContextVar("viewer", default=Viewer())  # noqa: B039 - frozen


def viewer() -> Viewer:
    """Of the request that is being answered."""
    return _CURRENT.get()


def answer_for(person: Person | None, *, signs_in: bool, language: str = "en") -> None:
    """From here on, in this task and what it starts, answers are for this viewer."""
    _CURRENT.set(Viewer(person, signs_in))
    speak(language)


def labelled(text: str) -> str:
    """The property of an element by which a screen reader names it."""
    return f'aria-label="{text}"'
