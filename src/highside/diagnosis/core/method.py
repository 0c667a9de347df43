"""What the procedure is made of, so that the worth of a part can be measured by leaving it out.

Nobody who wants a diagnosis leaves anything out. Measured are: that noise has a memory and a size that changes, that
an effect is fitted jointly with what the base fit adjusts anyway, and that a name may be refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class ProcedureParts:
    """The parts of the procedure; all are in force unless the method itself is under test."""

    colour: bool = True
    """else noise is white and equally large at all times on each channel"""
    refit: bool = True
    """else effects are tested against, and fitted to, what the base fit has left"""
    refusal: bool = True
    """else what explains most is named, whatever remains and however implausible its size"""
    laws: bool = True
    """else nothing but the library's effects is looked for"""

    @classmethod
    def without(cls, part: str | None) -> ProcedureParts:
        """All parts but one, by its field's name."""
        return cls() if part is None else replace(cls(), **{part: False})


WHOLE = ProcedureParts()
