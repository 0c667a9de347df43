"""The search for cycles of objects rests while a command is loaded, and goes on in its work."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest

from highside.cli.loading import loading

BEGUN = "import gc\nfrom highside.cli.loading import loading, own_process\nown_process()\n"


def ends_well(program: str) -> None:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_it_rests_while_modules_are_loaded_and_goes_on_afterwards() -> None:
    ends_well(
        BEGUN + "with loading():\n    assert not gc.isenabled()\n    with loading():\n        pass\n"
        "    assert not gc.isenabled(), 'the inner one has ended the outer'\n"
        "assert gc.isenabled() and gc.get_freeze_count() > 1000"
    )


def test_it_goes_on_after_what_could_not_be_loaded() -> None:
    failing = "try:\n    with loading():\n        import no_such_module\nexcept ImportError:\n    pass\n"
    ends_well(BEGUN + failing + "assert gc.isenabled()")


def test_who_has_switched_it_off_finds_it_so() -> None:
    ends_well(BEGUN + "gc.disable()\nwith loading():\n    pass\nassert not gc.isenabled()")


def test_in_the_process_of_another_nothing_changes() -> None:
    assert gc.isenabled()
    with loading():
        assert gc.isenabled()
    with pytest.raises(ImportError), loading():
        raise ImportError
    assert gc.isenabled()


def test_the_work_of_a_command_is_done_with_the_search() -> None:
    ends_well(
        "import gc, sys\nfrom highside.api import diagnosis\n"
        "def asked(*_, **__):\n    print(gc.isenabled(), file=sys.stderr)\n    sys.exit(0 if gc.isenabled() else 3)\n"
        "diagnosis.diagnose = asked\n"
        "sys.argv = ['highside', 'diagnose', 'x.csv', '--out', 'x']\n"
        "from highside.cli.main import main\nmain()"
    )
