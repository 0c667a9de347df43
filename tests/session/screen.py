"""What stands on a terminal after a program has written to it: enough of one to see a picture drawn over itself."""

from __future__ import annotations

import re

_TOKEN = re.compile(rb"\x1b\[([0-9;?]*)([A-Za-z])|\x1b[^\[]|\r|\n|[^\x1b\r\n]+")


def screen(written: bytes) -> list[str]:
    """The lines, the scrolled ones too; cursor up, erase line, carriage return and line feed are obeyed."""
    lines, row, column = [""], 0, 0
    for token in _TOKEN.finditer(written):
        text, numbers, command = token[0], token[1], token[2]
        if command == b"A":
            row = max(0, row - int(numbers or 1))
        elif command == b"K":
            lines[row] = "" if numbers == b"2" else lines[row][:column]
        elif text == b"\r":
            column = 0
        elif text == b"\n":
            row, column = row + 1, 0
            lines += [""] * (row + 1 - len(lines))
        elif not text.startswith(b"\x1b"):
            shown = text.decode("utf-8", "replace")
            lines[row] = lines[row][:column].ljust(column) + shown + lines[row][column + len(shown) :]
            column += len(shown)
    return [line.rstrip() for line in lines]
