"""Functions of probability as `scipy.special` computes them, without the rest of that package.

Its `__init__` copies numpy's whole namespace and with it imports `numpy.f2py`, `numpy.testing` and `unittest`: 0.1 s
before a diagnosis of 0.3 s. The functions are compiled in a module of it that needs none of that. They are the same
objects (`tests/unit/test_special.py`), also where the package is imported after them: it is then given the modules that
are there already, which Python does only for those that it imports itself. A scipy that is laid out differently is
imported whole.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scipy.special import (
        bdtrc,
        betaln,
        chdtrc,
        chdtri,
        erfc,
        fdtrc,
        fdtri,
        gammainccinv,
        gammaln,
        ndtr,
        ndtri,
        stdtr,
        stdtrit,
    )

__all__ = [
    "bdtrc",
    "betaln",
    "chdtrc",
    "chdtri",
    "erfc",
    "fdtrc",
    "fdtri",
    "gammainccinv",
    "gammaln",
    "ndtr",
    "ndtri",
    "stdtr",
    "stdtrit",
]

_PACKAGE = "scipy.special"


class _Completing(MetaPathFinder):
    """Gives the package, when it is imported, its modules that were imported before it: without `_special_ufuncs` its
    `errstate` and `seterr` fail."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != _PACKAGE or self not in sys.meta_path:
            return None
        sys.meta_path.remove(self)
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def complete(module: ModuleType) -> None:
            for name, one in [*sys.modules.items()]:
                parent, _, own = name.rpartition(".")
                if parent == _PACKAGE:
                    setattr(module, own, one)
            execute(module)

        spec.loader.exec_module = complete  # type: ignore[method-assign]
        return spec


class _FoundError(ImportError):
    """The compiled module is there, and nothing more of the package is wanted."""


class _Beside(MetaPathFinder, Loader):
    """Imports the compiled module alone in the place of its package.

    It does so as the import of the package by one thread, which then is broken off: whoever else imports the package
    meanwhile waits until that is over, as for any import, and then imports it whole. (Python itself does not wait for a
    package whose private module is imported by name: in that moment it may be found half there.)
    """

    def __init__(self) -> None:
        self._thread = threading.get_ident()

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != _PACKAGE or threading.get_ident() != self._thread:
            return None
        spec = ModuleSpec(fullname, self, is_package=True)
        spec.submodule_search_locations = [f"{folder}/special" for folder in path or ()]
        return spec

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return _BrokenOff(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        try:
            found = import_module(f"{_PACKAGE}._ufuncs")
            if all(hasattr(found, name) for name in __all__):
                sys.meta_path.insert(0, _Completing())
                raise _FoundError
        finally:
            module.__dict__["over"] = True


class _BrokenOff(ModuleType):
    """The package while it is imported for its compiled module alone. Who took hold of it meanwhile and waited for the
    end of that import has the package by it."""

    def __getattr__(self, name: str) -> Any:
        if "over" not in self.__dict__:
            raise AttributeError(f"module {_PACKAGE!r} has no attribute {name!r} yet")
        return getattr(import_module(_PACKAGE), name)


def _compiled() -> Any:
    """scipy's module of compiled functions, imported beside its package; the package where that cannot be."""
    if _PACKAGE not in sys.modules:
        beside = _Beside()
        sys.meta_path.insert(0, beside)
        try:
            import_module(_PACKAGE)
        except _FoundError:
            return sys.modules[f"{_PACKAGE}._ufuncs"]
        except ImportError:
            pass
        finally:
            sys.meta_path.remove(beside)
        if isinstance(sys.modules.get(_PACKAGE), _BrokenOff):
            del sys.modules[_PACKAGE]
    return import_module(_PACKAGE)


if not TYPE_CHECKING:
    _functions = _compiled()
    globals().update({name: getattr(_functions, name) for name in __all__})
