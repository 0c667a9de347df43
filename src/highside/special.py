"""Functions of probability as `scipy.special` computes them, without the rest of that package.

Its `__init__` copies numpy's whole namespace and with it imports `numpy.f2py`, `numpy.testing` and `unittest`: 0.1 s
before a diagnosis of 0.3 s. The functions are compiled in a module of it that needs none of that. They are the same
objects (`tests/unit/test_special.py`), also where the package is imported after them: it is then given the modules that
are there already, which Python does only for those that it imports itself. A scipy that is laid out differently is
imported whole.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
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


def _compiled() -> Any:
    """scipy's module of compiled functions, imported beside its package; the package where that cannot be."""
    if _PACKAGE not in sys.modules:
        import scipy

        folder = ModuleType(_PACKAGE)
        folder.__path__ = [f"{path}/special" for path in scipy.__path__]
        sys.modules[_PACKAGE] = folder
        try:
            found = import_module(f"{_PACKAGE}._ufuncs")
            if all(hasattr(found, name) for name in __all__):
                sys.meta_path.insert(0, _Completing())
                return found
        except ImportError:
            pass
        finally:
            del sys.modules[_PACKAGE]
    return import_module(_PACKAGE)


if not TYPE_CHECKING:
    globals().update({name: getattr(_compiled(), name) for name in __all__})
