"""Functions of probability as `scipy.special` computes them, without the rest of that package.

Its `__init__` copies numpy's whole namespace and with it imports `numpy.f2py`, `numpy.testing` and `unittest`: 0.1 s
before a diagnosis of 0.3 s. The functions are compiled in a module of it that needs none of that. They are the same
objects (`tests/unit/test_special.py`), also where the package is imported after them; a scipy that is laid out
differently is imported whole.
"""

from __future__ import annotations

import sys
from importlib import import_module
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
                return found
        except ImportError:
            pass
        finally:
            del sys.modules[_PACKAGE]
    return import_module(_PACKAGE)


if not TYPE_CHECKING:
    globals().update({name: getattr(_compiled(), name) for name in __all__})
