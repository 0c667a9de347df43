"""Draws `docs/demo.svg`: the live table of `highside demo` after 20 seconds. Run it again when the table changes."""

from __future__ import annotations

import asyncio
import io
import re
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import MONOKAI

from highside.cli.demo import live_table
from highside.service.demo import run_demo


def main() -> None:
    """Run the demonstration and save its last picture."""
    last = asyncio.run(run_demo(20.0, lambda snapshot: None))
    console = Console(record=True, width=86, file=io.StringIO(), force_terminal=True)
    console.print(live_table(last))
    svg = console.export_svg(title="highside demo", theme=MONOKAI)
    # no font is fetched from anywhere: the viewer's own monospaced one will do
    svg = re.sub(r"@font-face\s*\{.*?\}", "", svg, flags=re.DOTALL).replace("Fira Code", "DejaVu Sans Mono")
    svg = "\n".join(line.rstrip() for line in svg.splitlines() if line.strip()) + "\n"
    Path(__file__).with_name("demo.svg").write_text(svg)


if __name__ == "__main__":
    main()
