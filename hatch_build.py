"""What the build adds to the metadata: the long description, and the address of the project where it has one.

An index page shows the README away from its repository: pictures and links that are relative there lead nowhere here.
With the public address of the repository (`source-url` of `[tool.hatch.metadata.hooks.custom]`, or HIGHSIDE_SOURCE_URL
in the environment of the build) they become absolute, of the version that is built. Without one, nothing is made up: a
picture gives way to its description, a link to its text.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

IMAGE = re.compile(r"!\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]+)\)")
LINK = re.compile(r"(?<!!)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]+)\)")
ELSEWHERE = re.compile(r"[a-z][a-z0-9+.-]*:|#", re.IGNORECASE)
"""Targets that mean the same wherever they are read: an address, or a heading of the page itself."""
FENCE = re.compile(r"(^ *```.*?^ *```[^\n]*$)", re.MULTILINE | re.DOTALL)


def long_description(readme: str, files_url: str | None, pages_url: str | None) -> str:
    """The README for readers elsewhere. `files_url`, `pages_url`: what a path of the repository is put behind, for a
    file as it is and for a page that shows it; None: the repository has no public address. Code is left as it is."""

    def picture(found: re.Match[str]) -> str:
        if ELSEWHERE.match(found["target"]):
            return found[0]
        return f"![{found['text']}]({files_url}{found['target']})" if files_url else f"*(picture: {found['text']})*"

    def link(found: re.Match[str]) -> str:
        if ELSEWHERE.match(found["target"]):
            return found[0]
        return f"[{found['text']}]({pages_url}{found['target']})" if pages_url else found["text"]

    parts = FENCE.split(readme)
    # every second part is a block of code
    parts[::2] = [LINK.sub(link, IMAGE.sub(picture, part)) for part in parts[::2]]
    return "".join(parts)


class AddressedReadme(MetadataHookInterface):
    """Fills in `readme` and `urls`, which `[project]` declares dynamic."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        source = (os.environ.get("HIGHSIDE_SOURCE_URL") or str(self.config.get("source-url", ""))).rstrip("/")
        if source and not source.startswith("https://"):
            raise ValueError(f"HIGHSIDE_SOURCE_URL: {source!r} is no https:// address")

        def at(key: str) -> str | None:
            return str(self.config[key]).format(source=source, version=metadata["version"]) if source else None

        readme = Path(self.root, "README.md").read_text(encoding="utf-8")
        text = long_description(readme, at("files-url"), at("pages-url"))
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
        metadata["urls"] = {"Source": source, "Changelog": f"{at('pages-url')}CHANGELOG.md"} if source else {}
