"""Builds the documentation site: `make docs`, or `python docs/site/build.py [--to FOLDER]`.

The pages of `docs`, the root's own (changelog, contributing, security) and the reference made from the code are put
side by side, and Zensical makes the site of them: a link that leads nowhere, in the text or to an anchor, is an error.
The site takes nothing from the network: fonts are the system's, script and index of the search lie beside the pages.
`highside docs` shows the site from `src/highside/site`, from where it also gets into wheel and sdist.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PACKAGED = ROOT / "src" / "highside" / "site"
ROOT_PAGES = {
    "README.md": "readme.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "SECURITY.md": "security.md",
}
FENCE = re.compile(r"(^ *```.*?^ *```$)", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^()\s]+)\)")
OUTSIDE = re.compile(rb"""<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=["']?((?:https?:)?//[^"'\s>]+)""")
SHIM = re.compile(r'<script src="https://unpkg\.com/iframe-worker/shim"[^>]*></script>')
"""What lets the search run from file://; the site is shown by a server on the loopback and needs none."""


class SiteError(Exception):
    """The site cannot be built."""


def place_of(path: Path) -> Path | None:
    """Where a file of the repository lies in the site's sources; None: not there."""
    inside = path.relative_to(ROOT)
    if str(inside) in ROOT_PAGES:
        return Path(ROOT_PAGES[str(inside)])
    if inside.parts[0] == "docs" and path.is_file() and path.suffix in (".md", ".svg", ".png"):
        return Path(*inside.parts[1:])
    if inside.parts[:2] == ("docs", "tutorials") and path.suffix == ".py":
        return Path(*inside.parts[1:]).with_suffix(".txt")  # what a tutorial has its reader run: no code of the package
    if inside.parts[0] == "docs" and (path / "README.md").is_file():
        return Path(*inside.parts[1:]) / "README.md"
    return None


def restaged(text: str, page: Path) -> str:
    """The text of a page of the repository, its links as they are in the site. A link to a file that is no page of the
    site (a source, a configuration) stays as its words: the site stands without the repository."""
    own = place_of(page)
    assert own is not None

    def link(found: re.Match[str]) -> str:
        mark, words, target = found.groups()
        path, hash_, anchor = target.partition("#")
        if not path or re.match(r"[a-z]+:", path):
            return found[0]
        file = (page.parent / path).resolve()
        if not file.exists():
            generated = own.parent / path
            if "reference" in generated.parts:
                return found[0]
            raise SiteError(f"{page.relative_to(ROOT)}: {target} leads nowhere")
        place = place_of(file) if file.is_relative_to(ROOT) else None
        if place is None:
            return words
        up = "../" * (len(own.parts) - 1)
        return f"{mark}[{words}]({up}{place}{hash_}{anchor})"

    parts = FENCE.split(text)
    return "".join(part if part.lstrip().startswith("```") else LINK.sub(link, part) for part in parts)


def stage(folder: Path) -> None:
    """Put all pages into `folder`."""
    import pages

    sources = [ROOT / name for name in ROOT_PAGES]
    sources += [path for path in (ROOT / "docs").rglob("*") if path.is_file() and HERE not in path.parents]
    for path in sources:
        place = place_of(path)
        if place is None or path.suffix == ".pyc":
            continue
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".md":
            (folder / place).write_text(restaged(path.read_text(), path))
        else:
            shutil.copy(path, folder / place)
    reference = folder / "reference"
    reference.mkdir(exist_ok=True)
    for name, text in pages.pages().items():
        (reference / name).write_text(text)
    shutil.copy(HERE / "site.css", folder / "site.css")


def build(to: Path) -> int:
    """Build the site into the folder `to`; the number of its pages. Raises SiteError with what is wrong."""
    with tempfile.TemporaryDirectory() as made:
        work = Path(made)
        stage(work / "docs")
        settings = (HERE / "zensical.toml").read_text().replace("SOURCES", str(ROOT / "src"))
        (work / "zensical.toml").write_text(settings)
        command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
        done = subprocess.run(command, cwd=work, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            said = re.sub(r"\x1b\[[0-9;]*m", "", done.stdout + done.stderr)
            raise SiteError("\n".join(line for line in said.splitlines() if line.strip())[:6000])
        site = work / "site"
        html = sorted(site.rglob("*.html"))
        for page in html:
            page.write_text(SHIM.sub("", page.read_text()))
            if fetched := OUTSIDE.findall(page.read_bytes()):
                raise SiteError(f"{page.relative_to(site)} fetches {fetched[0].decode()}")
        if to.exists():
            shutil.rmtree(to)
        shutil.copytree(site, to)
    return len(html)


def main() -> None:
    parser = argparse.ArgumentParser(description="Build the documentation site.")
    parser.add_argument(
        "--to", type=Path, default=PACKAGED, help="folder, emptied first; the package's own if not given"
    )
    to = parser.parse_args().to.resolve()
    try:
        count = build(to)
    except SiteError as error:
        sys.exit(f"docs: {error}")
    sys.stdout.write(f"{to}: {count} pages; `highside docs` shows them\n")


if __name__ == "__main__":
    main()
