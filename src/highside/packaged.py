"""What travels with the package beside its code: the example configurations, and the documentation as a built site."""

from __future__ import annotations

from pathlib import Path

from highside.errors import InputError

_PACKAGE = Path(__file__).resolve().parent
_KINDS = {".toml", ".json", ".dbc", ".conf", ".acl"}


def example_files() -> dict[str, Path]:
    """The example configurations by name: of an installed package, or of the checkout it is installed from."""
    for folder in (_PACKAGE / "data" / "config", _PACKAGE.parent.parent / "config"):
        if folder.is_dir():
            return {path.name: path for path in sorted(folder.iterdir()) if path.suffix in _KINDS}
    return {}


def site() -> Path:
    """The folder of the built documentation. Raises InputError where none was built."""
    folder = _PACKAGE / "site"
    if not (folder / "index.html").is_file():
        raise InputError(
            "the documentation was not built into this installation", remedy="run `make docs` in the checkout"
        )
    return folder
