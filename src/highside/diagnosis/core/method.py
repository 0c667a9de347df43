"""What the procedure is made of, so that the worth of a part can be measured by leaving it out.

Nobody who wants a diagnosis leaves anything out. Measured are: that noise has a memory and a size that changes, that
an effect is fitted jointly with what the base fit adjusts anyway, and that a name may be refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from highside.errors import InputError


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
        """All parts but one. Raises InputError for a part that there is not."""
        if part is None:
            return cls()
        if part not in cls.__slots__:
            names = ", ".join(cls.__slots__)
            raise InputError(f"'{part}' is no part of the method", field="without", remedy=f"one of {names}")
        return replace(cls(), **{part: False})


WHOLE = ProcedureParts()
