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


@pytest.mark.parametrize(
    "other",
    [
        "from scipy.special import gamma; assert gamma(4.0) == 6.0",
        "from scipy import special; assert special.gamma(4.0) == 6.0",
        "import scipy.special; assert scipy.special.gamma(4.0) == 6.0",
        "import scipy.special._ufuncs as compiled; assert compiled.gamma(4.0) == 6.0",
        "import scipy.stats; assert scipy.stats.norm.cdf(0.0) == 0.5",
        "import highside.special; assert highside.special.erfc(0.0) == 1.0",
    ],
)
def test_another_thread_may_import_the_package_meanwhile(other: str) -> None:
    """It begins in the middle of the import, for which the compiled module takes its time, and finds all there is."""
    assert ended_well(f"""
import sys, threading, time
failed, begun = [], threading.Event()
def other():
    begun.wait(30)
    try:
        {other}
    except BaseException as error:
        failed.append(repr(error))
class Slow:
    def find_spec(self, name, path=None, target=None):
        if name == "scipy.special._ufuncs" and not begun.is_set():
            begun.set()
            time.sleep(0.4)
import scipy
sys.meta_path.insert(0, Slow())
thread = threading.Thread(target=other)
thread.start()
import highside.special
thread.join(30)
assert begun.is_set() and not thread.is_alive() and not failed, failed
import scipy.special
assert [n for n in highside.special.__all__ if getattr(scipy.special, n) is not getattr(highside.special, n)] == []
assert scipy.special.__file__ and type(sys.modules["scipy.special"]) is type(sys)
""")
