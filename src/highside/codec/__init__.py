"""Sans-IO framing and decoding: bytes or CAN frames in, `Frame`s out, and counts that add up.

`frame` says what a codec is, `stream` does the framing of those with sync bytes, `registry` is the one table of names;
each wire format is one file.
"""

from __future__ import annotations

__all__ = ["axes", "clock", "frame", "registry", "stream"]
"""the ways in: modules, loaded on request"""
