"""An error in the reader's language."""

from __future__ import annotations

from highside.errors import HighsideError, InputError
from highside.printable import one_line
from highside.words.catalogue import _, told

_ALSO = " | also "
"""Between several mistakes of one file (`config.mistakes`)"""


def error_told(error: HighsideError, of: str = "") -> str:
    """What is wrong, where, and what to do, in one line, as `str(error)`: what of it is a sentence of the catalogue is
    told, the rest (names, texts of files and of the operating system) stays as it is. `of`: as of `told`."""
    if not isinstance(error, InputError) or not hasattr(error, "what"):
        first = error.args[0] if error.args else ""
        return one_line(told(first, of)) if isinstance(first, str) else str(error)
    line = ": ".join(part for part in (error.where, error.field, told(error.what, of)) if part)
    if not error.remedy:
        return one_line(line)
    # the first of several mistakes may have nothing that is to be done
    first, *others = f" {error.remedy}".split(_ALSO)
    remedy = f"; {told(first.strip(), of)}" if first.strip() else ""
    return one_line(_(_ALSO).join([f"{line}{remedy}", *(_also(one, of) for one in others)]))


def _also(mistake: str, of: str) -> str:
    """A further mistake: its field, what is wrong, what to do."""
    field, colon, rest = mistake.partition(": ")
    if not colon or " " in field:
        return told(mistake, of)
    return f"{field}: {'; '.join(told(part, of) for part in rest.split('; '))}"
