"""What the library says of an argument, a command says of its option: `pose_sigma_deg` is `--pose-sigma-deg`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from highside.errors import InputError


@contextmanager
def as_options(*names: str, **options: str) -> Iterator[None]:
    """Within it an InputError about one of these arguments names the option of that name, or the one that is given."""
    try:
        yield
    except InputError as error:
        if error.field in options:
            raise InputError(error.what, where=error.where, field=options[error.field], remedy=error.remedy) from None
        if error.where is None and error.field in names:
            option = "--" + error.field.replace("_", "-")
            raise InputError(error.what, field=option, remedy=error.remedy) from None
        raise
