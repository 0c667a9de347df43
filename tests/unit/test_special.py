"""The functions of `highside.special` are scipy's own, whichever of the two is imported first."""

from __future__ import annotations

import subprocess
import sys

import pytest

from highside import special

SAME = """
import scipy.{package}
import scipy.special as package
assert [name for name in special.__all__ if getattr(package, name) is not getattr(special, name)] == []
assert scipy.special.__file__
"""


def ended_well(program: str) -> bool:
    return subprocess.run([sys.executable, "-c", program], timeout=60, check=False).returncode == 0


@pytest.mark.parametrize("package", ["special", "stats", "optimize"])
@pytest.mark.parametrize("first", ["import scipy.special", "import sys; assert 'scipy.special' not in sys.modules"])
def test_they_are_the_functions_of_the_package(first: str, package: str) -> None:
    assert ended_well(f"{first}\nfrom highside import special\n" + SAME.format(package=package))


def test_the_package_is_whole_where_it_is_imported_after_them() -> None:
    """Its errors are switched in a module that was there before it: `seterr` and `errstate` failed."""
    assert ended_well(
        "import sys\nfrom highside import special\nassert 'scipy.special' not in sys.modules\n"
        "import scipy.special as package\n"
        "before = {name for name in sys.modules if name.startswith('scipy.special._')}\n"
        "assert [name for name in before if not hasattr(package, name.rpartition('.')[2])] == []\n"
        "try:\n    with package.errstate(all='raise'):\n        package.gamma(-1.0)\n"
        "except package.SpecialFunctionError:\n    sys.exit(0)\nsys.exit(1)"
    )


def test_the_package_itself_is_not_imported() -> None:
    assert ended_well(
        "import sys; import highside.special; assert not {'scipy.special', 'unittest'} & set(sys.modules)"
    )


def test_a_scipy_that_is_laid_out_differently_is_imported_whole() -> None:
    elsewhere = "import sys; sys.modules['scipy.special._ufuncs'] = None\n"
    program = elsewhere + "import highside.special, types\n"
    # the package needs its own module too: what is asked for is the package, which then says what it lacks
    assert not ended_well(program)
    renamed = (
        "import sys, types, scipy\n"
        "sys.modules['scipy.special._ufuncs'] = types.ModuleType('empty')\n"
        "whole = types.ModuleType('scipy.special')\n"
        f"names = {special.__all__!r}\n"
        "whole.__dict__.update(dict.fromkeys(names, abs))\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'scipy.special':\n"
        "            from importlib.machinery import ModuleSpec\n"
        "            return ModuleSpec(name, self)\n"
        "    def create_module(self, spec): return whole\n"
        "    def exec_module(self, module): pass\n"
        "sys.meta_path.insert(0, Finder())\n"
        "import highside.special\n"
        "assert highside.special.chdtrc is abs\n"
    )
    assert ended_well(renamed)
