"""Fixtures that all tests may use."""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest

# before numpy is loaded: the matrices are small, and threads that wait for one another at each product make the suite
# several times slower (a regression of `test_blind_scoring.py`: 65 s of two busy processors with, 8 s without them)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# whatever language the terminal of whoever runs the tests is in
os.environ["HIGHSIDE_LANGUAGE"] = "en"

from highside.attitude import compiled

ROOT = Path(__file__).resolve().parent.parent
SHARED_DATA = Path(os.environ.get("HIGHSIDE_DATA") or ROOT.parent / "shared" / "data")


# started in the background of a script, the tests would inherit ignored signals and pass them on to every command they
# start, which could then not be interrupted
for _number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _number == signal.SIGINT else signal.SIG_DFL)


@pytest.fixture(autouse=True, scope="session")
def own_folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folders where things are kept unless told otherwise: fresh ones, never those of who runs the tests."""
    folder = tmp_path_factory.mktemp("home")
    before = {name: os.environ.get(name) for name in ("XDG_DATA_HOME", "XDG_STATE_HOME")}
    os.environ |= {"XDG_DATA_HOME": str(folder / "data"), "XDG_STATE_HOME": str(folder / "state")}
    yield folder
    for name, value in before.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


@pytest.fixture(scope="session")
def project_root() -> Path:
    """The top of the checkout."""
    return ROOT


@pytest.fixture
def brackets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[None]:
    """German is a language in which each message stands in brackets; with the parameter False its values do not."""
    from highside.words import catalogue
    from tests.brackets import put_in_brackets

    put_in_brackets(tmp_path, values=getattr(request, "param", True))
    monkeypatch.setattr(catalogue, "LOCALE", tmp_path)
    for kept in (catalogue.catalogue, catalogue._told):
        kept.cache_clear()
    yield
    for kept in (catalogue.catalogue, catalogue._told):
        kept.cache_clear()


@pytest.fixture(params=["compiled", "numpy"])
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Bulk corrections by the compiled loops, then by numpy, whatever the number of readings."""
    monkeypatch.setattr(compiled, "COMPILED_FROM", 0 if request.param == "compiled" else 1 << 62)
    assert compiled.wanted(1) == (request.param == "compiled"), "the tests need numba (the extra fast)"
    return str(request.param)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real recordings made by others, beside the checkout. Absent: skipped, but a failure under CI."""
    if not SHARED_DATA.is_dir():
        _without_recording(SHARED_DATA)
    return SHARED_DATA


def _without_recording(missing: Path) -> None:
    reason = (
        f"no real recordings at {missing}: `make data` fetches them, or HIGHSIDE_DATA names the folder that has them"
    )
    for one in _listed():
        if missing == SHARED_DATA / one["path"] and "url" not in one:
            reason = (
                f"no {missing}: it cannot be fetched ({one['not_fetched']}); HIGHSIDE_DATA names a folder that has it"
            )
    if os.environ.get("CI") == "true":
        pytest.fail(f"{reason}; CI must not skip these tests", pytrace=False)
    pytest.skip(reason)


def _listed() -> list[dict[str, Any]]:
    listed: list[dict[str, Any]] = json.loads((ROOT / "tests/data/recordings.json").read_text())["recordings"]
    return listed


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """One line for all tests that lacked a recording."""
    listed = _listed()
    missing = [one for one in listed if not (SHARED_DATA / one["path"]).is_file()]
    if missing:
        fetched = sum("url" in one for one in missing)
        terminalreporter.write_line(
            f"real recordings: {len(missing)} of {len(listed)} are not in {SHARED_DATA}; `make data` fetches {fetched},"
            " the others are at no address (tests/data/recordings.json has the reasons):"
            " HIGHSIDE_DATA names a folder that holds them"
        )


def _missing_recording(error: Exception) -> Path | None:
    """The file below the folder of recordings that an error names and that is not there: not all can be fetched."""
    for word in re.findall(re.escape(str(SHARED_DATA)) + r"/[\w./-]+", str(error)):
        if not (path := Path(word.rstrip("."))).exists():
            return path
    return None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Under CI a test that is skipped, for whatever reason, has failed: it shows nothing."""
    report = yield
    if report.skipped and not hasattr(report, "wasxfail") and os.environ.get("CI") == "true":
        report.outcome, report.longrepr = "failed", f"skipped, which CI must not do: {report.longrepr}"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Generator[None, None, None]:
    """A fixture that needs a recording which is not there is treated as `shared_data` treats the folder."""
    return (yield from _with_recordings())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, None, None]:
    """Likewise a test."""
    return (yield from _with_recordings())


def _with_recordings() -> Generator[None, None, None]:
    try:
        return (yield)
    except Exception as error:
        if (missing := _missing_recording(error)) is not None:
            _without_recording(missing)
        raise
