"""What stands on a live page while its programs are on their way.

The library shows after a second that the browser is too old for it, whatever the reason: over a bad line, or from a
busy machine, everybody read that. It stays for a browser that is (one without ES modules runs what is marked
`nomodule`); all others read that the page is being loaded, in their own language.
"""

from __future__ import annotations

import json

from nicegui import ui

from highside.web.words import _

_TOO_OLD = '<script nomodule>document.documentElement.className += " too-old";</script>'
_STYLE = """
html:not(.too-old) #esm-fallback { font-size: 0; }
html:not(.too-old) #esm-fallback::after { content: %s; font-size: 1.25rem; color: var(--soft); padding: 0 1rem; }
"""


def say_while_it_loads() -> None:
    """For the page that is being built."""
    ui.add_head_html(_TOO_OLD)
    # a string of JSON is one of CSS, too, as long as it has no line break
    ui.add_css(_STYLE % json.dumps(_("The page is being loaded..."), ensure_ascii=False))
