"""An error in the reader's language."""

from __future__ import annotations

from highside.errors import HighsideError, InputError
from highside.printable import one_line
from highside.words.catalogue import told


def error_told(error: HighsideError) -> str:
    """What is wrong, where, and what to do, in one line, as `str(error)`: what of it is a sentence of the catalogue is
    told, the rest (names, texts of files and of the operating system) stays as it is."""
    if not isinstance(error, InputError) or not hasattr(error, "what"):
        first = error.args[0] if error.args else ""
        return one_line(told(first)) if isinstance(first, str) else str(error)
    line = ": ".join(part for part in (error.where, error.field, told(error.what)) if part)
    return one_line(f"{line}; {told(error.remedy)}" if error.remedy else line)
