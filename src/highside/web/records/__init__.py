"""What is kept, in a browser: calibration records with their history, and bench sessions. Read alone, never written.

`shelf` reads store and journals, `views` makes pages of it by templates that escape, `routes` answers requests. These
pages are plain HTML without a script: the policy sent with them forbids all of it to the browser.
"""

from __future__ import annotations

__all__ = ["routes", "shelf", "views"]
"""the ways in: modules, loaded on request"""
