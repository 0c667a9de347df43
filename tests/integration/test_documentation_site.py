"""The documentation site: broken links end the build, all is in it, `highside docs` shows it offline, search too."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from daemon import HIGHSIDE

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

ROOT = Path(__file__).resolve().parents[2]
SERVED = (
    "import sys; from pathlib import Path; import highside.packaged as packaged;"
    " packaged._PACKAGE = Path(sys.argv.pop(1)); from highside.cli.main import main; main()"
)
"""`highside` with its package data elsewhere: a test does not write into the checkout"""


@pytest.fixture(scope="module")
def builder() -> Iterator[ModuleType]:
    pytest.importorskip("zensical", reason="the extra `docs`")
    sys.path.insert(0, str(ROOT / "docs" / "site"))
    try:
        import build as found  # type: ignore[import-not-found]

        yield found
    finally:
        sys.path.pop(0)
        for name in ("build", "pages"):
            sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def package(builder: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package folder with the site in it."""
    folder = tmp_path_factory.mktemp("package")
    assert builder.build(folder / "site") > 50
    return folder


def test_every_page_is_in_the_site_and_every_path_and_how_to_in_the_navigation(package: Path) -> None:
    site, settings = package / "site", (ROOT / "docs" / "site" / "zensical.toml").read_text()
    for page in (path for path in (ROOT / "docs").rglob("*.md")):
        place = page.relative_to(ROOT / "docs").with_suffix(".html")
        place = place.with_name("index.html") if place.name == "README.html" else place
        assert (site / place).is_file(), page
        if page.parent.name in ("paths", "howto", "tutorials", "theory"):
            assert f'"{page.relative_to(ROOT / "docs")}"' in settings
    assert "Calibration" in (site / "reference" / "python.html").read_text()
    assert 'id="highside.calibrate"' in (site / "reference" / "python.html").read_text()
    assert (site / "reference" / "asyncapi.json").is_file()


def test_a_broken_link_ends_the_build(builder: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(builder.SiteError, match="leads nowhere"):
        builder.restaged("[x](no-such-page.md)", ROOT / "docs" / "api.md")
    assert builder.restaged("[x](../Makefile)", ROOT / "docs" / "api.md") == "x"
    assert (
        builder.restaged("[x](../api.md#calibrate)", ROOT / "docs" / "theory" / "laws.md") == "[x](../api.md#calibrate)"
    )
    # what leads to no anchor, and to no page of the reference, is for --strict
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
    for text, fails in (("[a](#one)\n\n## One\n", False), ("[a](#two)\n\n## One\n", True), ("[a](lost.md)\n", True)):
        (tmp_path / "docs").mkdir(exist_ok=True)
        (tmp_path / "docs" / "index.md").write_text(f"# Page\n\n{text}")
        (tmp_path / "zensical.toml").write_text('[project]\nsite_name = "x"\n')
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=200, check=False)
        assert (done.returncode != 0) == fails, (text, done.stdout, done.stderr)


def test_a_page_that_would_fetch_something_is_noticed(builder: ModuleType) -> None:
    for text in (b'<script src="https://x.example/a.js">', b"<link rel=stylesheet href=//x.example/b.css>"):
        assert builder.OUTSIDE.search(text)
    assert not builder.OUTSIDE.search(b'<a href="https://x.example/">x</a> <script src="assets/a.js">')


@pytest.fixture
def served(package: Path) -> Iterator[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", SERVED, str(package), "docs", "errors", "--no-browser"],
        stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    assert process.stdout is not None
    try:
        yield process.stdout.readline().split()[0]
    finally:
        process.terminate()
        process.wait(20)
        process.stdout.close()


def test_highside_docs_shows_the_page_and_the_search_works_without_a_network(served: str) -> None:
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium")
    if chromium is None:
        assert not os.environ.get("CI"), "no chromium"
        pytest.skip("no chromium")
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/reference/errors\.html", served)
    own = served.removesuffix("reference/errors.html")
    asked: list[str] = []
    said: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
        page.goto(served, timeout=60_000)
        page.locator(".md-search__button").first.click()
        page.keyboard.type("rotor angle compensation")
        page.get_by_text(re.compile(r"\d+ results")).wait_for(timeout=60_000)
        page.keyboard.press("Enter")
        page.wait_for_url(re.compile(r"\?h=rotor"), timeout=60_000)
        for width in (1280, 390):
            page.set_viewport_size({"width": width, "height": 900})
            page.goto(f"{own}reference/configuration.html", timeout=60_000)
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        browser.close()
    assert len(asked) > 5 and all(address.startswith((own, "blob:", "data:")) for address in asked), asked
    assert not said


def test_without_a_site_and_with_a_wrong_name_one_line_says_what_to_do(package: Path, tmp_path: Path) -> None:
    def docs(folder: Path, name: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", SERVED, str(folder), "docs", name, "--no-browser"]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)

    done = docs(tmp_path, "index")
    assert (done.returncode, done.stdout) == (2, "")
    assert (
        done.stderr
        == "highside: the documentation was not built into this installation; run `make docs` in the checkout\n"
    )
    done = docs(package, "eror")
    assert done.returncode == 2 and "no such page" in done.stderr and "errors" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_examples_are_copied_and_files_of_the_user_are_kept(tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "bench.toml").write_text("mine")
    done = subprocess.run(
        [HIGHSIDE, "examples", "-o", "config"], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True
    )
    assert re.fullmatch(r"config: \d+ examples, 1 that were there are kept\n", done.stdout)
    assert (tmp_path / "config" / "bench.toml").read_text() == "mine"
    assert (tmp_path / "config" / "highside.dbc").read_bytes() == (ROOT / "config" / "highside.dbc").read_bytes()
    (tmp_path / "file").write_text("")
    done = subprocess.run(
        [HIGHSIDE, "examples", "-o", "file"], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 2 and done.stderr.startswith("highside: file: cannot be written")
