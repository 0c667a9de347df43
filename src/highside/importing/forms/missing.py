"""What is said where the library of a form is not installed, or fails on a file."""

from __future__ import annotations

from highside.errors import InputError

_SHOWN = 120


def not_installed(package: str, where: str) -> InputError:
    """For a form whose library is in the extra `import`."""
    return InputError(f"needs {package}, which is not installed", where=where, remedy="pip install 'highside[import]'")


def damaged(kind: str, error: Exception, where: str) -> InputError:
    """For whatever a library says of a file that it cannot read."""
    message = " ".join(str(error).split())[:_SHOWN] or type(error).__name__
    return InputError(f"is a damaged {kind} file ({message})", where=where, remedy="give the right file")
