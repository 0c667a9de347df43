"""Ways in which files are spoilt: each gives the bytes of a file and the session that is still true of it, or None
where it cannot be applied to that file."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from foreign_session import Session
from foreign_texts import ForeignFile

Spoilt = tuple[bytes, Session] | None
Mutation = Callable[[ForeignFile, Session, np.random.Generator], Spoilt]

_UNITS = (
    (("m/s^2", "m/s²", "m/s2", "mps2", "m_s2", "m/(s^2)"), ("g", "mg", "cm/s2")),
    (("mdps",), ("dps", "rad/s", "deg/s")),
    (("rad/s", "rads"), ("deg/s", "mdps")),
    (("deg/s", "°/s", "dps"), ("rad/s", "mdps")),
    (("[us]",), ("[ms]", "[s]", "[ns]")),
    (("(ms)", " ms"), ("(us)", " s")),
    (("(s)", "[s]"), ("(ms)", "[us]")),
    (("(g)", "_g", "[g]"), ("(m/s2)", "_mps2", "[mg]")),
    (("[mg]",), ("[g]", "[m/s2]")),
)
"""units as they stand in headers, and what is written in their place"""


def scaled_accelerations(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    by = float(rng.choice([9.80665, 1 / 9.80665, 1000.0, 1e-3, 2.0, 0.5, 101.97, 1.3]))
    return file.write(s.scaled(accel=by)), s


def scaled_rates(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    if "g" not in file.columns:
        return None
    by = float(rng.choice([57.29578, 1 / 57.29578, 1000.0, 1e-3, 2.0, 16.4, -1.0]))
    return file.write(s.scaled(rate=by)), s


def scaled_times(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    """Of a file without rates nothing shows it but the rows/s (docs/import.md)."""
    if "g" not in file.columns or "rate_hz" in file.answer:
        return None
    spoilt = s.scaled(time=float(rng.choice([1000.0, 1e-3, 60.0, 2.0, 0.5])))
    return None if (written := file.write(spoilt)) == file.write(s) else (written, s)


def one_sign(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    """Of a file with accelerations alone nothing shows it (docs/import.md)."""
    if file.columns == "a":
        return None
    signs = [1, 1, 1]
    signs[int(rng.integers(3))] = -1
    return file.write(s.turned((0, 1, 2), tuple(signs), rates=False)), s


def two_axes(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    if file.columns == "a":
        return None
    order = [(1, 0, 2), (0, 2, 1), (2, 1, 0), (1, 2, 0)][int(rng.integers(4))]
    return file.write(s.turned(order, (1, 1, 1), rates=False)), s


def one_rate(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    if "g" not in file.columns:
        return None
    sign = np.ones(3)
    sign[int(rng.integers(3))] = -1.0
    return file.write(replace(s, rate_dps=sign[:, None] * s.rate_dps)), s


def whole_triads(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    """Rates and accelerations turned together, which a reference alone shows."""
    if "r" not in file.columns:
        return None
    order = [(1, 0, 2), (0, 2, 1), (2, 0, 1), (0, 1, 2)][int(rng.integers(4))]
    signs = [(-1, 1, 1), (1, -1, -1), (-1, -1, -1), (1, 1, -1)][int(rng.integers(4))]
    return file.write(s.turned(order, signs, rates=True)), s


def cut_rows(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    if "fs" in file.answer or "rate_hz" in file.answer or file.tool in ("NumPy", "ActiLife"):
        return None  # rows that carry no time
    begin = int(rng.integers(1, s.n - 40))
    kept = s.rows(np.delete(np.arange(s.n), np.arange(begin, begin + int(rng.integers(1, 30)))))
    return file.write(kept), kept


def text_of(data: bytes) -> str | None:
    """The content of a text; None for a container."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return None
    return text if "\0" not in text else None


def torn_end(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    data = file.write(s)
    return None if text_of(data) is None else (data[: -int(rng.integers(2, 400))], s)


def parts(data: bytes) -> tuple[list[str], list[str], list[str]] | None:
    """Lines before the rows but the header, the header's cells, and the rows; the last cell is the separator."""
    text = text_of(data)
    if text is None:
        return None
    lines = text.replace("\r\n", "\n").rstrip("\n").split("\n")
    separator = max(";\t,", key=lines[-1].count)
    width = lines[-1].count(separator)
    rows = next((k for k, line in enumerate(lines) if line.count(separator) == width and re.match(r'"?[\d-]', line)), 0)
    if width < 3 or rows == 0 or lines[rows - 1].count(separator) != width:
        return None
    return lines[: rows - 1], [*lines[rows - 1].split(separator), separator], lines[rows:]


def joined(before: list[str], header: list[str], rows: list[str]) -> bytes:
    return ("\n".join([*before, header[-1].join(header[:-1]), *rows]) + "\n").encode()


def other_unit(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    """A unit in the header is replaced by another one of the same quantity."""
    found = parts(file.write(s))
    if found is None:
        return None
    before, header, rows = found
    there = [pair for pair in _UNITS if any(unit in name for unit in pair[0] for name in header[:-1])]
    if not there:
        return None
    units, others = there[int(rng.integers(len(there)))]
    if (units == ("[us]",) and "g" not in file.columns) or (units[0] in ("(ms)", "(s)") and "g" not in file.columns):
        return None
    other = str(rng.choice(others))
    pattern = re.compile("|".join(re.escape(unit) for unit in units))
    header = [*(pattern.sub(other, name) for name in header[:-1]), header[-1]]
    return joined(before, header, rows), s


def other_names(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    """Names of two columns exchanged, or replaced by words that say nothing."""
    found = parts(file.write(s))
    if found is None or file.columns == "a":
        return None
    before, header, rows = found
    a, b = (int(k) for k in rng.choice(len(header) - 1, 2, replace=False))
    if rng.random() < 0.7:
        header[a], header[b] = header[b], header[a]
    else:
        header[a] = "sensor value"
    return joined(before, header, rows), s


def shuffled_columns(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    found = parts(file.write(s))
    if found is None:
        return None
    before, header, rows = found
    separator = header[-1]
    order = rng.permutation(len(header) - 1)
    cells = [row.split(separator) for row in rows]
    return joined(
        before, [*(header[k] for k in order), separator], [separator.join(row[k] for k in order) for row in cells]
    ), s


def other_separator(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    data = file.write(s)
    found = parts(data)
    if found is None:
        return None
    other = str(rng.choice([mark for mark in ";\t,|" if mark != found[1][-1]]))
    return data.replace(found[1][-1].encode(), other.encode()), s


def other_point(file: ForeignFile, s: Session, rng: np.random.Generator) -> Spoilt:
    """Decimal commas: with a separator that fits them, or with one that makes nonsense of the rows."""
    text = text_of(file.write(s))
    if text is None or "," not in text:
        return None
    fits = rng.random() < 0.5
    text = text.replace(",", ";") if fits else text
    return re.sub(r"(?<=\d)\.(?=\d)", ",", text).encode(), s


MUTATIONS: tuple[Mutation, ...] = (
    scaled_accelerations, scaled_rates, scaled_times, one_sign, two_axes, one_rate, whole_triads, cut_rows, torn_end,
    other_unit, other_names, shuffled_columns, other_separator, other_point,
)  # fmt: skip
